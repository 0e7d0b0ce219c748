"""Slopes of patches of a window's ground: how much slopes vary where it is. Equation (14.3) of mathematics.md.

Along a straight track the slope is seen, across it only the sum of slope and roll. But ground that rises and falls
along the track does so across it as well, over patches as long as the strip of points is wide.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.geometry.robust import irls, middle

Array = NDArray[np.float64]

MOST_PATCHES = 6
MIN_POINTS = 8  # of a patch
STRIP = (0.02, 0.98)  # quantiles of the points' places, across and along, by which it is as wide and long as it is
FARTHEST = 3.0  # median distances from the middle; what is farther lies in no patch


def patch_slopes(points_enu_m: Array, variance_m2: Array) -> tuple[Array, Array]:
    """Slopes (C, 2), east and north, of patches less that of all points, and their noise's covariances (C, 2, 2).

    `points_enu_m` (P, 3), `variance_m2` (P,) of their heights. The strip they lie in is cut across its length into
    patches as long as it is wide. Too few points for any patch: one that slopes as all do.
    """
    known = np.all(np.isfinite(points_enu_m), axis=1) & np.isfinite(variance_m2)
    if np.count_nonzero(known) < MIN_POINTS:
        return np.zeros((1, 2)), np.zeros((1, 2, 2))
    points, variance = points_enu_m[known] - np.median(points_enu_m[known], axis=0), variance_m2[known]
    patch_of = _patches(points[:, :2])
    whole, _ = _slope(points[patch_of >= 0], variance[patch_of >= 0])
    counts = np.bincount(patch_of[patch_of >= 0])
    found = [_slope(points[patch_of == k], variance[patch_of == k]) for k in np.flatnonzero(counts >= MIN_POINTS)]
    if not found:
        return np.zeros((1, 2)), np.zeros((1, 2, 2))
    return np.stack([slope - whole for slope, _ in found]), np.stack([noise for _, noise in found])


def _patches(places_m: Array) -> NDArray[np.int64]:
    """Of each of P places (P, 2) about the middle the number of its patch along the strip, -1 outside the strip."""
    distance = np.linalg.norm(places_m, axis=1)
    near = distance <= FARTHEST * middle(distance)
    _, axes = np.linalg.eigh(np.cov(places_m[near].T))
    at = places_m @ axes  # across, along
    begin, end = np.quantile(at[near], STRIP, axis=0)
    width_m, length_m = np.maximum(end - begin, 1e-3)
    count = int(np.clip(round(length_m / width_m), 1, MOST_PATCHES))
    number = np.floor((at[:, 1] - begin[1]) / length_m * count).astype(np.int64)
    return np.where(near, np.clip(number, 0, count - 1), -1)


def _slope(points: Array, variance: Array) -> tuple[Array, Array]:
    """The slope (2,) of a plane through points (P, 3), robust, and the covariance (2, 2) that their noise gives it."""
    H = np.concatenate([np.ones((len(points), 1)), points[:, :2]], axis=1)
    relief = max(middle(np.abs(points[:, 2] - middle(points[:, 2]))), 1e-3)

    def fit(weight: Array) -> tuple[Array, Array]:
        weighted = (H * weight[:, None]).T
        N = weighted @ H
        N.flat[::4] += 1e-9 * N.trace()
        gain = np.linalg.solve(N, weighted)
        return gain, points[:, 2] - H @ (gain @ points[:, 2])

    gain, _ = irls(
        fit,
        1.0 / (variance + relief**2),
        lambda miss: (miss / (3.0 * max(1.4826 * middle(np.abs(miss)), 1e-6))) ** 2,
    )
    slope: Array = (gain @ points[:, 2])[1:]
    noise: Array = ((gain * variance) @ gain.T)[1:, 1:]
    return slope, noise
