"""Of a camera that is faster than the link, most pictures are placed once: when the window has seen past them."""

from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest

from contract.feature_set import FeatureSet, Status
from contract.geodesy import LocalFrame
from contract.locate import Locator
from contract.wire.codec import encode
from onboard.config.schema import parse_config
from onboard.events.types import Frame
from onboard.pipeline.record_book import PLACED_A_SET, RecordBook
from tests.onboard.pipeline.test_pipeline import BRISK, Session, flown, solved_at_once

pytestmark = pytest.mark.xdist_group("pipeline")

MAX_RATE_HZ = 0.5  # of the link: a set in flight at once every half second
INTERVAL_NS = round(1e9 / (PLACED_A_SET * MAX_RATE_HZ))
CLICKS = ((240.0, 180.0), (120.0, 90.0), (360.0, 270.0))


@pytest.fixture(scope="module")
def brisk() -> Session:
    return flown(BRISK)


@pytest.fixture(scope="module")
def slow_link(brisk: Session) -> Session:
    return replace(brisk, config=brisk.config + f"\n[link]\nmax_rate_hz = {MAX_RATE_HZ}\n")


@pytest.fixture(scope="module")
def slow_sets(slow_link: Session) -> list[FeatureSet]:
    return slow_link.run()


@pytest.fixture(scope="module")
def fast(brisk: Session) -> dict[int, list[FeatureSet]]:
    """The sets of each picture, the link being fast enough for all of them."""
    return by_frame(solved_at_once(brisk))


@pytest.fixture(scope="module")
def slow(slow_sets: list[FeatureSet]) -> dict[int, list[FeatureSet]]:
    """The same where it is slow."""
    return by_frame(slow_sets)


def by_frame(sets: list[FeatureSet]) -> dict[int, list[FeatureSet]]:
    out: dict[int, list[FeatureSet]] = defaultdict(list)
    for s in sets:
        out[s.frame].append(s)
    return out


def test_every_picture_has_a_set_in_the_end_and_those_that_waited_one_alone(
    brisk: Session, fast: dict[int, list[FeatureSet]], slow: dict[int, list[FeatureSet]]
) -> None:
    assert sorted(slow) == sorted(fast) == list(range(len(brisk.truth)))
    assert {f for f, sets in slow.items() if sets[-1].is_ok} >= {f for f, sets in fast.items() if sets[-1].is_ok}
    waited = [f for f, sets in slow.items() if len(sets) < len(fast[f])]
    assert len(waited) > 0.3 * len(slow)
    for f in waited:
        (only,) = slow[f]
        assert only.revision == 0 and not only.is_keyframe


def test_what_waited_is_answered_as_well_as_what_was_placed_twice(
    fast: dict[int, list[FeatureSet]], slow: dict[int, list[FeatureSet]]
) -> None:
    """The same ground to a tenth of the radius: both were placed last by the same windows."""
    compared = 0
    for f in (f for f, sets in slow.items() if len(sets) < len(fast[f])):
        for uv in CLICKS:
            one, other = Locator(slow[f][-1]).locate(uv), Locator(fast[f][-1]).locate(uv)
            here = LocalFrame(other.lat_deg, other.lon_deg, 0.0)
            apart_m = float(np.linalg.norm(here.to_enu(one.lat_deg, one.lon_deg, 0.0)[:2]))
            assert apart_m < 0.1 * other.ellipse.semi_major_m
            assert 0.9 < one.ellipse.semi_major_m / other.ellipse.semi_major_m < 1.1
            compared += 1
    assert compared > 30


def test_the_newest_set_is_never_older_than_the_link_asks(slow_link: Session) -> None:
    """From the first answer on: what is newest on board is at most an interval and a batch of telemetry old."""
    pipeline, newest_ns, ages_s = slow_link.pipeline(), 0, []
    for event in slow_link.events:
        for s in pipeline.handle(event):
            if s.is_ok:
                newest_ns = max(newest_ns, s.capture_unix_ns)
        if newest_ns and isinstance(event, Frame):
            ages_s.append((event.stamp_ns - newest_ns) / 1e9)
    assert len(ages_s) > 30
    assert 0.1 < max(ages_s) < INTERVAL_NS / 1e9 + 0.35


def test_two_runs_give_the_same_bytes(slow_link: Session, slow_sets: list[FeatureSet]) -> None:
    assert [encode(s) for s in slow_link.run()] == [encode(s) for s in slow_sets]


def test_what_waits_when_navigation_is_lost_is_placed_before_all_is_forgotten(slow_link: Session) -> None:
    """Nothing that was tracked goes without a set, whatever ends the window."""
    frames = [e for e in slow_link.events if isinstance(e, Frame)]
    cut = frames[-12].stamp_ns
    lost = [e for e in slow_link.events if isinstance(e, Frame) or e.stamp_ns < cut]
    sets = by_frame(slow_link.run(lost))
    assert sorted(sets) == [f.index for f in frames]
    assert all(sets[f.index][-1].status is Status.UNSYNCHRONISED for f in frames[-6:])
    before = [f.index for f in frames[:-16] if sets[f.index][-1].is_ok]
    assert len(before) > 0.7 * (len(frames) - 16)


def test_refusals_do_not_wait() -> None:
    book = RecordBook(parse_config(f"[link]\nmax_rate_hz = {MAX_RATE_HZ}"))
    assert not book.may_wait(0, has_newer=True)
    book.note_first(0, is_placed=True)
    assert book.may_wait(1, has_newer=False) and book.may_wait(2 * INTERVAL_NS, has_newer=True)
    assert not book.may_wait(INTERVAL_NS, has_newer=False)
    book.note_first(INTERVAL_NS, is_placed=False)
    assert not book.may_wait(INTERVAL_NS + 1, has_newer=True)
