"""The camera's path by a log at evenly spaced moments, as far as it is known: where it was, how it was turned."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, log_so3, matrix_from_quaternion, mount_rotation
from onboard.config.schema import Config
from onboard.events.types import Attitude, GimbalAttitude, NavEvent, PositionFix
from onboard.navigation.attitude_interpolation import Attitudes, Orientation
from onboard.navigation.gimbal import Gimbal, MountHypothesis
from onboard.navigation.limits import PATIENCE_NS
from onboard.telemetry.telemetry_log import NS_PER_S, TelemetryLog

Array = NDArray[np.float64]

STEP_NS = 100_000_000
AHEAD_NS = 5_000_000_000  # of the moment asked for, that events are held
GRAVITY_M_S2 = 9.81
STANDING_NS, STANDING_M = 3_000_000_000, 3.0  # at its beginning, of a log that has the take-off
SLOW_M_S = 1.0  # below it a velocity shows no heading
SMOOTH_S = 1.0  # over which a path's velocity and acceleration are taken


@dataclass(frozen=True, eq=False)
class LogTrack:
    """A path sampled every `STEP_NS` from `start_ns`; what is not known is nan.

    `centre_enu_m` (N, 3); `height_m` (N,) above the take-off, or above the lowest position if that is not known;
    `R_cam_enu` (M, N, 3, 3) by every hypothesis of what carries the camera; `rate_rad_s` (M, N, 3) in camera axes.
    `has_attitude`: from a sensor, not from the path.
    """

    start_ns: int
    centre_enu_m: Array
    height_m: Array
    R_cam_enu: Array
    rate_rad_s: Array
    has_attitude: bool
    has_take_off: bool

    @property
    def end_ns(self) -> int:
        return self.start_ns + STEP_NS * (len(self.height_m) - 1)

    def with_positions(self, age_s: float) -> LogTrack:
        """The same where the positions are older by so much than they were taken to be."""
        steps = np.arange(len(self.height_m), dtype=float)
        columns = [
            np.interp(steps + age_s * NS_PER_S / STEP_NS, steps, c) for c in (*self.centre_enu_m.T, self.height_m)
        ]
        return replace(self, centre_enu_m=np.stack(columns[:3], axis=1), height_m=columns[3])

    def with_attitudes(self, late_s: float) -> LogTrack:
        """The same where the camera turns by so much later than it was taken to do."""
        place = np.clip(np.arange(len(self.height_m)) - late_s * NS_PER_S / STEP_NS, 0, len(self.height_m) - 1)
        left = np.minimum(place.astype(np.intp), max(len(self.height_m) - 2, 0))
        share = (place - left)[:, None, None]
        turned = self.R_cam_enu[:, left] * (1.0 - share) + self.R_cam_enu[:, left + 1] * share
        return replace(self, R_cam_enu=turned, rate_rad_s=_rates(turned))


def log_track(log: TelemetryLog, config: Config) -> LogTrack:
    """Sample a log; `config` states mount, gimbal and delays."""
    begin_ns, end_ns = log.span_ns
    moments_ns = np.arange(begin_ns, end_ns + 1, STEP_NS)
    centre_enu_m, height_m, has_take_off = _places(log, moments_ns + round(config.gps.latency_s * NS_PER_S))
    turned = None if config.solve.attitude == "none" else _attitudes(log, config, moments_ns)
    R_enu_body = _by_path(centre_enu_m) if turned is None else R_ENU_NED @ turned
    mount = config.mount
    R_cam_enu = np.swapaxes(R_enu_body @ mount_rotation(mount.roll_deg, mount.pitch_deg, mount.yaw_deg), -1, -2)
    rates = _rates(R_cam_enu)
    return LogTrack(begin_ns, centre_enu_m, height_m, R_cam_enu, rates, turned is not None, has_take_off)


def _places(log: TelemetryLog, moments_ns: NDArray[np.int64]) -> tuple[Array, Array, bool]:
    """(N, 3) ENU m; (N,) m above the take-off, else above the lowest position; and whether that is the take-off."""
    fixes = sorted((e for e in log.events if isinstance(e, PositionFix)), key=lambda fix: fix.stamp_ns)
    stamps_ns = np.array([fix.stamp_ns for fix in fixes])
    places = np.array([(fix.lat_deg, fix.lon_deg, fix.height_amsl_m) for fix in fixes])
    # Before its receiver has a fix an autopilot may send any place: the frame lies where most of the flight is.
    enu_m = LocalFrame(*places[len(places) // 2]).to_enu(*places.T)
    homes_m = [fix.height_above_home_m for fix in fixes]
    above_m = np.array([np.nan if home_m is None else home_m for home_m in homes_m])
    has_home = bool(np.isfinite(above_m).any())
    above_m = above_m if has_home else enu_m[:, 2] - enu_m[:, 2].min()
    first = stamps_ns - stamps_ns[0] < STANDING_NS
    stood = bool(np.ptp(enu_m[first], axis=0).max() < STANDING_M and above_m[0] < STANDING_M)
    right = np.clip(np.searchsorted(stamps_ns, moments_ns), 1, max(len(fixes) - 1, 1))
    known = stamps_ns[right % len(fixes)] - stamps_ns[right - 1] <= PATIENCE_NS
    since = (moments_ns - stamps_ns[0]).astype(float)
    columns = [np.interp(since, (stamps_ns - stamps_ns[0]).astype(float), c) for c in (*enu_m.T, above_m)]
    out = np.where(known[:, None], np.stack(columns, axis=1), np.nan)
    return out[:, :3], out[:, 3], has_home or stood


def _attitudes(log: TelemetryLog, config: Config, moments_ns: NDArray[np.int64]) -> Array | None:
    """R_ned_body (M, N, 3, 3) by every hypothesis of what carries the camera; None without any attitude."""
    vehicle = Attitudes(config.telemetry.max_attitude_gap_s)
    gimbal, uses_gimbal = Gimbal(config, vehicle), config.mount.gimbal != "never"
    events = [e for e in log.events if isinstance(e, Attitude) or (uses_gimbal and isinstance(e, GimbalAttitude))]
    events.sort(key=lambda event: event.stamp_ns)
    found: list[dict[MountHypothesis, Array]] = []
    fed = 0
    for moment_ns in moments_ns.tolist():
        while fed < len(events) and events[fed].stamp_ns <= moment_ns + AHEAD_NS:
            _insert(events[fed], vehicle, gimbal)
            fed += 1
        found.append(_by_hypothesis(gimbal, vehicle, moment_ns))
    hypotheses = sorted({h for each in found for h in each}, key=list(MountHypothesis).index)
    if not hypotheses:
        return None
    unknown = np.full((3, 3), np.nan)
    return np.array([[each.get(h, unknown) for each in found] for h in hypotheses])


def _insert(event: NavEvent, vehicle: Attitudes, gimbal: Gimbal) -> None:
    match event:
        case Attitude():
            rate = None if event.rate_body_rad_s is None else np.array(event.rate_body_rad_s)
            vehicle.insert(event.stamp_ns, Orientation(matrix_from_quaternion(event.q_ned_body), rate))
        case GimbalAttitude():
            gimbal.insert(event)


def _by_hypothesis(gimbal: Gimbal, vehicle: Attitudes, moment_ns: int) -> dict[MountHypothesis, Array]:
    """R_ned_body by all that the camera may be carried by."""
    if several := gimbal.open_at(moment_ns):
        return several
    is_mount = not gimbal.attitudes.stamps_ns or (bool(vehicle.stamps_ns) and not gimbal.is_certain)
    hypothesis = MountHypothesis.MOUNT if is_mount else MountHypothesis.GIMBAL
    R_ned_body = gimbal.at(moment_ns, hypothesis)
    return {} if isinstance(R_ned_body, Status) else {hypothesis: R_ned_body}


def _rates(R_cam_enu: Array) -> Array:
    """(M, N, 3) of attitudes (M, N, 3, 3), by their neighbours."""
    out = np.full(R_cam_enu.shape[:-1], np.nan)
    if R_cam_enu.shape[1] > 2:
        turns = R_cam_enu[:, 2:] @ np.swapaxes(R_cam_enu[:, :-2], -1, -2)
        known = np.isfinite(turns).all(axis=(-1, -2))
        middle = out[:, 1:-1]
        middle[known] = -log_so3(turns[known]) / (2e-9 * STEP_NS)
    return out


def _by_path(centre_enu_m: Array) -> Array:
    """R_enu_body (2, N, 3, 3) of a vehicle that heads where it flies: it banks into its turns (5.10), or what carries
    the camera stays level; nan while slow.
    """
    reach = round(SMOOTH_S * NS_PER_S / STEP_NS / 2)
    velocity, acceleration = np.full_like(centre_enu_m, np.nan), np.full_like(centre_enu_m, np.nan)
    span_s = 2e-9 * reach * STEP_NS
    velocity[reach:-reach] = (centre_enu_m[2 * reach :] - centre_enu_m[: -2 * reach]) / span_s
    acceleration[reach:-reach] = (velocity[2 * reach :] - velocity[: -2 * reach]) / span_s
    velocity[np.hypot(velocity[:, 0], velocity[:, 1]) < SLOW_M_S] = np.nan
    gravity = np.array([0.0, 0.0, GRAVITY_M_S2])
    down = np.stack([-(acceleration + gravity), np.broadcast_to(-gravity, acceleration.shape)])
    down /= np.linalg.norm(down, axis=-1, keepdims=True)
    ahead = velocity - np.sum(velocity * down, axis=-1, keepdims=True) * down
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    return np.stack([ahead, np.cross(down, ahead), down], axis=-1)
