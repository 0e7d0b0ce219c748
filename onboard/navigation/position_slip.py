"""Slip: the speed at which the filter certainly moves its position against its own velocity.

A filter whose positions are late by more than it assumes moves its position against its velocity whenever it is
accelerated, and nothing is wrong with it then. That slip is part of the test's own covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.config.schema import Gps
from onboard.navigation.limits import LIKELY_SIGMAS, LONG_NS, RECENT_NS, SURE_SIGMAS
from onboard.navigation.position_interpolation import Position
from onboard.navigation.time_series import Series

Array = NDArray[np.float64]
Times = NDArray[np.int64]

MIN_DISPERSION_FREEDOM = 4
DYNAMIC_TIME_S = 3.0  # that a navigation filter takes to forget what acceleration did to it


@dataclass(frozen=True)
class Slip:
    """The filter's certain horizontal slip against its own velocity, and the dispersion about it (m).

    `in_turns_m_s`: one sigma of the slip that acceleration causes in a filter that is in order. (5.21)
    """

    surely_m_s: float = 0.0
    dispersion_m: float = 0.0
    in_turns_m_s: float = 0.0

    def exceeds(self, limit_m_s: float) -> bool:
        """Return whether it is more than a limit and acceleration explain together. (5.22)"""
        return self.surely_m_s > float(np.hypot(limit_m_s, LIKELY_SIGMAS * self.in_turns_m_s))


def slip_at(positions: Series[Position], moment_ns: int, gps: Gps) -> Slip:
    """A line through positions minus integrated velocities over two seconds about a moment.

    Its slope less three of its sigmas, and the dispersion about it per axis; 0 where too little is known.
    """
    about = positions.between(moment_ns - RECENT_NS // 2, moment_ns + RECENT_NS // 2)
    stamps_ns = np.array(about.stamps_ns, np.int64)
    velocities = np.array([p.velocity_enu_m_s[:2] for p in about.values if p.velocity_enu_m_s is not None])
    if (
        len(velocities) < max(len(stamps_ns), 3)
        or stamps_ns[-1] - stamps_ns[0] < RECENT_NS // 2
        or np.diff(stamps_ns).max() > gps.max_gap_s * 1e9
    ):
        return Slip()
    seconds = (stamps_ns - stamps_ns[0]) / 1e9
    deviation = np.array([p.enu_m[:2] for p in about.values]) - _integrated(velocities, seconds)
    deviation -= deviation.mean(axis=0)
    t = seconds - seconds.mean()
    span = float(t @ t)
    slope = t @ deviation / span
    miss = deviation - t[:, None] * slope
    freedom = len(t) - 2
    dispersion_m = gps.sigma_white_m  # of too few to estimate it from
    if freedom >= MIN_DISPERSION_FREEDOM:
        dispersion_m = float(np.sqrt(np.sum(miss**2) / (2 * freedom)))
    surely = float(np.linalg.norm(slope)) - SURE_SIGMAS * dispersion_m / np.sqrt(span)
    if surely <= 0.0:
        return Slip(0.0, dispersion_m)
    by_latency = _integrated(_slip_by_latency(positions, stamps_ns), seconds)
    return Slip(surely, dispersion_m, gps.sigma_latency_s * float(np.linalg.norm(t @ by_latency)) / span)


def _slip_by_latency(positions: Series[Position], moments_ns: Times) -> Array:
    """The slip (n, 2), m/s, of a filter at some moments (n,) if its latency is off by 1 s. Equation (5.21).

    It follows from the velocities' own steps: those of a filter that corrects itself are small next to a turn's.
    """
    held = positions.between(int(moments_ns[0]) - LONG_NS, int(moments_ns[-1]))
    velocities = [p.velocity_enu_m_s for p in held.values]
    known = [(t, v[:2]) for t, v in zip(held.stamps_ns, velocities, strict=True) if v is not None]
    stepped_ns = np.array([t for t, _ in known[1:]], np.int64)
    steps = np.diff(np.array([v for _, v in known]), axis=0)
    ago = (moments_ns[:, None] - stepped_ns) / (1e9 * DYNAMIC_TIME_S)
    answer = np.where(ago >= 0.0, (1.0 - ago) * np.exp(-np.maximum(ago, 0.0)), 0.0)
    return -2.0 / DYNAMIC_TIME_S * answer @ steps


def _integrated(velocities: Array, seconds: Array) -> Array:
    """Distance (n, 2) since the first of some moments (n,) by the trapezium rule."""
    steps = 0.5 * (velocities[1:] + velocities[:-1]) * np.diff(seconds)[:, None]
    return np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
