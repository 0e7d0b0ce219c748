"""A solved window and one picture's pose -> the feature set that is published, errors and all. Section 9.

The camera side of the window has covariance S; each point follows it and adds its own error (6.6). A picture's pose is
either a keyframe's, or a resection that follows the points (7.2). Everything is therefore linear in the window's camera
side plus independent noise, and the nine common states (9.3) are linear in that.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import DepthSource, FeatureSet, SharedErrors, Status
from contract.geodesy import LocalFrame, rotation_enu_ecef
from contract.kriging import stretch
from contract.rotations import skew
from onboard.estimation.ground_roughness import plane_and_roughness
from onboard.estimation.keyframe import Observation
from onboard.estimation.resection import Resection, Sighted, resect
from onboard.estimation.rolling_shutter import Moving, Sweep
from onboard.estimation.sensor_factors import travelled_sigma_m
from onboard.estimation.sliding_window import Window
from onboard.estimation.solved_window import Solved
from onboard.geometry.linalg import solve_small
from onboard.geometry.plane_homography import Pose
from onboard.geometry.robust import middle
from onboard.navigation.navigator import NavState

Array = NDArray[np.float64]

MIN_FEATURES = 8
MAX_RELATIVE_SIGMA = 0.3  # a feature's own depth error beyond which it adds nothing to the ground plane
ROTATION_PRIOR_RAD = 0.1
# The largest shared part of a variance: on the wire it is quantised in sigmas of the rest.
MAX_SHARED = 0.999


@dataclass(frozen=True)
class Origin:
    """The picture's identity: everything in the set that is not geometry."""

    vehicle: str
    session: int
    frame: int
    capture_unix_ns: int
    revision: int
    is_keyframe: bool


@dataclass(frozen=True, eq=False)
class Picture:
    """One picture: what took it, what identifies it, and what its places are counted in."""

    camera: Camera
    origin: Origin
    frame: LocalFrame  # the session's axes, in which poses and covariances are
    undulation_m: float  # ellipsoidal minus AMSL height; nan: unknown
    moving: Moving | None = None  # while it was read row by row; None: all rows at once
    readout_s: tuple[float, float] = (0.0, 0.0)  # and how long that took, with what of its sigma no state holds


@dataclass(frozen=True, eq=False)
class Placed:
    """A picture's set, and the pose (session axes) and solution that it was placed by.

    What places it again, or the next picture, begins where this one ended. `by_state` (9, D): how the nine common
    states, session axes, move with the solution's camera side, T of (9.3).
    """

    feature_set: FeatureSet
    pose: Pose
    solved: Solved
    by_state: Array
    ground_range: float  # one over the correlation length of the ground, 1/m: its variogram's slope over s^2, (9.20)


@dataclass(frozen=True, eq=False)
class Features:
    """The N features that the ground plane is fitted to, and which of them are published."""

    H: Array  # (N, 3) rows (1, x, y)
    uv_px: Array  # (N, 2)
    inverse_depth_per_m: Array
    variance: Array  # of d ln w, not shared by all
    noise: Array  # what of `variance` is the features' own and not the ground's
    published: NDArray[np.intp]  # rows


@dataclass(frozen=True, eq=False)
class Linearised:
    """Errors of one picture by D states: d pose = `by_state` d state + noise, d ln w = `M` d state + `by_pose` noise
    + own.
    """

    covariance: Array  # (D, D) of the states
    by_state: Array  # (6, D): rotation, then position
    noise: Array  # (6, 6) covariance of the pose's own noise
    H: Array  # (N, 3) rows (1, x, y) of the features
    M: Array  # (N, D)
    by_pose: Array  # (N, 6)
    own: Array  # (N,) variances
    camera: slice = field(default_factory=lambda: slice(0))  # columns of the states that are the camera's own
    directions: Array = field(default_factory=lambda: np.zeros((0, 3)))  # (N, 3) camera to points, ENU metres
    points_by_camera: Array = field(default_factory=lambda: np.zeros((0, 3, 0)))  # (N, 3, C) how these move the points


@dataclass(frozen=True, eq=False)
class _View:
    """A picture's pose as the window's camera side sees it: d pose = gain @ d camera side + noise."""

    pose: Pose
    gain: Array  # (6, D)
    noise: Array  # (6, 6)
    rows: NDArray[np.intp]  # points of the window that this picture uses
    rate_cam_rad_s: Array | None = None  # of a picture read row by row


@dataclass(frozen=True, eq=False)
class _Prior:
    """A picture's pose by a keyframe of the window and the sensors: one sigma (3,), ENU m, of the way between them."""

    pose: Pose
    keyframe: int
    travelled_m: Array


def place(
    window: Window,
    solved: Solved,
    seen: Observation,
    picture: Picture,
    guess: Pose,
    nav: NavState,
    start: Pose | None = None,
    ground_range: float | None = None,
) -> Placed | Status:
    """The feature set of one picture, or why it has none.

    `guess` starts the resection of a picture that is no keyframe of the window, its centre by the nearest of these and
    by `nav`; `start` is this picture's pose by an earlier solution, `ground_range` that of a picture that shows the
    same ground.
    """
    rows, known = solved.rows(seen.ids)
    if np.count_nonzero(known) < MIN_FEATURES:
        return Status.FEATURELESS
    view = _keyframe_view(solved, picture.origin.frame, rows[known])
    if view is None:
        near = solved.nearest(nav.stamp_ns)
        travelled_m = travelled_sigma_m(window.config, solved.keyframes[near].nav, nav)
        view = _resected_view(solved, seen, rows, known, _Prior(guess, near, travelled_m), start)
        if view is None:
            return Status.POOR_FIT
    if picture.moving is not None and view.rate_cam_rad_s is not None:
        moving = replace(picture.moving, rate_cam_rad_s=view.rate_cam_rad_s)
        # The readout is one of the window's states, if it is unsure.
        picture = replace(picture, moving=moving, readout_s=(solved.readout_s, 0.0))
    return _by_view(solved, view, picture, window.config.tracking.features, ground_range)


def _keyframe_view(solved: Solved, frame: int, rows: NDArray[np.intp]) -> _View | None:
    if frame not in solved.frames:
        return None
    k = solved.frames.index(frame)
    gain = np.zeros((6, solved.layout.size))
    gain[:, 6 * k : 6 * k + 6] = np.eye(6)
    state = solved.solution.state
    moving = solved.keyframes[k].observation.moving
    rate = None if moving is None else moving.rate_cam_rad_s
    return _View(Pose(state.R_cam_enu[k], state.centres_enu_m[k]), gain, np.zeros((6, 6)), rows, rate)


def _resected_view(
    solved: Solved,
    seen: Observation,
    rows: NDArray[np.intp],
    known: NDArray[np.bool_],
    prior: _Prior,
    start: Pose | None,
) -> _View | None:
    s, guess = solved.solution, prior.pose
    points = s.state.points_enu_m[rows[known]]
    weight = 1.0 / (solved.pixel_sigma_px * seen.gain[known])
    sigma = np.concatenate([[ROTATION_PRIOR_RAD] * 3, prior.travelled_m])
    sweep = None
    if (m := seen.moving) is not None:
        share = seen.share[known][None]
        rate, velocity = m.rate_cam_rad_s[None], m.velocity_enu_m_s[None]
        sweep = Sweep(solved.readout_s, share, rate, velocity, m.sigma_rate_rad_s, abs(solved.readout_s))
    begin = None if start is None else (start.R_cam_enu, start.centre_enu_m)
    sighted = Sighted(points, seen.raw_xy[known], weight, seen.camera)
    pose: Resection = resect(sighted, guess.R_cam_enu, guess.centre_enu_m, sigma, start=begin, sweep=sweep)
    if np.count_nonzero(pose.inliers) < max(MIN_FEATURES, 0.5 * len(points)):
        return None
    covariance = np.linalg.inv(pose.information)
    used = rows[known][pose.inliers]
    pull = covariance[:6] @ pose.by_point[pose.inliers]  # (N, 6, 3): d pose = -pull d point
    flat = pull.transpose(1, 0, 2).reshape(6, -1)
    gain = flat @ s.point_gain[used].reshape(flat.shape[1], -1)
    # The prior is a keyframe's pose, carried on: it has that one's errors. (7.3)
    by_prior = covariance[:6, :6] / sigma**2
    by_prior[:, :3] = by_prior[:, :3] @ pose.R_cam_enu @ s.state.R_cam_enu[prior.keyframe].T
    gain[:, 6 * prior.keyframe : 6 * prior.keyframe + 6] += by_prior
    noise = covariance[:6, :6] + (pull @ s.point_covariance[used]).transpose(1, 0, 2).reshape(6, -1) @ flat.T
    turning = None if sweep is None else sweep.rates_in(solved.readout_s, pose.rate_off_rad_s[None])[0]
    return _View(Pose(pose.R_cam_enu, pose.centre_enu_m), gain, noise, used, turning)


def _by_view(solved: Solved, view: _View, picture: Picture, most: int, ground_range: float | None) -> Placed | Status:
    """A picture whose pose is known, its set with the `most` features that are known best."""
    s = solved.solution
    R = view.pose.R_cam_enu
    p = (s.state.points_enu_m[view.rows] - view.pose.centre_enu_m) @ R.T
    ahead = p[:, 2] > 1.0
    uv, inside = picture.camera.project(p)
    keep = ahead & inside
    z = np.where(keep, p[:, 2], 1.0)
    xy = p[:, :2] / z[:, None]
    # d ln w of each feature: (9.2)
    by_point = -R[2] / z[:, None]
    by_pose = np.concatenate([np.stack([-xy[:, 1], xy[:, 0], np.zeros(len(z))], axis=1), -by_point], axis=1)
    own = (by_point * (s.point_covariance[view.rows] @ by_point[:, :, None])[:, :, 0]).sum(axis=1)
    keep &= np.sqrt(own) < MAX_RELATIVE_SIGMA
    if np.count_nonzero(keep) < MIN_FEATURES:
        return Status.LOW_PARALLAX if np.count_nonzero(ahead & inside) >= MIN_FEATURES else Status.FEATURELESS
    xy, z, uv, own, by_point, by_pose = xy[keep], z[keep], uv[keep], own[keep], by_point[keep], by_pose[keep]
    rows = view.rows[keep]
    M = by_pose @ view.gain - (by_point[:, None] @ s.point_gain[rows])[:, 0]  # (N, D)

    H = np.concatenate([np.ones((len(z), 1)), xy], axis=1)
    own = np.maximum(own, 1e-12)
    capture_unix_ns = picture.origin.capture_unix_ns
    covariance = solved.covariance_at(capture_unix_ns)
    columns = solved.layout.camera
    directions = s.state.points_enu_m[rows] - view.pose.centre_enu_m
    moved = -s.point_gain[rows][:, :, columns]
    errors = Linearised(covariance, view.gain, view.noise, H, M, by_pose, own, columns, directions, moved)
    common, variance, T = common_states(errors, R.T)
    factor = solved.variance_factor  # what reobserved points show of all of these, (16.4)
    common, variance = factor * common, factor * variance
    span_s = tuple((solved.keyframes[k].nav.stamp_ns - capture_unix_ns) / 1e9 for k in (0, -1))
    shared = replace(
        solved.shared, by_nuisance=np.sqrt(factor) * (T @ solved.shared.by_nuisance), span_s=(span_s[0], span_s[1])
    )
    best = np.sort(np.argsort(variance, kind="stable")[:most])
    features = Features(H, uv, 1.0 / z, variance, variance, best)
    made = assemble(picture, view.pose, features, common, shared, DepthSource.PARALLAX, ground_range)
    plane = made.plane_per_m
    slope = made.roughness / stretch(H[best, 1:], plane) * float(np.linalg.norm(plane))
    return Placed(made, view.pose, solved, T, slope / made.plane_sigma_relative**2)


def assemble(
    picture: Picture,
    pose: Pose,
    features: Features,
    common: Array,
    shared: SharedErrors,
    source: DepthSource,
    ground_range: float | None = None,
) -> FeatureSet:
    """The set of a picture whose errors are known: moved from the session's axes into those at the camera's own place.

    `common` (9, 9) and `shared` in session axes; `ground_range` as `plane_and_roughness` takes it.
    """
    origin, published, w = picture.origin, features.published, features.inverse_depth_per_m
    plane, spread, slope = plane_and_roughness(features.H, w, features.noise, ground_range)
    lat, lon, height = (float(c) for c in picture.frame.to_geodetic(pose.centre_enu_m))
    R_local_session = rotation_enu_ecef(lat, lon) @ picture.frame.R_enu_ecef.T
    lift = np.eye(9)
    lift[:3, :3] = lift[3:6, 3:6] = R_local_session
    return FeatureSet(
        vehicle=origin.vehicle,
        session=origin.session,
        frame=origin.frame,
        capture_unix_ns=origin.capture_unix_ns,
        status=Status.OK,
        camera=picture.camera,
        revision=origin.revision,
        is_keyframe=origin.is_keyframe,
        camera_lat_deg=lat,
        camera_lon_deg=lon,
        camera_height_m=height,
        undulation_m=picture.undulation_m,
        R_enu_cam=R_local_session @ pose.R_cam_enu.T,
        common_cov=lift @ common @ lift.T,
        shared=replace(shared, by_nuisance=np.sqrt(MAX_SHARED) * (lift @ shared.by_nuisance)),
        depth_source=source,
        plane_per_m=plane,
        plane_sigma_relative=spread,
        roughness=slope * stretch(features.H[published, 1:], plane),
        uv_px=features.uv_px[published],
        inverse_depth_per_m=w[published],
        sigma_inverse_depth_per_m=(np.sqrt(features.variance) * w)[published],
        shutter=None if picture.moving is None else picture.moving.for_ground(pose.R_cam_enu, *picture.readout_s),
    )


def common_states(errors: Linearised, R_enu_cam: Array) -> tuple[Array, Array, Array]:
    """The nine common states' covariance, each feature's own variance of d ln w, and d common / d state (9, D).

    Equations (9.3) to (9.5).
    """
    H, M, own, covariance = errors.H, errors.M, errors.own, errors.covariance
    weighted = (H / own[:, None]).T
    N = weighted @ H
    fit = solve_small(N + 1e-9 * N.trace() / 3.0 * np.eye(3), weighted)  # (3, N): modes of d ln w
    to_common = np.zeros((9, 6))
    to_common[:3, 3:] = np.eye(3)
    to_common[3:6, :3] = -R_enu_cam
    T = to_common @ errors.by_state
    T[6:] += fit @ M
    rest = M - H @ (fit @ M)
    if errors.points_by_camera.shape[2]:
        T[:, errors.camera], rest[:, errors.camera] = _as_common(errors)
    T_noise = to_common
    T_noise[6:] += fit @ errors.by_pose
    common = T @ covariance @ T.T + T_noise @ errors.noise @ T_noise.T
    variance = own + np.maximum(((rest @ covariance) * rest).sum(axis=1), 0.0)
    return 0.5 * (common + common.T), variance, T


def _as_common(errors: Linearised) -> tuple[Array, Array]:
    """The camera's own errors as errors of the nine common states: (9, C), and what is left of d ln w (N, C).

    A wrong focal length moves rays and depths together, such that the ground hardly moves sideways. A click must see
    that, but the wire has no states of the camera: the nine that move the points most nearly as they move are taken
    instead, (15.3).
    """
    d, H = errors.directions, errors.H
    z = np.linalg.norm(d, axis=1)
    scale = middle(z)
    G = np.zeros((len(d), 3, 9))
    G[:, :, :3] = np.eye(3)
    G[:, :, 3:6] = -skew(d) / scale  # the angles in units that move a point as far as a metre does
    G[:, :, 6:] = -d[:, :, None] * H[:, None] / scale
    weight = 1.0 / z
    A = (G * weight[:, None, None]).reshape(-1, 9)
    b = (errors.points_by_camera * weight[:, None, None]).reshape(len(A), -1)
    N = A.T @ A
    T = solve_small(N + 1e-6 * N.trace() / 9.0 * np.eye(9), A.T @ b)
    left = errors.points_by_camera - G @ T
    along = -np.einsum("ni,nic->nc", d, left) / (z * z)[:, None]
    T[3:] /= scale
    return T, along
