"""Positions by time -> position, velocity and distance travelled at any moment, and what joining them may be off by.

They are joined by cubic Hermite pieces whose slopes are the filter's own velocities, velocities by straight lines.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from onboard.navigation.limits import RECENT_NS
from onboard.navigation.time_series import Series

Array = NDArray[np.float64]

# The power of the gap that the interpolation error grows with while motion is smooth: a line, a piece of a cubic.
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
    """The weights, by stamp, of the received positions that one position was interpolated from.

    `between_m`: one sigma (3,), ENU m, of the vehicle's unknown motion between them.
    """

    weights: dict[int, float] = field(default_factory=dict)
    between_m: Array = field(default_factory=lambda: np.zeros(3))


class Path(Series[Position]):
    """Positions of one frame."""

    def at(self, moment_ns: int) -> Position | Status:
        """Position and velocity; STARTING before the first position, UNSYNCHRONISED in a gap or past the end."""
        bracket = self.joined(moment_ns)
        if isinstance(bracket, Status):
            return bracket
        left, right = bracket
        a, b = self.values[left], self.values[right]
        enu, above_home = self._place(left, right, moment_ns), a.height_above_home_m
        if above_home is not None:
            above_home += float(enu[2] - a.enu_m[2])  # home's own height is a constant
        if a.velocity_enu_m_s is None or b.velocity_enu_m_s is None:
            return Position(enu, None, above_home)
        s = self.share(left, right, moment_ns)
        return Position(enu, (1 - s) * self.velocity(left) + s * self.velocity(right), above_home)

    def joined_at(self, moment_ns: int) -> Joined:
        """The weights of `at`'s position, and its interpolation error because positions come rarely. (1.9)"""
        bracket = self.bracket(moment_ns)
        if bracket is None or bracket[0] == bracket[1]:
            return Joined()
        s = self.share(*bracket, moment_ns)
        before, after = (self.stamps_ns[i] for i in bracket)
        weights = {before: (1 + 2 * s) * (1 - s) ** 2, after: s * s * (3 - 2 * s)}
        return Joined(weights, (4.0 * s * (1.0 - s)) ** 2 * self._missed(*bracket, CUBIC))

    def displacement(self, start_ns: int, end_ns: int) -> Displacement | None:
        """The distance between two moments from the velocities alone (trapezium rule); None where any is missing."""
        start, end = self.at(start_ns), self.at(end_ns)
        if isinstance(start, Status) or isinstance(end, Status) or end_ns <= start_ns:
            return None
        first, last = bisect.bisect_right(self.stamps_ns, start_ns), bisect.bisect_left(self.stamps_ns, end_ns)
        velocities = [p.velocity_enu_m_s for p in (start, *self.values[first:last], end)]
        seconds = np.diff(np.array([start_ns, *self.stamps_ns[first:last], end_ns], np.int64)) / 1e9
        if seconds.max() > self.max_gap_s or any(v is None or not np.all(np.isfinite(v)) for v in velocities):
            return None
        v = np.array(velocities)
        missed = {}
        for left in range(max(first - 1, 0), min(last, len(self.stamps_ns) - 1)):
            s = np.clip([self.share(left, left + 1, t) for t in (start_ns, end_ns)], 0.0, 1.0)
            bump = s * s * (2.0 - 4.0 / 3.0 * s)  # the integral of 4 s (1 - s), (5.20)
            missed_m = self.seconds(left, left + 1) * self._missed(left, left + 1, LINE)
            missed[self.stamps_ns[left]] = (bump[1] - bump[0]) * missed_m
        return Displacement(0.5 * (v[1:] + v[:-1]).T @ seconds, missed)

    def velocity(self, index: int, reach_ns: int = 0) -> Array:
        """A position's velocity (3,); the components it lacks from its neighbours' positions."""
        known = self.values[index].velocity_enu_m_s
        if known is not None and np.all(np.isfinite(known)):
            return known
        # With no velocity at all the slope is that of the fix's neighbours (Catmull-Rom); a climb rate from heights
        # alone needs a longer base, their noise being metres.
        reach_ns = reach_ns if known is None else RECENT_NS // 2
        stamps = self.stamps_ns
        first = min(bisect.bisect_left(stamps, stamps[index] - reach_ns), max(index - 1, 0))
        last = max(bisect.bisect_right(stamps, stamps[index] + reach_ns) - 1, min(index + 1, len(stamps) - 1))
        if first == last:
            return np.zeros(3) if known is None else np.nan_to_num(known)
        slope: Array = (self.values[last].enu_m - self.values[first].enu_m) / self.seconds(first, last)
        return slope if known is None else np.where(np.isfinite(known), known, slope)

    def slope_at(self, moment_ns: int, reach_ns: int) -> Array | None:
        """A velocity (3,) by the positions alone that are within `reach_ns`; None beyond them all."""
        bracket = self.bracket(moment_ns)
        if bracket is None:
            return None
        s = 0.0 if bracket[0] == bracket[1] else self.share(*bracket, moment_ns)
        before, after = (self.velocity(index, reach_ns) for index in bracket)
        out: Array = (1 - s) * before + s * after
        return out

    def _place(self, left: int, right: int, moment_ns: int) -> Array:
        """The place (3,) on the cubic between two positions, or on the line beyond one."""
        a, b = self.values[left].enu_m, self.values[right].enu_m
        if left == right:
            return a + self.velocity(left) * ((moment_ns - self.stamps_ns[left]) / 1e9)
        s = self.share(left, right, moment_ns)
        out: Array = (1 + 2 * s) * (1 - s) ** 2 * a + s * s * (3 - 2 * s) * b
        slopes = s * (1 - s) ** 2 * self.velocity(left) - s * s * (1 - s) * self.velocity(right)
        return out + self.seconds(left, right) * slopes

    def _missed(self, left: int, right: int, power: int) -> Array:
        """One sigma (3,), in the middle of a gap, of a velocity (LINE, m/s) or a position (CUBIC, m). (1.9)

        Either end is predicted from the other and the next one beyond that is about as far, if held. Horizontal axes
        have one sigma between them.
        """
        stamps_ns, half_ns = self.stamps_ns, (self.stamps_ns[right] - self.stamps_ns[left]) // 2
        before = bisect.bisect_right(stamps_ns, stamps_ns[left] - half_ns) - 1
        after = bisect.bisect_left(stamps_ns, stamps_ns[right] + half_ns)
        worst = np.zeros(2)
        for first, own, last in ((before, left, right), (left, right, after)):
            if first < 0 or last == len(stamps_ns):
                continue
            if power == LINE:
                s = self.share(first, last, stamps_ns[own])
                miss = self.velocity(own) - ((1 - s) * self.velocity(first) + s * self.velocity(last))
            else:
                miss = self.values[own].enu_m - self._place(first, last, stamps_ns[own])
            smaller = (self.seconds(left, right) / self.seconds(first, last)) ** power
            worst = np.maximum(worst, 2.0 * smaller * np.array([np.hypot(miss[0], miss[1]), abs(miss[2])]))
        return worst[[0, 0, 1]]
