"""Keyframe -> next picture by telemetry alone: where features will be by the window and the autopilot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.sliding_window import Window
from onboard.geometry.plane_homography import Pose, predict_homography
from onboard.navigation.limits import MEMORY_NS, RECENT_NS
from onboard.navigation.navigator import Navigation, NavState
from onboard.pipeline.shortfall import Break

Array = NDArray[np.float64]

MIN_HEIGHT_M = 2.0
SAME_STAMPS = 0.5  # share that the sigma of stamps may change by while their error is taken for the same


def ground_so_far(window: Window, nav: NavState) -> Array | None:
    """Height (m) at the ENU origin and slopes of the ground plane: solved, else level at home; None if unknown."""
    if window.solved is not None:
        return window.solved.plane
    if nav.height_above_home_m is not None and nav.height_above_home_m > MIN_HEIGHT_M:
        return np.array([nav.position_enu_m[2] - nav.height_above_home_m, 0.0, 0.0])
    return None


def predict_motion(window: Window, was_nav: NavState, nav: NavState) -> Array | None:
    """Pixel homography (3, 3) from the newest keyframe to `nav`'s picture; None without attitude or ground.

    `was_nav` is the keyframe's state, looked up with the same time offset as `nav`.
    """
    plane = ground_so_far(window, nav)
    if not window.keyframes or plane is None:
        return None
    last = window.keyframes[-1]
    was, now = window.attitude_guess(was_nav), window.attitude_guess(nav)
    if was is None or now is None:
        return None
    moved = nav.position_enu_m - was_nav.position_enu_m
    return predict_homography(
        window.camera,
        Pose(last.R_cam_enu, last.centre_enu_m),
        Pose(now @ was.T @ last.R_cam_enu, last.centre_enu_m + moved),
        plane,
    )


def what_parts(was: NavState, now: NavState, navigation: Navigation, offset_ns: int) -> Break | None:
    """Why no window may hold both: navigation was lost in between, position or stamps jumped, or too long ago.

    Pictures that come slowly are no outage: in between, navigation had accepted positions. `offset_ns`: camera to
    autopilot.
    """
    apart_ns = now.stamp_ns - was.stamp_ns
    if now.stretch != was.stretch:
        return Break.JUMP
    if apart_ns > RECENT_NS:
        if not navigation.was_believed(was.stamp_ns + offset_ns, now.stamp_ns + offset_ns):
            return Break.OUTAGE
        if apart_ns > MEMORY_NS // navigation.config.solve.keyframes:
            return Break.APART
    one, other = was.stamp_sigma_s, now.stamp_sigma_s
    return None if abs(one - other) <= SAME_STAMPS * max(one, other) else Break.STAMPS
