"""Positions by time -> position, velocity and distance travelled at any moment, and what joining them may be off by.

They are joined by cubic Hermite pieces whose slopes are the filter's own velocities, velocities by straight lines.
"""

from __future__ import annotations

import bisect
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from onboard.navigation.limits import RECENT_NS
from onboard.navigation.time_series import Series

Array = NDArray[np.float64]

# By which power of the gap the error of joining grows while motion is smooth: a line, a piece of a cubic.
LINE, CUBIC = 2, 4


@dataclass(frozen=True, eq=False)
class Position:
    """The filter's position at one of its own stamps: ENU m in the navigation frame, and its velocity if known."""

    enu_m: Array
    velocity_enu_m_s: Array | None
    height_above_home_m: float | None


@dataclass(frozen=True, eq=False)
class Displacement:
    """The distance travelled (3,), ENU m, by integrated velocity.

    `between_m`: for each gap between two positions that it runs over, by the stamp that begins it, one sigma (3,) of
    what the velocity did in the gap. Distances over one gap share its error.
    """

    enu_m: Array
    between_m: dict[int, Array] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Joined:
    """How a position was joined from those that came: the weight of each, by its stamp.

    `between_m`: one sigma (3,), ENU m, of what the vehicle did between them.
    """

    weights: dict[int, float] = field(default_factory=dict)
    between_m: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, eq=False)
class Path:
    """Positions of one frame, sorted; gaps longer than `max_gap_s` are not bridged."""

    series: Series[Position]
    max_gap_s: float

    def at(self, moment_ns: int) -> Position | Status:
        """Position and velocity; STARTING before the first position, UNSYNCHRONISED in a gap or past the end."""
        bracket = self.series.joined(moment_ns, self.max_gap_s)
        if isinstance(bracket, Status):
            return bracket
        left, right = bracket
        a, b = self.series.values[left], self.series.values[right]
        velocity_a, velocity_b = self.velocity(left), self.velocity(right)
        is_measured = a.velocity_enu_m_s is not None and b.velocity_enu_m_s is not None
        if left == right:
            since = (moment_ns - self.series.stamps_ns[left]) / 1e9
            return Position(a.enu_m + velocity_a * since, velocity_a if is_measured else None, a.height_above_home_m)
        s = self._share(left, right, moment_ns)
        enu = self._joined(left, right, moment_ns)
        velocity = (1 - s) * velocity_a + s * velocity_b if is_measured else None
        above_home = None
        if a.height_above_home_m is not None:
            # Its difference from the height itself is a constant, home's own height.
            above_home = a.height_above_home_m + float(enu[2] - a.enu_m[2])
        return Position(enu, velocity, above_home)

    def joined_at(self, moment_ns: int) -> Joined:
        """What `at`'s position is joined from, and what it may be off by because positions come rarely. (1.9)"""
        bracket = self.series.bracket(moment_ns)
        if bracket is None or bracket[0] == bracket[1]:
            return Joined()
        s = self._share(*bracket, moment_ns)
        before, after = (self.series.stamps_ns[i] for i in bracket)
        weights = {before: (1 + 2 * s) * (1 - s) ** 2, after: s * s * (3 - 2 * s)}
        return Joined(weights, (4.0 * s * (1.0 - s)) ** 2 * self._missed(*bracket, CUBIC))

    def displacement(self, start_ns: int, end_ns: int) -> Displacement | None:
        """The distance between two moments from the velocities alone (trapezium rule); None where any is missing."""
        series = self.series
        ends = [self._velocity_at(start_ns), self._velocity_at(end_ns)]
        if ends[0] is None or ends[1] is None or end_ns <= start_ns:
            return None
        first, last = bisect.bisect_right(series.stamps_ns, start_ns), bisect.bisect_left(series.stamps_ns, end_ns)
        between = [p.velocity_enu_m_s for p in series.values[first:last]]
        stamps = np.array([start_ns, *series.stamps_ns[first:last], end_ns], np.int64)
        seconds = np.diff(stamps) / 1e9
        if seconds.max() > self.max_gap_s or any(b is None or not np.all(np.isfinite(b)) for b in between):
            return None
        v = np.array([ends[0], *between, ends[1]])
        missed = {}
        for left in range(max(first - 1, 0), min(last, len(series.stamps_ns) - 1)):
            begin, end = np.clip([self._share(left, left + 1, t) for t in (start_ns, end_ns)], 0.0, 1.0)
            gap_s = (series.stamps_ns[left + 1] - series.stamps_ns[left]) / 1e9
            share = _bump(end) - _bump(begin)
            missed[series.stamps_ns[left]] = share * gap_s * self._missed(left, left + 1, LINE)
        return Displacement(0.5 * (v[1:] + v[:-1]).T @ seconds, missed)

    def velocity(self, index: int, reach_ns: int = 0) -> Array:
        """A position's velocity (3,); the components it lacks from its neighbours' positions."""
        known = self.series.values[index].velocity_enu_m_s
        if known is not None and np.all(np.isfinite(known)):
            return known
        # With no velocity at all the slope is that of the fix's neighbours (Catmull-Rom); a climb rate from heights
        # alone needs a longer base, their noise being metres.
        reach_ns = reach_ns if known is None else RECENT_NS // 2
        stamps, values = self.series.stamps_ns, self.series.values
        first = min(bisect.bisect_left(stamps, stamps[index] - reach_ns), max(index - 1, 0))
        last = max(bisect.bisect_right(stamps, stamps[index] + reach_ns) - 1, min(index + 1, len(stamps) - 1))
        if first == last:
            return np.zeros(3) if known is None else np.nan_to_num(known)
        slope: Array = (values[last].enu_m - values[first].enu_m) / ((stamps[last] - stamps[first]) / 1e9)
        return slope if known is None else np.where(np.isfinite(known), known, slope)

    def _velocity_at(self, moment_ns: int) -> Array | None:
        position = self.at(moment_ns)
        velocity = None if isinstance(position, Status) else position.velocity_enu_m_s
        return velocity if velocity is not None and np.all(np.isfinite(velocity)) else None

    def _share(self, left: int, right: int, moment_ns: int) -> float:
        stamps_ns = self.series.stamps_ns
        return (moment_ns - stamps_ns[left]) / (stamps_ns[right] - stamps_ns[left])

    def _joined(self, left: int, right: int, moment_ns: int) -> Array:
        """The place (3,) on the cubic between two positions."""
        a, b = self.series.values[left].enu_m, self.series.values[right].enu_m
        seconds = (self.series.stamps_ns[right] - self.series.stamps_ns[left]) / 1e9
        s = self._share(left, right, moment_ns)
        out: Array = (1 + 2 * s) * (1 - s) ** 2 * a + s * s * (3 - 2 * s) * b
        out += seconds * (s * (1 - s) ** 2 * self.velocity(left) - s * s * (1 - s) * self.velocity(right))
        return out

    def _missed(self, left: int, right: int, power: int) -> Array:
        """One sigma (3,), in the middle of a gap, of a velocity (LINE, m/s) or a position (CUBIC, m). (1.9)

        Either end is predicted from the other and from one beyond. Horizontal axes have one sigma between them.
        """
        stamps_ns, gap_ns = self.series.stamps_ns, self.series.stamps_ns[right] - self.series.stamps_ns[left]
        worst = np.zeros(2)
        for before, own, after in self._predictable(left, right):
            s = self._share(before, after, stamps_ns[own])
            if power == LINE:
                predicted = (1 - s) * self.velocity(before) + s * self.velocity(after)
                miss = self.velocity(own) - predicted
            else:
                miss = self.series.values[own].enu_m - self._joined(before, after, stamps_ns[own])
            smaller = (gap_ns / (stamps_ns[after] - stamps_ns[before])) ** power
            worst = np.maximum(worst, 2.0 * smaller * np.array([np.hypot(miss[0], miss[1]), abs(miss[2])]))
        return worst[[0, 0, 1]]

    def _predictable(self, left: int, right: int) -> Iterator[tuple[int, int, int]]:
        """A gap's two ends, each between the other and the next position beyond that is about as far, if held."""
        stamps_ns = self.series.stamps_ns
        half_ns = (stamps_ns[right] - stamps_ns[left]) // 2
        before = bisect.bisect_right(stamps_ns, stamps_ns[left] - half_ns) - 1
        after = bisect.bisect_left(stamps_ns, stamps_ns[right] + half_ns)
        if before >= 0:
            yield before, left, right
        if after < len(stamps_ns):
            yield left, right, after


def finite(velocity_m_s: Array) -> Array:
    """A velocity (3,) with 0 where a component is not known."""
    return velocity_m_s if np.isfinite(velocity_m_s).all() else np.nan_to_num(velocity_m_s, nan=0.0)


def _bump(s: float) -> float:
    """The integral of 4 s (1 - s) from the begin of a gap, as a share of the gap."""
    return s * s * (2.0 - 4.0 / 3.0 * s)
