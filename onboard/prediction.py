"""Where one picture's features will be in another, before looking: pose change over the ground plane. (4.1), (4.2)"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import GROUND, SharedErrors

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pose:
    """A camera: R_cam_enu (3, 3) and its centre in ENU metres (3,)."""

    R_cam_enu: Array
    centre_enu_m: Array


@dataclass(frozen=True, eq=False)
class Believed:
    """A pose from sensors alone; seven states err: centre (ENU m), rotation (ENU axes, rad), ground height (m)."""

    R_cam_enu: Array
    centre_enu_m: Array
    white: Array  # (7, 7) covariance of what is this picture's own
    shared: SharedErrors  # `by_draw` (7, DRAWS)

    @property
    def covariance(self) -> Array:
        """(7, 7) of everything."""
        out: Array = self.white + self.shared.by_draw @ self.shared.by_draw.T
        return out

    def over_ground(self, sigma_m: float) -> Believed:
        """The same over a ground whose height as a whole is known to one sigma."""
        by_draw = self.shared.by_draw.copy()
        by_draw[6, GROUND.start] = sigma_m
        return replace(self, shared=replace(self.shared, by_draw=by_draw))

    def over_ranged_ground(self, sigma_m: float) -> Believed:
        """The same over a ground measured from the camera, to one sigma: where the camera's height errs, so does it."""
        white, by_draw = self.white.copy(), self.shared.by_draw.copy()
        white[6], white[:, 6] = white[2], white[:, 2]
        white[6, 6] = white[2, 2] + sigma_m**2
        by_draw[6] = by_draw[2]
        return replace(self, white=white, shared=replace(self.shared, by_draw=by_draw))


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
