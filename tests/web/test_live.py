"""A live aircraft as a page's source: what it publishes is there, is clicked, and grows old."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

from contract.answer import Fix
from contract.locate import Locator
from contract.vehicle_status import VehicleStatus, encode_status
from ground.client import Reply
from ground.web import live
from ground.web.clicks import Clicker
from ground.web.live import LiveSource
from onboard.link.publisher import Publisher, Rate
from tests.onboard.link.ports import free_endpoint
from tests.waiting import PATIENCE_S, eventually
from tests.web.served import Simulated

pytestmark = pytest.mark.xdist_group("web: served alone")


def wait_for(there: Callable[[], object], what: str) -> None:
    assert eventually(there), f"never came: {what}"


def test_sets_that_are_published_are_clicked_and_a_silent_aircraft_grows_old(simulated: Simulated) -> None:
    endpoint = free_endpoint()
    publisher = Publisher(simulated.vehicle, listen=[endpoint], rate=Rate(1e6, 1.0, 30.0))
    source = LiveSource([endpoint])
    try:
        sets = [
            s for f in simulated.frames[-6:-1] if (s := simulated.recording.by_frame(simulated.vehicle, f)) is not None
        ]
        first, *middle, last = [s for s in sets if s.is_ok]

        def heard_of_one() -> bool:
            publisher.publish(last)  # the listener may come a little after the link
            return source.vehicles() == [simulated.vehicle]

        wait_for(heard_of_one, "the first set")
        version = source.version(simulated.vehicle)
        reported = encode_status(
            VehicleStatus(last.capture_unix_ns / 1e9, last.session, "degraded", "clock", tracks=41)
        )

        def is_reported() -> bool:
            publisher.publish_status(reported, b"")  # once a second in flight: one may be lost
            return source.report(simulated.vehicle).status is not None

        wait_for(is_reported, "the status")
        report = source.report(simulated.vehicle)
        assert report.status is not None
        assert (report.status.state, report.status.tracks, report.session) == ("degraded", 41, last.session)
        assert report.newest_frame == last.frame
        assert source.version(simulated.vehicle) >= version
        (row,) = source.frames(simulated.vehicle)
        assert (row.frame, row.session, row.has_picture) == (last.frame, last.session, False)
        clicked = Clicker(source).click(simulated.vehicle, last.session, last.frame, 320.0, 240.0)
        expected = Locator(last).locate((320.0, 240.0))
        assert isinstance(clicked.answer, Fix)
        assert isinstance(expected, Fix)
        assert clicked.answer.lat_deg == pytest.approx(expected.lat_deg, abs=1e-6)
        # One that did not come is asked for; one of another session is refused, not mixed up.
        publisher.publish(first)
        wait_for(
            lambda: source.feature_set(simulated.vehicle, last.session, first.frame) is not None, "what is asked for"
        )
        # An aircraft that reports that it follows nothing is not asked to.
        assert "tracks.enabled = true" in source.unfollowed(simulated.vehicle)
        refused = Clicker(source).click(simulated.vehicle, last.session - 1, last.frame, 320.0, 240.0)
        assert "restarted" in refused.answer.reason  # type: ignore[union-attr]
        assert source.feature_set(simulated.vehicle, None, 1_000_000) is None
        publisher.close()
        ages_s: list[float] = []

        def has_aged() -> bool:
            age_s = source.report(simulated.vehicle).picture_age_s
            assert age_s is not None
            ages_s.append(age_s)
            return age_s >= min(ages_s) + 0.5  # an answer that comes late makes it younger, once

        wait_for(has_aged, "half a second")
        assert len(middle) >= 1
    finally:
        source.close()
        publisher.close()


def test_all_who_ask_for_a_picture_while_one_question_is_under_way_get_its_answer(
    simulated: Simulated, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint = free_endpoint()
    found = simulated.recording.by_frame(simulated.vehicle, simulated.newest)
    assert found is not None
    began, may_end, questions = threading.Event(), threading.Event(), []

    def slowly(*_: object, frame: int, **__: object) -> dict[str, Reply]:
        questions.append(frame)
        began.set()
        assert may_end.wait(PATIENCE_S)
        return {simulated.vehicle: Reply(found, 0.0)} if frame == found.frame else {}

    monkeypatch.setattr(live, "inquire", slowly)
    source = LiveSource([endpoint])
    try:
        with ThreadPoolExecutor(8) as pool:
            asked = [pool.submit(source._ask, endpoint, simulated.vehicle, found.frame)]
            assert began.wait(PATIENCE_S)
            asked += [pool.submit(source._ask, endpoint, simulated.vehicle, found.frame) for _ in range(5)]
            other = pool.submit(source._ask, endpoint, simulated.vehicle, 999)  # has a question of its own
            assert eventually(lambda: 999 in questions)
            may_end.set()
            assert [each.result() is found for each in asked] == [True] * 6
            assert other.result() is None
        assert sorted(questions) == sorted([found.frame, 999])
    finally:
        source.close()
