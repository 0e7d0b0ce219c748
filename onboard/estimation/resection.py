"""One view's pose from points already known and a prior pose. Equations (7.1), (7.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.rotations import exp_so3, log_so3
from onboard.estimation.factors import reprojection, reprojection_jacobians
from onboard.geometry.linalg import solve_small
from onboard.geometry.robust import robust_cost

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SETTLED = 1.0 / np.array([1e-5] * 3 + [1e-2] * 3)  # one over the step, rad and m, that is nothing any more


@dataclass(frozen=True, eq=False)
class Resection:
    """A pose, its information (6, 6) from pixels and prior (points taken as known), and how the pixels fit."""

    R_cam_enu: Array
    centre_enu_m: Array
    information: Array
    by_point: Array  # (N, 6, 3): J_view' J_point of each measurement, weighted
    sigmas: Array  # (N,) length of each whitened residual
    inliers: Mask


def resect(
    points_enu_m: Array,
    xy: Array,
    weight: Array,
    R_cam_enu: Array,
    centre_enu_m: Array,
    prior_sigma: Array,
    scale: float = 3.0,
    steps: int = 8,
    start: tuple[Array, Array] | None = None,
) -> Resection:
    """Gauss-Newton from a starting pose, which is also the prior with `prior_sigma` (6,): rad (camera axes), m (ENU).

    `start`, rotation and centre, is where to begin if a pose better than the prior's is known.

    `points_enu_m` (N, 3), normalised image coordinates `xy` (N, 2), `weight` (N,) 1 / sigma.
    """
    R0, C0 = R_cam_enu, centre_enu_m
    R, C = start or (R0, C0)
    prior = 1.0 / prior_sigma**2
    stiff = np.diag(prior)
    for _ in range(steps):
        A, _, r, _, _ = _whitened(points_enu_m, xy, weight, R, C, scale)
        off = np.concatenate([log_so3(R @ R0.T), C - C0])
        step = -solve_small(A @ A.T + stiff, A @ r + prior * off)
        R, C = exp_so3(step[:3]) @ R, C + step[3:]
        # A hundredth of a pixel, a centimetre: far below what the pose is known to.
        if np.abs(step * _SETTLED).max() < 1.0:
            break
    A, B, _, sigmas, used = _whitened(points_enu_m, xy, weight, R, C, scale)
    information = A @ A.T + stiff
    rows, N = A.reshape(6, 2, -1), len(points_enu_m)
    by_point = (rows[:, None, 0] * B[:, 0] + rows[:, None, 1] * B[:, 1]).reshape(18, N).T.reshape(N, 6, 3)
    return Resection(R, C, information, by_point, sigmas, used & (sigmas < 2.0 * scale))


def _whitened(
    points: Array, xy: Array, weight: Array, R: Array, C: Array, scale: float
) -> tuple[Array, Array, Array, Array, Mask]:
    """Rows by the view (6, 2N), by the point (3, 2, N), residual (2N,), sigmas (N,), and which lie ahead (N,)."""
    residual, predicted, depth = reprojection(R[None], C[None], points, xy.T[None])
    ahead: Mask = depth[0] > 1e-6
    squared = np.where(ahead, (residual[0] ** 2).sum(axis=0) * weight**2, 1e6)
    _, robust = robust_cost(squared, scale)
    s = weight * np.sqrt(robust) * ahead
    by_rotation, by_point = reprojection_jacobians(R[None], predicted, depth, s[None])
    A = np.concatenate([by_rotation[0], -by_point[0]]).reshape(6, -1)
    return A, by_point[0], (residual[0] * s).reshape(-1), np.sqrt(squared), ahead
