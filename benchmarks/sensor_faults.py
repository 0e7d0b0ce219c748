"""Recorded telemetry with one faulty sensor for some time: what it reports then, and when.

A disturbance changes messages of its sensor from a moment on for some seconds; everything else stays as recorded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.geodesy import LocalFrame
from contract.rotations import exp_so3, matrix_from_quaternion, quaternion_from_matrix
from onboard.events.types import Attitude, Event, GpsQuality, PositionFix

TILT, HEADING, VELOCITY, POSITION, ATTITUDE_TIME = "tilt", "heading", "velocity", "position", "attitude_time"
DRAG = "drag"


@dataclass(frozen=True)
class Disturbance:
    """One sensor wrong by `size` for `seconds` from `begin_s` after the flight's begin.

    `sensor`: TILT (deg, about north and so about roll and pitch by turns), HEADING (deg), VELOCITY (m/s, towards
    north-east), POSITION (m, towards the east, the receiver's and the filter's, velocity right), DRAG (m/s, the same
    growing, as a spoofed receiver's),
    ATTITUDE_TIME (s, attitude older than its stamp).
    """

    sensor: str
    begin_s: float
    seconds: float
    size: float


def _each_minute(sensor: str, seconds: float, size: float) -> tuple[Disturbance, ...]:
    return tuple(Disturbance(sensor, 50.0 + 60.0 * k, seconds, size) for k in range(8))


EVERY_MINUTE = {
    "tilt-jump": _each_minute(TILT, 20.0, 5.0),
    "compass-flip": _each_minute(HEADING, 15.0, 40.0),
    "velocity-wrong": _each_minute(VELOCITY, 10.0, 3.0),
    "position-jump": _each_minute(POSITION, 15.0, 20.0),
    "position-drag": _each_minute(DRAG, 15.0, 2.0),
    "attitude-late": _each_minute(ATTITUDE_TIME, 20.0, 0.5),
}


def disturbed(event: Event, begin_ns: int, disturbances: tuple[Disturbance, ...], place: LocalFrame) -> Event:
    """The message as the disturbances that are on at its stamp make it; `begin_ns` is the flight's begin."""
    for d in disturbances:
        after_s = (event.stamp_ns - begin_ns) / 1e9 - d.begin_s
        if 0.0 <= after_s < d.seconds:
            event = _by(d, event, place, after_s)
    return event


def _by(d: Disturbance, event: Event, place: LocalFrame, after_s: float) -> Event:
    if isinstance(event, Attitude):
        if d.sensor in (TILT, HEADING):
            axis = np.array([1.0, 0.0, 0.0] if d.sensor == TILT else [0.0, 0.0, 1.0])
            turned = exp_so3(np.radians(d.size) * axis) @ matrix_from_quaternion(event.q_ned_body)
            w, x, y, z = quaternion_from_matrix(turned).tolist()
            return replace(event, q_ned_body=(w, x, y, z))
        if d.sensor == ATTITUDE_TIME:
            return replace(event, stamp_ns=event.stamp_ns + round(d.size * 1e9))
    if isinstance(event, PositionFix):
        if d.sensor == VELOCITY and event.velocity_ned_m_s is not None:
            north, east, down = event.velocity_ned_m_s
            return replace(event, velocity_ned_m_s=(north + d.size * 0.8, east + d.size * 0.6, down))
        if d.sensor in (POSITION, DRAG):
            moved_m = d.size if d.sensor == POSITION else d.size * after_s
            return moved(event, place, np.array([moved_m, 0.0, 0.0]))
    if isinstance(event, GpsQuality) and event.fix is not None and d.sensor in (POSITION, DRAG):
        fix = _by(d, event.fix, place, after_s)
        assert isinstance(fix, PositionFix)
        return replace(event, fix=fix)
    return event


def moved(fix: PositionFix, place: LocalFrame, by_m: NDArray[np.float64]) -> PositionFix:
    """A position moved by (3,) ENU metres."""
    p = place.to_enu(fix.lat_deg, fix.lon_deg, fix.height_amsl_m) + by_m
    lat, lon, height = (float(c) for c in place.to_geodetic(p))
    return replace(fix, lat_deg=lat, lon_deg=lon, height_amsl_m=height)
