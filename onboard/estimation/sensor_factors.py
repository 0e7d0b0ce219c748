"""Configuration and navigation -> the window's residuals: which sensors take part, and with what covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.config.schema import Config
from onboard.estimation.boresight import STATES as SHARED
from onboard.estimation.boresight import Belief
from onboard.estimation.factors import (
    AttitudePrior,
    HeightModel,
    Layout,
    PositionPrior,
    Prior,
    RangePrior,
    SharedPrior,
    VelocityPrior,
    gauss_markov_sqrt_information,
    ground_plane,
    lasting_sigma,
)
from onboard.estimation.keyframe import Keyframe

Array = NDArray[np.float64]

# How far an aircraft without attitude sensor may be from flying level along its path in a coordinated turn.
PATH_SIGMA_RAD = 0.25
PATH_WHITE_SIGMA_RAD = 0.15
GRAVITY_M_S2 = 9.81
ECHO_SIGMAS = 4.0
TERRAIN_SLOPE_SIGMA = 0.005  # of an elevation model over a window's few hundred metres: neighbours err alike


def sensor_priors(
    config: Config,
    R_body_cam: Array,
    keyframes: list[Keyframe],
    layout: Layout,
    belief: Belief,
    has_terrain: bool,
    jitter_s: float,
) -> list[Prior]:
    """Every residual over the camera side that the configuration asks for and the keyframes have data for.

    `has_terrain`: the plane among the shared states is then the terrain model's own error, not the ground itself.
    `jitter_s`: one sigma of each picture's own stamp: white error wherever the vehicle moves or turns. (5.11)
    """
    solve_, gps = config.solve, config.gps
    stamps_ns = np.array([k.nav.stamp_ns for k in keyframes], np.int64)
    stamps = (stamps_ns - stamps_ns[0]) / 1e9
    offsets = np.array([k.nav_offset_s for k in keyframes])
    positions = np.stack([k.nav.position_enu_m for k in keyframes])
    velocities = np.stack(
        [np.zeros(3) if k.nav.velocity_enu_m_s is None else k.nav.velocity_enu_m_s for k in keyframes]
    )
    horizontal = max(k.nav.sigma_horizontal_m for k in keyframes)
    vertical = max(k.nav.sigma_vertical_m for k in keyframes)
    white_m = np.array([k.nav.sigma_white_m for k in keyframes])
    whitener = np.stack(
        [
            gauss_markov_sqrt_information(
                stamps, np.hypot(white_m * grow, jitter_s * velocities[:, axis]), wander, gps.wander_time_s
            )
            for axis, (wander, grow) in enumerate(((horizontal, 1.0), (horizontal, 1.0), (vertical, 1.5)))
        ]
    )
    lasting = np.array([lasting_sigma(stamps, s, gps.wander_time_s) for s in (horizontal, horizontal, vertical)])
    priors: list[Prior] = [PositionPrior(layout, positions, velocities, whitener, offsets, lasting)]
    flown = [k.flown_enu_m for k in keyframes[1:]]
    if solve_.velocity and all(f is not None for f in flown):
        speed = np.linalg.norm(velocities, axis=1)
        slip_m = jitter_s * np.hypot(speed[1:], speed[:-1])
        # Velocity errors last about a second: over longer intervals they average.
        dt = np.maximum(np.diff(stamps), 0.05)
        sigma = np.hypot(gps.sigma_velocity_m_s * np.sqrt(dt * np.minimum(dt, 1.0)), slip_m)
        priors.append(VelocityPrior(layout, np.array(flown), sigma, np.diff(velocities, axis=0), offsets[1:]))
    if all(k.nav.R_enu_body is not None for k in keyframes):
        R_enu_cam = np.stack([k.nav.R_enu_body @ R_body_cam for k in keyframes if k.nav.R_enu_body is not None])
        rates = np.stack([k.body_rate_rad_s for k in keyframes]) @ R_body_cam
        turning = np.einsum("kij,kj->ki", R_enu_cam, rates)
        white = np.radians(
            [solve_.attitude_white_sigma_deg, solve_.attitude_white_sigma_deg, solve_.heading_white_sigma_deg]
        )
        wander_deg = (solve_.attitude_sigma_deg, solve_.attitude_sigma_deg, solve_.heading_sigma_deg)
        attitude = np.stack(
            [
                gauss_markov_sqrt_information(
                    stamps,
                    np.hypot(white[axis], jitter_s * turning[:, axis]),
                    np.radians(sigma_deg),
                    solve_.attitude_wander_time_s,
                )
                for axis, sigma_deg in enumerate(wander_deg)
            ]
        )
        lasting = np.array([lasting_sigma(stamps, s, solve_.attitude_wander_time_s) for s in np.radians(wander_deg)])
        priors.append(AttitudePrior(layout, R_enu_cam, rates, attitude, offsets, lasting))
    else:
        coordinated = _coordinated(R_body_cam, stamps, velocities)
        if coordinated is not None:
            loose = gauss_markov_sqrt_information(stamps, PATH_WHITE_SIGMA_RAD, PATH_SIGMA_RAD, gps.wander_time_s)
            heading = gauss_markov_sqrt_information(stamps, PATH_WHITE_SIGMA_RAD, 2 * PATH_SIGMA_RAD, gps.wander_time_s)
            still = np.zeros((layout.keyframes, 3))
            path = PATH_SIGMA_RAD * np.array([1.0, 1.0, 2.0])
            lasting = np.array([lasting_sigma(stamps, s, gps.wander_time_s) for s in path])
            whitener = np.stack([loose, loose, heading])
            priors.append(AttitudePrior(layout, coordinated, still, whitener, offsets, lasting))
    priors.append(_shared_prior(config, layout, belief, has_terrain))
    return priors


def range_prior(
    keyframes: list[Keyframe],
    layout: Layout,
    reference_enu_m: Array,
    plane: Array,
    ground_sigma_m: float,
    terrain: HeightModel | None,
) -> RangePrior | None:
    """The range finder's distances, where keyframes have any; an echo unlike the others (a roof) is left out. (5.12)

    `reference_enu_m` (3,) and `plane` (3,): the ground plane as it is known so far; `ground_sigma_m`: how the ground
    deviates from it, or from the terrain (one sigma).
    """
    having = [(i, k.nav.ground_range) for i, k in enumerate(keyframes) if k.nav.ground_range is not None]
    if not having:
        return None
    vectors = np.stack([r.vector_enu_m for _, r in having])
    own = np.array([r.sigma_m for _, r in having]) * np.abs(vectors[:, 2]) / np.linalg.norm(vectors, axis=1)
    sigma_m = np.hypot(own, ground_sigma_m)
    index = np.array([i for i, _ in having], np.intp)
    ends = np.stack([keyframes[i].centre_enu_m for i in index]) + vectors
    above, _, _ = ground_plane(ends, reference_enu_m, plane, terrain)
    if not np.all(np.isfinite(above)):  # beyond the terrain's edge
        return None
    keep = np.abs(above - np.median(above)) < ECHO_SIGMAS * sigma_m
    return RangePrior(layout, index[keep], vectors[keep], sigma_m[keep], reference_enu_m, terrain)


def _coordinated(R_body_cam: Array, stamps_s: Array, velocities: Array) -> Array | None:
    """R_enu_cam (K, 3, 3) of a vehicle that heads where it flies and banks into its turns; None while it is slow.

    Lift acts along the aircraft's own up axis, so that axis lies near acceleration plus gravity. A weak prior, (5.10),
    but one that an upside-down solution contradicts.
    """
    if len(stamps_s) < 2 or np.linalg.norm(velocities[:, :2], axis=1).min() < 3.0:
        return None
    acceleration = np.gradient(velocities, stamps_s, axis=0)
    up = acceleration + np.array([0.0, 0.0, GRAVITY_M_S2])
    down = -up / np.linalg.norm(up, axis=1, keepdims=True)
    ahead = velocities - np.sum(velocities * down, axis=1, keepdims=True) * down
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    R_enu_body = np.stack([ahead, np.cross(down, ahead), down], axis=-1)
    out: Array = R_enu_body @ R_body_cam
    return out


def _shared_prior(config: Config, layout: Layout, belief: Belief, has_terrain: bool) -> SharedPrior:
    """Boresight and time offset as estimated so far, and the ground plane's slope and height."""
    covariance = np.zeros((7, 7))
    covariance[:SHARED, :SHARED] = belief.covariance
    solve_ = config.solve
    slope = np.tan(np.radians(solve_.level_ground_sigma_deg)) if solve_.level_ground else 3.0
    height_m = 1e4
    if has_terrain:  # the plane is then what the terrain model is off by, as a whole
        slope, height_m = TERRAIN_SLOPE_SIGMA, config.terrain.sigma_datum_m + 1e-3
    covariance[4:, 4:] = np.diag([height_m**2, slope**2, slope**2])
    mean = np.zeros(7)
    mean[:SHARED] = belief.mean
    return SharedPrior(layout, mean, np.linalg.inv(np.linalg.cholesky(covariance)))
