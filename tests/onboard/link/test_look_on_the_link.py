"""Having the camera look somewhere over real zenoh sessions on loopback: who may, by certificates, and no one else."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import zenoh

from contract.errors import LinkError
from contract.fleet import Fleet
from contract.link_config import Rights, Tls, link_config
from contract.look import AskLook, ConfirmLook, EndLook, Offer, parameters_of
from contract.topics import FEATURES, LOOK
from ground.certificate_name import common_name
from ground.look_link import LookLink
from ground.put_request import RequestRefused
from ground.router import _rights
from onboard.link.certificates import make_credentials
from onboard.link.publisher import Publisher, Rate
from tests.onboard.link.asking import answered, asked
from tests.onboard.link.ports import free_endpoint
from tests.onboard.link.test_access import session
from tests.onboard.link.test_publisher import a_set

WIDE = Rate(max_bit_rate=1e6)
OFFER = Offer("0123456789abcdef", -35.1, 149.2, 612.3, 2.4, 1.0)
CLICK = AskLook(7, 3, 10.0, 20.0, -35.1, 149.2, 3.0)


@dataclass
class Noting:
    asked: list[tuple[str, str]] = field(default_factory=list)

    def look(self, who: str, parameters: str, done: Callable[[bytes, bool], object]) -> None:
        self.asked.append((who, parameters))
        if parameters.startswith("session"):
            done(OFFER.to_json(), False)
        elif parameters.startswith("ticket"):
            done(b'{"result":"accepted"}', False)
        else:
            done(b'{"status":"denied","reason":"the autopilot refuses: denied"}', True)


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    make_credentials(folder, ["uav-1"], ["anna", "ben", "cleo"], [], 30.0)
    return folder


@dataclass(frozen=True)
class Place:
    endpoint: str
    keys: Path
    noting: Noting

    def tls(self, name: str) -> Tls:
        return Tls.in_folder(self.keys / name)

    def session(self, name: str) -> zenoh.Session:
        return session(self.endpoint, self.tls(name))


@pytest.fixture
def place(keys: Path) -> Iterator[Place]:
    endpoint, noting = free_endpoint().replace("tcp/", "tls/"), Noting()
    rights = Rights(pointers=["anna", "ben"])
    with Publisher("uav-1", [endpoint], rate=WIDE, tls=Tls.in_folder(keys / "uav-1"), rights=rights) as flying:
        flying.have_look = noting.look
        flying.publish(a_set(3))
        yield Place(endpoint, keys, noting)


def test_whoever_is_named_asks_confirms_and_ends_in_his_own_name(place: Place) -> None:
    for name in ("anna", "ben"):
        with answered(lambda name=name: LookLink(place.endpoint, None, place.tls(name))) as link:
            assert (link.vehicle, link.name) == ("uav-1", name)
            assert answered(lambda link=link: link.ask(CLICK)) == OFFER
            assert answered(lambda link=link: link.confirm(OFFER, 2.5)) == {"result": "accepted"}
            with pytest.raises(RequestRefused, match="denied: the autopilot refuses: denied"):
                link.end()
    asked_by = {who: {text for name, text in place.noting.asked if name == who} for who in ("anna", "ben")}
    expected = {parameters_of(one) for one in (CLICK, ConfirmLook(OFFER.ticket, 2.5), EndLook())}
    assert asked_by == {"anna": expected, "ben": expected}


def is_unheard(session: zenoh.Session, selector: str) -> bool:
    try:
        return not list(session.get(selector, timeout=1.0, target=zenoh.QueryTarget.ALL))
    except zenoh.ZError:
        return True


SELECTORS = ("pc/**", "pc/*/look/*", "pc/uav-1/look/**", "pc/uav-1/**", "pc/*/look/anna", "pc/uav-1/look/anna")


@pytest.mark.parametrize("who", ["cleo", "uav-1", "ben"])
def test_whoever_is_not_named_reaches_it_by_no_key_and_no_one_asks_in_anothers_name(place: Place, who: str) -> None:
    """Cleo may ask for everything else; ben may have it look, but not as anna."""
    assert "uav-1" in asked(place.endpoint, tls=place.tls(who))
    with place.session(who) as session:
        assert all(is_unheard(session, f"{key}?end=1") for key in SELECTORS)
        assert is_unheard(session, "pc/uav-1/look/mallory?end=1")
    assert place.noting.asked == []


def test_who_is_not_named_gets_no_answer_and_the_reason_why(place: Place) -> None:
    with (
        answered(lambda: LookLink(place.endpoint, "uav-1", place.tls("cleo"))) as link,
        pytest.raises(LinkError, match=r"does not answer 'cleo': is that name in its link\.pointers"),
    ):
        link.ask(CLICK)
    assert place.noting.asked == []


@pytest.mark.parametrize("rights", [Rights(), Rights(allowed=["anna"]), Rights(trackers=["anna"])])
def test_where_none_are_named_no_one_may_and_nothing_would_answer(keys: Path, rights: Rights) -> None:
    endpoint, noting = free_endpoint().replace("tcp/", "tls/"), Noting()
    with Publisher("uav-1", [endpoint], rate=WIDE, tls=Tls.in_folder(keys / "uav-1"), rights=rights) as flying:
        flying.have_look = noting.look
        flying.publish(a_set(3))
        here = Place(endpoint, keys, noting)
        assert "uav-1" in asked(endpoint, tls=here.tls("anna"))
        with here.session("anna") as session:
            assert all(is_unheard(session, f"{key}?end=1") for key in SELECTORS)
        assert noting.asked == [] and not hasattr(flying, "_look_queryable")


def test_without_certificates_no_one_may_whoever_is_named() -> None:
    endpoint, noting = free_endpoint(), Noting()
    with Publisher("uav-1", [endpoint], rate=WIDE, rights=Rights(pointers=["anna"])) as flying:
        flying.have_look = noting.look
        flying.publish(a_set(3))
        assert "uav-1" in asked(endpoint)
        with zenoh.open(zenoh.Config.from_json5(link_config("client", connect=[endpoint]))) as session:
            assert not is_unheard(session, FEATURES.key("uav-1"))
            assert all(is_unheard(session, f"{key}?end=1") for key in SELECTORS)
    assert noting.asked == []
    with pytest.raises(LinkError, match=r"link\.pointers: --credentials"):
        LookLink(endpoint, "uav-1", None)


def test_through_a_router_no_one_may() -> None:
    """An aircraft knows the router's certificate there, and no one's name: it is asked at its own endpoint."""
    rights = _rights(Fleet(aircraft=("uav-1",), operators=("anna",), viewers=("ben",)))
    key = zenoh.KeyExpr(f"{LOOK.key('uav-1')}/anna")
    reaching = [
        rule["id"]
        for rule in rights["rules"]
        if "query" in rule["messages"] and any(zenoh.KeyExpr(one).intersects(key) for one in rule["key_exprs"])
    ]
    assert reaching == []


def test_a_publisher_without_what_answers_refuses_in_words(keys: Path) -> None:
    endpoint = free_endpoint().replace("tcp/", "tls/")
    tls = {name: Tls.in_folder(keys / name) for name in ("uav-1", "anna")}
    with (
        Publisher("uav-1", [endpoint], rate=WIDE, tls=tls["uav-1"], rights=Rights(pointers=["anna"])),
        answered(lambda: LookLink(endpoint, "uav-1", tls["anna"])) as link,
    ):
        refused: list[RequestRefused] = []

        def ask() -> bool:
            try:
                link.ask(CLICK)
            except RequestRefused as error:
                refused.append(error)
            return bool(refused)

        assert answered(ask)
        assert refused[0].word == "disabled"


def test_a_confirmation_without_an_answer_may_have_been_done(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ground.look_link.ANSWERED_WITHIN_S", 0.5)
    with answered(lambda: LookLink(place.endpoint, "uav-1", place.tls("cleo"))) as link:  # who gets no answer
        with pytest.raises(LinkError, match="has not answered: it may have been done or not"):
            link.confirm(OFFER, 0.0)
        with pytest.raises(LinkError, match=r"link\.pointers"):
            link.end()


def test_a_certificates_name_is_what_its_authority_signed(keys: Path, tmp_path: Path) -> None:
    for name in ("anna", "ben", "uav-1"):
        assert common_name(keys / name / "certificate.pem") == name
    assert common_name(keys / "authority" / "ca.pem") == "pointclick authority"
    whole = (keys / "anna" / "certificate.pem").read_text()
    file = tmp_path / "x.pem"
    for wrong in ("", "no certificate", whole[: len(whole) // 2], whole.replace("M", "A", 5), json.dumps({"a": 1})):
        file.write_text(wrong)
        with pytest.raises(LinkError, match=r"x\.pem"):
            common_name(file)
    with pytest.raises(LinkError, match="No such file"):
        common_name(tmp_path / "none.pem")
