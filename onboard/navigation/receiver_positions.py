"""The receiver's own positions: how far they may have jumped, and how far the filter's are from them.

A filter's position is off by its receiver's error and by how far it is from its receiver's position. The first is
judged by the receiver's own velocity (Doppler shifts), in which the filter has no part; the second is seen. So a filter
that is shaken, or that comes back to its receiver's position, is not doubted for longer than it takes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from onboard.config.schema import Gps
from onboard.navigation.limits import LATE_NS, LIKELY_SIGMAS, LONG_NS, RECENT_NS
from onboard.navigation.position_interpolation import Path, Position
from onboard.navigation.position_jumps import PositionJumps
from onboard.navigation.time_series import Series

Array = NDArray[np.float64]

LEAST = 3  # positions in two seconds that something is known by


@dataclass(frozen=True, eq=False)
class _Apart:
    """The filter's position less the receiver's at a stamp of the latter (2,), m; the filter's velocity (2,), m/s."""

    offset_m: Array
    velocity_m_s: Array


class _Lag:
    """The time by which the receiver's positions come behind the filter's: a straight line's slope. (5.25)

    One change of their difference over two seconds upon the velocity's; one that went farther than the position's sigma
    hardly counts. Before the velocity has changed, it is 0 within `LATE_NS`.
    """

    def __init__(self, white_m: float) -> None:
        """`white_m`: least one sigma of a change."""
        self._white_m, self._count = white_m, 0
        # Of weight times offset and velocity, velocity and velocity, miss and miss.
        self._sums = np.array([0.0, (white_m / (LATE_NS / 1e9)) ** 2, 0.0])

    @property
    def seconds(self) -> float:
        """Its estimate."""
        return float(self._sums[0] / self._sums[1])

    @property
    def sigma_s(self) -> float:
        """One sigma of it."""
        variance = max(self._white_m**2, self._sums[2] / max(2 * self._count - 1, 1))
        return float(np.sqrt(variance / self._sums[1]))

    def learn(self, before: _Apart, after: _Apart, sigma_m: float) -> None:
        """Take one more change."""
        offset, by = after.offset_m - before.offset_m, after.velocity_m_s - before.velocity_m_s
        miss = offset - self.seconds * by
        weight = 1.0 / (1.0 + float(miss @ miss) / sigma_m**2)
        self._sums += weight * np.array([offset @ by, by @ by, miss @ miss])
        self._count += 1


class ReceiverPositions:
    """Takes the receiver's positions and then the filter's; knows how far the filter's may be off, horizontally."""

    def __init__(self, gps: Gps, was_unfit: Callable[[int, int, float], bool]) -> None:
        """`was_unfit(start_ns, end_ns, moved_m)`: whether the receiver had reported such an error."""
        self._gps, self._lag = gps, _Lag(gps.sigma_white_m)
        self.jumps = PositionJumps(gps, was_unfit, shared=1.0)
        self.begin(None)

    def begin(self, jumped_ns: int | None) -> None:
        """Positions come in a new frame."""
        self._path = Path(self._gps.max_gap_s)
        self._apart: Series[_Apart] = Series()
        self._waiting_ns: deque[int] = deque()  # stamps that the filter's positions have not reached yet
        self._learned_ns = 0
        self.jumps.begin(jumped_ns)

    def insert(self, stamp_ns: int, position: Position, sigma_m: tuple[float, float]) -> None:
        """Take one of the receiver's; `sigma_m`: the Gauss-Markov error assumed for it, horizontal and vertical.

        Its climb rate, where it reports one, is left out: heights are not judged here.
        """
        if position.velocity_enu_m_s is not None:
            velocity = np.array([*position.velocity_enu_m_s[:2], np.nan])
            position = Position(position.enu_m, velocity, position.height_above_home_m)
        if self._path.insert(stamp_ns, position) == len(self._path.stamps_ns) - 1:
            self.jumps.append(self._path, sigma_m)
            self._waiting_ns.append(stamp_ns)

    def compare(self, filtered: Path, sigma_m: float) -> None:
        """Take note that the filter's positions have grown; `sigma_m`: the Gauss-Markov error assumed, horizontal."""
        while self._waiting_ns and self._waiting_ns[0] <= filtered.stamps_ns[-1]:
            stamp_ns = self._waiting_ns.popleft()
            here, (own, *_) = filtered.at(stamp_ns), self._path.latest(stamp_ns)
            if isinstance(here, Status) or here.velocity_enu_m_s is None:
                continue
            apart = _Apart((here.enu_m - own.enu_m)[:2], here.velocity_enu_m_s[:2])
            self._apart.insert(stamp_ns, apart)
            if stamp_ns >= self._learned_ns + RECENT_NS:
                before = self._apart.between(stamp_ns - 2 * RECENT_NS, self._learned_ns).values
                if before:
                    self._lag.learn(before[-1], apart, sigma_m)
                self._learned_ns = stamp_ns

    def was_steady(self, start_ns: int, end_ns: int) -> bool:
        """Return whether the receiver's positions are known not to have jumped in or shortly before a stretch."""
        known = len(self._path.between(end_ns - RECENT_NS, end_ns).values) >= LEAST
        return known and self.jumps.was_steady(start_ns - LONG_NS, end_ns)

    def doubt_m(self, moment_ns: int) -> float | None:
        """One sigma (m) to be added to what is assumed of a receiver's position; None where too little was reported.

        The jumps of the receiver, (5.24), and the filter's distance from it: the worse of the second before and after.
        """
        sides = (
            self._apart.between(moment_ns - RECENT_NS // 2, moment_ns),
            self._apart.between(moment_ns + 1, moment_ns + RECENT_NS // 2),
        )
        if not sides[0].values or sum(len(side.values) for side in sides) < LEAST:
            return None
        apart_m = max(self._apart_m(side.values) for side in sides if side.values)
        return float(np.hypot(self.jumps.at(moment_ns)[0], apart_m))

    def _apart_m(self, side: list[_Apart]) -> float:
        """The distance of the filter from the receiver along and across its track, as far as it is no chance. (5.25)"""
        offsets = np.array([a.offset_m - self._lag.seconds * a.velocity_m_s for a in side])
        mean, velocity = offsets.mean(axis=0), np.mean([a.velocity_m_s for a in side], axis=0)
        speed = float(np.linalg.norm(velocity))
        along = velocity / speed if speed > 0.0 else np.array([1.0, 0.0])
        white = float(np.sqrt(np.mean((offsets - mean) ** 2))) if len(side) > 1 else self._gps.sigma_white_m
        sigmas = np.array([white, white]) / np.sqrt(len(side))
        sigmas[0] = np.hypot(sigmas[0], speed * self._lag.sigma_s)
        parts = np.array([along @ mean, along[0] * mean[1] - along[1] * mean[0]])
        return float(np.linalg.norm(parts[np.abs(parts) > LIKELY_SIGMAS * sigmas]))
