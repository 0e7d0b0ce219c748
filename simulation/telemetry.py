"""Writes the telemetry log an autopilot would have sent of a described flight, with modelled errors.

Errors have a white part (new in every message) and a slow part (Ornstein-Uhlenbeck, shared by messages close in time).
Every packet is stamped on arrival: its boot time, plus the link's constant latency, plus a jitter that is never
negative. As in the recordings, the session's clock is boot time plus the least delay seen in the log.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.errors import InputError
from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, euler_from_matrix, exp_so3, log_so3, quaternion_from_matrix
from simulation.autopilot_errors import AutopilotErrors, ErringFilter, SlowError
from simulation.trajectory import Trajectory, axes_from_local

Array = NDArray[np.float64]

BOOT_UNIX_S = 1_790_000_000.0
FIRST_BOOT_S = 60.0  # the autopilot has been up for this long when the log begins
RATE_STEP_S = 0.01


@dataclass(frozen=True)
class TelemetrySpec:
    """Rates in Hz, errors in one sigma. `attitude_message`: "euler" (ATTITUDE), "quaternion" or "both".

    `position_age_s`: GLOBAL_POSITION_INT reports where the vehicle was this long before its stamp; `gps_age_s`
    likewise. By default the errors are those that the configuration declares; `errors` are a navigation filter's on
    top, and `simulation.ordinary` samples both as ordinary autopilots have them.
    """

    position_hz: float = 10.0
    gps_hz: float = 5.0
    attitude_hz: float = 25.0
    attitude_message: str = "euler"
    latency_s: float = 0.03
    jitter_s: float = 0.02
    position_age_s: float = 0.0
    gps_age_s: float = 0.1
    white_horizontal_m: float = 0.05
    white_vertical_m: float = 0.05
    slow_horizontal_m: float = 0.8
    slow_vertical_m: float = 1.2
    slow_time_constant_s: float = 60.0
    velocity_m_s: float = 0.1
    white_attitude_deg: float = 0.05
    slow_attitude_deg: float = 0.5
    slow_attitude_time_constant_s: float = 30.0
    errors: AutopilotErrors = field(default_factory=AutopilotErrors)

    def __post_init__(self) -> None:
        if self.attitude_message not in ("euler", "quaternion", "both"):
            raise InputError(f"attitude message {self.attitude_message!r} is not known; use euler, quaternion or both")
        if min(self.position_hz, self.gps_hz) <= 0.0 or self.attitude_hz < 0.0:
            raise InputError("telemetry: position and GPS rates must be positive, the attitude's 0 (none) or more")
        if min(self.slow_time_constant_s, self.slow_attitude_time_constant_s) <= 0.0:
            raise InputError("telemetry: time constants must be positive")


def write_tlog(
    trajectory: Trajectory, origin: LocalFrame, undulation_m: float, spec: TelemetrySpec, seed: int
) -> tuple[bytes, float]:
    """The log's bytes and the Unix time, on the log's clock, of the trajectory's time 0."""
    rng = np.random.default_rng([seed, 505])
    start, end = trajectory.start_s, trajectory.end_s
    slow_position = SlowError(rng, start, end, spec.slow_time_constant_s)
    slow_attitude = SlowError(rng, start, end, spec.slow_attitude_time_constant_s)
    filter_ = ErringFilter(spec.errors, trajectory, seed)
    scale_m = np.array([spec.slow_horizontal_m, spec.slow_horizontal_m, spec.slow_vertical_m])
    white_m = np.array([spec.white_horizontal_m, spec.white_horizontal_m, spec.white_vertical_m])
    ground_amsl_m = origin.height_m - undulation_m

    def instants(rate_hz: float) -> Array:
        # The autopilot stamps in whole milliseconds, and those are the instants its messages are for.
        return np.round(np.arange(start, end, 1.0 / rate_hz) if rate_hz > 0 else np.zeros(0), 3)

    def positions(time: Array, age_s: float, off_m: Array) -> Array:
        seen = np.clip(time - age_s, start, end)
        enu = (
            trajectory.position_enu_m(seen)
            + off_m
            + scale_m * slow_position(time)
            + white_m * rng.standard_normal((len(time), 3))
        )
        return origin.to_geodetic(enu)

    outgoing: list[tuple[float, int, mavlink.MAVLink_message]] = []

    def boot_ms(t: float) -> int:
        return round((t - start + FIRST_BOOT_S) * 1e3)

    def send(t: float, message: mavlink.MAVLink_message) -> None:
        outgoing.append((t, len(outgoing), message))

    time = instants(spec.position_hz)
    geodetic = positions(time, spec.position_age_s, filter_.position_m(time))
    seen = np.clip(time - spec.position_age_s, start, end)
    velocity = trajectory.velocity_enu_m_s(seen) + spec.velocity_m_s * rng.standard_normal((len(time), 3))
    velocity += filter_.velocity_m_s(time)
    R_local = axes_from_local(origin, geodetic[:, 0], geodetic[:, 1]).swapaxes(1, 2)
    ned = np.einsum("ij,njk,nk->ni", R_ENU_NED.T, R_local, velocity)
    heading = euler_from_matrix(filter_.attitude(time, R_ENU_NED.T @ R_local @ trajectory.R_enu_body(time)))[:, 2]
    for t, (lat, lon, height), v, yaw in zip(time, geodetic, ned, heading, strict=True):
        amsl = height - undulation_m
        send(t, mavlink.MAVLink_global_position_int_message(
            boot_ms(t), round(lat * 1e7), round(lon * 1e7), round(amsl * 1e3), round((amsl - ground_amsl_m) * 1e3),
            *(round(c * 100.0) for c in v), round(float(np.degrees(yaw)) % 360.0 * 100.0) % 36000,
        ))  # fmt: skip

    sigma_h = float(np.hypot(spec.white_horizontal_m, spec.slow_horizontal_m))
    sigma_v = float(np.hypot(spec.white_vertical_m, spec.slow_vertical_m))
    time = instants(spec.gps_hz)
    geodetic = positions(time, spec.gps_age_s, filter_.receiver_m(time))
    velocity = trajectory.velocity_enu_m_s(time)
    for t, (lat, lon, height), v in zip(time, geodetic, velocity, strict=True):
        send(t, mavlink.MAVLink_gps_raw_int_message(
            boot_ms(t) * 1000, 3, round(lat * 1e7), round(lon * 1e7), round((height - undulation_m) * 1e3), 90, 140,
            round(float(np.hypot(v[0], v[1])) * 100.0),
            round(float(np.degrees(np.arctan2(v[0], v[1]))) % 360.0 * 100) % 36000,
            14, round(height * 1e3), round(sigma_h * 1e3), round(sigma_v * 1e3), round(spec.velocity_m_s * 1e3), 0, 0,
        ))  # fmt: skip

    time = instants(spec.attitude_hz)
    if len(time):
        wrong = spec.slow_attitude_deg * slow_attitude(time) + spec.white_attitude_deg * rng.standard_normal(
            (len(time), 3)
        )
        place = origin.to_geodetic(trajectory.position_enu_m(time))
        R_local = axes_from_local(origin, place[:, 0], place[:, 1]).swapaxes(1, 2)
        R_ned_body = filter_.attitude(time, R_ENU_NED.T @ R_local @ trajectory.R_enu_body(time))
        R_ned_body = R_ned_body @ exp_so3(np.radians(wrong))
        before, after = (trajectory.R_enu_body(np.clip(time + h, start, end)) for h in (-RATE_STEP_S, RATE_STEP_S))
        rates = log_so3(before.swapaxes(1, 2) @ after) / (2.0 * RATE_STEP_S)  # a gyro's are right where attitude drifts
        angles_of, q_of = euler_from_matrix(R_ned_body), quaternion_from_matrix(R_ned_body)
        for t, angles, q, rate in zip(time, angles_of, q_of, rates.tolist(), strict=True):
            if spec.attitude_message in ("euler", "both"):
                send(t, mavlink.MAVLink_attitude_message(boot_ms(t), *(float(a) for a in angles), *rate))
            if spec.attitude_message in ("quaternion", "both"):
                send(t, mavlink.MAVLink_attitude_quaternion_message(boot_ms(t), *(float(c) for c in q), *rate))

    home = round(origin.lat_deg * 1e7), round(origin.lon_deg * 1e7), round(ground_amsl_m * 1e3)
    for t in instants(2.0):
        utc_us = round((BOOT_UNIX_S + FIRST_BOOT_S + t - start) * 1e6)
        send(t, mavlink.MAVLink_system_time_message(utc_us, boot_ms(t)))
    for t in instants(1.0):
        send(
            t,
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 217, 10, 4, 3
            ),
        )
        send(
            t,
            mavlink.MAVLink_home_position_message(
                *home, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, boot_ms(t) * 1000
            ),
        )

    outgoing.sort(key=lambda item: item[:2])
    sent = np.array([item[0] for item in outgoing])
    # One link: packets arrive in the order sent, so a late one holds up those behind it.
    arrival = np.maximum.accumulate(sent + spec.latency_s + rng.exponential(max(spec.jitter_s, 1e-9), len(sent)))
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    log = bytearray()
    boot_unix_s = BOOT_UNIX_S + FIRST_BOOT_S - start
    least = np.inf
    for t, arrived, (_, _, message) in zip(sent, arrival, outgoing, strict=True):
        stamp_us = round((boot_unix_s + arrived) * 1e6)
        log += stamp_us.to_bytes(8, "big") + message.pack(sender)
        sender.seq = (sender.seq + 1) % 256
        least = min(least, stamp_us * 1e-6 - boot_unix_s - float(t))
    return bytes(log), boot_unix_s + float(least)
