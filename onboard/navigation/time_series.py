"""Values by time: what telemetry has reported in the last two minutes, sorted."""

from __future__ import annotations

import bisect
import itertools
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from contract.feature_set import Status
from onboard.navigation.limits import LATE_NS, MEMORY_NS

T = TypeVar("T")


@dataclass
class Series(Generic[T]):
    """Values by time, sorted, of the last two minutes."""

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

    def bracket(self, stamp_ns: int) -> tuple[int, int] | None:
        """Indices of the neighbours of a stamp; both the same at an end that is near enough to extrapolate from."""
        if not self.stamps_ns:
            return None
        right = bisect.bisect_left(self.stamps_ns, stamp_ns)
        if 0 < right < len(self.stamps_ns):
            return right - 1, right
        end = max(right - 1, 0)
        return (end, end) if abs(self.stamps_ns[end] - stamp_ns) <= LATE_NS else None

    def joined(self, stamp_ns: int, max_gap_s: float) -> tuple[int, int] | Status:
        """`bracket`, or the reason: STARTING before the first, UNSYNCHRONISED past the end or in a longer gap."""
        bracket = self.bracket(stamp_ns)
        if bracket is None:
            return Status.STARTING if stamp_ns < self.stamps_ns[0] else Status.UNSYNCHRONISED
        left, right = bracket
        too_long = (self.stamps_ns[right] - self.stamps_ns[left]) / 1e9 > max_gap_s
        return Status.UNSYNCHRONISED if too_long else bracket

    def spacing_ns(self, max_gap_s: float) -> int:
        """The longest of the last seven intervals, if it may be joined; 0 for fewer than two values."""
        recent = [later - earlier for earlier, later in itertools.pairwise(self.stamps_ns[-8:])]
        return max((gap_ns for gap_ns in recent if gap_ns <= max_gap_s * 1e9), default=0)

    def between(self, start_ns: int, end_ns: int) -> list[T]:
        """Values from one moment to another, both included."""
        first = bisect.bisect_left(self.stamps_ns, start_ns)
        return self.values[first : bisect.bisect_right(self.stamps_ns, end_ns)]

    def latest(self, moment_ns: int, for_ns: int = 0) -> list[T]:
        """Values of so long until a moment, the last one at least; empty where there was none yet."""
        first = bisect.bisect_right(self.stamps_ns, moment_ns - for_ns)
        end = bisect.bisect_right(self.stamps_ns, moment_ns)
        return self.values[max(min(first, end - 1), 0) : end]
