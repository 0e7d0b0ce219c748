"""The start of a window's adjustment: measurements on a grid, orientations, points, and the ground plane.

Where no sensor gives attitude, one pair with a long baseline and many common features is oriented by `start_pair`; the
other views follow from its points, the one that sees most of them next. Seed, section 2.2.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rolling_shutter import row_share
from contract.rotations import exp_so3
from onboard.estimation import camera_states
from onboard.estimation.factors import RATES, Layout, State
from onboard.estimation.keyframe import Ids, Keyframe, have_attitude, swept, turned
from onboard.estimation.platform_states import BORESIGHT
from onboard.estimation.rolling_shutter import LEAST_READOUT_S, Sweep, rates_between, sigma_of_rates
from onboard.estimation.window_acceptance import MIN_POINTS
from onboard.estimation.window_request import Request
from onboard.geometry.plane_fit import fit_plane
from onboard.geometry.relative_orientation import ENOUGH, relative_ransac, rotation_only, start_pair
from onboard.geometry.triangulation import on_plane, triangulate
from onboard.navigation.limits import MOST_OF

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MIN_PARALLAX_RAD = 0.008  # below this a point starts on the ground plane and not where its rays meet
MIN_BASELINE_M = 1.0  # below it positions give no direction of travel
ENOUGH_COMMON = 15  # features of a pair that is to be oriented
START_SIGMAS = 5.0  # of an inlier at the start, at 640 px width: larger pictures have larger calibration errors


def has_baseline(keyframes: tuple[Keyframe, ...]) -> bool:
    """Return whether the positions reach far enough to give a direction of travel."""
    positions = np.stack([k.nav.position_enu_m for k in keyframes])
    return float(np.linalg.norm(np.ptp(positions, axis=0))) >= MIN_BASELINE_M


def grid(request: Request, ids: Ids) -> tuple[Array, Array, Array, Array]:
    """Four arrays on the (keyframe, point) grid: measurements at the picture's moment, as rows saw them, weights, rows.

    A row is given as the share of the readout at which it is exposed, if rows are read in turn. (18.1)
    """
    xy = np.zeros((len(request.keyframes), len(ids), 2))
    raw, weight, share = np.zeros_like(xy), np.zeros(xy.shape[:2]), np.zeros(xy.shape[:2])
    for k, keyframe in enumerate(request.keyframes):
        seen = keyframe.observation
        _, at, of = np.intersect1d(ids, seen.ids, assume_unique=True, return_indices=True)
        xy[k, at], raw[k, at] = seen.xy[of], seen.raw_xy[of]
        share[k, at] = row_share(seen.uv_px[of, 1], seen.camera.height_px)
        weight[k, at] = 1.0 / (request.noise.pixel_sigma_px * seen.gain[of])
    return xy, raw, weight, share


def sweep(request: Request, keyframes: tuple[Keyframe, ...], share: Array) -> Sweep | None:
    """The motion of the keyframes' rows, by their current navigation; None if all rows are exposed at once.

    Without attitudes the poses themselves show how fast the camera turns, from keyframe to keyframe.
    """
    moving = [k.observation.moving for k in keyframes if k.observation.moving is not None]
    if len(moving) < len(keyframes):
        return None
    rate = turning(request, keyframes)
    velocity, sigma_rad_s = np.stack([m.velocity_enu_m_s for m in moving]), sigma_of_rates(moving, rate)
    camera = request.config.camera
    scale_s = max(float(np.hypot(camera.readout_s, camera.sigma_readout_s)), LEAST_READOUT_S)
    return Sweep(camera.readout_s, share, rate, velocity, sigma_rad_s, scale_s)


def turning(request: Request, keyframes: tuple[Keyframe, ...]) -> Array:
    """The rates (K, 3) at which the camera turns, rad/s, camera axes."""
    if have_attitude(keyframes):
        R_body_cam = request.R_body_cam @ exp_so3(request.platform.mean[BORESIGHT])
        return np.stack([k.body_rate_rad_s for k in keyframes]) @ R_body_cam
    stamps_s = np.array([(k.nav.stamp_ns - keyframes[0].nav.stamp_ns) / 1e9 for k in keyframes])
    return rates_between(stamps_s, np.stack([k.R_cam_enu for k in keyframes]))


def layout_of(request: Request, keyframes: tuple[Keyframe, ...], rows: Sweep | None) -> Layout:
    """The columns of the window's adjustment."""
    has_rates = rows is not None and rows.sigma_rate_rad_s > 0.0
    return Layout(len(keyframes), len(request.camera_taken), (RATES,) * has_rates)


def readout_of(request: Request, layout: Layout, state: State) -> float:
    """The readout time of the rows by a solution, s."""
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
    keyframes = request.keyframes
    is_followed = request.previous is not None and all(k.is_oriented for k in keyframes)
    if request.is_oriented or is_followed or have_attitude(keyframes):
        return keyframes
    centres = np.stack([k.nav.position_enu_m for k in keyframes])
    tolerance_rad = start_tolerance_rad(request.noise.pixel_sigma_px, request.camera)
    rotations = orient(xy, seen, centres, request.R_body_cam, tolerance_rad)
    return None if rotations is None else turned(keyframes, rotations)


def start_tolerance_rad(pixel_sigma_px: float, camera: Camera) -> float:
    """Epipolar error of an inlier at the start."""
    return START_SIGMAS * pixel_sigma_px * max(1.0, camera.width_px / 640.0) / camera.focal_px


def orient(xy: Array, seen: Mask, centres_enu_m: Array, R_body_cam: Array, tolerance_rad: float) -> Array | None:
    """R_cam_enu (K, 3, 3) of every view; None if no pair of them can be oriented.

    Normalised image coordinates `xy` (K, P, 2), `seen` (K, P), GPS `centres_enu_m` (K, 3); `tolerance_rad` is an
    inlier's epipolar error.
    """
    common = (seen.astype(int) @ seen.T.astype(int)).astype(float)
    between = centres_enu_m[:, None] - centres_enu_m[None]
    # A climb shows no heading, so that a pair with hardly any other motion could be given any heading.
    level2 = np.square(between[..., :2]).sum(axis=-1)
    baseline = level2 / np.maximum(np.sqrt(level2 + np.square(between[..., 2])), 1e-9)
    score = np.where(common >= ENOUGH_COMMON, baseline * np.sqrt(np.minimum(common, 60.0)), 0.0)
    rays = np.concatenate([xy, np.ones((*seen.shape, 1))], axis=2)
    best = sorted(combinations(range(len(seen)), 2), key=lambda pair: (score[pair], pair), reverse=True)[:3]
    for i, j in best:
        both = np.flatnonzero(seen[i] & seen[j])
        travel_enu_m = centres_enu_m[j] - centres_enu_m[i]
        if score[i, j] <= 0.0:
            break
        pair = start_pair(rays[i, both], rays[j, both], travel_enu_m, R_body_cam, tolerance_rad)
        if pair is None:
            continue
        known = np.isin(np.arange(seen.shape[1]), both[pair.inliers])
        rotations = _spread(rays, seen, centres_enu_m, {i: pair.first, j: pair.second}, known)
        if rotations is not None:
            return rotations
    return None


def _spread(rays: Array, seen: Mask, centres: Array, oriented: dict[int, Array], known: Mask) -> Array | None:
    """Orient the remaining views from triangulated points, the view that sees most of them next."""
    while len(oriented) < len(centres):
        views = sorted(oriented)
        R = np.stack([oriented[k] for k in views])
        cloud = triangulate(R, centres[views], rays[views, :, :2], seen[views])
        known = cloud.is_ahead & ((np.count_nonzero(seen[views], axis=0) > 2) | known | (cloud.parallax_rad > 0.02))
        waiting = [k for k in range(len(centres)) if k not in oriented]
        best = max(waiting, key=lambda k: int(np.count_nonzero(seen[k] & known)))
        use = seen[best] & known
        if np.count_nonzero(use) < ENOUGH:
            return None
        oriented[best] = rotation_only(cloud.points_enu_m[use] - centres[best], rays[best, use])
    return np.stack([oriented[k] for k in range(len(centres))])


def follow(rays_before: Array, rays: Array, R_before: Array, travel_enu_m: Array, tolerance_rad: float) -> Array | None:
    """R_cam_enu of a view from the one before it, whose orientation is known, and the positions of both. (3.4)

    For a view that sees no point whose place is known, as after a quick roll. `rays_before`, `rays` (N, 3): features
    that both see, third coordinate 1; `travel_enu_m` (3,) between them; `tolerance_rad` is an inlier's epipolar error.
    None where too few features support any rotation.
    """
    if len(rays) < ENOUGH_COMMON:
        return None
    start = rotation_only(rays_before, rays)
    if float(np.linalg.norm(travel_enu_m)) < MIN_BASELINE_M:
        return start @ R_before
    Q, inliers = relative_ransac(rays_before, rays, R_before @ travel_enu_m, tolerance_rad, Q=start)
    return Q @ R_before if np.count_nonzero(inliers) >= MOST_OF * len(rays) else None


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
    points = np.where(sound[:, None], points, on_plane(R, C, xy, seen, plane))
    middle = np.median(points[:, :2], axis=0)
    return points, np.array([*middle, plane[0] + plane[1:] @ middle]), np.array([0.0, *plane[1:]])
