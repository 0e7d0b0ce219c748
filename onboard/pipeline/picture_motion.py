"""The camera's motion by telemetry: from the keyframe to the next picture, and, row after row, during one picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rolling_shutter import row_share
from contract.rotations import exp_so3
from onboard.estimation.platform_states import BORESIGHT, OFFSET
from onboard.estimation.rolling_shutter import Moving, rates_between
from onboard.estimation.sliding_window import Window
from onboard.geometry.plane_homography import Pose, fit_homography, move, pixel_grid, predict_homography
from onboard.navigation.attitude_interpolation import RATE_WINDOW_NS
from onboard.navigation.limits import MEMORY_NS, RECENT_NS
from onboard.navigation.navigator import Navigation, NavState
from onboard.pipeline.statistics import Break

Array = NDArray[np.float64]

MIN_HEIGHT_M = 2.0
SAME_STAMPS = 0.5  # share that the sigma of stamps may change by while their error is taken for the same
TURN_RAD_S = 0.3  # faster is a turn or a gust: one sigma of a rate known only from keyframes a second apart


def ground_so_far(window: Window, nav: NavState) -> Array | None:
    """Height (m) at the ENU origin and slopes of the ground plane: solved, else level at home; None if unknown."""
    if window.solved is not None:
        return window.solved.plane
    if nav.height_above_home_m is not None and nav.height_above_home_m > MIN_HEIGHT_M:
        return np.array([nav.position_enu_m[2] - nav.height_above_home_m, 0.0, 0.0])
    return None


def predict_motion(
    window: Window,
    navigation: Navigation,
    was_nav: NavState,
    nav: NavState,
    way_enu_m: Array | None = None,
    R_now_was: Array | None = None,
) -> Array | None:
    """Pixel homography (3, 3) from the newest keyframe to `nav`'s picture; None without attitude or ground.

    `was_nav` is the keyframe's state, looked up with the same time offset as `nav`; `way_enu_m` (3,) and
    `R_now_was` (3, 3) are the way and the camera's turn between both, where known better than by position and attitude.
    """
    plane, R_was, R_now = ground_so_far(window, nav), window.attitude_guess(was_nav), window.attitude_guess(nav)
    if plane is None or R_was is None or R_now is None:
        return None
    camera, last = window.camera, window.keyframes[-1]
    first = Pose(last.R_cam_enu, last.centre_enu_m)
    moved = nav.position_enu_m - was_nav.position_enu_m if way_enu_m is None else way_enu_m
    turn = R_now @ R_was.T if R_now_was is None else R_now_was
    second = Pose(turn @ last.R_cam_enu, last.centre_enu_m + moved)
    H = predict_homography(camera, first, second, plane)
    was, now = last.observation.moving, moving_at(window, navigation, nav)
    if H is None or was is None or now is None:
        return H
    # The homography holds at the pictures' moments: change it to the moments at which the rows were exposed.
    at = pixel_grid(camera.size_px, (5, 5))
    to = move(H, at - _moved_px(camera, at, was))
    to = to + _moved_px(camera, to, now)
    return fit_homography(at, to, np.ones(len(at))) if np.all(np.isfinite(to)) else H


def what_parts(was: NavState, now: NavState, navigation: Navigation, offset_ns: int) -> Break | None:
    """The reason why no window may hold both states; None if one may.

    Navigation was lost in between, position or stamps jumped, or they are too far apart. Pictures that come slowly are
    no outage: in between, navigation had accepted positions. `offset_ns`: camera to autopilot.
    """
    apart_ns = now.stamp_ns - was.stamp_ns
    if now.stretch != was.stretch:
        return Break.JUMP
    if apart_ns > RECENT_NS:
        if not navigation.was_accepted(was.stamp_ns + offset_ns, now.stamp_ns + offset_ns):
            return Break.OUTAGE
        if apart_ns > MEMORY_NS // navigation.config.solve.keyframes:
            return Break.APART
    one, other = was.stamp_sigma_s, now.stamp_sigma_s
    return None if abs(one - other) <= SAME_STAMPS * max(one, other) else Break.STAMPS


def moving_at(window: Window, navigation: Navigation, nav: NavState) -> Moving | None:
    """The camera's motion while the picture with this state is read; None if all rows are exposed at once.

    Without attitude the camera is assumed to turn as it did between the newest keyframes.
    """
    if not window.config.camera.is_rolling:
        return None
    platform = window.alignment.platform
    at_ns = nav.stamp_ns + round(float(platform.mean[OFFSET]) * 1e9)
    R_cam_enu, rate_cam = window.attitude_guess(nav), np.zeros(3)
    sigma_rad_s, is_measured = TURN_RAD_S, True
    if R_cam_enu is not None:
        rate = navigation.body_rate_at(at_ns)
        if rate is not None:
            rate_cam = (window.R_body_cam @ exp_so3(platform.mean[BORESIGHT])).T @ rate
        sigma_rad_s, is_measured = _rate_sigma(window, navigation, at_ns)
    elif window.keyframes:
        last = window.keyframes[-2:]
        R_cam_enu = last[-1].R_cam_enu
        stamps_s = np.array([(k.nav.stamp_ns - last[0].nav.stamp_ns) / 1e9 for k in last])
        rate_cam = rates_between(stamps_s, np.stack([k.R_cam_enu for k in last]))[-1]
    else:
        R_cam_enu = window.R_body_cam.T
    velocity = nav.motion_enu_m_s
    plane = _inverse_depth(R_cam_enu, ground_so_far(window, nav), window.position_guess(nav))
    return Moving(window.readout[0], rate_cam, velocity, R_cam_enu @ velocity, plane, sigma_rad_s, is_measured)


def _rate_sigma(window: Window, navigation: Navigation, at_ns: int) -> tuple[float, bool]:
    """One sigma (rad/s) of the vehicle's rate at a moment, 0 if it does not matter; and whether that is measured."""
    sigma_rad_s = navigation.rate_sigma_at(at_ns, window.config.camera.sigma_jitter_s)
    if sigma_rad_s is None:  # the difference of two attitudes
        white_rad = np.radians(window.config.solve.attitude_white_sigma_deg)
        return float(np.sqrt(2.0) * white_rad) / (RATE_WINDOW_NS / 1e9), False
    # Not even the outermost row is moved by more than its features' own noise?
    moved_px = sigma_rad_s * 0.5 * np.hypot(*window.readout) * window.camera.focal_px
    return (0.0 if moved_px < window.noise.pixel_sigma_px else sigma_rad_s), True


def _inverse_depth(R_cam_enu: Array, plane: Array | None, centre_enu_m: Array) -> Array:
    """The ground plane as a + b x + c y (3,), 1/m; zeros where it is not known or the camera is not above it."""
    if plane is None:
        return np.zeros(3)
    normal = np.array([-plane[1], -plane[2], 1.0])
    clearance_m = float(normal @ centre_enu_m - plane[0])
    if clearance_m <= MIN_HEIGHT_M:
        return np.zeros(3)
    # A ray r = R' (x, y, 1) falls by -normal . r for each metre of depth.
    falls = -(R_cam_enu @ normal) / clearance_m
    return np.array([falls[2], falls[0], falls[1]])


def _moved_px(camera: Camera, uv_px: Array, moving: Moving) -> Array:
    """The displacement (N, 2) since the middle row of what these pixels see; none of what has no ray."""
    at = np.clip(uv_px, 0.0, np.array(camera.size_px) - 1.0)
    rays, valid = camera.unproject(at)
    xy = rays[:, :2]
    moved = moving.readout_s * moving.by_readout(xy, np.asarray(row_share(at[:, 1], camera.height_px)))
    return np.where(valid[:, None], camera.pixels(xy + moved) - camera.pixels(xy), 0.0)
