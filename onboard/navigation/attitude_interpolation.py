"""Attitudes by time -> attitude and angular rate at any moment, or the reason why there is none.

They are joined by cubic pieces of rotation with the measured rates at both ends (a recorded flight thinned to 3.3 Hz is
then 0.06 deg off at the 95th percentile), else by rotation at constant rate (0.50 deg).
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import exp_so3, log_so3, right_jacobian_inverse
from onboard.navigation.limits import PATIENCE_NS
from onboard.navigation.time_series import Series

Array = NDArray[np.float64]

RATE_WINDOW_NS = 60_000_000
RATES_ABOUT = 20  # measured rates before a moment, and after it, by which it is judged how well they can be joined


@dataclass(frozen=True, eq=False)
class Orientation:
    """An attitude (3, 3) and its rate (3,), rad/s, in body axes, if known."""

    R_ned_body: Array
    rate_body_rad_s: Array | None = None


class Attitudes(Series[Orientation]):
    """Attitudes that may be inserted in any order."""

    def at(self, moment_ns: int) -> Array | Status:
        """R_ned_body (3, 3); STARTING before the first attitude, UNSYNCHRONISED in a gap or past the end."""
        bracket = self.joined(moment_ns)
        if isinstance(bracket, Status):
            return bracket
        left, right = bracket
        a, b = self.values[left], self.values[right]
        if left == right:
            rate = self.rate_at(self.stamps_ns[left])
            turned = np.zeros(3) if rate is None else rate * ((moment_ns - self.stamps_ns[left]) / 1e9)
        else:
            turn, rate_end = _between(a, b)
            s = self.share(left, right, moment_ns)
            turned = s * turn
            if a.rate_body_rad_s is not None and rate_end is not None:
                turned = s * s * (3 - 2 * s) * turn
                turned += self.seconds(left, right) * s * (1 - s) * ((1 - s) * a.rate_body_rad_s - s * rate_end)
        return a.R_ned_body @ exp_so3(turned)

    def sigma_at(self, moment_ns: int) -> float:
        """One sigma (rad) of what `at` may be off by because attitudes come more slowly than the vehicle turns. (1.7)

        Without rates the neighbouring intervals determine it, of the newest those before it.
        """
        bracket = self.bracket(moment_ns)
        if bracket is None:
            return 0.0
        left, right = bracket
        a, b = self.values[left], self.values[right]
        seconds, s = self.seconds(left, right), self.share(left, right, moment_ns)
        turn, rate_end = _between(a, b)
        missed = np.zeros(3)
        if a.rate_body_rad_s is not None and rate_end is not None:
            missed = turn - 0.5 * seconds * (a.rate_body_rad_s + rate_end)
        elif left < right:
            missed = 0.5 * seconds * self._rate_change(left, right)
        return float(2.0 * s * (1.0 - s) * np.linalg.norm(missed))

    def _rate_change(self, left: int, right: int) -> Array:
        """The change of the mean rate (3,), rad/s, from interval to interval about one: by its two neighbours.

        By the larger of the last two changes where the next interval has not come yet.
        """
        is_newest = right + 1 == len(self.values)
        first, last = max(left - 1 - is_newest, 0), min(right + 1, len(self.values) - 1)
        rates = np.array([self._mean_rate(i, i + 1) for i in range(first, last)])
        changes = np.diff(rates, axis=0) if len(rates) > 1 else np.zeros((1, 3))
        out: Array = changes[np.linalg.norm(changes, axis=1).argmax()] if is_newest else changes.mean(axis=0)
        return out

    def _mean_rate(self, left: int, right: int) -> Array:
        """(3,) rad/s between two attitudes."""
        return log_so3(self.values[left].R_ned_body.T @ self.values[right].R_ned_body) / self.seconds(left, right)

    def rate_sigma_at(self, moment_ns: int, jitter_s: float) -> float | None:
        """One sigma (rad/s, of each axis) of what a rate joined from measured ones may be off by, (1.8); None where
        they are not measured, 0 where too few are held. `jitter_s`: one sigma of the moment.
        """
        bracket = self.bracket(moment_ns)
        if bracket is None or any(self.values[i].rate_body_rad_s is None for i in bracket):
            return None
        left, right = bracket
        about = slice(max(left - RATES_ABOUT + 1, 0), right + RATES_ABOUT)
        rates = np.array([a.rate_body_rad_s for a in self.values[about] if a.rate_body_rad_s is not None])
        stamps_s = (np.array(self.stamps_ns[about]) - moment_ns) / 1e9
        if left == right or len(rates) < len(stamps_s) or len(rates) < 5:
            return 0.0  # a miss over two gaps on both sides needs five
        near, far = (_missed(stamps_s, rates, gap) for gap in (1, 2))
        missed = near * min(1.0, near / far) if far > 0.0 else 0.0
        changes = np.diff(rates, axis=0) / np.diff(stamps_s)[:, None]
        return float(np.hypot(missed, jitter_s * np.sqrt(np.mean(changes**2))))

    def rate_at(self, moment_ns: int) -> Array | None:
        """Angular rate (3,), rad/s, body axes: measured, else from attitudes 60 ms apart; None if unknown."""
        bracket = self.joined(moment_ns)
        if isinstance(bracket, Status):
            return None
        left, right = bracket
        a, b = self.values[left].rate_body_rad_s, self.values[right].rate_body_rad_s
        if a is not None and b is not None:
            return a + self.share(left, right, moment_ns) * (b - a)
        while self.stamps_ns[right] - self.stamps_ns[left] < RATE_WINDOW_NS:
            grown = max(left - 1, 0), min(right + 1, len(self.stamps_ns) - 1)
            if grown == (left, right):
                return None
            left, right = grown
        return self._mean_rate(left, right) if self.seconds(left, right) <= self.max_gap_s else None

    def turned(self, start_ns: int, end_ns: int) -> Array | None:
        """The turn R_start_end (3, 3), body axes, by integrated rates (trapezium rule); None where any is missing.

        Attitudes' own errors are not in it.
        """
        if end_ns <= start_ns or any(isinstance(self.joined(t), Status) for t in (start_ns, end_ns)):
            return None
        first, last = bisect.bisect_right(self.stamps_ns, start_ns), bisect.bisect_left(self.stamps_ns, end_ns)
        inner = self.values[first:last]
        measured = [self._measured_rate(start_ns), *(a.rate_body_rad_s for a in inner), self._measured_rate(end_ns)]
        rates = [rate for rate in measured if rate is not None]
        seconds = np.diff(np.array([start_ns, *self.stamps_ns[first:last], end_ns], np.int64)) / 1e9
        if len(rates) < len(measured) or seconds.max() > self.max_gap_s:
            return None
        out = np.eye(3)
        for one, other, step_s in zip(rates, rates[1:], seconds, strict=False):
            out = out @ exp_so3(0.5 * step_s * (one + other))
        return out

    def turned_sigma(self, start_ns: int, end_ns: int, white_rad: float) -> float:
        """One sigma (rad, of each axis) of that turn: what rates miss between messages, and their bias. (1.10)

        `white_rad`: one sigma of an attitude, the white part, by which the bias shows over the last seconds.
        """
        seconds = (end_ns - start_ns) / 1e9
        missed = self.rate_sigma_at(end_ns, 0.0) or 0.0
        first = bisect.bisect_left(self.stamps_ns, end_ns - PATIENCE_NS)
        last = bisect.bisect_right(self.stamps_ns, end_ns) - 1
        if last <= first:
            return np.inf
        span_s = self.seconds(first, last)
        by_rates = self.turned(self.stamps_ns[first], self.stamps_ns[last])
        if by_rates is None or span_s < seconds:
            return np.inf
        by_attitudes = self.values[first].R_ned_body.T @ self.values[last].R_ned_body
        off_rad = float(np.linalg.norm(log_so3(by_rates.T @ by_attitudes))) / np.sqrt(3.0)
        bias_rad_s = np.hypot(off_rad, np.sqrt(2.0) * white_rad) / span_s
        return float(np.hypot(missed * np.sqrt(seconds * self.spacing_ns / 1e9), bias_rad_s * seconds))

    def _measured_rate(self, moment_ns: int) -> Array | None:
        bracket = self.bracket(moment_ns)
        if bracket is None or any(self.values[i].rate_body_rad_s is None for i in bracket):
            return None
        return self.rate_at(moment_ns)


@lru_cache(maxsize=512)  # a window asks again for most of what the one before it asked for, (10.3)
def _between(start: Orientation, end: Orientation) -> tuple[Array, Array | None]:
    """The turn (3,), rad, between two attitudes, and by (1.5) the rate at its end in the axes of its logarithm."""
    turn = log_so3(start.R_ned_body.T @ end.R_ned_body)
    rate = end.rate_body_rad_s
    return turn, None if rate is None else right_jacobian_inverse(turn) @ rate


def _missed(stamps_s: Array, rates: Array, gap: int) -> float:
    """Root of the mean square by which rates (N, 3) at times (N,) miss the line from `gap` before to `gap` after."""
    before, own, after = slice(None, -2 * gap), slice(gap, -gap), slice(2 * gap, None)
    share = (stamps_s[own] - stamps_s[before]) / (stamps_s[after] - stamps_s[before])
    predicted = rates[before] + share[:, None] * (rates[after] - rates[before])
    return float(np.sqrt(np.mean((rates[own] - predicted) ** 2)))
