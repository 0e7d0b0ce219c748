"""The event queue: telemetry always, pictures while they are of now."""

import math
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.events.types import Event, Frame, GpsQuality
from onboard.service.event_queue import EventQueue


class Clock:
    def __init__(self) -> None:
        self.s = 0.0

    def now_ns(self) -> int:
        return round(self.s * 1e9)


def picture(index: int) -> Frame:
    return Frame(index, index, None)


def fix(index: int) -> GpsQuality:
    return GpsQuality(index, 3)


def drained(event_queue: EventQueue) -> list[Event]:
    out = []
    while (got := event_queue.get(0.0)) is not None:
        out.append(got[1])
    return out


def test_events_leave_in_the_order_and_with_the_arrival_they_came_with() -> None:
    event_queue = EventQueue(Clock().now_ns, 1.0)
    events: list[Event] = [fix(0), picture(1), fix(2), fix(3), picture(4)]
    for event in events:
        event_queue.put(100 + event.stamp_ns, event)
    assert [event_queue.get(0.0) for _ in events] == [(100 + e.stamp_ns, e) for e in events]
    assert event_queue.get(0.0) is None


def test_pictures_that_waited_too_long_are_dropped_oldest_first_and_telemetry_never() -> None:
    clock = Clock()
    event_queue = EventQueue(clock.now_ns, 1.0)
    for n in range(10):
        clock.s = 0.2 * n
        event_queue.put(0, picture(n))
        event_queue.put(0, fix(n))
    left = drained(event_queue)
    assert [e.stamp_ns for e in left if isinstance(e, GpsQuality)] == list(range(10))
    assert [e.index for e in left if isinstance(e, Frame)] == [4, 5, 6, 7, 8, 9]
    assert event_queue.dropped == 4
    assert event_queue.dropped_within(1.0)
    clock.s += 5.0
    assert not event_queue.dropped_within(1.0)


def test_a_full_queue_drops_the_oldest_picture_for_a_new_one() -> None:
    event_queue = EventQueue(Clock().now_ns, 1e3, max_pictures=3)
    for n in range(5):
        event_queue.put(0, picture(n))
    assert [e.stamp_ns for e in drained(event_queue)] == [2, 3, 4]


def handled(load: float, seconds: float, pause_s: float = 0.0) -> tuple[list[int], list[float]]:
    """The pictures of 10 Hz, and their ages (s), had by one who takes `load` times as long for each and once pauses."""
    clock = Clock()
    event_queue = EventQueue(clock.now_ns, 1.0)
    came, had, ages_s = 0, list[int](), list[float]()
    free_s = 0.0
    while free_s < seconds:
        while 0.1 * came <= free_s:
            clock.s = 0.1 * came
            event_queue.put(0, picture(came))
            came += 1
        clock.s = free_s
        got = event_queue.get(0.0)
        if got is None:
            free_s = 0.1 * came
            continue
        had.append(n_of(got[1]))
        ages_s.append(free_s - 0.1 * had[-1])
        free_s += 0.1 * load + (pause_s if len(had) == 20 else 0.0)
    return had, ages_s


@pytest.mark.parametrize("load", [1.1, 1.5, 2.0, 4.0])
def test_who_cannot_keep_up_gets_pictures_of_now_as_many_as_ever(load: float) -> None:
    had, ages_s = handled(load, 60.0)
    settled = len(had) // 3
    # Before, each had waited for the whole second that is allowed.
    assert float(np.median(ages_s[settled:])) < 0.25
    assert max(ages_s) <= 1.0
    assert len(had) > 0.97 * 60.0 / (0.1 * load)
    # Spread over the time: a gap as long as a few pictures is one in which features are lost.
    assert max(np.diff(had[settled:])) <= math.ceil(load) + 2


def test_a_burst_that_is_caught_up_with_drops_nothing() -> None:
    had, ages_s = handled(0.4, 30.0, pause_s=0.7)
    assert had == list(range(len(had)))
    assert max(ages_s) > 0.6
    assert ages_s[-1] < 0.1


@given(
    st.lists(st.tuples(st.sampled_from("ptg"), st.floats(0.0, 0.7)), max_size=60),
    st.integers(1, 5),
    st.floats(0.1, 2.0),
)
def test_no_picture_is_ever_handed_out_late_or_out_of_order(
    steps: list[tuple[str, float]], most: int, max_delay_s: float
) -> None:
    clock = Clock()
    event_queue = EventQueue(clock.now_ns, max_delay_s, most)
    put_at: dict[int, float] = {}
    out: list[Event] = []
    for n, (what, pause_s) in enumerate(steps):
        clock.s += pause_s
        if what == "g":
            got = event_queue.get(0.0)
            if got is not None:
                out.append(got[1])
                if isinstance(got[1], Frame):
                    assert clock.s - put_at[n_of(got[1])] <= max_delay_s + 1e-6
        else:
            put_at[n] = clock.s
            event_queue.put(0, picture(n) if what == "p" else fix(n))
    out += drained(event_queue)
    stamps = [e.stamp_ns for e in out]
    assert stamps == sorted(stamps)
    telemetry = [e.stamp_ns for e in out if isinstance(e, GpsQuality)]
    assert telemetry == [n for n, (what, _) in enumerate(steps) if what == "t"]
    came = sum(what == "p" for what, _ in steps)
    assert came == event_queue.dropped + sum(isinstance(e, Frame) for e in out)


def n_of(event: Event) -> int:
    return event.index


def test_a_closed_queue_takes_nothing_and_gives_what_it_holds() -> None:
    event_queue = EventQueue(Clock().now_ns, 1.0)
    event_queue.put(0, fix(0))
    event_queue.close()
    event_queue.put(0, fix(1))
    assert not event_queue.is_over
    assert drained(event_queue) == [fix(0)]
    assert event_queue.is_over


def test_whoever_waits_is_woken_by_an_event_and_by_the_end() -> None:
    event_queue = EventQueue(time.monotonic_ns, 1.0)
    for act, expected in ((lambda: event_queue.put(7, fix(0)), (7, fix(0))), (event_queue.close, None)):
        timer = threading.Timer(0.05, act)
        timer.start()
        began = time.monotonic()
        assert event_queue.get(10.0) == expected
        assert time.monotonic() - began < 5.0


def test_without_events_the_wait_has_an_end_and_not_before_its_time() -> None:
    began = time.monotonic()
    assert EventQueue(time.monotonic_ns, 1.0).get(0.2) is None
    assert 0.19 <= time.monotonic() - began < 20.0
