"""A check that a camera's stamps keep their meaning: the delay from each stamp to the picture's arrival.

A picture can come late, but never sooner than exposure, read-out and transfer take. The least delay of the first
pictures is that time; a picture that seems to have come sooner carries a stamp that is late by the difference at least.
Stamps that have become early look like a host that is slow, unless no picture at all comes in time any more.
"""

from __future__ import annotations

from collections import deque

import numpy as np

REFERENCE_PICTURES = 30
MIN_SLACK_NS = 5_000_000
SPREAD_SLACK = 3.0  # times how far delays usually spread above the least
HELD_NS = 2_000_000_000  # for which the worst is held: a late arrival hides a late stamp


class StampConsistency:
    """Fed with every picture's delay; knows how far its stamp may be off."""

    def __init__(self) -> None:
        self._first_ns: list[int] = []
        self._least_ns = 0
        self._slack_ns = MIN_SLACK_NS
        self._recent: deque[tuple[int, int]] = deque()  # arrival and delay

    def sigma_s(self, arrival_ns: int, delay_ns: int) -> float:
        """Seconds that the stamp of a picture, arrived `delay_ns` after it, may be off; 0 while all is as it was.

        `arrival_ns` is on a clock that is not set. A stamp that is the arrival itself has no delay, and is off by the
        delay that pictures had before.
        """
        if len(self._first_ns) < REFERENCE_PICTURES:
            self._first_ns.append(delay_ns)
            # No stamp can be true that lies ahead of its picture's arrival.
            self._least_ns = max(min(self._first_ns), 0)
            spread_ns = float(np.median(self._first_ns)) - min(self._first_ns)
            self._slack_ns = max(MIN_SLACK_NS, round(SPREAD_SLACK * spread_ns))
        self._recent.append((arrival_ns, delay_ns))
        while self._recent[0][0] < arrival_ns - HELD_NS:
            self._recent.popleft()
        delays_ns = [delay for _, delay in self._recent]
        least_ns = min(delays_ns)
        # Too soon: at once. Too late: only when not one picture has been in time for as long as the worst is held.
        off_ns = self._least_ns - least_ns
        if off_ns < 0:
            spread_ns = float(np.median(delays_ns)) - least_ns
            if arrival_ns - self._recent[0][0] < HELD_NS // 2 or -off_ns <= SPREAD_SLACK * spread_ns:
                return 0.0
        return abs(off_ns) / 1e9 if abs(off_ns) > self._slack_ns else 0.0
