"""How fast the filter certainly moves its position against its own velocity: more than what it is known to do.

A filter whose positions are late by more than it assumes moves its position against its velocity whenever it is
accelerated, and nothing is wrong with it then. By how much it is late, and how far its response is from the one that is
assumed, the flight's own turns show; what is not known of it yet is part of the test's own covariance.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.config.schema import Gps
from onboard.navigation.position_interpolation import Position
from onboard.navigation.time_series import Series

Array = NDArray[np.float64]
Times = NDArray[np.int64]

SLIP_WINDOW_NS = 2_000_000_000
MIN_DISPERSION_FREEDOM = 4
SURE_SIGMAS = 3.0
LIMIT_SIGMAS = 4.0  # that `gps.max_slip_m_s` is, and so the factor of every part of the test's covariance. (5.22)
RESPONSE_SHARE = 0.3  # of `gps.sigma_latency_s`: one sigma an axis of nine recorded flights about (5.21), pooled
PRIOR_COUNT = 10.0  # effective measurements that this counts for, as in (13.2)
DYNAMIC_TIME_S = 3.0  # that a navigation filter takes to forget what acceleration did to it
REMEMBERED = 4.0  # of these, after which nothing is left


@dataclass(frozen=True)
class Slip:
    """How fast the filter certainly moves its position sideways of its velocity, and the dispersion about that (m).

    Along what acceleration makes a filter do, and across it: `surely_m_s` beyond what the flight has shown so far, and
    `in_turns_m_s`, one sigma of what acceleration does beside. (5.21)
    """

    surely_m_s: tuple[float, float] = (0.0, 0.0)
    dispersion_m: float = 0.0
    in_turns_m_s: tuple[float, float] = (0.0, 0.0)

    @property
    def speed_m_s(self) -> float:
        """In any direction."""
        return math.hypot(*self.surely_m_s)

    def exceeds(self, limit_m_s: float) -> bool:
        """Whether it is more than a limit and acceleration explain together. (5.22)"""
        explained = (math.hypot(limit_m_s, LIMIT_SIGMAS * sigma) for sigma in self.in_turns_m_s)
        return math.hypot(*(s / most for s, most in zip(self.surely_m_s, explained, strict=True))) > 1.0


@dataclass(frozen=True, eq=False)
class _Window:
    """Positions about a moment: stamps (n,), ns, seconds (n,), places (n, 2) and velocities (n, 2), ENU."""

    stamps_ns: Times
    seconds: Array
    places_m: Array
    velocities_m_s: Array


@dataclass(frozen=True, eq=False)
class _Line:
    """A line through positions minus integrated velocities: slope (2,), m/s, one sigma of that an axis, the dispersion
    about it (m), and the slope (2,), m/s, of a filter that is 1 s later than it assumes.
    """

    slope_m_s: Array
    sigma_m_s: float
    dispersion_m: float
    by_latency: Array


class SlipTest:
    """Positions against their own velocities, with the receiver's and the filter's errors as configured.

    Learns from the flight's own turns by how much the filter is late, and how far its response is from (5.21).
    """

    def __init__(self, gps: Gps) -> None:
        self.gps = gps
        self._late_s, self._late_s2 = 0.0, gps.sigma_latency_s**2  # how much later than assumed, and its variance
        self._found = self._expected = 0.0  # of the response, squares in configured variances, as (13.1)
        self._learned_ns = 0  # of the newest moment that is part of them

    @property
    def response_sigma_s(self) -> float:
        """One sigma an axis of a filter's response about (5.21): as configured, and as turns have shown it. (5.23)"""
        factor = (PRIOR_COUNT + self._found) / (PRIOR_COUNT + self._expected)
        return RESPONSE_SHARE * self.gps.sigma_latency_s * math.sqrt(factor)

    def at(self, positions: Series[Position], moment_ns: int) -> Slip:
        """A line through positions minus integrated velocities over two seconds about a moment.

        Its slope less three of its sigmas, and the dispersion about it per axis; 0 where too little is known.
        """
        window = self._window(positions, moment_ns)
        return Slip() if window is None else self._slip(self._line(positions, window))

    def learn(self, positions: Series[Position], moment_ns: int) -> None:
        """Add what a moment shows of how a filter in order slips in turns; no position counts twice. (5.23)

        Nothing is learned of a slip that is taken for a fault.
        """
        if 0 <= moment_ns - self._learned_ns < SLIP_WINDOW_NS:
            return
        window = self._window(positions, moment_ns)
        if window is None:
            return
        self._learned_ns = moment_ns
        line = self._line(positions, window)
        turning = float(np.linalg.norm(line.by_latency))
        by_response = (self.response_sigma_s * turning) ** 2
        if by_response == 0.0 or self._slip(line).exceeds(self.gps.max_slip_m_s):
            return
        own = by_response + line.sigma_m_s**2 + (self.gps.max_slip_m_s / LIMIT_SIGMAS) ** 2
        variance = np.array([own + self._late_s2 * turning**2, own])
        left = self._left(line)
        share = by_response / variance
        self._found += float(np.sum((share * left) ** 2)) / (RESPONSE_SHARE * self.gps.sigma_latency_s * turning) ** 2
        self._expected += float(share.sum())
        self._late_s += self._late_s2 * turning / variance[0] * left[0]
        self._late_s2 *= own / variance[0]

    def _left(self, line: _Line) -> Array:
        """The slope (2,), m/s, that the lateness found so far does not explain: along its own direction, and across."""
        turning = float(np.linalg.norm(line.by_latency))
        east, north = line.by_latency / turning if turning else (1.0, 0.0)
        left = line.slope_m_s - self._late_s * line.by_latency
        return np.array([[east, north], [-north, east]]) @ left

    def _slip(self, line: _Line) -> Slip:
        left = self._left(line)
        surely = max(1.0 - SURE_SIGMAS * line.sigma_m_s / max(float(np.linalg.norm(left)), 1e-12), 0.0)
        if surely == 0.0:
            return Slip(dispersion_m=line.dispersion_m)
        turning, response = float(np.linalg.norm(line.by_latency)), self.response_sigma_s
        in_turns = (math.sqrt(self._late_s2 + response**2) * turning, response * turning)
        return Slip((surely * float(left[0]), surely * float(left[1])), line.dispersion_m, in_turns)

    def _line(self, positions: Series[Position], window: _Window) -> _Line:
        strayed = window.places_m - integrated(window.velocities_m_s, window.seconds)
        strayed -= strayed.mean(axis=0)
        t = window.seconds - window.seconds.mean()
        span = float(t @ t)
        slope = t @ strayed / span
        miss = strayed - t[:, None] * slope
        freedom = len(t) - 2
        dispersion_m = self.gps.sigma_white_m  # of too few to estimate it from
        if freedom >= MIN_DISPERSION_FREEDOM:
            dispersion_m = float(np.sqrt(np.sum(miss**2) / (2 * freedom)))
        by_latency = t @ integrated(_slip_by_latency(positions, window.stamps_ns), window.seconds) / span
        return _Line(slope, dispersion_m / float(np.sqrt(span)), dispersion_m, by_latency)

    def _window(self, positions: Series[Position], moment_ns: int) -> _Window | None:
        """The positions about a moment; None where they are too few, too far apart or without velocities."""
        stamps = positions.stamps_ns
        first = bisect.bisect_left(stamps, moment_ns - SLIP_WINDOW_NS // 2)
        last = bisect.bisect_right(stamps, moment_ns + SLIP_WINDOW_NS // 2) - 1
        if last - first < 2 or stamps[last] - stamps[first] < SLIP_WINDOW_NS // 2:
            return None
        held = positions.values[first : last + 1]
        known = [p.velocity_enu_m_s[:2] for p in held if p.velocity_enu_m_s is not None]
        held_ns = np.array(stamps[first : last + 1], np.int64)
        seconds = (held_ns - held_ns[0]) / 1e9
        if len(known) < len(held) or np.diff(seconds).max() > self.gps.max_gap_s:
            return None
        return _Window(held_ns, seconds, np.array([p.enu_m[:2] for p in held]), np.array(known))


def _slip_by_latency(positions: Series[Position], moments_ns: Times) -> Array:
    """How a filter slips (n, 2), m/s, at some moments (n,) by a latency that is off by 1 s. Equation (5.21).

    Taken from the velocities' own steps: those of a filter that corrects itself are as nothing beside a turn's.
    """
    stamps = positions.stamps_ns
    first = bisect.bisect_left(stamps, int(moments_ns[0]) - round(REMEMBERED * DYNAMIC_TIME_S * 1e9))
    last = bisect.bisect_right(stamps, int(moments_ns[-1]))
    held = [
        (stamp_ns, p.velocity_enu_m_s[:2])
        for stamp_ns, p in zip(stamps[first:last], positions.values[first:last], strict=True)
        if p.velocity_enu_m_s is not None
    ]
    stepped_ns = np.array([stamp_ns for stamp_ns, _ in held[1:]], np.int64)
    steps = np.diff(np.array([v for _, v in held]), axis=0)
    ago = (moments_ns[:, None] - stepped_ns) / (1e9 * DYNAMIC_TIME_S)
    answer = np.where(ago >= 0.0, (1.0 - ago) * np.exp(-np.maximum(ago, 0.0)), 0.0)
    out: Array = -2.0 / DYNAMIC_TIME_S * answer @ steps
    return out


def integrated(velocities: Array, seconds: Array) -> Array:
    """Distance (n, ...) since the first of some moments (n,) by the trapezium rule."""
    out = np.zeros_like(velocities)
    apart_s = (seconds[1:] - seconds[:-1]).reshape(-1, *[1] * (velocities.ndim - 1))
    np.cumsum(0.5 * (velocities[1:] + velocities[:-1]) * apart_s, axis=0, out=out[1:])
    return out
