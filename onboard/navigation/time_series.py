"""Values by time: what telemetry has reported in the last two minutes, sorted."""

from __future__ import annotations

import bisect
import itertools
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from contract.feature_set import Status
from onboard.navigation.limits import LATE_NS, MEMORY_NS

T = TypeVar("T")


@dataclass(eq=False)
class Series(Generic[T]):
    """Values by time, sorted, of the last two minutes; gaps longer than `max_gap_s` are not bridged."""

    max_gap_s: float = float("inf")
    stamps_ns: list[int] = field(default_factory=list)
    values: list[T] = field(default_factory=list)

    def insert(self, stamp_ns: int, value: T) -> int | None:
        """Insert and return its index; None for a stamp that is here already or too old to keep."""
        if self.stamps_ns and stamp_ns < self.stamps_ns[-1] - MEMORY_NS:
            return None
        index = bisect.bisect_left(self.stamps_ns, stamp_ns)
        if index < len(self.stamps_ns) and self.stamps_ns[index] == stamp_ns:
            return None
        self.stamps_ns.insert(index, stamp_ns)
        self.values.insert(index, value)
        if self.stamps_ns[-1] - self.stamps_ns[0] > 2 * MEMORY_NS:
            old = bisect.bisect_left(self.stamps_ns, self.stamps_ns[-1] - MEMORY_NS)
            del self.stamps_ns[:old], self.values[:old]
            index -= old
        return index

    def covers(self, moment_ns: int) -> bool:
        """Return whether there are values at or before a moment, and at or after it."""
        return bool(self.stamps_ns) and self.stamps_ns[0] <= moment_ns <= self.stamps_ns[-1]

    def has_gap(self, moment_ns: int, received_ns: int) -> bool:
        """Return whether a moment is past the end, and all after `received_ns` comes too late to be joined with it."""
        end_ns = self.stamps_ns[-1] if self.stamps_ns else received_ns
        return moment_ns > end_ns and received_ns - end_ns > self.max_gap_s * 1e9

    def bracket(self, moment_ns: int) -> tuple[int, int] | None:
        """Indices of the neighbours of a moment; both the same at an end that is near enough to extrapolate from."""
        right = bisect.bisect_left(self.stamps_ns, moment_ns)
        if 0 < right < len(self.stamps_ns):
            return right - 1, right
        end = max(right - 1, 0)
        return (end, end) if self.stamps_ns and abs(self.stamps_ns[end] - moment_ns) <= LATE_NS else None

    def joined(self, moment_ns: int) -> tuple[int, int] | Status:
        """`bracket`, or the reason: STARTING before the first, UNSYNCHRONISED past the end or in a longer gap."""
        bracket = self.bracket(moment_ns)
        if bracket is not None and self.seconds(*bracket) <= self.max_gap_s:
            return bracket
        return Status.STARTING if self.stamps_ns and moment_ns < self.stamps_ns[0] else Status.UNSYNCHRONISED

    def seconds(self, left: int, right: int) -> float:
        return (self.stamps_ns[right] - self.stamps_ns[left]) / 1e9

    def share(self, left: int, right: int, moment_ns: int) -> float:
        """The share of the time from one value to another that has passed at a moment; 0 if both are the same."""
        gap_ns = self.stamps_ns[right] - self.stamps_ns[left]
        return (moment_ns - self.stamps_ns[left]) / gap_ns if gap_ns else 0.0

    @property
    def spacing_ns(self) -> int:
        """The longest of the last seven intervals that may be joined; 0 for fewer than two values."""
        recent = [later - earlier for earlier, later in itertools.pairwise(self.stamps_ns[-8:])]
        return max((gap_ns for gap_ns in recent if gap_ns <= self.max_gap_s * 1e9), default=0)

    def between(self, start_ns: int, end_ns: int) -> Series[T]:
        """The values from one moment to another, both included."""
        part = slice(bisect.bisect_left(self.stamps_ns, start_ns), bisect.bisect_right(self.stamps_ns, end_ns))
        return Series(self.max_gap_s, self.stamps_ns[part], self.values[part])

    def latest(self, moment_ns: int, for_ns: int = 0) -> list[T]:
        """Values of so long until a moment, the last one at least; empty where there was none yet."""
        first = bisect.bisect_right(self.stamps_ns, moment_ns - for_ns)
        end = bisect.bisect_right(self.stamps_ns, moment_ns)
        return self.values[max(min(first, end - 1), 0) : end]
