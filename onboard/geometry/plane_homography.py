"""Features of one picture predicted into another from the change of pose over the ground plane. (4.1), (4.2)"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pose:
    """A camera: R_cam_enu (3, 3) and its centre in ENU metres (3,)."""

    R_cam_enu: Array
    centre_enu_m: Array


def predict_pixels(camera: Camera, uv_px: Array, first: Pose, second: Pose, plane: Array) -> tuple[Array, Array]:
    """Pixels (N, 2) of the first view -> the second, over the ground plane; and whether each has a prediction.

    `plane` is (height m at the ENU origin, slope east, slope north). Equation (4.1).
    """
    rays, valid = camera.unproject(uv_px)
    rays_enu = rays @ first.R_cam_enu
    normal = np.array([-plane[1], -plane[2], 1.0])
    down = rays_enu @ normal
    clearance = plane[0] - normal @ first.centre_enu_m
    hits = valid & (down * np.sign(clearance) > 1e-3)
    depth = clearance / np.where(hits, down, 1.0)
    points = first.centre_enu_m + rays_enu * np.where(hits, depth, 0.0)[:, None]
    uv, seen = camera.project((points - second.centre_enu_m) @ second.R_cam_enu.T)
    return uv, hits & seen


def predict_homography(camera: Camera, first: Pose, second: Pose, plane: Array) -> Array | None:
    """Pixel homography H_second_first (3, 3) that best follows `predict_pixels` over the picture; None without overlap.

    (4.2) with the lens's distortion folded in by least squares over a grid of pixels.
    """
    u, v = np.meshgrid(np.linspace(0.0, camera.width_px - 1.0, 9), np.linspace(0.0, camera.height_px - 1.0, 7))
    grid = np.stack([u.ravel(), v.ravel()], axis=-1)
    moved, valid = predict_pixels(camera, grid, first, second, plane)
    if np.count_nonzero(valid) < 12:
        return None
    H, _ = cv2.findHomography(grid[valid], moved[valid], 0)
    if H is None or not np.all(np.isfinite(H)):
        return None
    out: Array = H
    return out


def move(H: Array, uv_px: Array) -> Array:
    """Apply a homography (3, 3) to pixels (N, 2)."""
    p = uv_px @ H[:, :2].T + H[:, 2]
    out: Array = p[:, :2] / p[:, 2:]
    return out
