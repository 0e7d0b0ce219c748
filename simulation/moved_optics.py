"""Pictures whose optics move: electronic stabilisation, which shifts the principal point, and a zoom."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from contract.camera import Camera
from contract.rotations import matrix_from_quaternion, quaternion_from_matrix
from simulation.trajectory import Trajectory

Array = NDArray[np.float64]

STEP_S = 0.02


def stabilised(
    camera: Camera,
    trajectory: Trajectory,
    R_body_cam: Array,
    times_s: Array,
    smooth_s: float = 0.5,
    margin: float = 0.1,
) -> list[Camera]:
    """The camera of each picture, of a video whose frame follows the camera's rotation smoothed over `smooth_s`.

    `margin`: how far the frame may be shifted either way, as a share of the picture's width.
    """
    at = np.arange(times_s[0] - 4.0 * smooth_s, times_s[-1] + 4.0 * smooth_s, STEP_S)
    at = np.clip(at, trajectory.start_s, trajectory.end_s)
    q = quaternion_from_matrix(trajectory.R_enu_body(at))
    flips = np.cumprod(np.concatenate([[1.0], np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)]))
    smooth = gaussian_filter1d(q * flips[:, None], smooth_s / STEP_S, axis=0)
    smooth = np.stack([np.interp(times_s, at, smooth[:, i]) for i in range(4)], axis=1)
    smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
    ahead = (matrix_from_quaternion(smooth) @ R_body_cam)[:, :, 2]
    seen = np.einsum("kji,kj->ki", trajectory.R_enu_body(times_s) @ R_body_cam, ahead)
    shift = -camera.focal_px * seen[:, :2] / seen[:, 2:]
    shift = np.clip(shift, -margin * camera.width_px, margin * camera.width_px)
    return [replace(camera, cx_px=camera.cx_px + u, cy_px=camera.cy_px + v) for u, v in shift.tolist()]


def zoomed(
    camera: Camera, times_s: Array, factor: float, from_s: float, to_s: float, ramp_s: float = 1.5
) -> list[Camera]:
    """The camera of each picture, of a lens that zooms by `factor` at `from_s` and back at `to_s`, each in `ramp_s`."""
    share = np.clip((times_s - from_s) / ramp_s, 0.0, 1.0) - np.clip((times_s - to_s) / ramp_s, 0.0, 1.0)
    grown = np.exp(share * np.log(factor))
    return [replace(camera, fx_px=camera.fx_px * g, fy_px=camera.fy_px * g) for g in grown.tolist()]
