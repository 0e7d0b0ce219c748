"""Feature sets over a ground known beforehand, for pictures without parallax: hover, pure rotation, the first seconds.

The pose is the autopilot's, through mount and boresight; the depth is where a grid of rays meets the surface. Errors
are propagated from the pose and the surface by finite differences of that intersection (9.7): an error of the pose
moves the depth field too, because the ground stays where it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import DepthSource, FeatureSet, Status
from contract.rotations import exp_so3
from onboard.config.schema import Config
from onboard.estimation.shared_errors import SensorPose
from onboard.estimation.sliding_window import Window
from onboard.geometry.plane_homography import Pose
from onboard.georeferencing.feature_sets import Features, Linearised, Picture, assemble, common_states
from onboard.navigation.navigator import NavState

Array = NDArray[np.float64]

GRID = (9, 7)
MIN_RAYS = 8
SURFACE_NOISE = 1e-8  # of d ln w, squared: the surface itself is known where its rays meet it
MAX_GRAZE = 0.12  # least sine of a ray's angle with the level ground
Cast = Callable[[Array, Array], Array]  # centre (3,), rays (N, 3) ENU -> depth (N,), inf where the ground is missed


@dataclass(frozen=True, eq=False)
class Surface:
    """A ground known beforehand."""

    cast: Cast
    sigma_m: float  # of the ground's own roughness about it, independent from place to place
    source: DepthSource


def level_cast(height_m: float) -> Cast:
    """Rays onto the level plane at a height (ENU, m)."""

    def cast(centre_enu_m: Array, rays_enu: Array) -> Array:
        down = -rays_enu[:, 2]
        ok = down > MAX_GRAZE * np.linalg.norm(rays_enu, axis=1)
        return np.where(ok, (centre_enu_m[2] - height_m) / np.where(ok, down, 1.0), np.inf)

    return cast


def over_known_ground(config: Config, window: Window, nav: NavState, picture: Picture) -> FeatureSet | None:
    """The picture's set by the autopilot's pose over a known ground; None without attitude or without such a ground.

    That ground is terrain, unless pictures have shown the ground elsewhere, (16.16), or what a range finder measures,
    or home's level.
    """
    sensor_pose = window.sensor_pose(nav)
    if sensor_pose is None:
        return None
    ranged = nav.ground_range
    if window.terrain is not None and not window.terrain_doubt:
        surface = Surface(window.terrain.cast, config.terrain.sigma_m, DepthSource.TERRAIN)
        over = sensor_pose.over_ground(config.terrain.sigma_datum_m)
    elif ranged is not None:
        # The beam hits one place; the ground about it lies as far off as it is rough.
        cast = level_cast(float(sensor_pose.centre_enu_m[2] + ranged.vector_enu_m[2]))
        surface = Surface(cast, 0.0, DepthSource.PLANE)
        over = sensor_pose.over_ranged_ground(float(np.hypot(ranged.sigma_m, config.solve.ground_roughness_sigma_m)))
    elif config.solve.home_level and nav.height_above_home_m is not None:
        cast = level_cast(float(nav.position_enu_m[2]) - nav.height_above_home_m)
        surface = Surface(cast, 0.0, DepthSource.PLANE)
        over = sensor_pose.over_ground(config.solve.home_level_sigma_m)
    else:
        return None
    result = over_surface(picture, over, surface)
    return result if isinstance(result, FeatureSet) else None


def over_surface(picture: Picture, sensor_pose: SensorPose, surface: Surface) -> FeatureSet | Status:
    """The feature set of one picture over a known ground; ABOVE_HORIZON where too few rays meet it.

    What is wrong with the surface as a whole belongs in `sensor_pose`.
    """
    camera, cast = picture.camera, surface.cast
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
    own = (surface.sigma_m * M[:, 6]) ** 2 + SURFACE_NOISE
    P = np.zeros((6, 7))
    P[:3, 3:6] = -sensor_pose.R_cam_enu
    P[3:, :3] = np.eye(3)
    H = np.concatenate([np.ones((len(z), 1)), rays[:, :2]], axis=1)
    errors = Linearised(sensor_pose.covariance, P, np.zeros((6, 6)), H, M, np.zeros((len(z), 6)), own)
    common, variance, T = common_states(errors, R_enu_cam)
    shared = replace(sensor_pose.shared, by_nuisance=T @ sensor_pose.shared.by_nuisance)
    pose = Pose(sensor_pose.R_cam_enu, sensor_pose.centre_enu_m)
    features = Features(H, uv, 1.0 / z, variance, np.full(len(z), SURFACE_NOISE), np.arange(len(z)))
    return assemble(picture, pose, features, common, shared, surface.source)


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
