"""Where a window's adjustment begins: measurements on a grid, orientations, points, and the ground plane."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from onboard.estimation import initialisation
from onboard.estimation.keyframe import Ids, Keyframe, have_attitude, turned
from onboard.estimation.window_acceptance import MIN_POINTS
from onboard.geometry.plane_fit import fit_plane
from onboard.geometry.triangulation import on_plane, triangulate

if TYPE_CHECKING:
    from onboard.estimation.window_solver import Request

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MIN_PARALLAX_RAD = 0.008  # below this a point starts on the ground plane and not where its rays meet
START_SIGMAS = 5.0  # of an inlier at the start, at 640 px width: larger pictures have larger calibration errors


def travel_m(keyframes: tuple[Keyframe, ...]) -> float:
    """How far the positions reach along the axes (m)."""
    positions = np.stack([k.nav.position_enu_m for k in keyframes])
    return float(np.linalg.norm(np.ptp(positions, axis=0)))


def grid(request: Request, ids: Ids) -> tuple[Array, Array]:
    """Measurements and weights on the (keyframe, point) grid."""
    xy = np.zeros((len(request.keyframes), len(ids), 2))
    weight = np.zeros((len(request.keyframes), len(ids)))
    for k, keyframe in enumerate(request.keyframes):
        seen = keyframe.observation
        at = np.minimum(np.searchsorted(ids, seen.ids), len(ids) - 1)
        known = ids[at] == seen.ids
        xy[k, at[known]] = seen.xy[known]
        weight[k, at[known]] = 1.0 / (request.noise.pixel_sigma_px * seen.gain[known])
    return xy, weight


def oriented(request: Request, xy: Array, seen: Mask) -> tuple[Keyframe, ...] | None:
    """The keyframes, each with a starting orientation; None if the rays support none."""
    keyframes, camera = request.keyframes, request.camera
    if request.is_oriented or have_attitude(keyframes):
        return keyframes
    if request.previous is not None and all(k.is_oriented for k in keyframes):
        return keyframes
    centres = np.stack([k.nav.position_enu_m for k in keyframes])
    tolerance_rad = start_tolerance_rad(request.noise.pixel_sigma_px, camera)
    rotations = initialisation.orient(xy, seen, centres, request.R_body_cam, tolerance_rad)
    if rotations is None:
        return None
    return turned(keyframes, rotations)


def start_tolerance_rad(pixel_sigma_px: float, camera: Camera) -> float:
    """Epipolar error of an inlier at the start."""
    return START_SIGMAS * pixel_sigma_px * max(1.0, camera.width_px / 640.0) / camera.focal_px


def starting_points(
    request: Request, ids: Ids, R: Array, C: Array, xy: Array, seen: Mask
) -> tuple[Array, Array, Array]:
    """Starting points (P, 3), the plane's reference point, and the plane about it."""
    rays = triangulate(R, C, xy, seen)
    points = rays.points_enu_m.copy()
    sound = rays.is_ahead & (rays.parallax_rad > MIN_PARALLAX_RAD)
    previous = request.previous
    if previous is not None:
        rows, known = previous.rows(ids)
        points[known] = previous.solution.state.points_enu_m[rows[known]]
        sound |= known
    if np.count_nonzero(sound) >= MIN_POINTS:
        plane, _ = fit_plane(points[sound])
    elif previous is not None:
        plane = previous.plane
    else:
        newest = request.keyframes[-1].nav
        height = newest.height_above_home_m or 100.0
        plane = np.array([newest.position_enu_m[2] - height, 0.0, 0.0])
    if np.any(np.abs(plane[1:]) > 0.6):  # steeper than any ground an orientation was right about
        plane = np.array([float(np.median(points[sound, 2])), 0.0, 0.0])
    loose = ~sound
    if np.any(loose):
        points[loose] = on_plane(R, C, xy, seen, plane)[loose]
    reference = np.array([*np.median(points[:, :2], axis=0), 0.0])
    reference[2] = plane[0] + plane[1:] @ reference[:2]
    return points, reference, np.array([0.0, plane[1], plane[2]])
