"""Positions that moved against their own velocity: refused while they settle, and doubted for as long as it takes.

A jump from one position to the next is a glitch: nothing is accepted until it has settled. Slip is the same spread over
seconds: a filter that is misled moves its position without the velocity that would bring it there; so does one that
recovers. Which of the two a single such jump was cannot be determined from telemetry: before or after it the position
is wrong by as much as it jumped. So what jumped is added up as a vector and kept in the sigma for as long as it takes.
It is explained by a jump back, by a receiver or filter that had reported that it has no position, or by being no more
than the Gauss-Markov error that is assumed anyway; what is left then decays with that error's correlation time.
Horizontal and vertical parts are judged apart, each by its own sigma.

A filter that is shaken moves its position against its own velocity because that velocity was wrong. So how far the
position has moved is measured by the receiver's own velocity where it reports one: that comes from Doppler shifts, and
neither the filter's nor the receiver's position has a part in it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from onboard.config.schema import Gps
from onboard.navigation.limits import LIKELY_SIGMAS, MEMORY_NS, RECENT_NS
from onboard.navigation.position_interpolation import Position
from onboard.navigation.position_slip import Slip, slip_at
from onboard.navigation.time_series import Series

Array = NDArray[np.float64]

GLITCH_SIGMAS = 5.0
# An episode of slip lasts from this share of `gps.max_slip_m_s` until below it again; clean flights stay below.
EPISODE_SHARE = 0.5
EXPLAINED_SHARE = 0.25  # of the largest jump that may be left after the jump back
# A filter takes part of a correction into its velocity, which is integrated here as real motion. Critically damped,
# position alone moves by 2/e of the correction at most.
SHARED_WITH_VELOCITY = 0.5 * float(np.e)


@dataclass(frozen=True, eq=False)
class _Deviation:
    """Position less integrated velocity (3,), and how far the velocity itself has changed by what was integrated."""

    stamp_ns: int
    offset_m: Array
    accelerated_m_s: Array = field(default_factory=lambda: np.zeros(2))


class _Lag:
    """The time by which the receiver's velocities come behind the filter's positions: a straight line's slope. (5.24)

    Position less integrated velocity moves by this time whenever the velocity changes; a regression of one change over
    two seconds on the other, in which what moved farther than the position's sigma hardly counts.
    """

    def __init__(self) -> None:
        self._sums = np.zeros(2)
        self.seconds = 0.0

    def learn(self, before: _Deviation, after: _Deviation, sigma_m: float) -> None:
        """Take one more change."""
        offset, by = (after.offset_m - before.offset_m)[:2], after.accelerated_m_s - before.accelerated_m_s
        miss = offset - self.seconds * by
        self._sums += np.array([offset @ by, by @ by]) / (1.0 + float(miss @ miss) / sigma_m**2)
        if self._sums[1] > 0.0:
            self.seconds = float(self._sums[0] / self._sums[1])

    def moved_m(self, before: _Deviation, after: _Deviation) -> Array:
        """Return how far the position has moved (3,) against velocity, ENU."""
        out: Array = after.offset_m - before.offset_m
        out[:2] -= self.seconds * (after.accelerated_m_s - before.accelerated_m_s)
        return out


@dataclass(frozen=True, eq=False)
class _Entry:
    """The doubt from a stamp on: the jumps' sum (3,), ENU m, and a part that decays (horizontal, vertical), m.

    `share`: of a correction that makes one metre of the jumps' sum, m.
    """

    stamp_ns: int
    unexplained_m: Array
    decaying_m: Array
    stretch: int
    share: float = 1.0

    def decayed(self, moment_ns: int, time_s: float) -> Array:
        """The rest of the part that decays: horizontal and vertical, m."""
        out: Array = self.decaying_m * np.exp(-max(moment_ns - self.stamp_ns, 0) / 1e9 / time_s)
        return out

    def at(self, moment_ns: int, time_s: float) -> Array:
        """One sigma of the doubt at a moment: horizontal and vertical, m."""
        doubt = _sizes(self.unexplained_m) * [self.share, 1.0]
        return np.asarray(np.hypot(doubt, self.decayed(moment_ns, time_s)), float)


@dataclass(eq=False)
class _Episode:
    """Slip under way since a stamp: the deviation before it, and how far it went from there at most."""

    start_ns: int
    before: _Deviation
    is_sure: bool = False
    most_m: float = 0.0
    sigma_m: Array = field(default_factory=lambda: np.zeros(2))  # the largest Gauss-Markov sigmas assumed meanwhile


class PositionJumps:
    """Takes every newest position; knows which moments are refused, and how far positions may be off otherwise."""

    def __init__(self, gps: Gps, was_unfit: Callable[[int, int, float], bool]) -> None:
        """`was_unfit(start_ns, end_ns, moved_m)`: whether receiver or filter had reported such an error."""
        self._gps, self._was_unfit = gps, was_unfit
        self._refused: list[tuple[int, int, str]] = []  # from, until (ns), and why
        self._entries: list[_Entry] = [_Entry(0, np.zeros(3), np.zeros(2), 0)]
        self._suspected: _Entry | None = None  # of an episode under way
        self._lag, self._share = _Lag(), SHARED_WITH_VELOCITY
        self.begin()

    def begin(self, jumped_ns: int | None = None) -> None:
        """Positions begin again, in another frame perhaps: nothing links them to those before but the doubt itself.

        `jumped_ns`: when those before were found to be elsewhere, if so.
        """
        self._lose_link(0)
        self._largest_m = _sizes((self._suspected or self._entries[-1]).unexplained_m)
        if jumped_ns is not None:
            self._refuse(jumped_ns, jumped_ns, "the position began to be somewhere else altogether, settling")

    def _refuse(self, start_ns: int, end_ns: int, why: str) -> None:
        self._refused = [jump for jump in self._refused if jump[1] > end_ns - 2 * MEMORY_NS]
        self._refused.append((start_ns, end_ns + round(self._gps.settle_s * 1e9), why))

    def refusal_at(self, moment_ns: int) -> str:
        """The reason for refusing a moment: a jump that has not settled; empty if there is none."""
        return next((why for start_ns, end_ns, why in self._refused if start_ns <= moment_ns < end_ns), "")

    def at(self, moment_ns: int) -> Array:
        """One sigma (m), horizontal and vertical, to be added to what is assumed of a position anyway."""
        return self._entry(moment_ns).at(moment_ns, self._gps.correlation_time_s)

    def stretch_at(self, moment_ns: int) -> int:
        """Counts the jumps that ended until a moment: positions on both sides of one cannot be compared."""
        return self._entry(moment_ns).stretch

    def _entry(self, moment_ns: int) -> _Entry:
        if self._suspected is not None and self._suspected.stamp_ns <= moment_ns:
            return self._suspected
        return next((e for e in reversed(self._entries) if e.stamp_ns <= moment_ns), self._entries[0])

    def append(self, positions: Series[Position], sigma_m: tuple[float, float], receiver_m_s: Array | None) -> None:
        """Take the newest position; `sigma_m`: the Gauss-Markov error assumed for it, horizontal and vertical.

        `receiver_m_s`: the receiver's own velocity, east and north, if it reports one.
        """
        values, end_ns, sigmas_m = positions.values, positions.stamps_ns[-1], np.array(sigma_m)
        if len(values) < 2 or positions.seconds(-2, -1) > self._gps.max_gap_s:
            self._lose_link(end_ns)  # over a gap nothing is known about a jump
            return
        start_ns, seconds = positions.stamps_ns[-2], positions.seconds(-2, -1)
        moved = expected = values[-1].enu_m - values[-2].enu_m
        velocities = [p.velocity_enu_m_s for p in values[-2:] if p.velocity_enu_m_s is not None]
        if velocities:
            expected = np.mean(np.nan_to_num(velocities), axis=0) * seconds
        elif len(values) > 2:
            expected = (values[-2].enu_m - values[-3].enu_m) * (seconds / positions.seconds(-3, -2))
        miss = moved - expected
        if len(velocities) == 2:
            # Without climb rate nothing is known of a drift in height.
            drift, accelerated = np.where(np.isnan(velocities).any(axis=0), 0.0, miss), np.zeros(2)
            if receiver_m_s is not None:
                drift[:2], accelerated = moved[:2] - receiver_m_s * seconds, (velocities[1] - velocities[0])[:2]
            self._share = SHARED_WITH_VELOCITY if receiver_m_s is None else 1.0
            self._follow(positions, drift, accelerated, sigmas_m)
        else:
            self._lose_link(end_ns)
        most_m = np.maximum(self._gps.glitch_m, GLITCH_SIGMAS * sigmas_m)
        horizontal = np.hypot(miss[0], miss[1]) > most_m[0]
        if not horizontal and abs(miss[2]) <= most_m[1]:
            return
        self._refuse(start_ns, end_ns, f"position jumped {np.linalg.norm(miss):.0f} m against velocity, settling")
        if not velocities or not horizontal:  # else it is measured as slip
            self._add(start_ns, end_ns, miss, sigmas_m, True)

    def _lose_link(self, stamp_ns: int) -> None:
        self._deviations = deque([_Deviation(stamp_ns, np.zeros(3))])  # recently
        self._episode: _Episode | None = None

    def _follow(self, positions: Series[Position], drift_m: Array, accelerated_m_s: Array, sigma_m: Array) -> None:
        """Take how far the newest position has moved from the last one against velocity (3,)."""
        stamp_ns, last = positions.stamps_ns[-1], self._deviations[-1]
        newest = _Deviation(stamp_ns, last.offset_m + drift_m, last.accelerated_m_s + accelerated_m_s)
        self._deviations.append(newest)
        self._lag.learn(self._deviation(stamp_ns - RECENT_NS), newest, float(sigma_m[0]))
        # Slip is known of a moment once half its window has passed.
        middle_ns = stamp_ns - RECENT_NS // 2
        self._judge(middle_ns, slip_at(positions, middle_ns, self._gps), sigma_m)
        while self._episode is None and self._deviations[0].stamp_ns < stamp_ns - 2 * RECENT_NS:
            self._deviations.popleft()

    def _deviation(self, moment_ns: int) -> _Deviation:
        """The last deviation until a moment, or the first that is held."""
        return next((d for d in reversed(self._deviations) if d.stamp_ns <= moment_ns), self._deviations[0])

    def _judge(self, moment_ns: int, slip: Slip, sigma_m: Array) -> None:
        slipping, episode = slip.exceeds(EPISODE_SHARE * self._gps.max_slip_m_s), self._episode
        if episode is None:
            if not slipping:
                return
            start_ns = max(moment_ns - RECENT_NS // 2, (self._suspected or self._entries[-1]).stamp_ns)
            self._episode = episode = _Episode(start_ns, self._deviation(start_ns))
        newest = self._deviations[-1]
        moved = self._lag.moved_m(episode.before, newest)
        # It may have been right before this episode, or before all that is unexplained.
        doubts = (moved, moved + self._entries[-1].unexplained_m)
        episode.most_m = max(episode.most_m, *(float(_sizes(doubt)[0]) for doubt in doubts))
        episode.sigma_m = np.maximum(episode.sigma_m, sigma_m)
        episode.is_sure |= slip.exceeds(self._gps.max_slip_m_s)
        if not slipping:
            self._episode = None
            if self._share == 1.0 and _sizes(moved)[0] <= LIKELY_SIGMAS * episode.sigma_m[0]:
                moved[2] = 0.0  # the filter's velocity was wrong, not its position; so was its climb rate
            self._add(episode.start_ns, newest.stamp_ns, moved, episode.sigma_m, episode.is_sure)
        elif episode.is_sure:
            self._suspect(episode)

    def _suspect(self, episode: _Episode) -> None:
        """Doubt, while it lasts, all that it has moved by so far."""
        last, self._suspected = self._entries[-1], None
        if episode.most_m > LIKELY_SIGMAS * episode.sigma_m[0]:
            doubt = np.array([episode.most_m, 0.0, last.unexplained_m[2]])
            decaying = last.decayed(episode.start_ns, self._gps.correlation_time_s)
            share = max(self._share, last.share)
            self._suspected = _Entry(episode.start_ns, doubt, decaying, last.stretch, share)

    def _add(self, start_ns: int, end_ns: int, moved_m: Array, sigma_m: Array, is_sure: bool) -> None:
        """Take a jump (3,), ENU m, that has ended; one that is not sure is too small to doubt a position for."""
        last, suspected, self._suspected = self._entries[-1], self._suspected, None
        chance_m, before_m = LIKELY_SIGMAS * sigma_m, _sizes(last.unexplained_m)
        known = _sizes(last.unexplained_m + moved_m) >= before_m  # where it grows
        if is_sure:
            known &= self._was_unfit(start_ns, end_ns, float(np.linalg.norm(moved_m)))
        if self._share == 1.0:
            # Small moves would add up to what undoes a jump by chance: one counts that undoes it, or is a jump itself.
            undoes = _sizes(last.unexplained_m + moved_m) <= EXPLAINED_SHARE * self._largest_m
            known |= (before_m > 0.0) & (_sizes(moved_m) <= chance_m) & ~undoes
        if suspected is not None:
            self._entries.append(suspected)  # what it came to in the end does not undo what it was meanwhile
        elif not is_sure and known.all():
            return
        total = last.unexplained_m + np.where(known[[0, 0, 1]], 0.0, moved_m)
        left_m = _sizes(total)
        self._largest_m = np.maximum(self._largest_m, left_m)
        # Small moves may add up to what undoes a jump by chance: only one that is a jump itself leaves so much.
        is_jump = is_sure & ((before_m == 0.0) | (_sizes(moved_m) > chance_m))
        may_stay_m = np.maximum(chance_m * is_jump, EXPLAINED_SHARE * self._largest_m)
        explained = ~known & (left_m <= may_stay_m)
        decaying = last.decayed(end_ns, self._gps.correlation_time_s)
        decaying = np.where(explained, np.hypot(decaying, left_m * [self._share, 1.0]), decaying)
        total = np.where(explained[[0, 0, 1]], 0.0, total)
        self._largest_m = np.where(explained, 0.0, self._largest_m)
        share = self._share if np.array_equal(before_m, np.zeros(2)) else max(self._share, last.share)
        stretch = last.stretch + bool(np.any(_sizes(moved_m) > chance_m))
        self._entries.append(_Entry(end_ns, total, decaying, stretch, share))
        while self._entries[1].stamp_ns < end_ns - MEMORY_NS:
            del self._entries[0]


def _sizes(moved_m: Array) -> Array:
    """Horizontal and vertical size (2,) of a jump (3,)."""
    return np.array([float(np.hypot(moved_m[0], moved_m[1])), abs(float(moved_m[2]))])
