"""Attitudes by time -> attitude and angular rate at any moment, or the reason why there is none.

They are joined by cubic pieces of rotation with the measured rates at both ends (a recorded flight thinned to 3.3 Hz is
then 0.06 deg off at the 95th percentile), else by rotation at constant rate (0.50 deg).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import exp_so3, log_so3, right_jacobian_inverse
from onboard.navigation.time_series import Series

Array = NDArray[np.float64]

RATE_WINDOW_NS = 60_000_000
RATES_ABOUT = 20  # measured rates before a moment, and after it, by which it is judged how well they can be joined


@dataclass(frozen=True, eq=False)
class _Attitude:
    R_ned_body: Array
    rate_body_rad_s: Array | None


class Attitudes:
    """Fed in any order; gaps longer than `max_gap_s` are not bridged."""

    def __init__(self, max_gap_s: float) -> None:
        self._max_gap_s = max_gap_s
        self._series: Series[_Attitude] = Series()

    def insert(self, stamp_ns: int, R_ned_body: Array, rate_body_rad_s: Array | None) -> None:
        """Take one attitude (3, 3) and its rate (3,), rad/s, in body axes, if known."""
        self._series.insert(stamp_ns, _Attitude(R_ned_body, rate_body_rad_s))

    @property
    def stamps_ns(self) -> list[int]:
        """When attitudes are held, sorted."""
        return self._series.stamps_ns

    @property
    def spacing_ns(self) -> int:
        """The longest of the last intervals between attitudes that may be joined; 0 for fewer than two."""
        return self._series.spacing_ns(self._max_gap_s)

    def forget(self) -> None:
        """The clock has stepped: nothing held can be compared any more."""
        self._series = Series()

    def at(self, moment_ns: int) -> Array | Status:
        """R_ned_body (3, 3); STARTING before the first attitude, UNSYNCHRONISED in a gap or past the end."""
        series = self._series
        bracket = series.joined(moment_ns, self._max_gap_s)
        if isinstance(bracket, Status):
            return bracket
        left, right = bracket
        start_ns, end_ns = series.stamps_ns[left], series.stamps_ns[right]
        before, after = series.values[left], series.values[right]
        if left == right:
            rate = self.rate_at(start_ns)
            turned = np.zeros(3) if rate is None else rate * ((moment_ns - start_ns) / 1e9)
            out: Array = before.R_ned_body @ exp_so3(turned)
            return out
        seconds = (end_ns - start_ns) / 1e9
        s = (moment_ns - start_ns) / 1e9 / seconds
        turn, rate_end = _between(before, after)
        if before.rate_body_rad_s is None or rate_end is None:
            turned = s * turn
        else:
            turned = s * s * (3 - 2 * s) * turn
            turned += seconds * s * (1 - s) * ((1 - s) * before.rate_body_rad_s - s * rate_end)
        out = before.R_ned_body @ exp_so3(turned)
        return out

    def sigma_at(self, moment_ns: int) -> float:
        """One sigma (rad) of what `at` may be off by because attitudes come more slowly than the vehicle turns. (1.7)

        Between two attitudes their own rates determine how far the vehicle should have turned; by how much it turned
        differently, the motion has changed in between. Without rates the neighbouring intervals determine it.
        """
        series = self._series
        bracket = series.bracket(moment_ns)
        if bracket is None or bracket[0] == bracket[1]:
            return 0.0
        left, right = bracket
        a, b = series.values[left], series.values[right]
        seconds = (series.stamps_ns[right] - series.stamps_ns[left]) / 1e9
        s = (moment_ns - series.stamps_ns[left]) / 1e9 / seconds
        turn, rate_end = _between(a, b)
        missed = np.zeros(3)
        if a.rate_body_rad_s is not None and rate_end is not None:
            missed = turn - 0.5 * seconds * (a.rate_body_rad_s + rate_end)
        elif left > 0 and right + 1 < len(series.values):
            missed = 0.25 * seconds * (self._mean_rate(right) - self._mean_rate(left - 1))
        return float(2.0 * s * (1.0 - s) * np.linalg.norm(missed))

    def _mean_rate(self, index: int) -> Array:
        """(3,) rad/s between an attitude and the next."""
        series = self._series
        seconds = (series.stamps_ns[index + 1] - series.stamps_ns[index]) / 1e9
        out: Array = log_so3(series.values[index].R_ned_body.T @ series.values[index + 1].R_ned_body) / seconds
        return out

    def rate_sigma_at(self, moment_ns: int, jitter_s: float) -> float | None:
        """One sigma (rad/s, of each axis) of what a rate joined from measured ones may be off by, (1.8); None where
        they are not measured. `jitter_s`: one sigma of the moment.

        Each measured rate is predicted from its neighbours, and from theirs: the two misses show how an error grows
        with the gap, and so what it is over the gap that is bridged. 0 where too few are held.
        """
        bracket = self._series.bracket(moment_ns)
        if bracket is None or any(self._series.values[i].rate_body_rad_s is None for i in bracket):
            return None
        left, right = bracket
        first, end = max(left - RATES_ABOUT + 1, 0), right + RATES_ABOUT
        about = [a.rate_body_rad_s for a in self._series.values[first:end]]
        rates = np.array([r for r in about if r is not None])
        if left == right or len(rates) < len(about) or len(rates) < 5:
            return 0.0  # a miss over two gaps on both sides needs five
        stamps_s = (np.array(self._series.stamps_ns[first:end]) - moment_ns) / 1e9
        near, far = (_missed(stamps_s, rates, gap) for gap in (1, 2))
        missed = near * min(1.0, near / far) if far > 0.0 else 0.0
        changes = np.diff(rates, axis=0) / np.diff(stamps_s)[:, None]
        return float(np.hypot(missed, jitter_s * np.sqrt(np.mean(changes**2))))

    def rate_at(self, stamp_ns: int) -> Array | None:
        """Angular rate (3,), rad/s, body axes: measured, else from attitudes 60 ms apart; None if unknown."""
        series = self._series
        bracket = series.bracket(stamp_ns)
        if bracket is None:
            return None
        left, right = bracket
        a, b = series.values[left].rate_body_rad_s, series.values[right].rate_body_rad_s
        measured = a is not None and b is not None
        while not measured and series.stamps_ns[right] - series.stamps_ns[left] < RATE_WINDOW_NS:
            grown = max(left - 1, 0), min(right + 1, len(series.stamps_ns) - 1)
            if grown == (left, right):
                return None
            left, right = grown
        seconds = (series.stamps_ns[right] - series.stamps_ns[left]) / 1e9
        if seconds > self._max_gap_s:
            return None
        if a is not None and b is not None:
            share = (stamp_ns - series.stamps_ns[left]) / 1e9 / seconds if seconds else 0.0
            return a + share * (b - a)
        rate: Array = log_so3(series.values[left].R_ned_body.T @ series.values[right].R_ned_body) / seconds
        return rate


@lru_cache(maxsize=512)  # a window asks again for most of what the one before it asked for, (10.3)
def _between(start: _Attitude, end: _Attitude) -> tuple[Array, Array | None]:
    """The turn (3,), rad, between two attitudes in a row, and the rate at its end in the axes of its logarithm."""
    turn = log_so3(start.R_ned_body.T @ end.R_ned_body)
    # d exp(v)/dt = exp(v) [rate]x gives dv/dt = Jr^-1(v) rate: (1.5).
    rate = end.rate_body_rad_s
    return turn, None if rate is None else right_jacobian_inverse(turn) @ rate


def _missed(stamps_s: Array, rates: Array, gap: int) -> float:
    """Root of the mean square by which rates (N, 3) at times (N,) miss the line from `gap` before to `gap` after."""
    before, own, after = slice(None, -2 * gap), slice(gap, -gap), slice(2 * gap, None)
    share = (stamps_s[own] - stamps_s[before]) / (stamps_s[after] - stamps_s[before])
    predicted = rates[before] + share[:, None] * (rates[after] - rates[before])
    return float(np.sqrt(np.mean((rates[own] - predicted) ** 2)))
