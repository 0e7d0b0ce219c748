"""The test whether a newer solution would change the answers to clicks on a picture, or its set still holds.

A click names a piece of ground that is seen at its pixel. Where the points of the ground have not moved, it has the
same answer; and where they are known no better or worse, the same radius. What remains is ground that could not be
clicked because no point near it was known: with the picture's corners in reach, there is none.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.feature_set import FeatureSet
from onboard.estimation.solved_window import Solved
from onboard.geometry.sampling import evenly
from onboard.georeferencing.feature_sets import Placed

Array = NDArray[np.float64]

MOVED = 0.1  # of the semi-major axis of a point's 90 % ellipse
WIDENED = 0.05  # of the same axis, either way
# Share of the 90 % interval of heights. Its change does not count: it falls by a fifth from the newest picture to the
# window's middle, while the ellipse stays as it is, and the wider one that a picture keeps is as true.
RISEN = 0.2
# Reach of clicks beyond the features' hull, in roots of the hull's area: a little less than the ground's own limit.
IN_REACH = 0.33
MOST_POINTS = 40  # of a pair of solutions that are looked at
RADIUS_90, INTERVAL_90 = float(np.sqrt(-2.0 * np.log(0.1))), 1.645  # in sigmas, of two dimensions and of one


class Revisions:
    """Remembers the newest pair of solutions: all pictures between two keyframes have the same."""

    def __init__(self) -> None:
        self._pair: tuple[Solved, Solved, bool] | None = None
        self._radius_m = 0.0  # the least by the newer of that pair, where its rows take another time

    def is_needless(self, placed: Placed, now: Solved) -> bool:
        """Return whether the picture need not be placed again by `now`."""
        before = placed.solved
        if before is now:
            return True
        if self._pair is None or self._pair[0] is not before or self._pair[1] is not now:
            self._pair = before, now, are_same(before, now)
            self._radius_m = 0.0 if now.readout_s == before.readout_s else _least_radius_m(now)
        is_here = self._pair[2] and is_all_in_reach(placed.feature_set.uv_px, placed.feature_set.camera.size_px)
        return is_here and _rows_move_m(placed.feature_set, now.readout_s - before.readout_s) <= MOVED * self._radius_m


def are_same(before: Solved, now: Solved) -> bool:
    """Return whether the points common to two solutions are where they were, and known as well as they were."""
    one, other = before.common(now)
    if not len(one):
        return False
    some = evenly(len(one), MOST_POINTS)
    one, other = one[some], other[some]
    moved_m = now.solution.state.points_enu_m[other] - before.solution.state.points_enu_m[one]
    moved_m = np.stack([np.hypot(moved_m[:, 0], moved_m[:, 1]), np.abs(moved_m[:, 2])])
    stamp_ns = before.keyframes[-1].nav.stamp_ns
    was_m, is_m = _reaches_m(before, one, stamp_ns), _reaches_m(now, other, stamp_ns)
    is_there = np.all(moved_m < [[MOVED], [RISEN]] * is_m)
    return bool(is_there and np.all(np.abs(was_m[0] - is_m[0]) < WIDENED * is_m[0]))


def _least_radius_m(solved: Solved) -> float:
    rows = np.flatnonzero(solved.good)
    some = rows[evenly(len(rows), MOST_POINTS)]
    return float(_reaches_m(solved, some, solved.keyframes[-1].nav.stamp_ns)[0].min())


def _rows_move_m(feature_set: FeatureSet, longer_s: float) -> float:
    """The largest distance (m) that clicks move over the ground if the readout takes longer: at the corners. (18.5)"""
    if feature_set.shutter is None or longer_s == 0.0:
        return 0.0
    rays, _ = feature_set.camera.unproject(corners_of(feature_set.camera.size_px))
    w = np.maximum(rays @ feature_set.plane_per_m[[1, 2, 0]], 1e-6)
    moved = 0.5 * longer_s * feature_set.shutter.image_velocity(rays[:, :2], w)
    return float((np.linalg.norm(moved, axis=1) / w).max())


def _reaches_m(solved: Solved, rows: NDArray[np.intp], stamp_ns: int) -> Array:
    """Points' errors (2, N), m: semi-major axes of the horizontal 90 % ellipses, and 90 % intervals of the heights."""
    s = solved.solution
    gain = s.point_gain[rows]
    covariance = gain @ solved.covariance_at(stamp_ns) @ gain.transpose(0, 2, 1) + s.point_covariance[rows]
    major, height = np.linalg.eigvalsh(covariance[:, :2, :2])[:, 1], covariance[:, 2, 2]
    return np.sqrt(solved.variance_factor * np.stack([RADIUS_90**2 * major, INTERVAL_90**2 * height]))


def is_all_in_reach(uv_px: Array, size_px: tuple[int, int]) -> bool:
    """Return whether every pixel of a picture is near enough to the hull of features (N, 2) to answer a click."""
    if len(uv_px) < 3:
        return False
    hull = cv2.convexHull(uv_px.astype(np.float32))
    reach_px = IN_REACH * float(np.sqrt(cv2.contourArea(hull)))
    # The hull and what is in reach of it are convex: with the corners, the whole picture is in it.
    corners = corners_of(size_px)
    return all(-cv2.pointPolygonTest(hull, (u, v), True) < reach_px for u, v in corners.tolist())


def corners_of(size_px: tuple[int, int]) -> Array:
    return np.array([(u, v) for u in (0.0, size_px[0] - 1.0) for v in (0.0, size_px[1] - 1.0)])
