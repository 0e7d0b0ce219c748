"""Keyframes' navigation looked up again where the time offset or the delay it was looked up at is known better now.

An offset acts on a window by first derivatives, (5.4) to (5.7), which hold for some tens of milliseconds of a roll.
"""

from __future__ import annotations

from dataclasses import replace

from contract.feature_set import Status
from onboard.estimation.keyframe import Keyframe
from onboard.estimation.platform_states import DELAY, OFFSET
from onboard.estimation.sliding_window import Window
from onboard.navigation.navigator import Navigation

LEAST_OFFSET_S, LEAST_DELAY_S = 0.003, 0.02  # of 3 rad/s and 30 m/s: half a degree and half a metre
EXPLAINS_S = 0.02  # of an offset, a third of a degree in a slow roll: what contradicted was the clock and no sensor


def look_up_again(window: Window, navigation: Navigation) -> None:
    """Replace the navigation of the window's keyframes, all of them or, where one has none any more, none."""
    mean = window.alignment.belief.mean
    offset_s, delay_s = float(mean[OFFSET]), float(mean[DELAY])
    if all(
        abs(k.nav_offset_s - offset_s) <= LEAST_OFFSET_S and abs(k.nav_delay_s - delay_s) <= LEAST_DELAY_S
        for k in window.keyframes
    ):
        return
    offset_ns = round(offset_s * 1e9)
    solved = set() if window.solved is None else set(window.solved.frames)
    found: list[Keyframe] = []
    for k in window.keyframes:
        nav = navigation.state_at(k.nav.stamp_ns, offset_s, k.nav.stamp_sigma_s, delay_s)
        rate = navigation.body_rate_at(k.nav.stamp_ns + offset_ns)
        if isinstance(nav, Status) or nav.stretch != k.nav.stretch or rate is None:
            return
        flown = None
        if found and k.flown is not None:
            flown = navigation.displacement(found[-1].nav.stamp_ns + offset_ns, k.nav.stamp_ns + offset_ns)
        now = replace(k, nav=nav, nav_offset_s=offset_s, nav_delay_s=delay_s, body_rate_rad_s=rate, flown=flown)
        R_cam_enu = window.attitude_guess(nav)
        if k.frame not in solved and R_cam_enu is not None:  # its start was by the navigation that is replaced
            now = replace(now, R_cam_enu=R_cam_enu, centre_enu_m=window.position_guess(nav))
        found.append(now)
    if max(abs(k.nav_offset_s - offset_s) for k in window.keyframes) > EXPLAINS_S:
        window.noise = replace(window.noise, failing=window.noise.failing.explained())
    window.keyframes = found
