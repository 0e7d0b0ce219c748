"""PX4's own log (.ulg) -> events: vehicle_global_position (its velocity from vehicle_local_position), vehicle_attitude,
vehicle_gps_position, estimator_status, gimbal_device_attitude_status and distance_sensor, in the roles of the MAVLink
messages that PX4 makes of them. Read by pyulog.
"""

from __future__ import annotations

import contextlib
import io
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.errors import InputError
from onboard.clocks.boot_clock import Mode
from onboard.events.types import (
    Attitude,
    FilterStatus,
    GimbalAttitude,
    GpsQuality,
    Home,
    NavEvent,
    PositionFix,
    RangeFinder,
)
from onboard.telemetry.gps_time import GpsClock, receiver_lag_s
from onboard.telemetry.mavlink_events import AT_REST, FROZEN_GPS_NS, GIMBAL_UNFIT, sensor_direction
from onboard.telemetry.telemetry_log import TelemetryLog, interpolated

Array = NDArray[np.float64]

MAGIC = b"ULog\x01\x12\x35"
TOPICS = [
    "vehicle_global_position",
    "vehicle_local_position",
    "vehicle_attitude",
    "vehicle_angular_velocity",
    "sensor_combined",
    "vehicle_gps_position",
    "sensor_gps",
    "estimator_status",
    "estimator_selector_status",
    "gimbal_device_attitude_status",
    "distance_sensor",
    "home_position",
    "camera_capture",
    "camera_trigger",
]
FIX = 3
REPORT_US = 200_000
MOST_UTC_US = 2**63 / 1000  # beyond which nanoseconds have no room in 64 bits: of a damaged log


class _Topic:
    """One topic's columns by name, sorted by time."""

    def __init__(self, data: dict[str, Any] | None) -> None:
        data = data or {"timestamp": np.zeros(0)}
        stamps = np.asarray(data["timestamp"], np.int64)
        sampled = np.asarray(data.get("timestamp_sample", np.zeros(len(stamps))), np.int64)
        # The time for which it holds, where the log states it.
        boot_us = np.where(sampled > 0, np.minimum(sampled, stamps), stamps)
        order = np.argsort(boot_us, kind="stable")
        self.boot_us: NDArray[np.int64] = boot_us[order]
        self._columns = {name: np.asarray(column)[order] for name, column in data.items()}

    def __len__(self) -> int:
        return len(self.boot_us)

    def is_whole(self, name: str) -> bool:
        return name in self._columns and bool(np.issubdtype(self._columns[name].dtype, np.integer))

    def column(self, *names: str, scales: tuple[float, ...] = (), unknown: float = math.nan) -> Array:
        """The first of these columns that there is, times its scale; `unknown` where there is none."""
        for index, name in enumerate(names):
            if name in self._columns:
                scale = scales[index] if scales else 1.0
                return self._columns[name].astype(float) * scale
        return np.full(len(self), unknown)

    def columns(self, *names: str) -> Array:
        """(N, F)"""
        return np.stack([self.column(name) for name in names], axis=-1)

    def at(self, boot_us: NDArray[np.int64], values: Array) -> Array:
        """`values` (N, F) of this topic interpolated at other times; nan past the ends and within gaps."""
        return interpolated(self.boot_us, values, boot_us)


def read_ulog(path: Path | str, clock: Mode = "auto", boot_unix_s: float | None = None) -> TelemetryLog:
    """Read a whole log, stamped on Unix time by the receiver's. A cut end is passed over.

    `boot_unix_s` is the Unix time (s) at the autopilot's boot, for a log without UTC, as PX4's simulator writes it.
    Raises InputError, one line, for a file that is no log, or has no position, or has no UTC without `boot_unix_s` or
    UTC with it, and where pyulog is missing.
    """
    topics = _topics(path)
    gps = topics["vehicle_gps_position"]
    gps = gps if len(gps) else topics["sensor_gps"]
    utc_us = gps.column("time_utc_usec", unknown=0.0)
    fixed = (utc_us > 0) & (utc_us < MOST_UTC_US) & (gps.column("fix_type", unknown=0.0) >= FIX)
    gps_clock = GpsClock(clock)
    for boot_us, unix_us in zip(gps.boot_us[fixed].tolist(), utc_us[fixed].tolist(), strict=True):
        gps_clock.add(boot_us * 1000, int(unix_us) * 1000)
    if gps_clock.is_set and boot_unix_s is not None:
        raise InputError(f"telemetry {path}: has UTC (vehicle_gps_position); leave --time-offset out")
    if gps_clock.is_set:
        gps_clock.lag_s = _lag_s(gps, fixed, utc_us, topics["vehicle_global_position"], gps_clock)
    elif boot_unix_s is not None:
        gps_clock.add(0, round(boot_unix_s * 1e9))
    else:
        raise InputError(
            f"telemetry {path}: no UTC in it (vehicle_gps_position); give the Unix time at its boot, --time-offset S, "
            "or --time-offset 0 where the pictures' stamps count from the boot too"
        )
    events: list[NavEvent] = [
        *_positions(topics, gps, gps_clock),
        *_attitudes(topics, gps_clock),
        *_qualities(gps, gps_clock),
        *_filter_statuses(topics["estimator_status"], topics["vehicle_local_position"], gps_clock),
        *_gimbal(topics["gimbal_device_attitude_status"], gps_clock),
        *_ranges(topics["distance_sensor"], gps_clock),
        *_homes(topics["home_position"], gps_clock),
    ]
    if not any(isinstance(event, PositionFix) for event in events):
        raise InputError(
            f"telemetry {path}: no position in it (vehicle_global_position, or vehicle_gps_position with a 3D fix)"
        )
    return replace(TelemetryLog.by_stamp(events, gps_clock.segments), shots_ns=_shots(topics, gps_clock))


def _topics(path: Path | str) -> dict[str, _Topic]:
    try:
        from pyulog import ULog  # noqa: PLC0415  an extra
    except ModuleNotFoundError as error:
        raise InputError(
            f"telemetry {path}: PX4's logs are read by pyulog, which is not installed: pip install pyulog"
        ) from error
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            log = ULog(str(path), TOPICS)
        except Exception as error:  # the library raises whatever its structures run into
            why = " ".join(str(error).split()) or type(error).__name__
            raise InputError(f"telemetry {path}: not a PX4 log that can be read ({why})") from error
    by_name: dict[str, dict[int, Any]] = {}
    for dataset in log.data_list:
        by_name.setdefault(dataset.name, {})[dataset.multi_id] = dataset.data
    chosen = by_name.get("estimator_selector_status", {}).get(0)
    primary = int(chosen["primary_instance"][-1]) if chosen and len(chosen.get("primary_instance", ())) else 0
    wanted = {name: primary if name == "estimator_status" else 0 for name in TOPICS}
    return {name: _Topic(by_name.get(name, {}).get(instance)) for name, instance in wanted.items()}


def _place(topic: _Topic) -> tuple[Array, Array, Array]:
    """Latitude, longitude (degrees) and height above sea level (m), by whichever names and units the log has."""
    whole = topic.is_whole("lat")
    degrees, metres = (1e-7, 1e-3) if whole else (1.0, 1.0)
    return (
        topic.column("latitude_deg", "lat", scales=(1.0, degrees)),
        topic.column("longitude_deg", "lon", scales=(1.0, degrees)),
        topic.column("altitude_msl_m", "alt", scales=(1.0, metres)),
    )


def _lag_s(gps: _Topic, fixed: NDArray[np.bool_], utc_us: Array, filtered: _Topic, clock: GpsClock) -> float:
    """The receiver's delay, by its track against the filter's, with the least delayed report as time so far."""
    unix_ns = (utc_us[fixed] * 1000).astype(np.int64).tolist()
    places, by_filter = (np.stack(_place(topic)[:2], -1) for topic in (gps, filtered))
    return receiver_lag_s(clock, gps.boot_us[fixed], unix_ns, places[fixed], (filtered.boot_us, by_filter))


def _positions(topics: dict[str, _Topic], gps: _Topic, clock: GpsClock) -> list[NavEvent]:
    local, position = topics["vehicle_local_position"], topics["vehicle_global_position"]
    velocity = local.columns("vx", "vy", "vz")
    velocity[(local.column("v_xy_valid", unknown=1.0) == 0) | (local.column("v_z_valid", unknown=1.0) == 0)] = np.nan
    velocity = local.at(position.boot_us, velocity)
    if not len(local):  # logs before 2020 have it here
        velocity = position.columns("vel_n", "vel_e", "vel_d")
    valid = (position.column("lat_lon_valid", unknown=1.0) != 0) & (position.column("alt_valid", unknown=1.0) != 0)
    delay_ns = 0
    if not len(position):
        position, velocity = gps, _receiver_velocity(gps)
        valid = gps.column("fix_type", unknown=0.0) >= FIX
        delay_ns = round(clock.lag_s * 1e9)
    homes = topics["home_position"]
    home_m = homes.column("alt")[homes.column("valid_alt", unknown=1.0) != 0]
    ground_m = float(home_m[0]) if len(home_m) else math.nan
    out: list[NavEvent] = []
    for us, place, v, is_valid in zip(
        position.boot_us.tolist(), np.stack(_place(position), -1).tolist(), velocity.tolist(), valid, strict=True
    ):
        fix = _fix(clock.to_unix_ns(us * 1000) - delay_ns, place, v, ground_m) if is_valid else None
        if fix is not None:
            out.append(fix)
    return out


def _receiver_velocity(gps: _Topic) -> Array:
    velocity = gps.columns("vel_n_m_s", "vel_e_m_s", "vel_d_m_s")
    velocity[gps.column("vel_ned_valid", unknown=1.0) == 0] = np.nan
    return velocity


def _fix(stamp_ns: int, place: list[float], v: list[float], ground_m: float) -> PositionFix | None:
    """A position, if it is one: 0, 0 is what is logged for nowhere."""
    is_place = (place[0], place[1]) != (0.0, 0.0) and abs(place[0]) <= 90 and abs(place[1]) <= 180
    if not is_place or not math.isfinite(place[2]):
        return None
    above_m = place[2] - ground_m
    velocity = (v[0], v[1], v[2]) if math.isfinite(sum(v)) else None
    return PositionFix(stamp_ns, place[0], place[1], place[2], velocity, above_m if math.isfinite(above_m) else None)


def _attitudes(topics: dict[str, _Topic], clock: GpsClock) -> list[NavEvent]:
    attitude, rates, raw = (topics[k] for k in ("vehicle_attitude", "vehicle_angular_velocity", "sensor_combined"))
    if len(rates):
        rate = rates.at(attitude.boot_us, rates.columns("xyz[0]", "xyz[1]", "xyz[2]"))
    elif len(raw):
        rate = raw.at(attitude.boot_us, raw.columns("gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"))
    else:
        rate = attitude.columns("rollspeed", "pitchspeed", "yawspeed")
    out: list[NavEvent] = []
    for us, q, body in zip(attitude.boot_us.tolist(), _unit(attitude), rate.tolist(), strict=True):
        if q is not None:
            known = (body[0], body[1], body[2]) if math.isfinite(sum(body)) else None
            out.append(Attitude(clock.to_unix_ns(us * 1000), q, known))
    return out


def _unit(topic: _Topic) -> list[tuple[float, float, float, float] | None]:
    """Its quaternions, of length one; None where they are none."""
    out: list[tuple[float, float, float, float] | None] = []
    for w, x, y, z in topic.columns("q[0]", "q[1]", "q[2]", "q[3]").tolist():
        norm = math.hypot(w, x, y, z)
        out.append((w / norm, x / norm, y / norm, z / norm) if 0.5 < norm < 2.0 else None)
    return out


def _qualities(gps: _Topic, clock: GpsClock) -> list[NavEvent]:
    ellipsoid = gps.column("altitude_ellipsoid_m", "alt_ellipsoid", scales=(1.0, 1e-3))
    undulation = ellipsoid - _place(gps)[2]
    undulation[(ellipsoid == 0.0) | (np.abs(undulation) > 150.0)] = np.nan
    sigmas = gps.columns("eph", "epv", "s_variance_m_s")
    satellites = gps.column("satellites_used")
    utc_us, fix_types = gps.column("time_utc_usec", unknown=0.0), gps.column("fix_type", unknown=0.0)
    places, velocities = np.stack(_place(gps), -1).tolist(), _receiver_velocity(gps).tolist()
    out: list[NavEvent] = []
    moved_us, last_us = 0, math.nan
    for i, us in enumerate(gps.boot_us.tolist()):
        is_new = bool(utc_us[i] != last_us or utc_us[i] == 0)
        if is_new:
            moved_us, last_us = us, utc_us[i]
        fix_type = 0 if us - moved_us > FROZEN_GPS_NS // 1000 else int(fix_types[i])
        claims = [float(s) if math.isfinite(s) and s > 0.0 else None for s in sigmas[i]]
        known = fix_type >= FIX and math.isfinite(undulation[i])
        count = int(satellites[i]) if math.isfinite(satellites[i]) else None
        stamp_ns = clock.to_unix_ns(us * 1000)
        is_fix = is_new and fix_type >= FIX
        fix = _fix(stamp_ns - round(clock.lag_s * 1e9), places[i], velocities[i], math.nan) if is_fix else None
        quality = GpsQuality(stamp_ns, fix_type, count, claims[0], claims[1], claims[2], fix=fix)
        out.append(replace(quality, undulation_m=float(undulation[i])) if known else quality)
    return out


def _filter_statuses(topic: _Topic, local: _Topic, clock: GpsClock) -> list[NavEvent]:
    claims = local.at(topic.boot_us, local.columns("evh", "evv")).max(axis=1)
    out: list[NavEvent] = []
    reported, reported_us = -1, 0
    flags_of = topic.column("solution_status_flags").tolist()
    for us, value, claim in zip(topic.boot_us.tolist(), flags_of, claims.tolist(), strict=True):
        if not math.isfinite(value):
            continue
        flags = int(value)
        if flags == reported and us - reported_us < REPORT_US:
            continue
        reported, reported_us = flags, us
        has_position = bool(flags & mavlink.ESTIMATOR_POS_HORIZ_ABS)
        is_held = bool(flags & mavlink.ESTIMATOR_CONST_POS_MODE)
        # PX4 holds the position whenever it stands still, with GNSS fused and position and velocity good.
        is_at_rest = is_held and flags & AT_REST == AT_REST
        out.append(
            FilterStatus(
                clock.to_unix_ns(us * 1000),
                has_position and (not is_held or is_at_rest),
                bool(flags & mavlink.ESTIMATOR_GPS_GLITCH),
                is_at_rest,
                claim if math.isfinite(claim) and claim > 0.0 else None,
            )
        )
    return out


def _shots(topics: dict[str, _Topic], clock: GpsClock) -> tuple[int, ...]:
    """Return when pictures were taken, Unix ns: as the camera reported, else as it was triggered."""
    reported, triggered = topics["camera_capture"], topics["camera_trigger"]
    taken = reported.column("result", unknown=1.0) > 0
    boot_us = reported.boot_us[taken] if taken.any() else triggered.boot_us
    return tuple(clock.to_unix_ns(us * 1000) for us in boot_us.tolist())


def _gimbal(topic: _Topic, clock: GpsClock) -> list[NavEvent]:
    flags = topic.column("device_flags", unknown=0.0).astype(np.int64)
    failures = topic.column("failure_flags", unknown=0.0).astype(np.int64)
    earth = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME | mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
    vehicle = (flags & mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME != 0) | (flags & earth == 0)
    return [
        GimbalAttitude(clock.to_unix_ns(us * 1000), q, "vehicle" if in_vehicle else "earth")
        for us, q, in_vehicle, failed in zip(topic.boot_us.tolist(), _unit(topic), vehicle, failures, strict=True)
        if q is not None and not failed & GIMBAL_UNFIT
    ]


def _ranges(topic: _Topic, clock: GpsClock) -> list[NavEvent]:
    least, most = topic.column("min_distance", unknown=0.0), topic.column("max_distance", unknown=1e9)
    distances, orientations = topic.column("current_distance"), topic.column("orientation", unknown=25.0)
    variances, qualities = topic.column("variance", unknown=0.0), topic.column("signal_quality", unknown=-1.0)
    out: list[NavEvent] = []
    for i, us in enumerate(topic.boot_us.tolist()):
        direction = sensor_direction(int(orientations[i]))
        if direction is not None and least[i] < distances[i] < most[i] and qualities[i] != 0:
            sigma_m = math.sqrt(variances[i]) if variances[i] > 0.0 else None
            out.append(RangeFinder(clock.to_unix_ns(us * 1000), float(distances[i]), direction, sigma_m))
    return out


def _homes(topic: _Topic, clock: GpsClock) -> list[NavEvent]:
    known = (topic.column("valid_alt", unknown=1.0) > 0) & (topic.column("valid_hpos", unknown=1.0) > 0)
    places = topic.columns("lat", "lon", "alt")
    return [
        Home(clock.to_unix_ns(us * 1000), *place)
        for us, place, is_known in zip(topic.boot_us.tolist(), places.tolist(), known, strict=True)
        if is_known and np.isfinite(place).all()
    ]
