"""One view's pose from points already known and a prior pose. Equations (7.1), (7.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rotations import exp_so3, log_so3
from onboard.estimation.factors import reprojection, reprojection_jacobians
from onboard.estimation.noise_shape import rounded, shape_of
from onboard.estimation.rolling_shutter import Sweep
from onboard.geometry.linalg import solve_small
from onboard.geometry.robust import robust_cost

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# A step (rad, m, rad/s) that is nothing any more: a hundredth of a pixel, a centimetre, far below what is known.
_SETTLED = np.array([1e-5] * 3 + [1e-2] * 3 + [1e-3] * 3)


class Sighted(NamedTuple):
    """Points (N, 3), ENU m, their normalised image coordinates (N, 2) in one view, and 1 / sigma of these (N,).

    `seen_by`: the camera, where the noise may not be round in these coordinates.
    """

    points_enu_m: Array
    xy: Array
    weight: Array
    seen_by: Camera | None = None


@dataclass(frozen=True, eq=False)
class Resection:
    """A pose, its information (6, 6) from pixels and prior (points taken as known), and how the pixels fit."""

    R_cam_enu: Array
    centre_enu_m: Array
    information: Array
    by_point: Array  # (N, 6, 3): J_view' J_point of each measurement, weighted
    sigmas: Array  # (N,) length of each whitened residual
    inliers: Mask
    # The correction of the given rate if nothing measures that; information and `by_point` then have three more rows.
    rate_off_rad_s: Array


def resect(
    seen: Sighted,
    R_cam_enu: Array,
    centre_enu_m: Array,
    prior_sigma: Array,
    scale: float = 3.0,
    steps: int = 8,
    start: tuple[Array, Array] | None = None,
    sweep: Sweep | None = None,
) -> Resection:
    """Gauss-Newton from a starting pose, which is also the prior with `prior_sigma` (6,): rad (camera axes), m (ENU).

    `start`: rotation and centre to begin from, if better ones are known. `sweep`: of this one view, where `seen.xy` is
    what its rows saw.
    """
    R0, C0 = R_cam_enu, centre_enu_m
    R, C = start or (R0, C0)
    rate_off, rate_sigma = np.zeros(3), 0.0 if sweep is None else sweep.sigma_rate_rad_s
    n = 9 if rate_sigma > 0.0 else 6
    prior = 1.0 / np.append(prior_sigma, [rate_sigma] * 3)[:n] ** 2
    stiff, step = np.diag(prior), np.zeros(9)
    for _ in range(steps):
        A, _, r, _, _ = _whitened(seen, R, C, scale, sweep, rate_off)
        off = np.concatenate([log_so3(R @ R0.T), C - C0, rate_off])[:n]
        step[:n] = -solve_small(A @ A.T + stiff, A @ r + prior * off)
        R, C, rate_off = exp_so3(step[:3]) @ R, C + step[3:6], rate_off + step[6:]
        if np.all(np.abs(step) < _SETTLED):
            break
    A, B, _, sigmas, ahead = _whitened(seen, R, C, scale, sweep, rate_off)
    by_point = np.einsum("vip,cip->pvc", A.reshape(n, 2, -1), B)
    return Resection(R, C, A @ A.T + stiff, by_point, sigmas, ahead & (sigmas < 2.0 * scale), rate_off)


def _whitened(
    seen: Sighted, R: Array, C: Array, scale: float, sweep: Sweep | None, rate_off: Array
) -> tuple[Array, Array, Array, Array, Mask]:
    """Rows by the view (6, 2N), by the point (3, 2, N), residual (2N,), sigmas (N,), and which lie ahead (N,).

    By the view (9, 2N) where its angular rate is to be found too.
    """
    points, xy, weight, seen_by = seen
    shape = shape_of(seen_by, xy.T[None])
    residual, predicted, depth = reprojection(R[None], C[None], points, xy.T[None])
    by_rate = np.zeros((0, 2, len(points)))
    if sweep is not None:
        residual += sweep.readout_s * sweep.by_readout(R[None], predicted, depth)
        if sweep.sigma_rate_rad_s > 0.0:
            by_rate = sweep.by_rate(predicted)[0]
            residual += np.einsum("rip,r->ip", by_rate, rate_off)
    ahead: Mask = depth[0] > 1e-6
    residual = rounded(shape, residual)
    squared = np.where(ahead, (residual[0] ** 2).sum(axis=0) * weight**2, 1e6)
    s = weight * np.sqrt(robust_cost(squared, scale)[1]) * ahead
    by_rotation, by_point = reprojection_jacobians(R[None], predicted, depth, s[None])
    by_rotation, by_point, by_rate = (rounded(shape, J) for J in (by_rotation, by_point, by_rate[None]))
    A = np.concatenate([by_rotation[0], -by_point[0], by_rate[0] * s]).reshape(6 + by_rate.shape[1], -1)
    return A, by_point[0], (residual[0] * s).reshape(-1), np.sqrt(squared), ahead
