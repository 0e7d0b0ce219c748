"""The ground station's router with real certificates and sessions on loopback: who hears, asks and publishes what."""

import contextlib
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import zenoh

from contract.errors import InputError, LinkError
from contract.fleet import FLEET_FILE, Fleet, read_fleet
from contract.link_config import Tls, link_config
from contract.topics import ALIVE, FEATURES, STATUS
from contract.whole_file import save
from contract.wire.codec import encode
from ground.__main__ import main
from ground.client import SetCache, ask
from ground.commands.router import ListOfFile
from ground.pins.sharing import PinSharing
from ground.pins.store import PinStore
from ground.router import Router, router_config
from onboard.__main__ import main as onboard_main
from onboard.link.publisher import Publisher
from tests.ground.pins.test_store import clicked
from tests.onboard.link.asking import asked, nobody_answers
from tests.onboard.link.ports import free_endpoint
from tests.onboard.link.test_access import WIDE, session
from tests.onboard.link.test_publisher import a_set
from tests.waiting import PATIENCE_S, eventually

ROOT = Path(__file__).resolve().parents[2]
LIE = 99_999  # a picture that no one has taken
ROUTER = (sys.executable, "-m", "ground", "router")


@dataclass(frozen=True)
class Station:
    keys: Path
    endpoint: str
    router: Router

    def tls(self, name: str) -> Tls:
        return Tls.in_folder(self.keys / name)

    def aircraft(self, name: str) -> Publisher:
        return Publisher(name, [], [self.endpoint], rate=WIDE, tls=self.tls(name))

    def session(self, name: str, mode: str = "client") -> zenoh.Session:
        return session(self.endpoint, self.tls(name), mode)

    def cache(self, name: str) -> SetCache:
        return SetCache(self.endpoint, tls=self.tls(name))


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    words = ["--router", "base", "--vehicle", "uav-1", "--vehicle", "uav-2", "--operator", "anna", "--operator", "cleo"]
    assert onboard_main(["make-credentials", str(folder), *words, "--viewer", "ben"]) == 0
    assert onboard_main(["make-credentials", str(folder), "--viewer", "former"]) == 0
    fleet = read_fleet(folder / FLEET_FILE)
    assert fleet.router == "base" and fleet.aircraft == ("uav-1", "uav-2") and fleet.viewers == ("ben", "former")
    assert fleet.operators == fleet.pins == ("anna", "cleo")
    save(folder / FLEET_FILE, replace(fleet, viewers=("ben",)).to_toml())
    return folder


@pytest.fixture
def station(keys: Path) -> Iterator[Station]:
    endpoint = free_endpoint().replace("tcp/", "tls/")
    fleet = replace(read_fleet(keys / FLEET_FILE), listen=(endpoint,))
    with Router(fleet, keys) as router:
        yield Station(keys, endpoint, router)


@contextlib.contextmanager
def ended(program: subprocess.Popen[bytes]) -> Iterator[None]:
    try:
        yield
        assert program.poll() is None
    finally:
        program.terminate()
        status = program.wait(PATIENCE_S)
    assert status == 0


def is_received(cache: SetCache, publisher: Publisher, vehicle: str, frame: int) -> bool:
    """Whether a set arrives that is published until it does."""

    def again() -> bool:
        publisher.publish(a_set(frame, vehicle=vehicle))
        return cache.by_frame(vehicle, frame) is not None

    return eventually(again)


def frames(endpoint: str, tls: Tls) -> dict[str, int | None]:
    """The pictures that are answered of: of each aircraft its newest, where all had the time to answer."""
    return {name: answer.frame for name, answer in asked(endpoint, tls=tls).items()}


def test_operators_hear_and_ask_and_viewers_only_hear(station: Station) -> None:
    with station.aircraft("uav-1") as first, station.aircraft("uav-2") as second:
        for who in ("anna", "ben"):
            with station.cache(who) as cache:
                assert is_received(cache, first, "uav-1", 3) and is_received(cache, second, "uav-2", 5)
        assert eventually(lambda: frames(station.endpoint, station.tls("anna")) == {"uav-1": 3, "uav-2": 5})
        assert nobody_answers(station.endpoint, tls=station.tls("ben"))


def test_an_aircraft_that_publishes_under_another_s_name_is_not_received(station: Station) -> None:
    status: list[bytes] = []
    with (
        station.aircraft("uav-1") as true,
        station.session("uav-2") as liar,
        station.session("anna") as listener,
        station.cache("anna") as cache,
    ):
        listener.declare_subscriber("pc/*/status", lambda sample: status.append(sample.payload.to_bytes()))
        liar.declare_queryable(FEATURES.key("uav-1"), lambda q: q.reply(FEATURES.key("uav-1"), encode(a_set(99))))
        liar.liveliness().declare_token(ALIVE.key("uav-3"))
        assert is_received(cache, true, "uav-1", 3)
        last = 10

        def is_heard_of_itself() -> bool:
            """Five times what it may say, which comes after the lies."""
            nonlocal last
            last += 1
            liar.put(FEATURES.key("uav-1"), encode(a_set(LIE)))
            liar.put(STATUS.key("uav-1"), b"a lie")
            liar.delete(FEATURES.key("uav-1"))
            liar.put(STATUS.key("uav-2"), b"its own")
            true.publish(a_set(last))
            return status.count(b"its own") >= 5

        assert eventually(is_heard_of_itself)
        assert eventually(lambda: cache.by_frame("uav-1", last) is not None)
        assert b"a lie" not in status
        assert cache.by_frame("uav-1", LIE) is None and cache.dropped.unreadable == 0
        answer = asked(station.endpoint, "uav-1", tls=station.tls("anna"))["uav-1"]
        assert answer.frame == last
        tokens: set[str] = set()

        def is_told() -> bool:
            tokens.update(str(reply.ok.key_expr) for reply in listener.liveliness().get(ALIVE.key("*")) if reply.ok)
            return bool(tokens)

        assert eventually(is_told)
        assert tokens == {ALIVE.key("uav-1")}


@pytest.mark.parametrize("who", ["anna", "ben", "uav-2"])
def test_people_and_other_aircraft_publish_nothing_of_an_aircraft_s(station: Station, who: str) -> None:
    with station.aircraft("uav-1") as true, station.session(who) as other, station.cache("anna") as cache:
        assert is_received(cache, true, "uav-1", 3)
        for _ in range(10):
            other.put(FEATURES.key("uav-1"), encode(a_set(99)))
            other.put(FEATURES.key("uav-9"), encode(a_set(99, vehicle="uav-9")))
            time.sleep(0.03)
        assert is_received(cache, true, "uav-1", 4)
        assert cache.by_frame("uav-1", 99) is None and cache.vehicles == ["uav-1"]


def test_an_aircraft_neither_hears_nor_asks_another(station: Station) -> None:
    received: list[str] = []
    with station.aircraft("uav-1") as true, station.session("uav-2") as curious, station.cache("anna") as cache:
        curious.declare_subscriber("pc/**", lambda sample: received.append(str(sample.key_expr)))
        assert is_received(cache, true, "uav-1", 3)
        assert is_received(cache, true, "uav-1", 4)
        assert received == [] and [r for r in curious.get(FEATURES.key("uav-1"), timeout=1.0) if r.ok] == []


def test_a_name_that_was_taken_from_the_list_hears_nothing(station: Station) -> None:
    """Its certificate is still the authority's: the list is what revokes."""
    with station.aircraft("uav-1") as true, station.cache("former") as cache, station.cache("anna") as friend:
        assert is_received(friend, true, "uav-1", 3) and is_received(friend, true, "uav-1", 4)
        assert cache.vehicles == []
        assert nobody_answers(station.endpoint, tls=station.tls("former"))


def test_a_stranger_cannot_connect(station: Station, tmp_path: Path) -> None:
    assert onboard_main(["make-credentials", str(tmp_path), "--operator", "anna"]) == 0
    own = tmp_path / "anna"
    impostor = Tls(str(station.keys / "anna" / "ca.pem"), str(own / "certificate.pem"), str(own / "key.pem"))
    with station.aircraft("uav-1") as true, station.cache("anna") as friend:
        assert is_received(friend, true, "uav-1", 3)
        with pytest.raises(LinkError):
            ask(station.endpoint, tls=impostor)
        with pytest.raises(LinkError):
            ask(station.endpoint.replace("tls/", "tcp/"))
        assert "uav-1" in asked(station.endpoint, tls=station.tls("anna"))


def test_pins_are_shared_by_those_who_may_and_by_no_one_else(station: Station, tmp_path: Path) -> None:
    with contextlib.ExitStack() as opened:
        stores = {name: opened.enter_context(PinStore(tmp_path / f"{name}.sqlite")) for name in ("anna", "cleo", "ben")}
        for name, store in stores.items():
            opened.enter_context(PinSharing(store, connect=[station.endpoint], tls=station.tls(name)))
        stores["ben"].add([clicked()], name="not to be heard", who="ben")
        pin = stores["anna"].add([clicked()], name="tent", who="anna")
        assert eventually(lambda: [p.name for p in stores["cleo"].pins()] == ["tent"])
        stores["cleo"].edit(pin.id, name="red tent", who="cleo")
        assert eventually(lambda: [p.name for p in stores["anna"].pins()] == ["red tent"])
        assert [p.name for p in stores["ben"].pins()] == ["not to be heard"]


def test_one_more_aircraft_is_added_while_all_others_run_on(keys: Path, tmp_path: Path) -> None:
    """The command as it runs: the list is written by make-credentials, and no one but the router does anything."""
    keys = Path(shutil.copytree(keys, tmp_path / "keys"))
    endpoint = free_endpoint().replace("tcp/", "tls/")
    config = keys / FLEET_FILE
    tls = {name: Tls.in_folder(keys / name) for name in ("uav-1", "anna")}
    output = tmp_path / "said"
    with (
        output.open("w") as file,
        ended(subprocess.Popen([*ROUTER, "--config", str(config), "--listen", endpoint], cwd=ROOT, stderr=file)),
        Publisher("uav-1", [], [endpoint], rate=WIDE, tls=tls["uav-1"]) as first,
        SetCache(endpoint, tls=tls["anna"]) as cache,
    ):
        assert is_received(cache, first, "uav-1", 3)
        assert onboard_main(["make-credentials", str(keys), "--vehicle", "late"]) == 0
        with Publisher("late", [], [endpoint], rate=WIDE, tls=Tls.in_folder(keys / "late")) as late:
            assert is_received(cache, late, "late", 5)
            assert is_received(cache, first, "uav-1", 6)
        config.write_text("aircraft = 3\n")
        assert eventually(lambda: "the list from before stays" in output.read_text())
        assert is_received(cache, first, "uav-1", 7)


def test_two_stations_relay_each_other_s_aircraft_and_each_keeps_its_own_rights(keys: Path, station: Station) -> None:
    """Of one authority: the second station is connected to the first, and each has the other on its list."""
    here = Path(shutil.copytree(keys, keys.with_name(f"{keys.name}-east"), dirs_exist_ok=True))
    if not (here / "east").is_dir():
        assert onboard_main(["make-credentials", str(here), "--router", "east", "--operator", "eva"]) == 0
    endpoint = free_endpoint().replace("tcp/", "tls/")
    east = Fleet("east", (endpoint,), (station.endpoint,), aircraft=("uav-2",), operators=("eva",), stations=("base",))
    station.router.replace(replace(station.router.fleet, aircraft=("uav-1",), stations=("east",)))
    with (
        Router(east, here),
        station.aircraft("uav-1") as west,
        Publisher("uav-2", [], [endpoint], rate=WIDE, tls=station.tls("uav-2")) as eastern,
        station.cache("anna") as anna,
        SetCache(endpoint, tls=Tls.in_folder(here / "eva")) as eva,
        session(endpoint, station.tls("uav-2")) as liar,
    ):
        for cache in (anna, eva):
            assert is_received(cache, west, "uav-1", 3) and is_received(cache, eastern, "uav-2", 5)
        assert eventually(lambda: frames(endpoint, Tls.in_folder(here / "eva")) == {"uav-1": 3, "uav-2": 5})
        assert nobody_answers(endpoint, tls=station.tls("anna"))  # not on the list of the east
        for _ in range(10):
            liar.put(FEATURES.key("uav-1"), encode(a_set(99)))
            time.sleep(0.03)
        assert is_received(anna, west, "uav-1", 4) and anna.by_frame("uav-1", 99) is None


def test_a_list_that_cannot_be_leaves_the_router_with_the_one_before(station: Station) -> None:
    with station.aircraft("uav-1") as true, station.cache("anna") as cache:
        assert is_received(cache, true, "uav-1", 3)
        with pytest.raises(LinkError, match=r"no certificate .*/none: pc-onboard make-credentials .* --router none"):
            station.router.replace(replace(station.router.fleet, router="none"))
        with pytest.raises(LinkError, match=r"tcp/127\.0\.0\.1:7447 is not encrypted"):
            station.router.replace(replace(station.router.fleet, listen=("tcp/127.0.0.1:7447",)))
        with pytest.raises(LinkError, match=r"cannot listen at tls/192\.0\.2\.1:7447"):
            station.router.replace(replace(station.router.fleet, listen=("tls/192.0.2.1:7447",)))
        assert is_received(cache, true, "uav-1", 4)


def test_sets_are_thinned_for_each_aircraft_by_itself(station: Station) -> None:
    station.router.replace(replace(station.router.fleet, sets_hz=2.0))
    received: list[str] = []
    with station.session("uav-1") as one, station.session("uav-2") as two, station.session("anna") as anna:
        anna.declare_subscriber(FEATURES.key("*"), lambda sample: received.append(str(sample.key_expr)))
        began_s, sent = time.monotonic(), 0

        def are_sent() -> bool:
            """For two seconds at least, and until two of each have come: the subscription may be known late."""
            nonlocal sent
            one.put(FEATURES.key("uav-1"), b"1")
            two.put(FEATURES.key("uav-2"), b"2")
            sent += 1
            return sent >= 100 and all(received.count(FEATURES.key(name)) >= 2 for name in ("uav-1", "uav-2"))

        assert eventually(are_sent)
        for name in ("uav-1", "uav-2"):
            assert 2 <= received.count(FEATURES.key(name)) <= 2.0 * (time.monotonic() - began_s) + 2.0


def test_what_is_printed_for_zenohd_is_the_router_s_own_configuration(
    keys: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(keys.parent)
    relative = Path(keys.name) / FLEET_FILE
    assert main(["router", "--config", str(relative), "--print-zenohd-config"]) == 0
    text = capsys.readouterr().out
    assert zenoh.Config.from_json5(text).get_json("mode") == '"router"'
    printed = json.loads(text)
    assert printed == router_config(read_fleet(relative), keys)
    for name, path in printed["transport"]["link"]["tls"].items():
        if name.endswith(("certificate", "key")):
            assert Path(path).is_absolute() and Path(path).is_file()
    assert printed["access_control"]["default_permission"] == "deny"
    assert all(subject["cert_common_names"] for subject in printed["access_control"]["subjects"])
    # Without --config it is the list in this folder; and a folder stands for the list in it.
    monkeypatch.chdir(keys)
    for words in ([], ["--config", str(keys)]):
        assert main(["router", "--print-zenohd-config", *words]) == 0
        assert json.loads(capsys.readouterr().out) == printed


def test_the_list_is_read_again_only_when_the_file_is_another(tmp_path: Path) -> None:
    path = tmp_path / FLEET_FILE
    save(path, Fleet(aircraft=("a",)).to_toml())
    listed = ListOfFile(path, ["tls/127.0.0.1:1"])
    assert listed.read() == Fleet(aircraft=("a",), listen=("tls/127.0.0.1:1",))
    assert listed.changed() is None
    save(path, Fleet(aircraft=("a", "b")).to_toml())
    fleet = listed.changed()
    assert fleet.aircraft == ("a", "b") and listed.changed() is None
    path.unlink()
    with pytest.raises(InputError, match="No such file"):
        listed.changed()
    assert listed.changed() is None


def test_an_aircraft_s_certificate_does_not_serve_where_the_router_is_reached(tmp_path: Path) -> None:
    words = ["--router", "base", "--vehicle", "uav-1", "--operator", "anna", "--address", "127.0.0.2"]
    assert onboard_main(["make-credentials", str(tmp_path), *words]) == 0
    endpoint = free_endpoint().replace("tcp/127.0.0.1", "tls/127.0.0.2")
    anna = Tls.in_folder(tmp_path / "anna")
    with Publisher("uav-1", [endpoint], rate=WIDE, tls=Tls.in_folder(tmp_path / "uav-1")) as impostor:
        impostor.publish(a_set(3))
        with pytest.raises(LinkError):
            ask(endpoint, tls=anna)
    fleet = replace(read_fleet(tmp_path / FLEET_FILE), listen=(endpoint,))
    with Router(fleet, tmp_path), Publisher("uav-1", [], [endpoint], tls=Tls.in_folder(tmp_path / "uav-1")) as true:
        true.publish(a_set(4))
        assert "uav-1" in asked(endpoint, tls=anna)


def test_a_router_needs_a_free_port(station: Station) -> None:
    with (
        pytest.raises(LinkError, match="the router cannot listen at tls/127"),
        Router(station.router.fleet, station.keys),
    ):
        pass
    plain = json.loads(link_config("router", listen=[station.endpoint.replace("tls/", "tcp/")]))
    assert "region_name" not in plain and "access_control" not in plain
