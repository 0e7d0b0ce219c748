"""Which queries wait for a picture's set, and how long."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.history import History
from contract.topics import ANSWER_TIMEOUT_S, TIME_TOLERANCE_S
from onboard.link.pending_pictures import MAX_PENDING, PendingPictures
from onboard.link.reply import MOST_PATIENCE_S, Question, patience_s
from tests.contract.sets import plain_set

SET = plain_set(10)
AT_S = SET.capture_unix_ns / 1e9


def asked(frame: str | None = None, unix_s: float | None = None) -> Question:
    return Question(frame, None if unix_s is None else repr(unix_s), 0)


def test_a_query_waits_for_a_picture_that_was_taken_and_for_no_other() -> None:
    history: History[bytes] = History()
    history.add(SET, b"")
    pictures = PendingPictures()
    pictures.taken(8, SET.capture_unix_ns + 2 * 10**9)
    assert asked(frame="8").pending(history, pictures) == 8
    assert asked(unix_s=AT_S + 1.9).pending(history, pictures) == 8
    for other in (asked(frame="9"), asked(frame="-8"), asked(frame="x"), asked(unix_s=AT_S + 9.0), asked()):
        assert other.pending(history, pictures) is None
    pictures.made(8)
    assert asked(frame="8").pending(history, pictures) is None


def test_a_time_with_a_set_near_by_is_answered_at_once() -> None:
    history: History[bytes] = History()
    history.add(SET, b"")
    pictures = PendingPictures()
    pictures.taken(8, SET.capture_unix_ns + 33_000_000)
    assert asked(unix_s=AT_S + 0.033).pending(history, pictures) is None


@given(st.lists(st.integers(0, 10**6), max_size=40), st.floats(0.0, 1000.0))
def test_the_nearest_picture_is_within_the_tolerance_and_none_is_nearer(stamps_ms: list[int], unix_s: float) -> None:
    pictures = PendingPictures()
    for frame, at_ms in enumerate(stamps_ms):
        pictures.taken(frame, at_ms * 1_000_000)
    off_s = [abs(at_ms / 1e3 - unix_s) for at_ms in stamps_ms]
    found = pictures.nearest(unix_s)
    if found is None:
        assert all(off > TIME_TOLERANCE_S - 1e-6 for off in off_s)
    else:
        assert off_s[found] <= min(off_s) + 1e-6 and off_s[found] <= TIME_TOLERANCE_S + 1e-6


def test_pictures_that_never_get_a_set_do_not_pile_up() -> None:
    pictures = PendingPictures()
    for frame in range(MAX_PENDING + 10):
        pictures.taken(frame, frame)
    assert 9 not in pictures and 10 in pictures and MAX_PENDING + 9 in pictures


@pytest.mark.parametrize(
    ("reported", "expected"),
    [
        (None, ANSWER_TIMEOUT_S),
        ("8", 8.0),
        ("1e9", MOST_PATIENCE_S),
        ("-3", 0.0),
        ("x", ANSWER_TIMEOUT_S),
        ("nan", 3.0),
    ],
)
def test_a_ground_says_how_long_it_waits_within_bounds(reported: str | None, expected: float) -> None:
    assert patience_s(reported) == expected
