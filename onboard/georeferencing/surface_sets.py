"""Feature sets over a ground known beforehand, for pictures without parallax: hover, pure rotation, the first seconds.

The pose is the autopilot's, through mount and boresight; the depth is where a grid of rays meets the surface. Errors
are propagated from the pose and the surface by finite differences of that intersection (9.7): an error of the pose
moves the depth field too, because the ground stays where it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import DepthSource, FeatureSet, Status
from contract.geodesy import LocalFrame
from contract.rotations import exp_so3
from onboard.estimation.sensor_pose import SensorPose
from onboard.geometry.plane_homography import Pose
from onboard.georeferencing.feature_sets import Origin, assemble, common_states

Array = NDArray[np.float64]

GRID = (9, 7)
MIN_RAYS = 8
SURFACE_NOISE = 1e-8  # of d ln w, squared: the surface itself is known where its rays meet it
MAX_GRAZE = 0.12  # least sine of a ray's angle with the level ground
Cast = Callable[[Array, Array], Array]  # centre (3,), rays (N, 3) ENU -> depth (N,), inf where the ground is missed


def level_cast(height_m: float) -> Cast:
    """Rays onto the level plane at a height (ENU, m)."""

    def cast(centre_enu_m: Array, rays_enu: Array) -> Array:
        down = -rays_enu[:, 2]
        ok = down > MAX_GRAZE * np.linalg.norm(rays_enu, axis=1)
        return np.where(ok, (centre_enu_m[2] - height_m) / np.where(ok, down, 1.0), np.inf)

    return cast


def over_surface(
    camera: Camera,
    sensor_pose: SensorPose,
    cast: Cast,
    ground_sigma_m: float,
    source: DepthSource,
    origin: Origin,
    frame: LocalFrame,
    undulation_m: float,
) -> FeatureSet | Status:
    """The feature set of one picture over a known ground; ABOVE_HORIZON where too few rays meet it.

    `ground_sigma_m` is the ground's own roughness about the surface, independent from place to place; what is wrong
    with the surface as a whole belongs in `sensor_pose`.
    """
    u, v = np.meshgrid(
        np.linspace(0.01, 0.99, GRID[0]) * (camera.width_px - 1),
        np.linspace(0.01, 0.99, GRID[1]) * (camera.height_px - 1),
    )
    uv = np.stack([u.ravel(), v.ravel()], axis=-1)
    rays, valid = camera.unproject(uv)
    z = cast(sensor_pose.centre_enu_m, rays @ sensor_pose.R_cam_enu)
    keep = valid & np.isfinite(z) & (z > 1.0)
    if np.count_nonzero(keep) < MIN_RAYS:
        return Status.ABOVE_HORIZON
    uv, rays, z = uv[keep], rays[keep], z[keep]
    M = _sensitivity(sensor_pose, cast, rays, z)
    usable = np.all(np.isfinite(M), axis=1)
    if np.count_nonzero(usable) < MIN_RAYS:
        return Status.ABOVE_HORIZON
    uv, rays, z, M = uv[usable], rays[usable], z[usable], M[usable]
    R_enu_cam = sensor_pose.R_cam_enu.T
    # The same linear path as a solved window: d pose = gain d state, d ln w = M d state.
    own = (ground_sigma_m * M[:, 6]) ** 2 + SURFACE_NOISE
    P = np.zeros((6, 7))
    P[:3, 3:6] = -sensor_pose.R_cam_enu
    P[3:, :3] = np.eye(3)
    H = np.concatenate([np.ones((len(z), 1)), rays[:, :2]], axis=1)
    none = np.zeros((6, 6))
    common, variance, T = common_states(H, own, M, np.zeros((len(z), 6)), P, R_enu_cam, sensor_pose.covariance, none)
    shared = replace(sensor_pose.shared, by_nuisance=T @ sensor_pose.shared.by_nuisance)
    pose = Pose(sensor_pose.R_cam_enu, sensor_pose.centre_enu_m)
    every = np.arange(len(z))
    return assemble(
        camera,
        origin,
        frame,
        undulation_m,
        pose,
        common,
        shared,
        source,
        H,
        uv,
        1.0 / z,
        variance,
        every,
        noise=np.full(len(z), SURFACE_NOISE),
    )


def _sensitivity(sensor_pose: SensorPose, cast: Cast, rays: Array, z: Array) -> Array:
    """d ln w (N, 7) by centre, rotation and ground height: central differences of the intersection, (9.7)."""
    R_enu_cam, C = sensor_pose.R_cam_enu.T, sensor_pose.centre_enu_m
    step_m, step_rad = 0.05 * float(np.median(z)) / 10.0, 2e-3
    M = np.empty((len(z), 7))
    for axis in range(3):
        nudge = np.eye(3)[axis]
        ahead, behind = (cast(C + s * step_m * nudge, rays @ R_enu_cam.T) for s in (1.0, -1.0))
        M[:, axis] = -(np.log(ahead) - np.log(behind)) / (2.0 * step_m)
        turned = [exp_so3(s * step_rad * nudge) @ R_enu_cam for s in (1.0, -1.0)]
        ahead, behind = (cast(C, rays @ R.T) for R in turned)
        M[:, 3 + axis] = -(np.log(ahead) - np.log(behind)) / (2.0 * step_rad)
    # Raising the ground is lowering the camera, as far as the depth goes.
    M[:, 6] = -M[:, 2]
    return M
