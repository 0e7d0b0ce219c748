"""The second motion that explains how pictures of a plane change: the two-fold ambiguity of a plane. (3.9)

Longuet-Higgins 1986; in closed form Malis and Vargas 2007, section 4. Two views of a plane are related by a homography,
and a homography decomposes into two motions with a plane each. Where the travel is nearly along the plane's normal (a
climb) both planes lie ahead of both views, and the second motion is as good as the true one as far as the ground is
flat.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MIN_TRAVEL = 1e-3  # of the distance to the plane, below which two views have no other motion


def second_motion(travel_m: Array, normal: Array, distance_m: float) -> tuple[Array, Array, Array]:
    """Rotation Q (3, 3), travel (3,) and normal (3,) of the second motion of a view that travels without turning.

    All in the first view's axes: a point X of the plane `normal @ X == distance_m` appears at X - travel_m in the
    second view, and by the second motion in the direction of Q (X - travel). The same motion has travel and normal of
    the other sign too; which of both planes lies ahead is for the caller to see. The first motion where there is none.
    """
    t = -travel_m / distance_m
    length = float(np.linalg.norm(t))
    both = length * normal + 2.0 / max(length, 1e-12) * t
    rho = float(np.linalg.norm(both))
    if min(length, rho) < MIN_TRAVEL:
        return np.eye(3), travel_m, normal
    plane, travel = both / rho, length / rho * (2.0 * (1.0 + float(normal @ t)) * normal - t)
    Q = (np.eye(3) + np.outer(t, normal)) @ np.linalg.inv(np.eye(3) + np.outer(travel, plane))
    return Q, -distance_m * travel, plane


def mirrored(
    R_cam_enu: Array, centres_enu_m: Array, plane: Array, xy: Array, seen: NDArray[np.bool_], least_ahead: float
) -> Array | None:
    """R_cam_enu (K, 3, 3) of views whose pictures of a plane the second motion explains; None if it does not. (3.10)

    `plane` (3,): height at the origin (m), slope east, slope north. `xy` (K, P, 2) normalised image coordinates, `seen`
    (K, P). None where less than the share `least_ahead` of the measurements look at the second motion's plane.
    """
    K = len(centres_enu_m)
    middle = K // 2
    normal = np.array([plane[1], plane[2], -1.0])
    normal /= np.linalg.norm(normal)
    at = centres_enu_m[middle]
    distance_m = float((at[2] - plane[0] - plane[1:] @ at[:2]) * -normal[2])
    if distance_m <= 0.0:
        return None
    travel = centres_enu_m - at
    motions = [second_motion(t, normal, distance_m) for t in travel]
    far = np.linalg.norm(travel, axis=1) > MIN_TRAVEL * distance_m
    if np.count_nonzero(far) < 2:
        return None
    # Where the travel turns round its plane does too: all are counted on the side of the farthest view's.
    farthest = motions[int(np.argmax(np.linalg.norm(travel, axis=1)))][2]
    side = np.array([1.0 if float(m[2] @ farthest) >= 0.0 else -1.0 for m in motions])
    by_second = np.stack([m[1] for m in motions]) * side[:, None]
    normals = np.stack([m[2] for m in motions]) * side[:, None]
    turned = np.stack([R @ m[0] for R, m in zip(R_cam_enu, motions, strict=True)])
    rays = np.concatenate([xy, np.ones((*seen.shape, 1))], axis=2) @ turned
    second = normals[far].mean(axis=0)
    looks = float(np.mean((rays @ second)[seen] > 0.0))
    if max(looks, 1.0 - looks) < least_ahead:
        return None
    if looks < 0.5:
        by_second, second = -by_second, -second
    # To the world's axes, in which travel and plane are known: the rotation that takes both nearest to them.
    size = float(np.sum(travel[far] ** 2))
    U, _, Vt = np.linalg.svd(travel[far].T @ by_second[far] + size * np.outer(normal, second))
    A = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    out: Array = turned @ A.T
    return out
