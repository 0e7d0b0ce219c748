"""Who may connect, read and publish: certificates and access control over real zenoh sessions on loopback."""

import json
import os
import stat
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zenoh
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from contract.errors import InputError, LinkError
from contract.feature_set import FeatureSet
from contract.link_config import Rights, Tls, link_config
from contract.topics import FEATURES, STATUS
from contract.wire.codec import encode
from ground.__main__ import main as ground_main
from ground.client import SetCache, ask
from onboard.__main__ import main
from onboard.link.certificates import Authority, make_credentials, service_group
from onboard.link.publisher import Publisher, Rate
from tests.onboard.link.asking import asked, nobody_answers
from tests.onboard.link.ports import free_endpoint
from tests.onboard.link.test_publisher import a_set
from tests.waiting import eventually

WIDE = Rate(max_bit_rate=1e8, max_rate_hz=30.0)


@dataclass(frozen=True)
class Place:
    """One aircraft in the air with its certificates, and where it listens."""

    credentials: Path
    endpoint: str
    publisher: Publisher

    def tls(self, name: str) -> Tls:
        return Tls.in_folder(self.credentials / name)


@pytest.fixture(scope="module")
def credentials(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("credentials")
    make_credentials(folder, ["uav-1"], ["anna", "ben"], [], 30.0)
    return folder


@pytest.fixture
def place(credentials: Path) -> Iterator[Place]:
    endpoint = free_endpoint().replace("tcp/", "tls/")
    tls = Tls.in_folder(credentials / "uav-1")
    with Publisher("uav-1", [endpoint], rate=WIDE, tls=tls) as publisher:
        publisher.publish(a_set(3))
        yield Place(credentials, endpoint, publisher)


def session(endpoint: str, tls: Tls | None, mode: str = "client") -> zenoh.Session:
    return zenoh.open(zenoh.Config.from_json5(link_config(mode, connect=[endpoint], tls=tls)))


def refused(open_it: Callable[[], object]) -> bool:
    try:
        open_it()
    except (zenoh.ZError, LinkError):
        return True
    return False


@pytest.mark.parametrize("who", ["anna", "ben", "uav-1"])
def test_whoever_has_a_certificate_of_the_authority_may_ask_and_listen(place: Place, who: str) -> None:
    answer = asked(place.endpoint, tls=place.tls(who))["uav-1"]
    assert isinstance(answer, FeatureSet) and answer.frame == 3
    with SetCache(place.endpoint, tls=place.tls(who)) as cache:
        assert eventually(lambda: hears(cache, place))


def test_a_stranger_without_a_certificate_cannot_connect(place: Place) -> None:
    tls_without = json.loads(link_config("client", connect=[place.endpoint], tls=place.tls("anna")))
    for name in ("connect_certificate", "connect_private_key", "listen_certificate", "listen_private_key"):
        del tls_without["transport"]["link"]["tls"][name]
    tls_without["transport"]["link"]["tls"]["enable_mtls"] = False
    assert received_nothing(place, json.dumps(tls_without))


def test_a_certificate_of_another_authority_does_not_connect(place: Place, tmp_path: Path) -> None:
    make_credentials(tmp_path, [], ["anna"], [], 30.0)
    own = tmp_path / "anna"
    # It trusts the aircraft, and is not trusted.
    tls = Tls(str(place.credentials / "anna" / "ca.pem"), str(own / "certificate.pem"), str(own / "key.pem"))
    assert received_nothing(place, link_config("client", connect=[place.endpoint], tls=tls))


def test_an_expired_certificate_does_not_connect(place: Place, tmp_path: Path) -> None:
    authority = Authority.load(place.credentials / "authority")
    then = datetime.now(UTC) - timedelta(days=10)
    authority.issue("anna", tmp_path / "old", days=9.0, now=then)
    assert received_nothing(place, link_config("client", connect=[place.endpoint], tls=Tls.in_folder(tmp_path / "old")))


def test_plain_tcp_does_not_get_through_to_an_encrypted_link(place: Place) -> None:
    assert received_nothing(place, link_config("client", connect=[place.endpoint.replace("tls/", "tcp/")]))


def hears(cache: SetCache, place: Place) -> bool:
    place.publisher.publish(a_set(3))
    return cache.by_frame("uav-1", 3) is not None


def received_nothing(place: Place, config: str) -> bool:
    """Whether a session so configured opens not at all, or neither reads nor publishes anything."""
    received: list[bytes] = []
    with SetCache(place.endpoint, tls=place.tls("anna")) as friend:
        assert eventually(lambda: hears(friend, place))
        try:
            stranger = zenoh.open(zenoh.Config.from_json5(config))
        except zenoh.ZError:
            return True
        # With TLS 1.3 a client may think itself connected until it learns that it is not.
        with stranger:
            try:
                stranger.declare_subscriber("pc/**", lambda sample: received.append(sample.payload.to_bytes()))
                stranger.put(FEATURES.key("uav-1"), encode(a_set(99)))
                replies = [r for r in stranger.get(FEATURES.key("uav-1"), timeout=1.0) if r.ok is not None]
            except zenoh.ZError:
                replies = []
            place.publisher.publish(a_set(4))
            assert eventually(lambda: friend.by_frame("uav-1", 4) is not None)
            time.sleep(0.3)
        return not received and not replies and friend.by_frame("uav-1", 99) is None


@pytest.mark.parametrize("who", ["anna", "ben"])
def test_a_viewer_publishes_neither_sets_nor_status_and_answers_for_no_one(place: Place, who: str) -> None:
    status: list[bytes] = []
    with SetCache(place.endpoint, tls=place.tls("anna")) as friend, session(place.endpoint, place.tls(who)) as viewer:
        listener = session(place.endpoint, place.tls("anna"))
        listener.declare_subscriber("pc/*/status", lambda sample: status.append(sample.payload.to_bytes()))
        queryable = viewer.declare_queryable(
            FEATURES.key("uav-2"), lambda q: q.reply(FEATURES.key("uav-2"), encode(a_set(98, vehicle="uav-2")))
        )
        for _ in range(10):
            viewer.put(FEATURES.key("uav-1"), encode(a_set(99)))
            viewer.put(STATUS.key("uav-1"), b"spoofed")
            viewer.delete(FEATURES.key("uav-1"))
            time.sleep(0.05)

        def is_received() -> bool:
            place.publisher.publish(a_set(5))
            place.publisher.publish_status(b"true", b"{}")
            return friend.by_frame("uav-1", 5) is not None and b"true" in status

        assert eventually(is_received)
        assert friend.by_frame("uav-1", 99) is None and friend.dropped.unreadable == 0
        assert status.count(b"spoofed") == 0
        assert set(asked(place.endpoint, tls=place.tls("anna"))) == {"uav-1"}
        queryable.undeclare()
        listener.close()


def test_without_certificates_too_no_one_publishes_through_the_aircraft() -> None:
    endpoint = free_endpoint()
    with (
        Publisher("uav-1", [endpoint], rate=WIDE) as publisher,
        SetCache(endpoint) as friend,
        session(endpoint, None) as stranger,
    ):
        for _ in range(10):
            stranger.put(FEATURES.key("uav-1"), encode(a_set(99)))
            time.sleep(0.05)
        publisher.publish(a_set(5))
        assert eventually(lambda: friend.by_frame("uav-1", 5) is not None)
        assert friend.by_frame("uav-1", 99) is None


def test_only_the_named_may_listen_and_ask_where_some_are_named(credentials: Path) -> None:
    endpoint = free_endpoint().replace("tcp/", "tls/")
    tls = {name: Tls.in_folder(credentials / name) for name in ("uav-1", "anna", "ben")}
    with Publisher("uav-1", [endpoint], rate=WIDE, tls=tls["uav-1"], rights=Rights(allowed=["anna"])) as publisher:
        publisher.publish(a_set(3))
        assert "uav-1" in asked(endpoint, tls=tls["anna"])
        assert "uav-1" in asked(endpoint, tls=tls["uav-1"])  # its own programs
        assert nobody_answers(endpoint, tls=tls["ben"])
        with SetCache(endpoint, tls=tls["ben"]) as cache:
            publisher.publish(a_set(4))
            time.sleep(2.5)  # the newest is said again every two seconds
            assert cache.vehicles == []


def test_no_one_on_the_ground_can_pass_for_an_aircraft(credentials: Path) -> None:
    """A person's certificate is not for serving: a ground that reaches it instead of the aircraft hangs up."""
    endpoint = free_endpoint().replace("tcp/", "tls/")
    ben = Tls.in_folder(credentials / "ben")
    with Publisher("uav-1", [endpoint], rate=WIDE, tls=ben) as impostor:
        impostor.publish(a_set(99))
        with pytest.raises(LinkError, match=r"nothing listens|cannot open"):
            ask(endpoint, tls=Tls.in_folder(credentials / "anna"))


def test_an_aircraft_reached_where_its_certificate_does_not_say_is_not_accepted(tmp_path: Path) -> None:
    make_credentials(tmp_path, ["uav-1"], ["anna"], ["10.1.2.3"], 30.0)
    endpoint = free_endpoint().replace("tcp/127.0.0.1", "tls/127.0.0.2")
    with Publisher("uav-1", [endpoint], rate=WIDE, tls=Tls.in_folder(tmp_path / "uav-1")) as publisher:
        publisher.publish(a_set(3))
        with pytest.raises(LinkError):
            ask(endpoint, tls=Tls.in_folder(tmp_path / "anna"))


def test_a_plain_endpoint_next_to_certificates_is_refused(credentials: Path) -> None:
    tls = Tls.in_folder(credentials / "uav-1")
    with pytest.raises(LinkError, match=r"tcp/0\.0\.0\.0:7447 is not encrypted"):
        Publisher("uav-1", ["tcp/0.0.0.0:7447"], tls=tls)
    with pytest.raises(LinkError, match="is not encrypted"):
        ask("tcp/127.0.0.1:7447", tls=tls)


def test_the_service_s_group_reads_an_aircraft_s_files_and_no_one_else_s(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Made by root on the aircraft, the service could not read its own key."""
    monkeypatch.setattr("onboard.link.certificates.service_group", os.getegid)
    make_credentials(tmp_path / "keys", ["uav-1"], ["anna"], [], 30.0)
    modes = {p.relative_to(tmp_path / "keys"): stat.S_IMODE(p.stat().st_mode) for p in (tmp_path / "keys").rglob("*")}
    for path, mode in modes.items():
        is_shared = path.parts[0] == "uav-1"
        assert mode == ((0o640 if is_shared else 0o600) if path.suffix else (0o750 if is_shared else 0o700)), path


def test_a_file_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match=r"ca\.pem: No such file"):
        Tls.in_folder(tmp_path)
    with pytest.raises(LinkError, match="key is missing"):
        Tls.of(tmp_path / "a", tmp_path / "b", None)
    assert Tls.of(None, None, None) is None


def test_the_command_issues_what_a_click_over_the_encrypted_link_needs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "keys"
    assert main(["make-credentials", str(folder), "--vehicle", "uav-1", "--operator", "anna", "--viewer", "ben"]) == 0
    assert str(folder / "uav-1") in capsys.readouterr().out
    for file in folder.rglob("*.pem"):  # where there is a service of ours, its group reads the aircraft's
        is_shared = service_group() is not None and file.parent.name == "uav-1"
        assert stat.S_IMODE(file.stat().st_mode) == (0o640 if is_shared else 0o600)
    assert sorted(p.name for p in (folder / "anna").iterdir()) == ["ca.pem", "certificate.pem", "key.pem"]
    assert main(["make-credentials", str(folder), "--viewer", "cleo"]) == 0  # the same authority, later
    endpoint = free_endpoint().replace("tcp/", "tls/")
    with Publisher("uav-1", [endpoint], rate=WIDE, tls=Tls.in_folder(folder / "uav-1")) as publisher:
        publisher.publish(a_set(3))
        click = ["click", "320", "240", "--max-age", "inf", "--connect", endpoint, "--format", "json"]
        assert eventually(lambda: ground_main([*click, "--credentials", str(folder / "cleo")]) == 0)
        assert json.loads(capsys.readouterr().out.splitlines()[-1])["frame"] == 3
        files = [str(folder / "ben" / name) for name in ("ca.pem", "certificate.pem", "key.pem")]
        assert eventually(
            lambda: ground_main([*click, "--ca", files[0], "--certificate", files[1], "--key", files[2]]) == 0
        )
        assert ground_main([*click, "--ca", files[0]]) == 2
        assert "certificate and key is missing" in capsys.readouterr().err
        assert ground_main(click) == 2


def test_certificates_say_what_they_are_for(credentials: Path) -> None:
    def read(*parts: str) -> x509.Certificate:
        return x509.load_pem_x509_certificate(credentials.joinpath(*parts).read_bytes())

    authority = read("authority", "ca.pem")
    assert authority.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    assert authority.extensions.get_extension_for_class(x509.KeyUsage).value.key_cert_sign
    for name, serves in (("uav-1", True), ("anna", False)):
        certificate = read(name, "certificate.pem")
        assert certificate.subject.rfc4514_string() == f"CN={name}"
        certificate.verify_directly_issued_by(authority)
        assert not certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
        uses = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert (ExtendedKeyUsageOID.SERVER_AUTH in uses) == serves and ExtendedKeyUsageOID.CLIENT_AUTH in uses
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        assert name in names.get_values_for_type(x509.DNSName)
        assert ("127.0.0.1" in map(str, names.get_values_for_type(x509.IPAddress))) == serves
        left = certificate.not_valid_after_utc - datetime.now(UTC)
        assert timedelta(days=29) < left <= timedelta(days=30)


def test_a_certificate_in_use_is_not_replaced(credentials: Path) -> None:
    with pytest.raises(InputError, match="anna exists"):
        make_credentials(credentials, [], ["anna"], [], 30.0)
