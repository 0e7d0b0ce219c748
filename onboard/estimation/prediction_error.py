"""The ground's motion between two pictures by velocities and rates, and its sigma.

On ground that repeats itself nothing else decides which row is which.

Only what two pictures do not share counts: an error that both have moves both predictions equally.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.rotations import exp_so3, log_so3
from onboard.estimation.factors import AttitudePrior
from onboard.estimation.platform_states import BORESIGHT, OFFSET
from onboard.estimation.sensor_factors import attitude_sigma_rad, travelled_sigma_m
from onboard.estimation.sensor_table import BY_NAME, VELOCITY, declared
from onboard.estimation.sliding_window import Window
from onboard.navigation.navigator import Navigation, NavState

Array = NDArray[np.float64]


def _moments_ns(window: Window, was: NavState, now: NavState) -> tuple[int, int]:
    """Two pictures' moments on the autopilot's clock."""
    offset_ns = round(float(window.alignment.platform.mean[OFFSET]) * 1e9)
    return was.stamp_ns + offset_ns, now.stamp_ns + offset_ns


def way_between(window: Window, navigation: Navigation, was: NavState, now: NavState) -> tuple[Array, Array]:
    """The way (3,), ENU m, from one picture to another and one sigma of it: by velocities, else by positions."""
    travelled = navigation.displacement(*_moments_ns(window, was, now))
    if travelled is None:
        return now.position_enu_m - was.position_enu_m, travelled_sigma_m(window.config, was, now)
    gps, seconds = window.config.gps, (now.stamp_ns - was.stamp_ns) / 1e9
    factors = window.noise.factors_at(now.stamp_ns)
    correlated = max(gps.sigma_velocity_correlated_m_s, was.sigma_velocity_m_s, now.sigma_velocity_m_s)
    slow_m = correlated * factors.slow_sigma(VELOCITY) * seconds
    white_m = gps.sigma_velocity_m_s * factors.sigma(BY_NAME[VELOCITY].white) * np.sqrt(seconds * min(seconds, 1.0))
    between_m2 = sum((gap_m**2 for gap_m in travelled.between_m.values()), np.zeros(3))
    return travelled.enu_m, np.sqrt(between_m2 + white_m**2 + slow_m**2)


def turn_between(
    window: Window, navigation: Navigation, was: NavState, now: NavState
) -> tuple[Array | None, Array | None]:
    """The camera's turn R_now_was (3, 3) by rates, None by attitudes; and its covariance (3, 3), rad², ENU."""
    R_was, R_now = window.attitude_guess(was), window.attitude_guess(now)
    if R_was is None or R_now is None:
        return None, None
    config, platform, factors = window.config, window.alignment.platform, window.noise.factors_at(now.stamp_ns)
    white_rad = np.array(
        [declared(config, w) * factors.sigma(w) for w in (BY_NAME[n].white for n in AttitudePrior.sensors)]
    )
    at_ns = _moments_ns(window, was, now)
    turned = navigation.turned(*at_ns, float(white_rad.max()))
    if turned is not None:
        R_body_cam = window.R_body_cam @ exp_so3(platform.mean[BORESIGHT])
        turn, variance = R_body_cam.T @ turned[0].T @ R_body_cam, np.full(3, turned[1] ** 2)
    else:
        turn = None
        forgotten = 1.0 - np.exp(-(now.stamp_ns - was.stamp_ns) / 1e9 / config.solve.attitude_correlation_time_s)
        variance = 2.0 * white_rad**2 + 2.0 * forgotten * attitude_sigma_rad(config, factors) ** 2
        variance += was.attitude_sigma_rad**2 + now.attitude_sigma_rad**2
    rates = [rate for t in at_ns if (rate := navigation.body_rate_at(t)) is not None]
    if len(rates) == 2:
        late_s, jitter_s = np.sqrt(platform.covariance[OFFSET, OFFSET]), _jitter_s(window, now)
        variance += (late_s * np.linalg.norm(rates[1] - rates[0])) ** 2 + jitter_s**2 * float(np.sum(np.square(rates)))
    turn_rad = np.linalg.norm(log_so3(R_now @ R_was.T))
    variance += turn_rad**2 * np.trace(platform.covariance[BORESIGHT, BORESIGHT]) / 3.0
    return turn, np.diag(variance)


def prediction_sigma_px(
    window: Window, navigation: Navigation, was: NavState, now: NavState, plane: Array
) -> float | None:
    """One sigma (px) of the ground's predicted motion in the picture's middle, where it is largest. (4.4)

    `plane` (3,): the ground so far, its height (m) at the ENU origin and its slopes. None without attitude.
    """
    R_cam_enu = window.attitude_guess(now)
    _, turned = turn_between(window, navigation, was, now)
    if R_cam_enu is None or turned is None:
        return None
    normal = np.array([-plane[1], -plane[2], 1.0])
    falls = -float(normal @ R_cam_enu[2])
    clearance_m = float(normal @ window.position_guess(now) - plane[0])
    if falls <= 0.0 or clearance_m <= 0.0:
        return None
    depth_m = clearance_m / falls
    way_m, sigma_m = way_between(window, navigation, was, now)
    by_way = (R_cam_enu[:2] * sigma_m) / depth_m
    by_depth = (R_cam_enu[:2] @ way_m) / depth_m * _clearance_sigma(window, now, clearance_m)
    by_turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]) @ R_cam_enu
    covariance = by_way @ by_way.T + np.outer(by_depth, by_depth) + by_turn @ turned @ by_turn.T
    late = (R_cam_enu[:2] @ now.motion_enu_m_s) / depth_m * _jitter_s(window, now)
    covariance += 2.0 * np.outer(late, late)
    return window.camera.focal_px * float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))


def _jitter_s(window: Window, now: NavState) -> float:
    return float(np.hypot(window.noise.jitter_s, now.stamp_sigma_s))


def _clearance_sigma(window: Window, now: NavState, clearance_m: float) -> float:
    """One sigma of the height above the ground as a share of it: as the window solved it, else as home's is known."""
    solved = window.solved
    if solved is not None:
        by_states = -solved.solution.point_gain[solved.good][:, 2].mean(axis=0)
        by_states[solved.layout.centre(solved.layout.keyframes - 1)] -= np.array([0.0, 0.0, 1.0])
        variance_m2 = float(by_states @ solved.solution.covariance @ by_states) * solved.variance_factor
        return float(np.sqrt(max(variance_m2, 0.0))) / clearance_m
    # The ground about home is level to its configured slope, over no less than what the picture shows.
    away_m = max(float(np.linalg.norm(now.position_enu_m[:2])), clearance_m)
    slope_m = np.tan(np.radians(window.config.solve.level_ground_sigma_deg)) * away_m
    return float(np.hypot(slope_m, now.sigma_vertical_m)) / clearance_m
