"""Keyframes: when a picture becomes one, and their attitudes at other time offsets than the one they were taken at."""

from __future__ import annotations

import numpy as np

from onboard.estimation.clock_profile import ClockProfile, clock_profile, offsets_about
from onboard.estimation.keyframe import stamp_sigma_s
from onboard.estimation.platform_states import OFFSET
from onboard.estimation.sliding_window import Window
from onboard.estimation.window_problem import Outcome
from onboard.geometry.robust import middle
from onboard.navigation.navigator import Navigation
from onboard.vision.klt_tracker import Tracks

KEYFRAME_SHIFT = 0.10  # median motion, as a share of the picture's width, that makes a keyframe
KEYFRAME_SHARE = 0.65  # of features still followed, and of the picture that the keyframe shows: below it one is made
KEYFRAME_TURN_RAD = 0.30


def wants_keyframe(tracks: Tracks, size_px: tuple[int, int]) -> bool:
    """Return whether the picture with these tracks should be the next keyframe."""
    shift = middle(np.linalg.norm(tracks.uv_px - tracks.keyframe_uv_px, axis=1))
    linear = tracks.motion[:2, :2]
    turn = abs(float(np.arctan2(linear[1, 0] - linear[0, 1], linear[0, 0] + linear[1, 1])))
    left = min(len(tracks) / tracks.offered, tracks.shown_before(size_px))
    return shift > KEYFRAME_SHIFT * size_px[0] or left < KEYFRAME_SHARE or turn > KEYFRAME_TURN_RAD


def profile_of(outcome: Outcome, window: Window, navigation: Navigation) -> ClockProfile | None:
    """The fit of a solved window's orientations to the autopilot's attitudes over time offsets; None if unknown."""
    found = outcome.solved or outcome.rejected or outcome.weighed
    if found is None or stamp_sigma_s(outcome.keyframes):
        return None
    before = window.alignment.prior_for(outcome.keyframes[0].nav.stamp_ns)
    known = float(before.mean[OFFSET]), float(before.covariance[OFFSET, OFFSET])
    offsets_s = offsets_about(window.times_s()[0], float(before.sigma[OFFSET]))
    offsets_ns = [round(offset_s * 1e9) for offset_s in offsets_s]
    attitudes = [
        navigation.attitudes_at([k.nav.stamp_ns + offset_ns for offset_ns in offsets_ns], k.nav.position_enu_m)
        for k in outcome.keyframes
    ]
    measured = [i for i, R in enumerate(attitudes) if R is not None]
    if not measured:
        return None
    solve, mount = window.config.solve, window.config.mount
    own = np.hypot(solve.attitude_sigma_deg, solve.attitude_white_sigma_deg)
    sigma_rad = np.radians([own, np.hypot(own, mount.sigma_deg), np.hypot(own, solve.heading_sigma_deg)])
    R_enu_cam = np.stack([R for R in attitudes if R is not None], axis=1) @ window.R_body_cam
    return clock_profile(found.solution.state.R_cam_enu[measured], R_enu_cam, offsets_s, known, sigma_rad)
