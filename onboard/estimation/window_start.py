"""Where a window's adjustment begins: measurements on a grid, orientations, points, and the ground plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rolling_shutter import row_share
from contract.rotations import exp_so3
from onboard.estimation import camera_states, initialisation
from onboard.estimation.factors import RATES, Layout, State
from onboard.estimation.keyframe import Ids, Keyframe, have_attitude, swept, turned
from onboard.estimation.platform_states import BORESIGHT
from onboard.estimation.rolling_shutter import LEAST_READOUT_S, Sweep, rates_between, sigma_of_rates
from onboard.estimation.window_acceptance import MIN_POINTS
from onboard.estimation.window_request import Request
from onboard.geometry.plane_fit import fit_plane
from onboard.geometry.triangulation import on_plane, triangulate

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MIN_PARALLAX_RAD = 0.008  # below this a point starts on the ground plane and not where its rays meet
START_SIGMAS = 5.0  # of an inlier at the start, at 640 px width: larger pictures have larger calibration errors


def travel_m(keyframes: tuple[Keyframe, ...]) -> float:
    """How far the positions reach along the axes (m)."""
    positions = np.stack([k.nav.position_enu_m for k in keyframes])
    return float(np.linalg.norm(np.ptp(positions, axis=0)))


def grid(request: Request, ids: Ids) -> tuple[Array, Array, Array, Array]:
    """On the (keyframe, point) grid: measurements at each picture's moment, as its rows saw them, weights, and rows.

    A row is given as the share of the readout at which it is exposed.
    """
    xy = np.zeros((len(request.keyframes), len(ids), 2))
    raw = np.zeros_like(xy)
    weight, share = np.zeros(xy.shape[:2]), np.zeros(xy.shape[:2])
    for k, keyframe in enumerate(request.keyframes):
        seen = keyframe.observation
        at = np.minimum(np.searchsorted(ids, seen.ids), len(ids) - 1)
        known = ids[at] == seen.ids
        xy[k, at[known]], raw[k, at[known]] = seen.xy[known], seen.raw_xy[known]
        share[k, at[known]] = seen.share[known]
        weight[k, at[known]] = 1.0 / (request.noise.pixel_sigma_px * seen.gain[known])
    return xy, raw, weight, share


def row_shares(keyframes: tuple[Keyframe, ...], ids: Ids) -> Array:
    """The share (K, P) of a readout at which each measurement's row is exposed, if rows are read in turn. (18.1)"""
    share = np.zeros((len(keyframes), len(ids)))
    for k, keyframe in enumerate(keyframes):
        seen = keyframe.observation
        _, at, of = np.intersect1d(ids, seen.ids, return_indices=True)
        share[k, at] = row_share(seen.uv_px[of, 1], seen.camera.height_px)
    return share


def sweep(request: Request, keyframes: tuple[Keyframe, ...], share: Array) -> Sweep | None:
    """How the keyframes' rows move, by their navigation as it is now; None where all rows are exposed at once.

    Without attitudes the poses themselves say how fast the camera turns, from keyframe to keyframe.
    """
    moving = [k.observation.moving for k in keyframes if k.observation.moving is not None]
    if len(moving) < len(keyframes):
        return None
    if have_attitude(keyframes):
        R_body_cam = request.R_body_cam @ exp_so3(request.platform.mean[BORESIGHT])
        rate = np.stack([k.body_rate_rad_s for k in keyframes]) @ R_body_cam
    else:
        stamps_s = np.array([(k.nav.stamp_ns - keyframes[0].nav.stamp_ns) / 1e9 for k in keyframes])
        rate = rates_between(stamps_s, np.stack([k.R_cam_enu for k in keyframes]))
    velocity, sigma_rad_s = np.stack([m.velocity_enu_m_s for m in moving]), sigma_of_rates(moving, rate)
    camera = request.config.camera
    scale_s = max(float(np.hypot(camera.readout_s, camera.sigma_readout_s)), LEAST_READOUT_S)
    return Sweep(camera.readout_s, share, rate, velocity, sigma_rad_s, scale_s)


def layout_of(request: Request, keyframes: tuple[Keyframe, ...], rows: Sweep | None) -> Layout:
    """The columns of the window's adjustment."""
    has_rates = rows is not None and rows.sigma_rate_rad_s > 0.0
    return Layout(len(keyframes), len(request.camera_taken), (RATES,) * has_rates)


def readout_of(request: Request, layout: Layout, state: State) -> float:
    """How long the rows take by a solution, s."""
    found_s = request.config.camera.readout_s + camera_states.readout_s(state.camera)
    # Rates are estimated as what they move, which no rate does in no time.
    least_s = LEAST_READOUT_S if RATES in layout.blocks else 0.0
    return float(np.copysign(max(abs(found_s), least_s), found_s))


def with_found_rates(
    request: Request, keyframes: tuple[Keyframe, ...], layout: Layout, rows: Sweep | None, state: State
) -> tuple[Keyframe, ...]:
    """The keyframes with the angular rates that a solution has found of them, where it looked for any."""
    if rows is None or RATES not in layout.blocks:
        return keyframes
    readout_s = readout_of(request, layout, state)
    return swept(keyframes, rows.rates_in(readout_s, state.own[:, layout.part(RATES)]), readout_s)


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
