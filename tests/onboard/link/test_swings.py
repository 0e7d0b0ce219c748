"""The camera's turning since the set before, as a set that is sent seldom states it."""

import dataclasses
import math

import numpy as np
import pytest

from contract.feature_set import FeatureSet, Status
from contract.rotations import exp_so3
from contract.wire.codec import decode
from onboard.link.publisher import Publisher, Rate
from onboard.link.set_selection import MEMORY_NS, Offer, Selection
from onboard.link.swings import MOST_S, Swings
from tests.contract.sets import plain_set
from tests.onboard.link.ports import free_endpoint
from tests.waiting import eventually

START_NS, RATE_HZ = 1_700_000_000_000_000_000, 10
BASE = plain_set(20)


def turned(frame: int) -> FeatureSet:
    """Pictures ten times a second, of a camera that nods by 0.1 rad."""
    nod = 0.1 * math.sin(2.0 * math.pi * 0.9 * frame / RATE_HZ)
    stamp_ns = START_NS + frame * 10**9 // RATE_HZ
    return dataclasses.replace(
        BASE, frame=frame, capture_unix_ns=stamp_ns, R_enu_cam=BASE.R_enu_cam @ exp_so3([nod, 0.0, 0.0])
    )


def kept(frames: list[int]) -> Swings:
    swings = Swings()
    for frame in frames:
        swings.add(turned(frame))
    return swings


def at_ns(frame: int) -> int:
    return turned(frame).capture_unix_ns


def test_the_pictures_between_two_sets_are_stated_evenly_and_truly() -> None:
    swing = kept(list(range(21))).since(at_ns(10), turned(20))
    assert swing is not None
    assert swing.before_s == pytest.approx([0.2, 0.4, 0.6, 0.8])
    for before_s, by in zip(swing.before_s, swing.turned_cam_rad, strict=True):
        then = turned(20 - round(before_s * RATE_HZ)).R_enu_cam
        assert np.allclose(turned(20).R_enu_cam @ exp_so3(by), then, atol=1e-12)


@pytest.mark.parametrize(
    ("frames", "sent", "most_s", "count"),
    [
        pytest.param([0, 1, 2], 0, 0.0, 0, id="near sets need nothing"),
        pytest.param([0, 10], 0, 0.0, 0, id="no picture between"),
        pytest.param([0, 5, 10], 0, 0.5, 1, id="as many as there are"),
        pytest.param(list(range(101)), 0, MOST_S, 9, id="a gap of ten seconds: the last two"),
        pytest.param([0, 1, 2, 100], 0, 0.0, 0, id="pictures of long before are none of this gap's"),
    ],
)
def test_as_much_is_stated_as_the_gap_needs_and_is_known(
    frames: list[int], sent: int, most_s: float, count: int
) -> None:
    swing = kept(frames).since(at_ns(sent), turned(frames[-1]))
    assert (0 if swing is None else len(swing.before_s)) == count
    assert swing is None or (np.all(np.diff(swing.before_s) > 0.05) and swing.before_s[-1] <= most_s)


def test_pictures_without_a_pose_and_other_sessions_are_no_part_of_it() -> None:
    swings = kept([0])
    for frame in range(1, 10):
        swings.add(dataclasses.replace(turned(frame), status=Status.TURNING))
    assert swings.since(at_ns(0), turned(10)) is None
    assert swings.since(at_ns(0), dataclasses.replace(turned(10), status=Status.TURNING)) is None
    swings = kept(list(range(10)))
    swings.add(dataclasses.replace(turned(10), session=BASE.session + 1))
    assert swings.since(at_ns(0), dataclasses.replace(turned(10), session=BASE.session + 1)) is None


def test_memory_stays_bounded_and_a_revision_replaces_what_it_revises() -> None:
    swings = kept(list(range(1000)))
    assert len(swings._kept) <= (MEMORY_NS / 1e9 + MOST_S) * RATE_HZ + 1
    revised = dataclasses.replace(turned(996), R_enu_cam=turned(996).R_enu_cam @ exp_so3([0.0, 0.02, 0.0]), revision=1)
    swings.add(revised)
    swing = swings.since(at_ns(990), turned(1000))
    assert swing is not None and swing.before_s[1] == pytest.approx(0.4)
    assert np.allclose(turned(1000).R_enu_cam @ exp_so3(swing.turned_cam_rad[1]), revised.R_enu_cam, atol=1e-12)


def test_the_set_before_is_the_last_that_was_sent_with_an_answer() -> None:
    selection: Selection[int] = Selection()
    assert selection.sent_before_ns(at_ns(5)) is None
    for frame in (0, 10, 20):
        offer = Offer(1, frame, 0, at_ns(frame), frame != 20, False, frame)
        selection.offer(offer)
        selection.sent(offer, frame / RATE_HZ)
    assert selection.sent_before_ns(at_ns(30)) == at_ns(10)
    assert selection.sent_before_ns(at_ns(10)) == at_ns(0)


def test_a_published_set_states_the_pictures_that_were_not_sent_and_a_frequent_one_nothing() -> None:
    with Publisher("uav-1", [free_endpoint()], rate=Rate(1e8, 1.0, 30.0)) as publisher:
        assert decode(publisher.publish(turned(0))).swing is None
        assert eventually(lambda: publisher.sent == 1)
        with publisher._changed:  # so that none of them goes before the last is there
            packets = [publisher.publish(turned(frame)) for frame in range(1, 11)]
        found = [decode(packet).swing for packet in packets]
        assert found[0] is None and found[-1] is not None
        assert found[-1].before_s == pytest.approx([0.2, 0.4, 0.6, 0.8])
        assert eventually(lambda: publisher.sent >= 2)
