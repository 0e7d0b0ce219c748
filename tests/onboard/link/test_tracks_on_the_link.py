"""Tracks over real zenoh sessions on loopback: asked for, refused, received; and who may ask, by certificates."""

import dataclasses
import json
from pathlib import Path

import pytest
import zenoh

from contract.errors import LinkError
from contract.fleet import Fleet
from contract.link_config import Rights, Tls, link_config
from contract.topics import FOLLOW, SPOTS, TOPICS, TRACKS, Topic
from contract.track import ListTracks, StartTrack, StopTrack
from contract.wire.track_code import encode_track
from ground.put_request import RequestRefused
from ground.router import _rights
from ground.track_link import TrackLink
from onboard.link.byte_budget import USES, Budget, Kind
from onboard.link.certificates import make_credentials
from onboard.link.publisher import Publisher, Rate
from tests.contract.sets import plain_set
from tests.contract.test_track_code import REPORT
from tests.onboard.link.asking import answered
from tests.onboard.link.ports import free_endpoint
from tests.waiting import eventually

WIDE = Rate(max_bit_rate=1e6)


def test_a_track_is_asked_for_and_its_reports_are_received() -> None:
    endpoint, asked = free_endpoint(), list[str]()

    def follow(text: str) -> tuple[bytes, bool]:
        asked.append(text)
        return b'{"track": 3, "frame": 7}', False

    with Publisher("uav-1", [endpoint], rate=WIDE) as flying:
        flying.follow = follow
        with answered(lambda: TrackLink(endpoint, None)) as link:
            assert link.vehicle == "uav-1"
            assert answered(lambda: link.ask(StartTrack(10.5, 20.25, 7))) == {"track": 3, "frame": 7}
            assert set(asked) == {"u=10.5;v=20.25;frame=7"}
            received: list[str] = []

            def is_told(payload: bytes) -> bool:
                flying.report(TRACKS, payload)
                while (report := link.next(0.1)) is not None:
                    received.append(report.to_text())
                return len(received) >= 2 and len(received) % 2 == 0

            assert eventually(lambda: is_told(encode_track(REPORT) * 2))
            assert set(received) == {REPORT.to_text()} and link.unreadable == 0
            assert eventually(lambda: is_told(b"\xff" * 30) and link.unreadable > 0)


def test_reports_of_a_session_that_does_not_run_are_left_out() -> None:
    """The aircraft is asked which one does: a track of yesterday may have the same number."""
    endpoint = free_endpoint()
    made = dataclasses.replace(plain_set(20), session=REPORT.session)
    old = dataclasses.replace(REPORT, session=REPORT.session - 100)
    with Publisher("uav-1", [endpoint], rate=WIDE) as flying, TrackLink(endpoint, "uav-1") as link:
        flying.publish(made)

        def is_received() -> bool:
            flying.report(TRACKS, encode_track(old) + encode_track(REPORT))
            return link.next(0.2) is not None and link.left_out > 0

        assert eventually(is_received)
        for _ in range(20):
            flying.report(TRACKS, encode_track(old) + encode_track(REPORT))
            report = link.next(0.05)
            assert report is None or report.session == REPORT.session


def test_a_refusal_has_the_aircrafts_reason() -> None:
    endpoint = free_endpoint()
    with Publisher("uav-1", [endpoint], rate=WIDE) as flying, TrackLink(endpoint, "uav-1") as link:
        with pytest.raises(
            RequestRefused,
            match=r"disabled: this aircraft does not follow things: for its next flight set tracks\.enabled = true",
        ):
            link.ask(ListTracks())
        flying.follow = lambda _: (json.dumps({"status": "full", "reason": "stop one"}).encode(), True)
        with pytest.raises(RequestRefused, match="full: stop one"):
            link.ask(StartTrack(1.0, 2.0))


def test_only_the_named_may_follow(tmp_path: Path) -> None:
    make_credentials(tmp_path, ["uav-1"], ["anna", "ben"], [], 30.0)
    endpoint = free_endpoint().replace("tcp/", "tls/")
    tls = {name: Tls.in_folder(tmp_path / name) for name in ("uav-1", "anna", "ben")}
    with Publisher("uav-1", [endpoint], rate=WIDE, tls=tls["uav-1"], rights=Rights(trackers=["anna"])) as flying:
        flying.follow = lambda text: (json.dumps({"tracks": [len(text)]}).encode(), False)
        with TrackLink(endpoint, "uav-1", tls["anna"]) as anna, TrackLink(endpoint, "uav-1", tls["ben"]) as ben:
            assert answered(lambda: anna.ask(StopTrack(3))) == {"tracks": [6]}
            with pytest.raises(LinkError, match="may this certificate follow"):
                ben.ask(StopTrack(3))

            def is_received() -> bool:
                flying.report(TRACKS, encode_track(REPORT))
                return ben.next(0.3) is not None

            assert eventually(is_received)  # to read is another right


def test_without_trackers_the_rights_are_as_they_were() -> None:
    rules = json.loads(link_config("peer", is_aircraft=True, rights=Rights(trackers=["anna"])))["access_control"]
    asked = [topic.key("*") for topic in (*TOPICS, FOLLOW)]  # without certificates no one has a name
    assert [rule["key_exprs"] for rule in rules["rules"]] == [["pc/**"], asked, ["pc/**"]]
    assert len(rules["subjects"]) == 1


def test_through_a_router_operators_may_follow_and_viewers_may_not() -> None:
    rights = _rights(Fleet(aircraft=("uav-1",), operators=("anna",), viewers=("ben",)))
    by_rule = {rule["id"]: rule for rule in rights["rules"]}
    allowed = {
        policy["subjects"][0]: any(
            "query" in by_rule[rule]["messages"]
            and "ingress" in by_rule[rule]["flows"]
            and any(
                zenoh.KeyExpr(key).includes(zenoh.KeyExpr(FOLLOW.key("uav-1"))) for key in by_rule[rule]["key_exprs"]
            )
            for rule in policy["rules"]
        )
        for policy in rights["policies"]
    }
    assert allowed == {"aircraft uav-1": False, "operators": True, "viewers": False}


@pytest.mark.parametrize(("kind", "size"), [(TRACKS, 456), (SPOTS, 200)], ids=["eight tracks", "a packet of spots"])
def test_reports_go_twice_a_second_and_leave_sets_their_rate(kind: Topic, size: int) -> None:
    """A minute at 64 kbit/s: five sets a second."""
    budget = Budget(64_000.0, 0.2, 5.0, 0.0)
    sent = dict.fromkeys(USES, 0)
    due_set = due_report = 0.0
    for step in range(60_000):
        now_s = step * 0.001
        budget.waits(Kind.SET, 600 if now_s >= due_set else None, now_s)
        budget.waits(kind, size if now_s >= due_report else None, now_s)
        if now_s >= due_report and budget.send(kind, size, now_s):
            sent[kind] += 1
            due_report += 0.5
        if now_s >= due_set and budget.send(Kind.SET, 600, now_s):
            sent[Kind.SET] += 1
            due_set += 0.2
    assert sent[Kind.SET] >= 290 and 110 <= sent[kind] <= 121
