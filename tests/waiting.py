"""Waiting for what other threads, processes and machines do: as long as a loaded machine may need, and no longer.

A test that waits for something says what, never for how long: PATIENCE_S passes only where it never comes. Where a time
itself is claimed, it is counted less what this thread was held up, for so was what it waits for.
"""

import time
from collections.abc import Callable

PATIENCE_S = 120.0  # for what takes a second where nothing else runs; on a slow machine at a load of 30 a page took 60
LOOK_S, LOOK_AT_MOST_S = 0.02, 0.1  # a look may cost a request or a program: one that waits for long looks less often
LEAST_STALL_S = 0.05  # a sleep that is longer by less is an ordinary one


def eventually(condition: Callable[[], object], within_s: float = PATIENCE_S) -> bool:
    """Whether it comes to hold: looked at once more after the time is over, for this thread may have been held up."""
    deadline_s, pause_s = time.monotonic() + within_s, LOOK_S
    while True:
        is_last = time.monotonic() > deadline_s
        if condition():
            return True
        if is_last:
            return False
        time.sleep(pause_s)
        pause_s = min(1.2 * pause_s, LOOK_AT_MOST_S)


class Stalls:
    """For how long this thread was held up in all: what runs next to it was, too, and is excused for as long."""

    def __init__(self) -> None:
        self.total_s = 0.0

    def sleep(self, seconds: float) -> None:
        began_s = time.monotonic()
        time.sleep(seconds)
        held_up_s = time.monotonic() - began_s - seconds
        self.total_s += held_up_s if held_up_s > LEAST_STALL_S else 0.0


def until(condition: Callable[[], object], within_s: float) -> float:
    """Seconds until it holds, less the stalls; more than `within_s` if it does not."""
    began_s, stalls = time.monotonic(), Stalls()
    while not condition() and time.monotonic() - began_s - stalls.total_s <= within_s:
        stalls.sleep(LOOK_S)
    return time.monotonic() - began_s - stalls.total_s
