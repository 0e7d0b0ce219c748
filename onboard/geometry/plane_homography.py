"""Features of one picture predicted into another from the change of pose over the ground plane. (4.1), (4.2)"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from onboard.geometry.linalg import solve_small

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
    H = fit_homography(grid[valid], moved[valid], np.ones(np.count_nonzero(valid)))
    return H if np.all(np.isfinite(H)) else None


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
    return p[:, :2] / p[:, 2:]


class HomographyFit:
    """Weighted least squares homographies through the same pairs of pixels, `at` (N, 2) -> `to` (N, 2), N >= 4."""

    def __init__(self, at: Array, to: Array) -> None:
        self._centre, self._scale = at.mean(axis=0), max(float(np.ptp(at)), 1.0)
        n = len(at)
        p = (at - self._centre) / self._scale
        self._q = (to - self._centre) / self._scale
        self._p1 = np.ones((n, 3))
        self._p1[:, :2] = p
        self._A = np.zeros((2, n, 8))
        self._A[0, :, :3] = self._A[1, :, 3:6] = self._p1
        np.multiply(-self._q.T[:, :, None], p, out=self._A[:, :, 6:])
        self._h = np.eye(3)

    def solve(self, weight: Array) -> Array:
        """One linear step, scaled; returns the distance (N,), px, that each pair misses by."""
        A = self._A.reshape(-1, 8)
        AW = (self._A * weight[:, None]).reshape(-1, 8)
        N = AW.T @ A
        N.flat[::9] += 1e-9
        h = solve_small(N, AW.T @ self._q.T.ravel())
        self._h = np.append(h, 1.0).reshape(3, 3)
        moved = self._p1 @ self._h.T
        miss = moved[:, :2] / moved[:, 2:] - self._q
        out: Array = np.hypot(miss[:, 0], miss[:, 1]) * self._scale
        return out

    @property
    def H(self) -> Array:
        """The last solution (3, 3), in pixels."""
        (u, v), s = self._centre, self._scale
        to_unit = np.array([[1 / s, 0, -u / s], [0, 1 / s, -v / s], [0, 0, 1.0]])
        from_unit = np.array([[s, 0, u], [0, s, v], [0, 0, 1.0]])
        out: Array = from_unit @ self._h @ to_unit
        out /= out[2, 2]
        return out


def fit_homography(at: Array, to: Array, weight: Array) -> Array:
    """Weighted least squares homography (3, 3), pixels `at` (N, 2) -> `to` (N, 2), N >= 4. One linear step, scaled."""
    fit = HomographyFit(at, to)
    fit.solve(weight)
    return fit.H
