"""The ground that the pixels of a picture show, by its set's plane. (25.2)"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.kriging import MIN_PLANE_SHARE

Array = NDArray[np.float64]

USUAL_M = 100.0  # from the ground, where nothing is known of it yet


@dataclass(frozen=True, eq=False)
class GroundScale:
    """Level ground (h, w) that a pixel at each place of a coarse grid shows, m2; nan where it shows none."""

    pixel_m2: Array

    @property
    def middle_m(self) -> float:
        """The side of the usual pixel's ground."""
        return float(np.sqrt(np.nanmedian(self.pixel_m2)))

    @property
    def is_ground(self) -> NDArray[np.bool_]:
        """The places (h, w) that show ground that can be measured, and whose neighbours do so too."""
        shown = np.pad(np.isfinite(self.pixel_m2), 1, mode="edge")
        height, width = self.pixel_m2.shape
        out: NDArray[np.bool_] = np.all(
            [shown[i : i + height, j : j + width] for i in range(3) for j in range(3)], axis=0
        )
        return out

    def area_m2(self, size_px: tuple[int, int]) -> float:
        """Return the area of all the ground that a picture of `size_px` shows."""
        counted = self.pixel_m2[self.is_ground]
        return float(counted.sum()) * size_px[0] * size_px[1] / self.pixel_m2.size


def ground_scale(its_set: FeatureSet, shape: tuple[int, int]) -> GroundScale | None:
    """Return the scale of a picture's set on a grid of that many rows and columns; None without an answer or ground."""
    s, camera = its_set, its_set.camera
    if not s.is_ok:
        return None
    rays, valid = camera.unproject(grid_pixels(camera, shape))
    w = rays @ np.array([s.plane_per_m[1], s.plane_per_m[2], s.plane_per_m[0]])
    shown = valid & (w > MIN_PLANE_SHARE * max(float(w.max()), 1e-12))
    up = abs(float(s.R_enu_cam[2] @ np.array([s.plane_per_m[1], s.plane_per_m[2], s.plane_per_m[0]])))
    by_pixel = camera.fx_px * camera.fy_px * np.abs(camera.area_gain(rays.reshape(-1, 3)[:, :2])).reshape(w.shape)
    area = up / np.where(shown, w, np.nan) ** 3 / np.where(shown, by_pixel, np.nan)
    return GroundScale(area) if shown.any() and up > 0.0 else None


def usual_scale(camera: Camera, shape: tuple[int, int]) -> GroundScale:
    return GroundScale(np.full(shape, USUAL_M**2 / (camera.fx_px * camera.fy_px)))


def grid_pixels(camera: Camera, shape: tuple[int, int]) -> Array:
    """Pixels (h, w, 2) in the middles of as many parts of the picture."""
    rows, columns = shape
    u = (np.arange(columns) + 0.5) * (camera.width_px / columns) - 0.5
    v = (np.arange(rows) + 0.5) * (camera.height_px / rows) - 0.5
    return np.stack(np.meshgrid(u, v), axis=-1)
