"""Keyframes: when a picture becomes one, and their navigation at other time offsets than the one they were taken at.

An offset acts on a window by first derivatives, (5.4) to (5.7), which hold for some tens of milliseconds of a roll: so
navigation is looked up again where the offset is known better, and attitudes are compared at offsets far from it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from contract.feature_set import Status
from onboard.estimation.clock_profile import ClockProfile, clock_profile, offsets_about
from onboard.estimation.keyframe import Keyframe, stamp_sigma_s, with_attitude
from onboard.estimation.platform_states import OFFSET
from onboard.estimation.sliding_window import Window
from onboard.estimation.window_request import Outcome
from onboard.geometry.robust import middle
from onboard.navigation.navigator import Navigation
from onboard.vision.klt_tracker import Tracks

KEYFRAME_SHIFT = 0.10  # median motion, as a share of the picture's width, that makes a keyframe
KEYFRAME_SHARE = 0.65  # of features still followed, and of the picture that the keyframe shows: below it one is made
KEYFRAME_TURN_RAD = 0.30
LEAST_OFFSET_S, LEAST_DELAY_S = 0.003, 0.02  # of 3 rad/s and 30 m/s: half a degree and half a metre


def wants_keyframe(tracks: Tracks, size_px: tuple[int, int]) -> bool:
    """Return whether the picture with these tracks should be the next keyframe."""
    shift = middle(np.linalg.norm(tracks.uv_px - tracks.keyframe_uv_px, axis=1))
    linear = tracks.motion[:2, :2]
    turn = abs(float(np.arctan2(linear[1, 0] - linear[0, 1], linear[0, 0] + linear[1, 1])))
    left = min(len(tracks) / tracks.offered, tracks.shown_before(size_px))
    return shift > KEYFRAME_SHIFT * size_px[0] or left < KEYFRAME_SHARE or turn > KEYFRAME_TURN_RAD


def look_up_again(window: Window, navigation: Navigation) -> None:
    """Replace the navigation of the window's keyframes, all of them or, where one has none any more, none."""
    offset_s, delay_s = window.times_s()
    if (
        all(
            abs(k.nav_offset_s - offset_s) <= LEAST_OFFSET_S and abs(k.nav_delay_s - delay_s) <= LEAST_DELAY_S
            for k in window.keyframes
        )
        or not with_attitude(window.keyframes).any()
    ):
        return
    offset_ns = round(offset_s * 1e9)
    solved = set() if window.solved is None else set(window.solved.frames)
    found: list[Keyframe] = []
    for k in window.keyframes:
        nav = navigation.state_at(k.nav.stamp_ns, offset_s, k.nav.stamp_sigma_s, delay_s)
        rate = navigation.body_rate_at(k.nav.stamp_ns + offset_ns)
        if isinstance(nav, Status) or nav.stretch != k.nav.stretch or (rate is None and nav.R_enu_body is not None):
            return
        rate = k.body_rate_rad_s if rate is None else rate
        displacement = None
        if found and k.displacement is not None:
            displacement = navigation.displacement(found[-1].nav.stamp_ns + offset_ns, k.nav.stamp_ns + offset_ns)
        now = replace(
            k, nav=nav, nav_offset_s=offset_s, nav_delay_s=delay_s, body_rate_rad_s=rate, displacement=displacement
        )
        R_cam_enu = window.attitude_guess(nav)
        if k.frame not in solved and R_cam_enu is not None:  # its start was by the navigation that is replaced
            now = replace(now, R_cam_enu=R_cam_enu, centre_enu_m=window.position_guess(nav))
        found.append(now)
    window.keyframes = found


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
