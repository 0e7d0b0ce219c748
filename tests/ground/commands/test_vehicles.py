"""Who is there: through a router with dozens of aircraft, and on a link to one; no one is asked for it."""

import json
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from contract.link_config import link_config
from contract.topics import ALIVE, ANY_VEHICLE, FEATURES, STATUS
from contract.vehicle_status import VehicleStatus, encode_status
from contract.wire.codec import encode
from ground.__main__ import main
from ground.client import SetCache, open_link
from ground.pins.sharing import PinSharing
from ground.pins.store import PinStore
from ground.presence import Presence, vehicles_there
from onboard.link.publisher import Publisher
from tests.onboard.link.ports import free_endpoint
from tests.onboard.link.test_access import WIDE
from tests.onboard.link.test_publisher import a_set
from tests.waiting import eventually

MANY = 24


class Aircraft:
    """Of a fleet, as light as can be: a token, a status when it is asked to, and a count of what it is asked."""

    def __init__(self, name: str, endpoint: str) -> None:
        self.name, self.asked = name, 0
        self.session = zenoh.open(zenoh.Config.from_json5(link_config("client", connect=[endpoint], is_aircraft=True)))
        self.queryables = [self.session.declare_queryable(t.key(name), self._count) for t in (FEATURES, STATUS)]
        self.token = self.session.liveliness().declare_token(ALIVE.key(name))

    def say(self, state: str) -> None:
        self.session.put(STATUS.key(self.name), encode_status(VehicleStatus(1.7e9, 7, state, reason="why", ok_hz=2.0)))

    def _count(self, query: zenoh.Query) -> None:
        self.asked += 1
        query.drop()


@pytest.fixture
def router() -> Iterator[str]:
    """A router without certificates: what may be done is tested elsewhere."""
    from ground.router import REGIONS  # noqa: PLC0415

    endpoint = free_endpoint()
    config = json.loads(link_config("router", listen=[endpoint]))
    config["gateway"] = {"south": [{"filters": [region]} for region in REGIONS]}
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))):
        yield endpoint


@pytest.fixture
def fleet(router: str) -> Iterator[list[Aircraft]]:
    with ExitStack() as opened:
        fleet = [Aircraft(f"uav-{k:02d}", router) for k in range(MANY)]
        for aircraft in fleet:
            opened.enter_context(aircraft.session)
        yield fleet


def rows(text: str) -> dict[str, dict[str, object]]:
    return {row["vehicle"]: row for row in map(json.loads, text.splitlines())}


def test_dozens_of_aircraft_are_listed_and_none_of_them_is_asked(
    router: str, fleet: list[Aircraft], capsys: pytest.CaptureFixture[str]
) -> None:
    with open_link("client", router, None) as session:
        assert eventually(lambda: len(vehicles_there(session)) == MANY)
    listed: dict[str, dict[str, object]] = {}

    def are_listed() -> bool:
        """In half a second and what it takes to connect; asked again where a busy machine took longer."""
        began_s = time.monotonic()
        code = main(["vehicles", "--connect", router, "--json", "--wait", "0.5"])
        took_s = time.monotonic() - began_s
        listed.clear()
        listed.update(rows(capsys.readouterr().out))
        return code == 0 and list(listed) == [a.name for a in fleet] and took_s < 2.0

    assert eventually(are_listed)
    assert all(row["link"] == "up" and row["last_seen_s"] is None for row in listed.values())
    assert [a.asked for a in fleet] == [0] * MANY


def test_state_and_age_come_from_what_is_sent_anyway_and_who_goes_is_gone(router: str, fleet: list[Aircraft]) -> None:
    with open_link("client", router, None) as session:
        presence = Presence(session)
        assert eventually(lambda: len(presence.now()) == MANY)

        reported_s = time.monotonic()

        def received(name: str, state: str) -> bool:
            fleet[3].say(state)
            (one,) = (p for p in presence.now() if p.vehicle == name)
            return one.status is not None and one.status.state == state

        assert eventually(lambda: received("uav-03", "no_gps"))
        (one,) = (p for p in presence.now() if p.vehicle == "uav-03")
        assert one.is_there
        assert 0.0 <= one.status_age_s < time.monotonic() - reported_s + 0.1
        fleet[3].session.close()
        assert eventually(lambda: [p.vehicle for p in presence.now() if not p.is_there] == ["uav-03"])
        assert eventually(lambda: len(there := vehicles_there(session)) == MANY - 1 and "uav-03" not in there)
    assert [a.asked for a in fleet] == [0] * MANY


def test_a_click_that_names_no_aircraft_among_many_asks_no_one(
    router: str, fleet: list[Aircraft], capsys: pytest.CaptureFixture[str]
) -> None:
    with open_link("client", router, None) as session:
        assert eventually(lambda: len(vehicles_there(session)) == MANY)
    click = ["click", "320", "240", "--connect", router]

    def is_refused() -> bool:
        assert main(click) == 2
        printed = capsys.readouterr().err
        return "several aircraft are at" in printed and "--vehicle" in printed and "uav-07" in printed

    assert eventually(is_refused)
    assert [a.asked for a in fleet] == [0] * MANY

    def is_asked() -> bool:
        assert main([*click, "--vehicle", "uav-07"]) == 2  # which answers nothing here
        return any(a.asked for a in fleet)

    assert eventually(is_asked)
    assert [a.name for a in fleet if a.asked] == ["uav-07"]


def test_a_server_that_shares_pins_through_the_router_relays_no_aircraft(router: str, tmp_path: Path) -> None:
    """Who reaches that server only has the rights of that server: to its pins."""
    endpoint, received, near = free_endpoint(), [], []
    with (
        Publisher("uav-1", [], [router], rate=WIDE) as publisher,
        PinStore(tmp_path / "pins.sqlite") as store,
        PinSharing(store, listen=[endpoint], connect=[router]),
        open_link("client", endpoint, None) as stranger,
        open_link("client", endpoint, None) as liar,
        open_link("client", router, None) as friend,
    ):
        stranger.declare_subscriber("pc/*/features", received.append)
        stranger.declare_subscriber("pc/pins/*/said", near.append)
        with SetCache(router) as cache:

            def hears() -> bool:
                publisher.publish(a_set(3))
                return cache.by_frame("uav-1", 3) is not None and bool(near)

            assert eventually(lambda: hears() and vehicles_there(friend) == ["uav-1"])
            for _ in range(10):
                liar.put(FEATURES.key("uav-1"), encode(a_set(99)))
                publisher.publish(a_set(4))
                time.sleep(0.03)
            assert eventually(lambda: cache.by_frame("uav-1", 4) is not None)
            assert received == [] and vehicles_there(stranger) == [] and cache.by_frame("uav-1", 99) is None


def test_watch_shows_dozens(router: str, fleet: list[Aircraft], capsys: pytest.CaptureFixture[str]) -> None:
    stop = threading.Event()

    def fly() -> None:
        while not stop.wait(0.1):
            for aircraft in fleet:
                aircraft.session.put(FEATURES.key(aircraft.name), encode(a_set(3, vehicle=aircraft.name)))
                aircraft.say("ok")

    flying = threading.Thread(target=fly)
    flying.start()
    try:
        shown: dict[str, dict[str, object]] = {}

        def are_shown() -> bool:
            """All of them in three seconds, or in the next three where a busy machine lost some."""
            assert main(["watch", "--connect", router, "--json", "--count", "1", "--period", "3"]) == 0
            shown.clear()
            shown.update(rows(capsys.readouterr().out))
            return list(shown) == [a.name for a in fleet]

        assert eventually(are_shown)
    finally:
        stop.set()
        flying.join()
    assert all(row["ce90_m"] is not None and row["frame"] == 3 for row in shown.values())


def test_the_only_aircraft_behind_a_router_needs_no_name(router: str, capsys: pytest.CaptureFixture[str]) -> None:
    with Publisher("uav-1", [], [router], rate=WIDE) as publisher:
        publisher.publish(a_set(3))
        with open_link("client", router, None) as session:
            assert eventually(lambda: vehicles_there(session) == ["uav-1"])
        click = ["click", "320", "240", "--connect", router, "--max-age", "inf", "--format", "json"]
        assert eventually(lambda: main(click) == 0)
        assert json.loads(capsys.readouterr().out.splitlines()[-1])["frame"] == 3


def test_a_table_is_for_people_and_an_aircraft_of_an_earlier_version_is_there_as_long_as_it_is_received(
    capsys: pytest.CaptureFixture[str],
) -> None:
    endpoint = free_endpoint()
    assert main(["vehicles", "--connect", endpoint]) == 2
    assert "nothing listens" in capsys.readouterr().err
    with zenoh.open(zenoh.Config.from_json5(link_config("peer", listen=[endpoint]))) as old:
        assert eventually(lambda: main(["vehicles", "--connect", endpoint, "--wait", "0.3"]) == 1)
        assert "no aircraft is there" in capsys.readouterr().err
        state = encode_status(VehicleStatus(1.7e9, 7, "no_gps", reason="fix lost", ok_hz=0.5))
        with open_link("client", endpoint, None) as session:
            presence = Presence(session)

            def received() -> bool:
                old.put(STATUS.key("old-1"), state)
                return [p.is_there for p in presence.now()] == [True]

            assert eventually(received)
    with Publisher("uav-1", [endpoint], rate=WIDE) as publisher:
        publisher.publish_status(state, b"{}")
        with open_link("client", endpoint, None) as session:
            assert eventually(lambda: vehicles_there(session) == ["uav-1"])
            assert not [r for r in session.get(ALIVE.key(ANY_VEHICLE), timeout=0.5) if r.ok]
        assert eventually(lambda: main(["vehicles", "--connect", endpoint, "--wait", "0.3"]) == 0)
        heads, row = capsys.readouterr().out.splitlines()[-2:]
        assert heads.split()[:3] == ["vehicle", "link", "state"] and row.split()[:2] == ["uav-1", "up"]
