"""A window's first orientations from rays and GPS positions alone, when no sensor gives attitude. Seed, section 2.2.

One pair with a long baseline and many common features is oriented by `relative_orientation.start_pair`; the other views
follow from its points, nearest first, each by the rotation that best turns the known points' directions into its rays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.geometry.relative_orientation import relative_ransac, rotation_only, start_pair
from onboard.geometry.triangulation import triangulate

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ENOUGH_COMMON = 15
ENOUGH_KNOWN = 8
MIN_SUPPORT = 0.5  # of the common features, near their epipolar planes
MIN_BASELINE_M = 1.0  # below it positions give no direction of travel


def orient(xy: Array, seen: Mask, centres_enu_m: Array, R_body_cam: Array, tolerance_rad: float) -> Array | None:
    """R_cam_enu (K, 3, 3) of every view; None if no pair of them can be oriented.

    Normalised image coordinates `xy` (K, P, 2), `seen` (K, P), GPS `centres_enu_m` (K, 3); `tolerance_rad` is an
    inlier's epipolar error.
    """
    K = len(centres_enu_m)
    common = (seen.astype(int) @ seen.T.astype(int)).astype(float)
    between = centres_enu_m[:, None] - centres_enu_m[None]
    # What was climbed tells no heading, and a pair that has hardly anything else would be given any.
    level2 = np.square(between[..., :2]).sum(axis=-1)
    baseline = level2 / np.maximum(np.sqrt(level2 + np.square(between[..., 2])), 1e-9)
    score = np.where(common >= ENOUGH_COMMON, baseline * np.sqrt(np.minimum(common, 60.0)), 0.0)
    pairs = sorted(((float(score[i, j]), i, j) for i in range(K) for j in range(i + 1, K)), reverse=True)
    for value, i, j in pairs[:3]:
        if value <= 0.0:
            break
        both = seen[i] & seen[j]
        rays_i = np.concatenate([xy[i, both], np.ones((np.count_nonzero(both), 1))], axis=1)
        rays_j = np.concatenate([xy[j, both], np.ones((np.count_nonzero(both), 1))], axis=1)
        pair = start_pair(rays_i, rays_j, centres_enu_m[j] - centres_enu_m[i], R_body_cam, tolerance_rad)
        if pair is None:
            continue
        known = np.zeros(seen.shape[1], bool)
        known[np.flatnonzero(both)[pair.inliers]] = True
        rotations = _spread(xy, seen, centres_enu_m, {i: pair.first, j: pair.second}, known)
        if rotations is not None:
            return rotations
    return None


def follow(rays_before: Array, rays: Array, R_before: Array, travel_enu_m: Array, tolerance_rad: float) -> Array | None:
    """R_cam_enu of a view from the one before it, whose orientation is known, and the positions of both. (3.4)

    For a view that sees no point whose place is known, as after a quick roll. `rays_before`, `rays` (N, 3): features
    that both see, third coordinate 1; `travel_enu_m` (3,) between them; `tolerance_rad` is an inlier's epipolar error.
    None where too few features support any rotation.
    """
    if len(rays) < ENOUGH_COMMON:
        return None
    start = rotation_only(rays_before, rays)
    if float(np.linalg.norm(travel_enu_m)) < MIN_BASELINE_M:
        return start @ R_before
    Q, inliers = relative_ransac(rays_before, rays, R_before @ travel_enu_m, tolerance_rad, Q=start)
    return Q @ R_before if np.count_nonzero(inliers) >= MIN_SUPPORT * len(rays) else None


def _spread(xy: Array, seen: Mask, centres: Array, oriented: dict[int, Array], known: Mask) -> Array | None:
    """Orient the remaining views from triangulated points, the view that sees most of them next."""
    K = len(centres)
    while True:
        views = sorted(oriented)
        R = np.stack([oriented[k] for k in views])
        cloud = triangulate(R, centres[views], xy[views], seen[views])
        known = cloud.is_ahead & ((np.count_nonzero(seen[views], axis=0) > 2) | known | (cloud.parallax_rad > 0.02))
        waiting = [k for k in range(K) if k not in oriented]
        if not waiting:
            return R
        best = max(waiting, key=lambda k: int(np.count_nonzero(seen[k] & known)))
        use = seen[best] & known
        if np.count_nonzero(use) < ENOUGH_KNOWN:
            return None
        rays = np.concatenate([xy[best, use], np.ones((np.count_nonzero(use), 1))], axis=1)
        oriented[best] = rotation_only(cloud.points_enu_m[use] - centres[best], rays)
