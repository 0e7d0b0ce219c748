"""Features of one picture predicted into another from the change of pose over the ground plane. (4.1), (4.2)"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

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


def predict_pixels(
    camera: Camera, uv_px: Array, first: Pose, second: Pose, plane: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Pixels (N, 2) of the first view -> the second, over the ground plane; and whether each has a prediction.

    `plane` is (height m at the ENU origin, slope east, slope north). Equation (4.1).
    """
    return _over_plane(camera, *camera.unproject(uv_px), first, second, plane)


def _over_plane(
    camera: Camera, rays: Array, valid: NDArray[np.bool_], first: Pose, second: Pose, plane: Array
) -> tuple[Array, NDArray[np.bool_]]:
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
    grid, rays, has_ray = _grid(camera)
    moved, valid = _over_plane(camera, rays, has_ray, first, second, plane)
    if np.count_nonzero(valid) < 12:
        return None
    H, _ = cv2.findHomography(grid[valid], moved[valid], 0)
    if H is None or not np.all(np.isfinite(H)):
        return None
    out: Array = np.asarray(H, np.float64)
    return out


@lru_cache(maxsize=8)
def _grid(camera: Camera) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Pixels (63, 2) all over the picture, their rays, and which have one: the same for every picture."""
    grid = pixel_grid(camera.size_px, (9, 7))
    return grid, *camera.unproject(grid)


@lru_cache(maxsize=8)
def pixel_grid(size_px: tuple[int, int], counts: tuple[int, int]) -> Array:
    """Pixels (N, 2) in columns and rows from border to border of a picture. Not to be written to."""
    columns, rows = np.meshgrid(*(np.linspace(0.0, size - 1.0, n) for size, n in zip(size_px, counts, strict=True)))
    grid: Array = np.stack([columns.ravel(), rows.ravel()], axis=-1).astype(np.float64)
    grid.setflags(write=False)
    return grid


def move(H: Array, uv_px: Array) -> Array:
    """Apply a homography (3, 3) to pixels (N, 2)."""
    p = uv_px @ H[:, :2].T + H[:, 2]
    out: Array = p[:, :2] / p[:, 2:]
    return out
