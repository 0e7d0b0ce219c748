"""Pictures to look at: with counts and a set, no more often than asked for, and never an older one."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.feature_set import Status
from onboard.events.types import Frame, GpsQuality
from onboard.spots.due_pictures import DuePictures
from tests.onboard.spots.scenes import BOSON, Scene, ThermalSpec, set_of

POSE = Scene(ThermalSpec()).pose(0)
COUNTS = np.zeros((4, 5), np.uint16)


def picture(index: int, stamp_s: float) -> Frame:
    return Frame(round(stamp_s * 1e9), index, COUNTS.astype(np.uint8), counts=COUNTS)


def taken(due: DuePictures, stamps_s: list[float]) -> list[int]:
    out = []
    for index, stamp_s in enumerate(stamps_s):
        due.event(picture(index, stamp_s))
        frame = due.take(set_of(BOSON, POSE, index))
        out += [] if frame is None else [frame.index]
    return out


@pytest.mark.parametrize(("rate_hz", "count"), [(2.0, 20), (0.5, 5)])
def test_so_many_a_second_are_due(rate_hz: float, count: int) -> None:
    found = taken(DuePictures(rate_hz, 8), [0.1 * k + 0.01 * (k % 3) for k in range(100)])
    assert count <= len(found) <= count + 1


@given(st.lists(st.floats(0.0, 20.0), max_size=40).map(sorted))
def test_never_more_often_however_they_come(stamps_s: list[float]) -> None:
    found = [stamps_s[index] for index in taken(DuePictures(2.0, 8), stamps_s)]
    assert all(later - earlier >= 0.449 for earlier, later in itertools.pairwise(found))


def test_what_has_no_counts_is_older_or_has_been_taken_is_not_due() -> None:
    due = DuePictures(2.0, 2)
    due.event(replace(picture(0, 0.0), counts=None))
    due.event(GpsQuality(0, 3))
    assert due.take(set_of(BOSON, POSE, 0)) is None
    for index in (5, 6, 7):
        due.event(picture(index, float(index)))
    assert due.take(set_of(BOSON, POSE, 5)) is None  # two are kept
    assert due.take(set_of(BOSON, POSE, 7)) is not None
    assert due.take(set_of(BOSON, POSE, 6)) is None and due.take(set_of(BOSON, POSE, 7)) is None


def test_a_new_session_is_looked_at_at_once_and_so_is_a_picture_that_was_refused() -> None:
    due = DuePictures(2.0, 4)
    due.event(picture(9, 9.0))
    assert due.take(set_of(BOSON, POSE, 9)) is not None
    due.event(picture(0, 9.1))
    assert due.take(set_of(BOSON, POSE, 0, session=8)) is not None
    due.event(picture(1, 9.9))
    assert due.take(set_of(BOSON, POSE, 1, Status.TURNING, session=8)) is not None
