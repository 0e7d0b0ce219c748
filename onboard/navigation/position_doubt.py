"""How far a position may be off because it once moved against its own velocity and nothing has explained it since.

A filter that is misled moves its position without the velocity that would bring it there; so does one that
recovers. Which of the two a single such jump was cannot be determined from telemetry: before or after it the position
is wrong by as much as it jumped. So what jumped is added up as a vector and kept in the sigma for as long as it takes.
It is explained by a jump back, by a receiver or filter that had reported that it has no position, or by being no more
than the Gauss-Markov error that is assumed anyway; what is left then decays with that error's correlation time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.config.schema import Config
from onboard.navigation.position_interpolation import Position
from onboard.navigation.position_slip import SLIP_WINDOW_NS, Slip, SlipTest
from onboard.navigation.time_series import Series

Array = NDArray[np.float64]

# An episode of slip lasts from this share of `gps.max_slip_m_s` until below it again; clean flights stay below.
EPISODE_SHARE = 0.5
ALIKE_SIGMAS = 2.0  # of the Gauss-Markov error: a jump no larger may as well be that
EXPLAINED_SHARE = 0.25  # of the largest jump that may be left after the jump back
# A filter takes part of a correction into its velocity, which is integrated here as real motion. Critically damped,
# position alone moves by 2/e of the correction at most.
SHARED_WITH_VELOCITY = 0.5 * float(np.e)
MAX_ENTRIES = 200


@dataclass(frozen=True, eq=False)
class _Entry:
    """What is doubted from a stamp on: the jumps' sum (3,), ENU m, and what decays (horizontal, vertical), m."""

    stamp_ns: int
    unexplained_m: Array
    decaying_m: Array
    stretch: int

    def at(self, moment_ns: int, time_s: float) -> Array:
        """Horizontal and vertical, m."""
        left = _decayed(self, moment_ns, time_s)
        lasting = _parts(self.unexplained_m)
        return np.asarray(np.hypot(lasting, left), float)


@dataclass(eq=False)
class _Episode:
    """Slip under way since a stamp: the drift before it, and how far it drifted from there at most."""

    start_ns: int
    before_m: Array
    is_sure: bool = False
    most_m: float = 0.0
    sigma_m: float = 0.0  # the largest Gauss-Markov sigma assumed meanwhile


class PositionDoubt:
    """Fed with every newest position; returns how far positions may be off after jumps that nothing has explained."""

    def __init__(self, config: Config, slip: SlipTest, was_unfit: Callable[[int, int, float], bool]) -> None:
        """`was_unfit(start_ns, end_ns, moved_m)`: whether receiver or filter had reported such an error."""
        self._gps, self._slip, self._was_unfit = config.gps, slip, was_unfit
        self._entries: list[_Entry] = [_Entry(0, np.zeros(3), np.zeros(2), 0)]
        self._is_suspected = False  # the newest entry is of an episode under way
        self.begin()

    def begin(self) -> None:
        """Positions begin again, in another frame perhaps: nothing links them to those before but the doubt itself."""
        self._strayed: deque[tuple[int, Array]] = deque()  # (3,) position less integrated velocity, lately
        self._last: Position | None = None
        self._episode: _Episode | None = None
        self._largest_m = float(np.linalg.norm(self._entries[-1].unexplained_m))

    def at(self, moment_ns: int) -> Array:
        """One sigma (m), horizontal and vertical, to be added to what is assumed of a position anyway."""
        return self._entry(moment_ns).at(moment_ns, self._gps.correlation_time_s)

    def stretch_at(self, moment_ns: int) -> int:
        """Counts the jumps that ended until a moment: positions on both sides of one cannot be compared."""
        return self._entry(moment_ns).stretch

    def _entry(self, moment_ns: int) -> _Entry:
        return next((e for e in reversed(self._entries) if e.stamp_ns <= moment_ns), self._entries[0])

    def append(self, positions: Series[Position], sigma_m: float) -> None:
        """The newest position has come; `sigma_m`: the Gauss-Markov error assumed for it, horizontal."""
        stamp_ns, now = positions.stamps_ns[-1], positions.values[-1]
        before, self._last = self._last, now
        is_linked = before is not None and bool(self._strayed)
        if is_linked and (stamp_ns - self._strayed[-1][0]) / 1e9 > self._gps.max_gap_s:
            is_linked = False
        if before is None or not is_linked or before.velocity_enu_m_s is None or now.velocity_enu_m_s is None:
            # Over a gap, or without velocities, nothing is known about a jump.
            self._strayed = deque([(stamp_ns, np.zeros(3))])
            self._episode = None
            return
        seconds = (stamp_ns - self._strayed[-1][0]) / 1e9
        flown = 0.5 * seconds * np.nan_to_num(before.velocity_enu_m_s + now.velocity_enu_m_s)
        moved = now.enu_m - before.enu_m
        if not np.isfinite(before.velocity_enu_m_s[2] + now.velocity_enu_m_s[2]):
            flown[2] = moved[2]  # no climb rate: nothing is known of a jump in height
        self._strayed.append((stamp_ns, self._strayed[-1][1] + moved - flown))
        # Slip is known of a moment once half its window has passed.
        middle_ns = stamp_ns - SLIP_WINDOW_NS // 2
        self._follow(middle_ns, self._slip.at(positions, middle_ns), sigma_m)
        if self._episode is None:
            while self._strayed[0][0] < stamp_ns - 2 * SLIP_WINDOW_NS:
                self._strayed.popleft()

    def _follow(self, moment_ns: int, slip: Slip, sigma_m: float) -> None:
        slipping = slip.exceeds(EPISODE_SHARE * self._gps.max_slip_m_s)
        episode = self._episode
        if episode is None:
            if slipping:
                start_ns = max(moment_ns - SLIP_WINDOW_NS // 2, self._entries[-1].stamp_ns)
                self._episode = episode = _Episode(start_ns, self._strayed_at(start_ns))
            else:
                return
        newest_ns, strayed = self._strayed[-1]
        moved = strayed - episode.before_m
        episode.most_m = max(episode.most_m, float(np.hypot(moved[0], moved[1])))
        episode.sigma_m = max(episode.sigma_m, sigma_m)
        if not episode.is_sure and slip.exceeds(self._gps.max_slip_m_s):
            episode.is_sure = True
        if not slipping:
            self._episode = None
            self._end(episode, newest_ns, moved)
        elif episode.is_sure:
            self._suspect(episode)

    def _strayed_at(self, stamp_ns: int) -> Array:
        return next((s for t, s in reversed(self._strayed) if t <= stamp_ns), self._strayed[0][1])

    def _settled(self) -> _Entry:
        """What was doubted before the episode under way."""
        if self._is_suspected:
            self._entries.pop()
            self._is_suspected = False
        return self._entries[-1]

    def _suspect(self, episode: _Episode) -> None:
        """While it lasts, all that it has moved by so far is in doubt."""
        last = self._settled()
        if episode.most_m <= ALIKE_SIGMAS * episode.sigma_m:
            return
        lasting = last.at(episode.start_ns, self._gps.correlation_time_s)
        doubt = np.array([lasting[0] / SHARED_WITH_VELOCITY + episode.most_m, 0.0, lasting[1]])
        self._put(_Entry(episode.start_ns, doubt, np.zeros(2), last.stretch))
        self._is_suspected = True

    def _end(self, episode: _Episode, end_ns: int, moved_m: Array) -> None:
        last = self._settled()
        self._add(last, episode.start_ns, end_ns, moved_m, episode.sigma_m, episode.is_sure)

    def jumped(self, start_ns: int, end_ns: int, moved_m: Array, sigma_m: float) -> None:
        """A jump (3,), ENU m, between two positions that have no velocities, or upward alone."""
        self._add(self._settled(), start_ns, end_ns, moved_m, sigma_m, True)

    def _add(self, last: _Entry, start_ns: int, end_ns: int, moved_m: Array, sigma_m: float, is_sure: bool) -> None:
        size_m = float(np.linalg.norm(moved_m))
        total = last.unexplained_m + moved_m
        left_m, before_m = float(np.linalg.norm(total)), float(np.linalg.norm(last.unexplained_m))
        if not is_sure and not left_m < before_m:
            return  # too little to doubt a position for; but enough to explain a jump that it undoes
        self._largest_m = max(self._largest_m, left_m)
        stretch = last.stretch + (size_m > ALIKE_SIGMAS * sigma_m)
        decaying = _decayed(last, end_ns, self._gps.correlation_time_s)
        if is_sure and left_m > before_m and self._was_unfit(start_ns, end_ns, size_m):
            total = last.unexplained_m
        elif left_m <= max(ALIKE_SIGMAS * sigma_m, EXPLAINED_SHARE * self._largest_m):
            total, decaying, self._largest_m = np.zeros(3), np.hypot(decaying, _parts(total)), 0.0
        self._put(_Entry(end_ns, total, decaying, stretch))

    def _put(self, entry: _Entry) -> None:
        self._entries.append(entry)
        del self._entries[:-MAX_ENTRIES]


def _parts(moved_m: Array) -> Array:
    """Horizontal and vertical size of a jump (3,), as the correction at least that it was part of."""
    return np.array([SHARED_WITH_VELOCITY * float(np.hypot(moved_m[0], moved_m[1])), abs(float(moved_m[2]))])


def _decayed(entry: _Entry, moment_ns: int, time_s: float) -> Array:
    out: Array = entry.decaying_m * np.exp(-max(moment_ns - entry.stamp_ns, 0) / 1e9 / time_s)
    return out
