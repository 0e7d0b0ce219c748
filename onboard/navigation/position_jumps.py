"""Positions that moved against their own velocity: refused while they settle, and doubted for as long as it takes.

A jump from one position to the next is a glitch: nothing is accepted until it has settled. Slip is the same spread over
seconds: a filter that is misled moves its position without the velocity that would bring it there; so does one that
recovers. Which of the two a single such jump was cannot be determined from telemetry: before or after it the position
is wrong by as much as it jumped. So what jumped is added up as a vector and kept in the sigma for as long as it takes.
It is explained by a jump back, by a receiver or filter that had reported that it has no position, or by being no more
than the Gauss-Markov error that is assumed anyway; what is left then decays with that error's correlation time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

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
class _Entry:
    """The doubt from a stamp on: the jumps' sum (3,), ENU m, and a part that decays (horizontal, vertical), m."""

    stamp_ns: int
    unexplained_m: Array
    decaying_m: Array
    stretch: int

    def decayed(self, moment_ns: int, time_s: float) -> Array:
        """The rest of the part that decays: horizontal and vertical, m."""
        out: Array = self.decaying_m * np.exp(-max(moment_ns - self.stamp_ns, 0) / 1e9 / time_s)
        return out

    def at(self, moment_ns: int, time_s: float, shared: float) -> Array:
        """One sigma of the doubt at a moment: horizontal and vertical, m."""
        return np.asarray(np.hypot(_parts(self.unexplained_m, shared), self.decayed(moment_ns, time_s)), float)


@dataclass(eq=False)
class _Episode:
    """Slip under way since a stamp: the drift before it, and how far it drifted from there at most."""

    start_ns: int
    before_m: Array
    is_sure: bool = False
    most_m: float = 0.0
    largest_m: float = 0.0  # of the jumps' sum, its own part so far included
    sigma_m: float = 0.0  # the largest Gauss-Markov sigma assumed meanwhile


class PositionJumps:
    """Takes every newest position; knows which moments are refused, and how far positions may be off otherwise."""

    def __init__(
        self, gps: Gps, was_unfit: Callable[[int, int, float], bool], shared: float = SHARED_WITH_VELOCITY
    ) -> None:
        """`was_unfit(start_ns, end_ns, moved_m)`: whether receiver or filter had reported such an error.

        `shared`: how many times as large a correction may be as what the position moves against its velocity.
        """
        self._gps, self._was_unfit, self._shared = gps, was_unfit, shared
        self._refused: list[tuple[int, int, str]] = []  # from, until (ns), and why
        self._entries: list[_Entry] = [_Entry(0, np.zeros(3), np.zeros(2), 0)]
        self._suspected: _Entry | None = None  # of an episode under way
        self.begin()

    def begin(self, jumped_ns: int | None = None) -> None:
        """Positions begin again, in another frame perhaps: nothing links them to those before but the doubt itself.

        `jumped_ns`: when those before were found to be elsewhere, if so.
        """
        self._lose_link(0)
        self._largest_m = float(np.linalg.norm((self._suspected or self._entries[-1]).unexplained_m))
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
        return self._entry(moment_ns).at(moment_ns, self._gps.correlation_time_s, self._shared)

    def stretch_at(self, moment_ns: int) -> int:
        """Counts the jumps that ended until a moment: positions on both sides of one cannot be compared."""
        return self._entry(moment_ns).stretch

    def was_steady(self, start_ns: int, end_ns: int) -> bool:
        """Return whether no position jumped between two moments, nor does one now."""
        return self._episode is None and self.stretch_at(start_ns) == self.stretch_at(end_ns)

    def _entry(self, moment_ns: int) -> _Entry:
        if self._suspected is not None and self._suspected.stamp_ns <= moment_ns:
            return self._suspected
        return next((e for e in reversed(self._entries) if e.stamp_ns <= moment_ns), self._entries[0])

    def append(self, positions: Series[Position], sigma_m: tuple[float, float]) -> None:
        """The newest position has come; `sigma_m`: the Gauss-Markov error assumed for it, horizontal and vertical."""
        values, end_ns = positions.values, positions.stamps_ns[-1]
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
            self._follow(positions, np.where(np.isnan(velocities).any(axis=0), 0.0, miss), sigma_m[0])
        else:
            self._lose_link(end_ns)
        most_m = np.maximum(self._gps.glitch_m, GLITCH_SIGMAS * np.array(sigma_m))
        horizontal = np.hypot(miss[0], miss[1]) > most_m[0]
        if not horizontal and abs(miss[2]) <= most_m[1]:
            return
        self._refuse(start_ns, end_ns, f"position jumped {np.linalg.norm(miss):.0f} m against velocity, settling")
        if not velocities or not horizontal:  # else it is measured as slip
            self._add(start_ns, end_ns, miss, sigma_m[0], True, [])

    def _lose_link(self, stamp_ns: int) -> None:
        self._deviations = deque([(stamp_ns, np.zeros(3))])  # position less integrated velocity (3,), recently
        self._episode: _Episode | None = None

    def _follow(self, positions: Series[Position], drift_m: Array, sigma_m: float) -> None:
        """Take how far the newest position has moved from the last one against velocity (3,)."""
        stamp_ns = positions.stamps_ns[-1]
        self._deviations.append((stamp_ns, self._deviations[-1][1] + drift_m))
        # Slip is known of a moment once half its window has passed.
        middle_ns = stamp_ns - RECENT_NS // 2
        self._judge(middle_ns, slip_at(positions, middle_ns, self._gps), sigma_m)
        while self._episode is None and self._deviations[0][0] < stamp_ns - 2 * RECENT_NS:
            self._deviations.popleft()

    def _judge(self, moment_ns: int, slip: Slip, sigma_m: float) -> None:
        slipping, episode = slip.exceeds(EPISODE_SHARE * self._gps.max_slip_m_s), self._episode
        if episode is None:
            if not slipping:
                return
            start_ns = max(moment_ns - RECENT_NS // 2, (self._suspected or self._entries[-1]).stamp_ns)
            before = next((d for t, d in reversed(self._deviations) if t <= start_ns), self._deviations[0][1])
            self._episode = episode = _Episode(start_ns, before)
        newest_ns, deviation = self._deviations[-1]
        moved = deviation - episode.before_m
        episode.most_m = max(episode.most_m, float(np.hypot(moved[0], moved[1])))
        total = self._entries[-1].unexplained_m + moved
        episode.largest_m = max(episode.largest_m, float(np.hypot(total[0], total[1])))
        episode.sigma_m = max(episode.sigma_m, sigma_m)
        episode.is_sure |= slip.exceeds(self._gps.max_slip_m_s)
        if not slipping:
            self._episode = None
            self._add(episode.start_ns, newest_ns, moved, episode.sigma_m, episode.is_sure, self._meanwhile(episode))
        elif episode.is_sure:
            self._suspect(episode)

    def _suspect(self, episode: _Episode) -> None:
        """While it lasts, all that it has moved by so far is in doubt."""
        last, self._suspected = self._entries[-1], None
        if episode.most_m > LIKELY_SIGMAS * episode.sigma_m:
            slow = last.at(episode.start_ns, self._gps.correlation_time_s, self._shared)
            doubt = np.array([slow[0] / self._shared + episode.most_m, 0.0, slow[1]])
            self._suspected = _Entry(episode.start_ns, doubt, np.zeros(2), last.stretch)

    def _meanwhile(self, episode: _Episode) -> list[_Entry]:
        """The doubt while an episode lasted, which what it came to in the end does not undo: the most its sum was."""
        last = self._entries[-1]
        if self._suspected is None:
            return []
        largest_m = max(episode.largest_m, float(np.hypot(last.unexplained_m[0], last.unexplained_m[1])))
        decaying = last.decayed(episode.start_ns, self._gps.correlation_time_s)
        sum_m = np.array([largest_m, 0.0, last.unexplained_m[2]])
        return [replace(last, stamp_ns=episode.start_ns, unexplained_m=sum_m, decaying_m=decaying)]

    def _add(
        self, start_ns: int, end_ns: int, moved_m: Array, sigma_m: float, is_sure: bool, meanwhile: list[_Entry]
    ) -> None:
        """A jump (3,), ENU m, has ended; one that is not sure is too small to doubt a position for."""
        last, self._suspected = self._entries[-1], None
        size_m = float(np.linalg.norm(moved_m))
        total = last.unexplained_m + moved_m
        left_m, before_m = float(np.linalg.norm(total)), float(np.linalg.norm(last.unexplained_m))
        if not is_sure and not left_m < before_m:
            return  # but enough to explain a jump that it undoes
        self._largest_m = max(self._largest_m, left_m)
        decaying = last.decayed(end_ns, self._gps.correlation_time_s)
        if is_sure and left_m > before_m and self._was_unfit(start_ns, end_ns, size_m):
            total = last.unexplained_m
        elif left_m <= max(LIKELY_SIGMAS * sigma_m, EXPLAINED_SHARE * self._largest_m):
            total, decaying, self._largest_m = np.zeros(3), np.hypot(decaying, _parts(total, self._shared)), 0.0
        stretch = last.stretch + (size_m > LIKELY_SIGMAS * sigma_m)
        self._entries += [*meanwhile, _Entry(end_ns, total, decaying, stretch)]
        while self._entries[1].stamp_ns < end_ns - MEMORY_NS:
            del self._entries[0]


def _parts(moved_m: Array, shared: float) -> Array:
    """Horizontal and vertical size of a jump (3,), as the correction at least that it was part of."""
    return np.array([shared * float(np.hypot(moved_m[0], moved_m[1])), abs(float(moved_m[2]))])
