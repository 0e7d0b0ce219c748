"""One view's pose from points already known, with whatever is believed of it beforehand. Equations (7.1), (7.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.rotations import exp_so3, log_so3
from onboard.bundle import robust_cost
from onboard.residuals import reprojection, reprojection_jacobians

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


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
) -> Resection:
    """Gauss-Newton from a starting pose, which is also the prior with `prior_sigma` (6,): rad (camera axes), m (ENU).

    `points_enu_m` (N, 3), unit-depth `xy` (N, 2), `weight` (N,) 1 / sigma.
    """
    R0, C0 = R_cam_enu, centre_enu_m
    R, C = R0, C0
    prior = 1.0 / prior_sigma**2
    for _ in range(steps):
        A, _, r, _, _ = _whitened(points_enu_m, xy, weight, R, C, scale)
        off = np.concatenate([log_so3(R @ R0.T), C - C0])
        H = A.T @ A + np.diag(prior)
        step = -np.linalg.solve(H, A.T @ r + prior * off)
        R, C = exp_so3(step[:3]) @ R, C + step[3:]
        # A thousandth of a pixel, a millimetre: far below what the pose is known to.
        if float(np.abs(step[:3]).max()) < 1e-6 and float(np.abs(step[3:]).max()) < 1e-3:
            break
    A, B, _, sigmas, used = _whitened(points_enu_m, xy, weight, R, C, scale)
    information = A.T @ A + np.diag(prior)
    by_point = np.einsum("nai,naj->nij", A.reshape(-1, 2, 6), B.reshape(-1, 2, 3))
    return Resection(R, C, information, by_point, sigmas, used & (sigmas < 2.0 * scale))


def _whitened(
    points: Array, xy: Array, weight: Array, R: Array, C: Array, scale: float
) -> tuple[Array, Array, Array, Array, Mask]:
    residual, predicted, depth = reprojection(R[None], C[None], points, xy.T[None])
    ahead = depth[0] > 1e-6
    squared = np.where(ahead, np.sum(residual[0] ** 2, axis=0) * weight**2, 1e6)
    _, robust = robust_cost(squared, scale)
    s = weight * np.sqrt(robust) * ahead
    by_rotation, by_point = reprojection_jacobians(R[None], predicted, depth, s[None])
    A = np.concatenate([by_rotation[0], -by_point[0]]).transpose(2, 1, 0).reshape(-1, 6)
    B = by_point[0].transpose(2, 1, 0).reshape(-1, 3)
    r = (residual[0] * s).T.reshape(-1)
    return A, B, r, np.sqrt(squared), ahead
