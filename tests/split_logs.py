"""A flight's log taken apart, as people have it: positions in one file, attitudes with coarse positions in another."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from contract.rotations import euler_from_matrix, matrix_from_quaternion
from onboard.events.types import Attitude, GpsQuality, NavEvent, PositionFix
from onboard.telemetry.telemetry_log import TelemetryLog

METRES_A_DEGREE = 111_132.0
DRIFT_S = 60.0  # over which a receiver's error keeps its value
HEAD = "unix_time_s,lat_deg,lon_deg,height_amsl_m,height_above_home_m,{velocity}roll_deg,pitch_deg,yaw_deg"
VELOCITY = "velocity_north_m_s,velocity_east_m_s,velocity_down_m_s,"


def another_receiver(
    log: TelemetryLog,
    rng: np.random.Generator,
    within_s: tuple[float, float] = (0.0, 1e9),
    ahead_s: float = 0.0,
    rate_hz: float = 1.0,
    decimals: int = 6,
    drift_m: float = 1.5,
    jitter_s: float = 0.03,
) -> TelemetryLog:
    """The positions of a stretch as another receiver's log has them: its own errors, rate, digits and clock."""
    first_ns, last_s = log.span_ns[0], -np.inf
    slow_m, events = drift_m * rng.normal(size=3), list[NavEvent]()
    for fix in (e for e in log.events if isinstance(e, PositionFix)):
        at_s = (fix.stamp_ns - first_ns) / 1e9
        if not within_s[0] <= at_s <= within_s[1] or at_s - last_s < 0.98 / rate_hz:
            continue
        keeps = np.exp(-(at_s - max(last_s, 0.0)) / DRIFT_S)
        slow_m, last_s = keeps * slow_m + np.sqrt(1.0 - keeps**2) * drift_m * rng.normal(size=3), at_s
        north_m, east_m, up_m = slow_m + 0.2 * drift_m * rng.normal(size=3)
        a_lon = METRES_A_DEGREE * np.cos(np.radians(fix.lat_deg))
        events.append(
            PositionFix(
                fix.stamp_ns + round((ahead_s + jitter_s * rng.normal()) * 1e9),
                round(fix.lat_deg + north_m / METRES_A_DEGREE, decimals),
                round(fix.lon_deg + east_m / a_lon, decimals),
                round(fix.height_amsl_m + up_m, 1),
            )
        )
    return TelemetryLog.by_stamp(events)


def only(log: TelemetryLog, *kinds: type[NavEvent]) -> TelemetryLog:
    """The log with these alone."""
    pairs = [p for p in zip(log.arrival_ns, log.events, strict=True) if isinstance(p[1], kinds)]
    return replace(log, events=[e for _, e in pairs], arrival_ns=[t for t, _ in pairs])


def ahead(log: TelemetryLog, by_s: float) -> TelemetryLog:
    """The log by a clock that is ahead by so much."""
    by_ns = round(by_s * 1e9)
    events = [replace(e, stamp_ns=e.stamp_ns + by_ns) for e in log.events if not isinstance(e, GpsQuality)]
    return TelemetryLog.by_stamp(events)


def together(*logs: TelemetryLog) -> TelemetryLog:
    return TelemetryLog.by_stamp(event for log in logs for event in log.events)


def table(log: TelemetryLog, path: Path) -> Path:
    """A log as the table that we read."""
    rows = [HEAD.format(velocity=VELOCITY)]
    for event in log.events:
        at = f"{event.stamp_ns / 1e9:.4f}"
        if isinstance(event, PositionFix):
            velocity = event.velocity_ned_m_s or ("", "", "")
            above = "" if event.height_above_home_m is None else event.height_above_home_m
            cells = (at, f"{event.lat_deg:.7f}", f"{event.lon_deg:.7f}", event.height_amsl_m, above, *velocity)
            rows.append(",".join(map(str, (*cells, "", "", ""))))
        elif isinstance(event, Attitude):
            euler = np.degrees(euler_from_matrix(matrix_from_quaternion(event.q_ned_body)))
            rows.append(",".join((at, *[""] * 7, *(f"{angle:.3f}" for angle in euler))))
    path.write_text("\n".join([*rows, ""]))
    return path
