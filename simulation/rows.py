"""A camera that exposes its rows one after the other: where each row looks from, and which pixels see a point."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rolling_shutter import row_share
from simulation.trajectory import Trajectory

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEPS = 5  # of the row that sees a point: each leaves a hundredth of the one before


@dataclass(frozen=True, eq=False)
class RowsOf:
    """A camera fixed to a vehicle on its way. `readout_s` is signed: positive if the first row comes first."""

    trajectory: Trajectory
    R_body_cam: Array
    readout_s: float
    lever_body_m: Array = field(default_factory=lambda: np.zeros(3))

    def poses(self, camera: Camera, time_s: float, v_px: Array) -> tuple[Array, Array]:
        """R_enu_cam (N, 3, 3) and centres (N, 3) of rows (N,) of the picture whose middle row is exposed at a time."""
        at = time_s + self.readout_s * np.asarray(
            row_share(np.clip(v_px, -0.5, camera.height_px - 0.5), camera.height_px)
        )
        R_enu_body = self.trajectory.R_enu_body(at)
        return R_enu_body @ self.R_body_cam, self.trajectory.position_enu_m(at) + R_enu_body @ self.lever_body_m

    def rays(self, camera: Camera, time_s: float, uv_px: Array) -> tuple[Array, Array]:
        """Rays (N, 3) of pixels (N, 2), ENU axes, and where they begin (N, 3)."""
        R_enu_cam, centres = self.poses(camera, time_s, uv_px[:, 1])
        rays, _ = camera.unproject(uv_px)
        return np.einsum("nij,nj->ni", R_enu_cam, rays), centres

    def pixels(self, camera: Camera, time_s: float, points_enu_m: Array) -> tuple[Array, Mask]:
        """Pixels (N, 2) that see points (N, 3), and whether they are on the picture."""
        v_px = np.full(len(points_enu_m), 0.5 * (camera.height_px - 1))
        for _ in range(STEPS if self.readout_s else 1):
            R_enu_cam, centres = self.poses(camera, time_s, v_px)
            uv, seen = camera.project(np.einsum("nji,nj->ni", R_enu_cam, points_enu_m - centres))
            v_px = np.where(np.isfinite(uv[:, 1]), uv[:, 1], v_px)
        return uv, seen
