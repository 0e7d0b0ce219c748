"""The fit of the autopilot's record of shots to pictures at any time offset; either side may have lost some."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOST = 0.01  # how likely a shot is without its picture, and a picture without its shot
SPREAD_S = 0.03  # one sigma of how long a camera takes, from shot to shot
LATEST_S, STEP_S = 0.3, 0.05  # by which an exposure may follow its record, where the record is the trigger's


def shot_cost(moments_ns: Sequence[int], shots_ns: Sequence[int], offsets_s: Array, stamp_sigma_s: float) -> Array:
    """(T,) costs of offsets by counts and spacing, as -2 times the logarithm of a likelihood. (28.6)"""
    if not moments_ns or not shots_ns:
        return np.zeros(len(offsets_s))
    pictures = (np.asarray(moments_ns, np.int64) - moments_ns[0]) / 1e9
    shots = (np.sort(np.asarray(shots_ns, np.int64)) - moments_ns[0]) / 1e9
    sigma_s = float(np.hypot(stamp_sigma_s, SPREAD_S))
    sums = np.full((len(offsets_s), 0), np.inf)
    for late_s in np.arange(0.0, LATEST_S + 0.5 * STEP_S, STEP_S):
        moved = pictures + (offsets_s - late_s)[:, None]
        one = _misses(moved, shots, sigma_s).sum(axis=1)
        other = np.array([_misses(shots, row, sigma_s).sum() for row in np.sort(moved, axis=1)])
        sums = np.column_stack([sums, one + other])
    out: Array = sums.min(axis=1)
    return out


def _misses(of: Array, among: Array, sigma_s: float) -> Array:
    """The cost of each by its distance from the nearest; half of a square, because a pair is counted by both."""
    right = np.clip(np.searchsorted(among, of), 1, max(len(among) - 1, 1))
    near = np.minimum(np.abs(of - among[right - 1]), np.abs(of - among[right % len(among)]))
    out: Array = -2.0 * np.log(np.exp(-0.25 * np.square(near / sigma_s)) + LOST)
    return out
