"""The variance of the slope across a window's track, if ground varies across a track as it does along it.

Along a straight track the ground's heights are seen, across it only the sum of slope and roll. The variogram of the
heights along it gives the variance of any slope, without a model of the covariance. Section 14 of mathematics.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.kriging import distances
from onboard.geometry.plane_fit import fit_plane
from onboard.geometry.robust import OUTLIER_SIGMAS, middle
from onboard.geometry.sampling import evenly

Array = NDArray[np.float64]

MIN_POINTS = 12
MOST_POINTS = 100  # whose pairs are compared
FARTHEST = 3.0  # median distances from the middle; what is farther is left out
STEEPEST_PAIR = np.tan(np.radians(30.0))  # of a pair's direction from the track's
CLASSES = 12  # of distance
MIN_PAIRS = 6  # of a class


def slope_variance(points_enu_m: Array, variance_m2: Array, along: Array) -> float:
    """Variance of the slope across a direction `along` (2,) of the plane through points (P, 3), noise left out. (14.3)

    `variance_m2` (P,) of their heights. Zero where there are too few points.
    """
    known = np.flatnonzero(np.all(np.isfinite(points_enu_m), axis=1) & np.isfinite(variance_m2))
    if len(known) < MIN_POINTS:
        return 0.0
    some = known[evenly(len(known), MOST_POINTS)]
    east, north = along / max(float(np.linalg.norm(along)), 1e-9)
    from_middle = points_enu_m[some, :2] - np.median(points_enu_m[some, :2], axis=0)
    places, height = from_middle @ np.array([[east, -north], [north, east]]), points_enu_m[some, 2]
    used = _belong(places, height)
    rows = np.concatenate([np.ones((np.count_nonzero(used), 1)), places[used]], axis=1)
    across: Array = np.linalg.pinv(rows)[2]
    return max(-float(across @ _variogram(places[used], height[used], variance_m2[some][used]) @ across), 0.0)


def _belong(places_m: Array, height_m: Array) -> NDArray[np.bool_]:
    """A mask (P,) of the points that lie near the others and their plane: points of wrong tracks do not."""
    distance = np.linalg.norm(places_m, axis=1)
    near = distance <= FARTHEST * middle(distance)
    plane, spread_m = fit_plane(np.column_stack([places_m, height_m])[near])
    belong: NDArray[np.bool_] = near & (np.abs(height_m - plane[0] - places_m @ plane[1:]) <= OUTLIER_SIGMAS * spread_m)
    return belong


def _variogram(places_m: Array, height_m: Array, noise_m2: Array) -> Array:
    """Half the mean square of heights' differences (P, P) by distance, from pairs along the track. (14.3)

    `places_m` (P, 2) along and across.
    """
    apart_m = distances(places_m, places_m)
    farthest_m = max(float(apart_m.max()), 1e-9)
    first, second = np.triu_indices(len(places_m), 1)
    along, across = np.abs(places_m[first] - places_m[second]).T
    kind = np.minimum((apart_m[first, second] / farthest_m * CLASSES).astype(np.int64), CLASSES - 1)
    seen = across < STEEPEST_PAIR * along
    count = np.bincount(kind[seen], minlength=CLASSES)
    half_square = 0.5 * np.bincount(kind[seen], (height_m[first] - height_m[second])[seen] ** 2, CLASSES)
    taken = count >= MIN_PAIRS
    distance = np.concatenate([[0.0], (np.flatnonzero(taken) + 0.5) / CLASSES * farthest_m])
    value = np.concatenate([[0.0], np.maximum(half_square[taken] / count[taken] - middle(noise_m2), 0.0)])
    return np.asarray(np.interp(apart_m, distance, value), float)
