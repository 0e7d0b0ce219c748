"""The seed's test scene (its section 3): a 5 m grid, two views 40 m apart at 250 m, 640x480 over 40 degrees.

World axes are ENU: the seed's x is east, its y north; a heading of 30 degrees is from x towards y. The camera is the
seed's, x along the travel and z down. This module and the other `study*` files may import onboard's packages (nothing
else in `simulation` does): the study examines those very functions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rotations import exp_so3, mount_rotation
from onboard.geometry.relative_orientation import travel_aligned

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CAMERA = Camera.from_field_of_view(640, 480, 40.0)
HEIGHT_M = 250.0
BASELINE_M = 40.0
GRID_M = 5.0
HEADING_RAD = float(np.radians(30.0))
R_BODY_CAM: Array = mount_rotation(0.0, -90.0, -90.0)
TRAVEL_ENU: Array = np.array([np.cos(HEADING_RAD), np.sin(HEADING_RAD), 0.0])
AXES = {"heading": np.array([0.0, 0.0, 1.0]), "pitch": np.array([0.0, 1.0, 0.0]), "roll": np.array([1.0, 0.0, 0.0])}
_REACH_M = 400.0


@dataclass(frozen=True, eq=False)
class Scene:
    """True views and the features that all of them see.

    R_cam_enu (K, 3, 3), centres_enu_m (K, 3), points_enu_m (P, 3), uv_px (K, P, 2).
    """

    R_cam_enu: Array
    centres_enu_m: Array
    points_enu_m: Array
    uv_px: Array


def nominal() -> Array:
    """R_cam_enu (3, 3) of the camera that is aligned with the travel and looks straight down."""
    return travel_aligned(TRAVEL_ENU, R_BODY_CAM)


def turned(R_cam_enu: Array, axis: str, angle_rad: float) -> Array:
    """The camera turned by `angle_rad` about its own z (heading), y (pitch) or x (roll)."""
    return exp_so3(-angle_rad * AXES[axis]) @ R_cam_enu


def grid() -> Array:
    """Ground features (N, 3), a grid aligned with the world's axes about the first view's foot."""
    line = np.arange(-_REACH_M, _REACH_M + GRID_M / 2, GRID_M)
    x, y = np.meshgrid(line, line)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


def project(R_cam_enu: Array, centres_enu_m: Array, points_enu_m: Array) -> tuple[Array, Mask]:
    """Pixels (K, P, 2) of points (P, 3) in K views, and whether each falls into the picture (K, P)."""
    p = np.einsum("kij,kpj->kpi", R_cam_enu, points_enu_m[None] - centres_enu_m[:, None])
    depth = np.maximum(p[..., 2:], 1e-9)
    uv = p[..., :2] / depth * [CAMERA.fx_px, CAMERA.fy_px] + [CAMERA.cx_px, CAMERA.cy_px]
    inside = np.all((uv >= -0.5) & (uv <= [CAMERA.width_px - 0.5, CAMERA.height_px - 0.5]), axis=-1)
    return uv, inside & (p[..., 2] > 1.0)


def unit_depth(uv_px: Array) -> Array:
    """Pixels (..., 2) -> normalised image coordinates (..., 2) of the study's ideal camera."""
    return (uv_px - [CAMERA.cx_px, CAMERA.cy_px]) / [CAMERA.fx_px, CAMERA.fy_px]


def two_views(first: tuple[str, float] | None = None, second: tuple[str, float] | None = None) -> Scene:
    """The seed's two views. `first` (axis, rad) turns both from the nominal orientation, `second` the second alone."""
    R1 = nominal() if first is None else turned(nominal(), *first)
    R2 = R1 if second is None else turned(R1, *second)
    R = np.stack([R1, R2])
    centres = np.array([0.0, 0.0, HEIGHT_M]) + np.array([[0.0], [BASELINE_M]]) * TRAVEL_ENU
    points = grid()
    uv, inside = project(R, centres, points)
    seen = inside.all(axis=0)
    return Scene(R, centres, points[seen], uv[:, seen])
