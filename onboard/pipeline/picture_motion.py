"""How a camera that reads its rows one after the other moved during one picture, by telemetry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rolling_shutter import row_share
from contract.rotations import exp_so3
from onboard.estimation.keyframe import Observation, observation
from onboard.estimation.platform_states import BORESIGHT, OFFSET
from onboard.estimation.rolling_shutter import Moving, rates_between
from onboard.estimation.sliding_window import Window
from onboard.geometry.plane_homography import fit_homography, move
from onboard.navigation.attitude_interpolation import RATE_WINDOW_NS
from onboard.navigation.navigator import Navigation, NavState
from onboard.pipeline.motion_prediction import ground_so_far
from onboard.vision.klt_tracker import Tracks

Array = NDArray[np.float64]

TURN_RAD_S = 0.3  # faster is a turn or a gust: one sigma of a rate known only from keyframes a second apart


def moving_at(window: Window, navigation: Navigation, nav: NavState) -> Moving | None:
    """Of the picture with this state; None where all rows are exposed at once.

    Without attitude the camera is taken to turn as it did between the newest keyframes.
    """
    if not window.config.camera.is_rolling:
        return None
    belief = window.alignment.belief
    R_cam_enu = window.attitude_guess(nav)
    rate_cam = np.zeros(3)
    if R_cam_enu is not None:
        rate = navigation.body_rate_at(nav.stamp_ns + round(float(belief.mean[OFFSET]) * 1e9))
        if rate is not None:
            rate_cam = (window.R_body_cam @ exp_so3(belief.mean[BORESIGHT])).T @ rate
    elif window.keyframes:
        last = window.keyframes[-2:]
        R_cam_enu = last[-1].R_cam_enu
        stamps_s = np.array([(k.nav.stamp_ns - last[0].nav.stamp_ns) / 1e9 for k in last])
        rate_cam = rates_between(stamps_s, np.stack([k.R_cam_enu for k in last]))[-1]
    else:
        R_cam_enu = window.R_body_cam.T
    velocity = navigation.velocity_at(nav)
    plane = _inverse_depth(R_cam_enu, ground_so_far(window, nav), window.position_guess(nav))
    if nav.R_enu_body is None:
        return Moving(window.readout[0], rate_cam, velocity, R_cam_enu @ velocity, plane, TURN_RAD_S)
    at_ns = nav.stamp_ns + round(float(belief.mean[OFFSET]) * 1e9)
    noisy = navigation.rate_sigma_at(at_ns, window.config.camera.sigma_jitter_s)
    is_measured = noisy is not None
    if noisy is None:
        # The difference of two attitudes.
        noisy = float(np.sqrt(2.0) * np.radians(window.config.solve.attitude_white_sigma_deg)) / (RATE_WINDOW_NS / 1e9)
    elif noisy * 0.5 * np.hypot(*window.readout) * window.camera.focal_px < window.noise.pixel_sigma_px:
        noisy = 0.0  # not even the outermost row is moved by more than its features' own noise
    return Moving(window.readout[0], rate_cam, velocity, R_cam_enu @ velocity, plane, noisy, is_measured)


def _inverse_depth(R_cam_enu: Array, plane: Array | None, centre_enu_m: Array) -> Array:
    """The ground plane as a + b x + c y (3,), 1/m; zeros where it is not known or the camera is not above it."""
    if plane is None:
        return np.zeros(3)
    normal = np.array([-plane[1], -plane[2], 1.0])
    clearance_m = float(normal @ centre_enu_m - plane[0])
    if clearance_m <= 1.0:
        return np.zeros(3)
    # A ray r = R' (x, y, 1) falls by -normal . r for each metre of depth.
    falls = -(R_cam_enu @ normal) / clearance_m
    return np.array([falls[2], falls[0], falls[1]])


def seen_at(window: Window, camera: Camera, navigation: Navigation, nav: NavState, tracks: Tracks) -> Observation:
    """What a picture with this state saw, by this calibration."""
    return observation(camera, tracks.ids, tracks.uv_px, moving_at(window, navigation, nav))


def as_read(window: Window, navigation: Navigation, H: Array | None, nav: NavState) -> Array | None:
    """A motion (3, 3), pixels, from the newest keyframe's moment to `nav`'s, as it is between their rows."""
    was = window.keyframes[-1].observation.moving
    now = None if was is None else moving_at(window, navigation, nav)
    if H is None or was is None or now is None:
        return H
    camera = window.camera
    u, v = np.meshgrid(np.linspace(0.0, camera.width_px - 1.0, 5), np.linspace(0.0, camera.height_px - 1.0, 5))
    at = np.stack([u.ravel(), v.ravel()], axis=-1)
    to = move(H, at - _moved_px(camera, at, was))
    to = to + _moved_px(camera, to, now)
    return fit_homography(at, to, np.ones(len(at))) if np.all(np.isfinite(to)) else H


def _moved_px(camera: Camera, uv_px: Array, moving: Moving) -> Array:
    """How far (N, 2) what these pixels see has moved since the middle row; the lens's distortion left out."""
    focal = np.array([camera.fx_px, camera.fy_px])
    xy = (uv_px - (camera.cx_px, camera.cy_px)) / focal
    share = np.asarray(row_share(np.clip(uv_px[:, 1], 0.0, camera.height_px - 1.0), camera.height_px))
    out: Array = moving.readout_s * moving.by_readout(xy, share) * focal
    return out
