"""Configuration and navigation -> the window's residuals: which sensors take part, and with what covariance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from onboard.config.schema import Config
from onboard.estimation.boresight import PlatformEstimate
from onboard.estimation.factors import (
    AttitudePrior,
    Layout,
    Parts,
    PositionPrior,
    Prior,
    RangePrior,
    SharedPrior,
    VelocityPrior,
    gauss_markov_covariance,
    gauss_markov_sqrt_information,
    ground_plane,
    persistent_sigma,
    whitener_of,
)
from onboard.estimation.ground_slope import NO_SLOPE_PRIOR, SlopePrior
from onboard.estimation.keyframe import Keyframe, with_attitude
from onboard.estimation.platform_states import DELAY, VELOCITY_DELAY
from onboard.estimation.sensor_table import BY_NAME, POSITION, declared
from onboard.estimation.variance_components import VarianceFactors
from onboard.geometry.robust import OUTLIER_SIGMAS
from onboard.geometry.terrain_grid import Terrain
from onboard.navigation.navigator import NavState
from onboard.navigation.position_interpolation import Displacement
from onboard.navigation.position_slip import DYNAMIC_TIME_S

Array = NDArray[np.float64]

# One sigma of an aircraft without attitude sensor about flying level along its path in a coordinated turn.
PATH_SIGMA_RAD = 0.25
PATH_WHITE_SIGMA_RAD = 0.15
GRAVITY_M_S2 = 9.81
UNKNOWN_M = 1e5  # one sigma of a displacement of which nothing is known
UNKNOWN_RAD = 1e3  # and of an attitude
TERRAIN_SLOPE_SIGMA = 0.005  # of an elevation model over a window's few hundred metres: neighbours are off together


@dataclass(frozen=True, eq=False)
class Sensors:
    """The sensors' measurements at a window's K keyframes, and the weights of their residuals.

    `jitter_s`: one sigma of each picture's own stamp: white error wherever the vehicle moves or turns. (5.11)
    """

    config: Config
    R_body_cam: Array
    keyframes: Sequence[Keyframe]
    layout: Layout
    factors: VarianceFactors
    jitter_s: float

    def priors(self, platform: PlatformEstimate, has_terrain: bool, slope: SlopePrior | None = None) -> list[Prior]:
        """All residuals over the camera side that the configuration asks for and the keyframes have data for.

        `has_terrain`: the plane among the shared states is then the terrain model's own error, not the ground itself.
        `slope`: the prior of the ground's; None: level as configured.
        """
        shared = shared_prior(self.config, self.layout, platform, has_terrain, slope)
        return [_position(self), *_velocity(self), *_attitude(self), shared]

    @cached_property
    def stamps_s(self) -> Array:
        """(K,) from the first on."""
        return _stamps_s(self.keyframes)

    @cached_property
    def velocities_enu_m_s(self) -> Array:
        """(K, 3): measured, else by the positions; zero where nothing is known."""
        return _velocities(self.keyframes)

    @cached_property
    def lever_cam_m(self) -> Array:
        """The lever arm (3,) from the autopilot's reference point to the camera, camera axes."""
        out: Array = self.R_body_cam.T @ np.array(self.config.mount.lever_arm_m)
        return out

    @cached_property
    def dynamic_m_s(self) -> Array:
        """One sigma (K,) of the velocity's error that comes of acceleration: a filter's delays, times it. (5.16)

        It lasts for as long as the filter takes to forget it, so what counts is the largest of the last seconds.
        """
        changes = np.linalg.norm(np.diff(self.velocities_enu_m_s, axis=0), axis=1)
        about = np.where(self._are_about, changes / np.maximum(np.diff(self.stamps_s), 0.05), 0.0)
        out: Array = self.config.gps.sigma_latency_s * about.max(axis=1, initial=0.0)
        return out

    def turning_rad(self, yaw_rates_rad_s: Array) -> Array:
        """One sigma (K,) of the heading's error that comes of turns: a filter's delays, times the rate of its course.

        A filter that takes its heading from a late velocity's direction turns late; one that stands has none. (5.23)
        """
        (east, north, _), seconds = self.velocities_enu_m_s.T, np.diff(self.stamps_s)
        across = east[:-1] * north[1:] - north[:-1] * east[1:]
        course_rad = np.arctan2(across, east[:-1] * east[1:] + north[:-1] * north[1:])
        yaw_rad = 0.5 * (yaw_rates_rad_s[1:] + yaw_rates_rad_s[:-1]) * seconds
        turned_rad = np.minimum(*(np.abs(self._are_about @ angle_rad) for angle_rad in (course_rad, yaw_rad)))
        return self.config.gps.sigma_latency_s * turned_rad / np.maximum(self._are_about @ seconds, 0.05)

    @cached_property
    def _are_about(self) -> NDArray[np.bool_]:
        """A mask (K, K - 1) of the intervals that end within a filter's memory before or after each keyframe."""
        return np.abs(self.stamps_s[1:] - self.stamps_s[:, None]) <= DYNAMIC_TIME_S

    def errors(
        self, sensors: Iterable[str], slow: Iterable[Array], white: Iterable[Array], fixed: Iterable[Array]
    ) -> tuple[Array, Parts]:
        """Whiteners (3, n, n) of a residual's errors and their estimated parts, (5.5), axis by axis.

        Given are, for each axis, the sensor, the two parts of its covariance (n, n) as declared, and what else it has.
        Each part counts by its estimated variance; all of it by the sensor's group, which shows nothing of its parts
        while it fails.
        """
        whole, parts = [], []
        for name, Q_slow, Q_white, Q_fixed in zip(sensors, slow, white, fixed, strict=True):
            declared_parts = {name: Q_slow, BY_NAME[name].white: Q_white}
            estimated = {part: self.factors.of(part) * Q for part, Q in declared_parts.items()}
            failing = self.factors.group_sigma(name)
            whole.append(failing**2 * sum(estimated.values(), Q_fixed))
            parts.append(estimated if failing == 1.0 else {})
        return whitener_of(np.stack(whole)), tuple(parts)


def _stamps_s(keyframes: Sequence[Keyframe]) -> Array:
    stamps_ns = np.array([k.nav.stamp_ns for k in keyframes], np.int64)
    out: Array = (stamps_ns - stamps_ns[0]) / 1e9
    return out


def _velocities(keyframes: Sequence[Keyframe]) -> Array:
    return np.stack([k.nav.motion_enu_m_s for k in keyframes])


def _fading(stamps_s: Array, sigma: Array) -> Array:
    """Covariance (N, N) of errors of one sigma each (N,), which a filter forgets. (5.16), (5.23)"""
    return np.outer(sigma, sigma) * gauss_markov_covariance(stamps_s, 1.0, DYNAMIC_TIME_S)


def _independent(variance: Array) -> Array:
    """Covariances (3, N, N) of independent errors with these variances (N, 3)."""
    return variance.T[:, :, None] * np.eye(len(variance))


def _claims_m(navs: Sequence[NavState]) -> tuple[Array, Array]:
    """One sigma of positions: the largest Gauss-Markov part (3,), and the white part (3, N)."""
    slow_m = np.array([(n.sigma_horizontal_m, n.sigma_horizontal_m, n.sigma_vertical_m) for n in navs])
    return slow_m.max(axis=0), np.outer([1.0, 1.0, 1.5], [n.sigma_white_m for n in navs])


def travelled_sigma_m(config: Config, one: NavState, other: NavState) -> Array:
    """One sigma (3,), ENU m, of the way between two positions: what their errors do not have in common. (7.3)"""
    if one.stretch != other.stretch:
        return np.full(3, UNKNOWN_M)
    navs, gps = (one, other), config.gps
    slow_m, white_m = _claims_m(navs)
    forgotten = 1.0 - np.exp(-abs(other.stamp_ns - one.stamp_ns) / 1e9 / gps.correlation_time_s)
    between_m = np.stack([n.joined.between_m for n in navs])
    faster = other.motion_enu_m_s - one.motion_enu_m_s
    late_m = faster * np.hypot(gps.sigma_latency_s, config.camera.sigma_latency_s)
    squares = 2.0 * forgotten * slow_m**2 + np.sum(white_m.T**2 + between_m**2, axis=0) + late_m**2
    out: Array = np.sqrt(squares)
    return out


def _position(m: Sensors) -> PositionPrior:
    stamps, navs, time_s = m.stamps_s, [k.nav for k in m.keyframes], m.config.gps.correlation_time_s
    (slow_m, white_m), datum_m = _claims_m(navs), max(n.sigma_datum_m for n in navs)
    white = shared_fixes([n.joined.weights for n in navs]) * (white_m[:, :, None] * white_m[:, None])
    between_m = np.stack([n.joined.between_m for n in navs])
    fixed = _independent((m.jitter_s * m.velocities_enu_m_s) ** 2 + between_m**2)
    fixed += _fading(stamps, 0.5 * DYNAMIC_TIME_S * m.dynamic_m_s)
    fixed[2] += datum_m**2
    slow = gauss_markov_covariance(stamps, slow_m[:, None, None], time_s)
    whitener, parts = m.errors(PositionPrior.sensors, slow, white, fixed)
    persistent = persistent_sigma(stamps, slow_m * m.factors.slow_sigma(POSITION), time_s)
    return PositionPrior(
        m.layout,
        np.stack([n.position_enu_m for n in navs]),
        m.velocities_enu_m_s,
        whitener,
        np.array([k.nav_offset_s + k.nav_delay_s for k in m.keyframes]),
        np.hypot(persistent, [0.0, 0.0, datum_m]),
        parts,
        m.lever_cam_m,
    )


def velocity_sigma_m_s(config: Config, keyframes: Sequence[Keyframe]) -> float:
    """One sigma of the velocity's Gauss-Markov error as declared: no less than receiver or filter claim."""
    return max(config.gps.sigma_velocity_correlated_m_s, *(k.nav.sigma_velocity_m_s for k in keyframes))


def _velocity(m: Sensors) -> list[Prior]:
    """Displacements by integrated velocity, whose error is white from interval to interval and Gauss-Markov. (5.6)"""
    gps, later = m.config.gps, m.keyframes[1:]
    displacement = [k.displacement for k in later]
    known = np.array([d is not None for d in displacement], bool)
    if not m.config.solve.velocity or not known.any():
        return []
    stamps, velocities = m.stamps_s, m.velocities_enu_m_s
    speed = np.linalg.norm(velocities, axis=1)
    dt = np.maximum(np.diff(stamps), 0.05)
    middle = 0.5 * (stamps[1:] + stamps[:-1])
    # The white error lasts about a second: over longer intervals it averages.
    white = np.diag(gps.sigma_velocity_m_s**2 * dt * np.minimum(dt, 1.0))
    slow_m = dt * velocity_sigma_m_s(m.config, m.keyframes)
    slow = np.outer(slow_m, slow_m) * gauss_markov_covariance(middle, 1.0, gps.velocity_correlation_time_s)
    # An interval over a gap of the telemetry shows nothing; those about it do.
    unknown = np.where(known, (m.jitter_s * np.hypot(speed[1:], speed[:-1])) ** 2, UNKNOWN_M**2)
    turning = _fading(middle, dt * np.maximum(m.dynamic_m_s[1:], m.dynamic_m_s[:-1]))
    fixed = between_covariance(displacement) + np.diag(unknown) + turning
    whitener, parts = m.errors(VelocityPrior.sensors, [slow] * 3, [white] * 3, fixed)
    return [
        VelocityPrior(
            m.layout,
            np.array([np.zeros(3) if d is None else d.enu_m for d in displacement]),
            np.diff(velocities, axis=0),
            whitener,
            np.array([k.nav_offset_s for k in later]),
            parts=parts,
            lever_cam_m=m.lever_cam_m,
        )
    ]


def shared_fixes(weights: Sequence[Mapping[int, float]]) -> Array:
    """Correlation (K, K) of positions' white errors: pictures between the same positions have their errors. (5.19)"""
    fixes = sorted({stamp_ns for w in weights for stamp_ns in w})
    by_fix = np.array([[w.get(stamp_ns, 0.0) for stamp_ns in fixes] for w in weights])
    out: Array = by_fix @ by_fix.T
    np.fill_diagonal(out, 1.0)
    return out


def between_covariance(displacement: Sequence[Displacement | None]) -> Array:
    """Covariance (3, n, n) of distances travelled by what velocity did between positions: gap by gap. (5.20)"""
    between_m = [{} if d is None else d.between_m for d in displacement]
    gaps = sorted({stamp_ns for b in between_m for stamp_ns in b})
    by_gap = np.array([[b.get(stamp_ns, np.zeros(3)) for stamp_ns in gaps] for b in between_m])
    by_gap = by_gap.reshape(len(between_m), len(gaps), 3)
    out: Array = np.einsum("iga,jga->aij", by_gap, by_gap)
    return out


def _attitude(m: Sensors) -> list[Prior]:
    """The autopilot's, (5.7), or where no keyframe has any what the path shows of it, (5.10).

    A keyframe in a gap of the attitudes shows nothing; those about it do.
    """
    config, keyframes, stamps = m.config, m.keyframes, m.stamps_s
    offsets = np.array([k.nav_offset_s for k in keyframes])
    known = with_attitude(keyframes)
    if not known.any():
        R_enu_cam = coordinated_turn(m.R_body_cam, keyframes)
        if R_enu_cam is None:
            return []
        sigma, time_s = PATH_SIGMA_RAD * np.array([1.0, 1.0, 2.0]), config.gps.correlation_time_s
        whitener = gauss_markov_sqrt_information(stamps, PATH_WHITE_SIGMA_RAD, sigma[:, None, None], time_s)
        still, persistent = np.zeros((len(stamps), 3)), persistent_sigma(stamps, sigma, time_s)
        return [AttitudePrior(m.layout, R_enu_cam, still, whitener, offsets, persistent)]
    R_cam_body = m.R_body_cam.T
    R_enu_body = np.stack([k.R_cam_enu.T @ R_cam_body if (R := k.nav.R_enu_body) is None else R for k in keyframes])
    R_enu_cam = R_enu_body @ m.R_body_cam
    rates = np.stack([k.body_rate_rad_s for k in keyframes]) @ m.R_body_cam
    turning = np.einsum("kij,kj->ki", R_enu_cam, rates)
    between = np.where(known, [k.nav.attitude_sigma_rad for k in keyframes], UNKNOWN_RAD)
    # A gimbal's yaw that counts from nowhere is off by one angle, a state of each window. (5.18)
    zero = np.array([k.nav.yaw_sigma_rad for k in keyframes])
    fixed = _independent(between[:, None] ** 2 + (m.jitter_s * turning) ** 2)
    fixed[2] += _fading(stamps, m.turning_rad(turning[:, 2])) + np.outer(zero, zero)
    time_s = config.solve.attitude_correlation_time_s
    slow = [gauss_markov_covariance(stamps, declared(config, name), time_s) for name in AttitudePrior.sensors]
    white = [declared(config, BY_NAME[name].white) ** 2 * np.eye(len(stamps)) for name in AttitudePrior.sensors]
    whitener, parts = m.errors(AttitudePrior.sensors, slow, white, fixed)
    persistent = persistent_sigma(stamps, attitude_sigma_rad(config, m.factors), time_s)
    persistent = np.hypot(persistent, [0.0, 0.0, zero[known].mean()])
    by_heading = cosine_sine_of_heading(R_enu_body)
    return [AttitudePrior(m.layout, R_enu_cam, rates, whitener, offsets, persistent, parts, by_heading)]


def cosine_sine_of_heading(R_enu_body: Array) -> Array:
    """(..., 2) of attitudes (..., 3, 3), heading counted from north; of the direction of the nose's projection."""
    nose = R_enu_body[..., 1::-1, 0]
    out: Array = nose / np.maximum(np.linalg.norm(nose, axis=-1, keepdims=True), 1e-9)
    return out


def attitude_sigma_rad(config: Config, factors: VarianceFactors) -> Array:
    """One sigma (3,) of the attitude's Gauss-Markov part about east, north, up, as estimated so far."""
    return np.array([declared(config, name) * factors.slow_sigma(name) for name in AttitudePrior.sensors])


def range_prior(
    keyframes: list[Keyframe],
    layout: Layout,
    reference_enu_m: Array,
    plane: Array,
    ground_sigma_m: float,
    terrain: Terrain | None,
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
    keep = np.abs(above - np.median(above)) < OUTLIER_SIGMAS * sigma_m
    return RangePrior(layout, index[keep], vectors[keep], sigma_m[keep], reference_enu_m, terrain)


def coordinated_turn(R_body_cam: Array, keyframes: Sequence[Keyframe]) -> Array | None:
    """R_enu_cam (K, 3, 3) of a vehicle that heads where it flies and banks into its turns; None while it is slow.

    Lift acts along the aircraft's own up axis, so that axis lies near acceleration plus gravity. A weak prior, (5.10),
    but one that an upside-down solution contradicts.
    """
    stamps_s, velocities = _stamps_s(keyframes), _velocities(keyframes)
    if len(keyframes) < 2 or np.linalg.norm(velocities[:, :2], axis=1).min() < 3.0:
        return None
    acceleration = np.gradient(velocities, stamps_s, axis=0)
    up = acceleration + np.array([0.0, 0.0, GRAVITY_M_S2])
    down = -up / np.linalg.norm(up, axis=1, keepdims=True)
    ahead = velocities - np.sum(velocities * down, axis=1, keepdims=True) * down
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    R_enu_body = np.stack([ahead, np.cross(down, ahead), down], axis=-1)
    return R_enu_body @ R_body_cam


def with_delays_held_open(config: Config, platform: PlatformEstimate) -> PlatformEstimate:
    """The same estimate with both delays at least as uncertain as declared.

    What turns show of a filter's delays is not all of them: inertial sensors keep turns in time. (5.15)
    """
    covariance, delays = platform.covariance.copy(), [DELAY, VELOCITY_DELAY]
    covariance[delays, delays] = np.maximum(covariance[delays, delays], config.gps.sigma_latency_s**2)
    return replace(platform, covariance=covariance)


def level_sigma(config: Config) -> float:
    """One sigma of the ground's slope (its tangent) where nothing is known of it."""
    solve_ = config.solve
    return float(np.tan(np.radians(solve_.level_ground_sigma_deg))) if solve_.level_ground else NO_SLOPE_PRIOR


def shared_prior(
    config: Config, layout: Layout, platform: PlatformEstimate, has_terrain: bool, slope: SlopePrior | None = None
) -> SharedPrior:
    """Boresight and time offset as estimated so far, and the ground plane's slope and height."""
    height_m = 1e4
    if slope is None:
        slope = SlopePrior(covariance=level_sigma(config) ** 2 * np.eye(2))
    if has_terrain:  # the plane is then what the terrain model is off by, as a whole
        slope, height_m = SlopePrior(covariance=TERRAIN_SLOPE_SIGMA**2 * np.eye(2)), config.terrain.sigma_datum_m + 1e-3
    held_open = with_delays_held_open(config, platform).covariance
    whitener = block_diag(whitener_of(held_open), 1.0 / height_m, slope.whitener)
    return SharedPrior(layout, np.concatenate([platform.mean, [0.0], slope.mean]), whitener)
