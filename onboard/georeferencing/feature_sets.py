"""A solved window and one picture's pose -> the feature set that is published, errors and all. Section 9.

The camera side of the window has covariance S; each point follows it and adds its own error (6.6). A picture's pose is
either a keyframe's, or a resection that follows the points (7.2). Everything is therefore linear in the window's camera
side plus independent noise, and the nine common states (9.3) are linear in that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import DepthSource, FeatureSet, SharedErrors, Status
from contract.geodesy import LocalFrame, rotation_enu_ecef
from onboard.estimation.ground_roughness import plane_and_roughness
from onboard.estimation.keyframe import Observation
from onboard.estimation.resection import Resection, resect
from onboard.estimation.sliding_window import Window
from onboard.estimation.window_solver import Solved
from onboard.geometry.plane_homography import Pose

Array = NDArray[np.float64]

MIN_FEATURES = 8
MAX_RELATIVE_SIGMA = 0.3  # a feature's own depth error beyond which it adds nothing to the ground plane
ROTATION_PRIOR_RAD = 0.1
POSITION_PRIOR_M = 1.0
# Of a variance, at most: on the wire the shared part is quantised in sigmas of the rest.
MAX_SHARED = 0.999


@dataclass(frozen=True)
class Origin:
    """What identifies the picture: everything in the set that is not geometry."""

    vehicle: str
    session: int
    frame: int
    capture_unix_ns: int
    revision: int
    is_keyframe: bool


@dataclass(frozen=True, eq=False)
class _View:
    """A picture's pose as the window's camera side sees it: d pose = gain @ d camera side + noise."""

    R_cam_enu: Array
    centre_enu_m: Array
    gain: Array  # (6, D)
    noise: Array  # (6, 6)
    rows: NDArray[np.intp]  # points of the window that this picture uses


def georeference(
    window: Window,
    solved: Solved,
    seen: Observation,
    origin: Origin,
    frame: LocalFrame,
    nav_undulation_m: float,
    centre_guess_m: Array,
    R_guess: Array,
) -> FeatureSet | Status:
    """The feature set of one picture, or why it has none.

    `centre_guess_m` (3,) and `R_guess` (3, 3) start the resection of a picture that is no keyframe of the window.
    """
    rows, known = solved.rows(seen.ids)
    if np.count_nonzero(known) < MIN_FEATURES:
        return Status.FEATURELESS
    view = _keyframe_view(solved, origin.frame, rows[known])
    if view is None:
        view = _resected_view(window, solved, seen, rows, known, centre_guess_m, R_guess)
        if view is None:
            return Status.POOR_FIT
    return _assemble(window, solved, view, origin, frame, nav_undulation_m)


def _keyframe_view(solved: Solved, frame: int, rows: NDArray[np.intp]) -> _View | None:
    if frame not in solved.frames:
        return None
    k = solved.frames.index(frame)
    gain = np.zeros((6, solved.layout.size))
    gain[:, 6 * k : 6 * k + 6] = np.eye(6)
    state = solved.solution.state
    return _View(state.R_cam_enu[k], state.centres_enu_m[k], gain, np.zeros((6, 6)), rows)


def _resected_view(
    window: Window,
    solved: Solved,
    seen: Observation,
    rows: NDArray[np.intp],
    known: NDArray[np.bool_],
    centre_guess_m: Array,
    R_guess: Array,
) -> _View | None:
    s = solved.solution
    points = s.state.points_enu_m[rows[known]]
    weight = 1.0 / (solved.pixel_sigma_px * seen.gain[known])
    prior = np.array([ROTATION_PRIOR_RAD] * 3 + [POSITION_PRIOR_M] * 3)
    pose: Resection = resect(points, seen.xy[known], weight, R_guess, centre_guess_m, prior)
    if np.count_nonzero(pose.inliers) < max(MIN_FEATURES, 0.5 * len(points)):
        return None
    covariance = np.linalg.inv(pose.information)
    used = rows[known][pose.inliers]
    pull = covariance @ pose.by_point[pose.inliers]  # (N, 6, 3): d pose = -pull d point
    flat = pull.transpose(1, 0, 2).reshape(6, -1)
    gain = flat @ s.point_gain[used].reshape(flat.shape[1], -1)
    noise = covariance + (pull @ s.point_covariance[used]).transpose(1, 0, 2).reshape(6, -1) @ flat.T
    return _View(pose.R_cam_enu, pose.centre_enu_m, gain, noise, used)


def _assemble(
    window: Window, solved: Solved, view: _View, origin: Origin, frame: LocalFrame, undulation_m: float
) -> FeatureSet | Status:
    s, camera = solved.solution, window.camera
    R = view.R_cam_enu
    p = (s.state.points_enu_m[view.rows] - view.centre_enu_m) @ R.T
    ahead = p[:, 2] > 1.0
    uv, inside = camera.project(p)
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
    R_enu_cam = R.T
    covariance = solved.covariance_at(origin.capture_unix_ns)
    common, variance, T = common_states(H, own, M, by_pose, view.gain, R_enu_cam, covariance, view.noise)
    span_s = tuple((solved.keyframes[k].nav.stamp_ns - origin.capture_unix_ns) / 1e9 for k in (0, -1))
    shared = replace(solved.shared, by_nuisance=T @ solved.shared.by_nuisance, span_s=(span_s[0], span_s[1]))
    best = np.sort(np.argsort(variance, kind="stable")[: window.config.tracking.features])
    pose = Pose(R, view.centre_enu_m)
    return assemble(
        camera, origin, frame, undulation_m, pose, common, shared, DepthSource.PARALLAX, H, uv, 1.0 / z, variance, best
    )


def assemble(
    camera: Camera,
    origin: Origin,
    frame: LocalFrame,
    undulation_m: float,
    pose: Pose,
    common: Array,
    shared: SharedErrors,
    source: DepthSource,
    H: Array,
    uv_px: Array,
    w: Array,
    variance: Array,
    published: NDArray[np.intp],
    noise: Array | None = None,
) -> FeatureSet:
    """The set of a picture whose errors are known: moved from the session's axes into those at the camera's own place.

    `common` (9, 9) and `shared` in session axes; `H` (N, 3) rows (1, x, y), pixels (N, 2), inverse depths `w` (N,) and
    relative `variance` (N,) of every feature, which the ground plane is fitted to; `published`: the rows that travel.
    `noise` (N,): what of `variance` is the features' own and not the ground's; all of it unless given.
    """
    plane, spread, roughness = plane_and_roughness(H, w, variance if noise is None else noise)
    lat, lon, height = (float(c) for c in frame.to_geodetic(pose.centre_enu_m))
    R_local_session = rotation_enu_ecef(lat, lon) @ frame.R_enu_ecef.T
    lift = np.eye(9)
    lift[:3, :3] = lift[3:6, 3:6] = R_local_session
    return FeatureSet(
        vehicle=origin.vehicle,
        session=origin.session,
        frame=origin.frame,
        capture_unix_ns=origin.capture_unix_ns,
        status=Status.OK,
        camera=camera,
        revision=origin.revision,
        is_keyframe=origin.is_keyframe,
        camera_lat_deg=lat,
        camera_lon_deg=lon,
        camera_height_m=height,
        undulation_m=undulation_m,
        R_enu_cam=R_local_session @ pose.R_cam_enu.T,
        common_cov=lift @ common @ lift.T,
        shared=replace(shared, by_nuisance=np.sqrt(MAX_SHARED) * (lift @ shared.by_nuisance)),
        depth_source=source,
        plane_per_m=plane,
        plane_sigma_relative=spread,
        roughness=roughness,
        uv_px=uv_px[published],
        inverse_depth_per_m=w[published],
        sigma_inverse_depth_per_m=(np.sqrt(variance) * w)[published],
    )


def common_states(
    H: Array, own: Array, M: Array, by_pose: Array, gain: Array, R_enu_cam: Array, covariance: Array, noise: Array
) -> tuple[Array, Array, Array]:
    """The nine common states' covariance, each feature's own variance of d ln w, and d common / d state (9, D).

    Equations (9.3) to (9.5).

    With D states of covariance `covariance` (D, D): d pose = `gain` (6, D) d state + noise (6, 6), d ln w = `M` (N, D)
    d state + `by_pose` (N, 6) noise + own (N,). `H` (N, 3) holds (1, x, y) of each feature.
    """
    weighted = (H / own[:, None]).T
    N = weighted @ H
    fit = np.linalg.solve(N + 1e-9 * np.trace(N) / 3.0 * np.eye(3), weighted)  # (3, N): modes of d ln w
    to_common = np.zeros((9, 6))
    to_common[:3, 3:] = np.eye(3)
    to_common[3:6, :3] = -R_enu_cam
    T = to_common @ gain
    T[6:] += fit @ M
    T_noise = to_common
    T_noise[6:] += fit @ by_pose
    common = T @ covariance @ T.T + T_noise @ noise @ T_noise.T
    rest = M - H @ (fit @ M)
    variance = own + np.maximum(((rest @ covariance) * rest).sum(axis=1), 0.0)
    return 0.5 * (common + common.T), variance, T
