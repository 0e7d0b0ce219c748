"""The clock an autopilot runs by: the host's, or one that makes a whole flight run faster."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """The clock from which the autopilot takes its time."""

    def now_ns(self) -> int:
        """Now."""

    def wall_s(self, ns: int) -> float:
        """Real seconds in which so much of this clock's time passes."""


class HostClock:
    """CLOCK_MONOTONIC."""

    def now_ns(self) -> int:
        """Now."""
        return time.monotonic_ns()

    def wall_s(self, ns: int) -> float:
        """The same."""
        return ns / 1e9
