"""Parrot's video metadata of version 3 (Anafi, Anafi Thermal, Anafi USA), a track of a video -> rows.

One sample belongs to each picture, at the picture's own time: numbers of fixed point, as Parrot's libvideo-metadata
has them. What stands behind the first 64 bytes is not read.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np

from contract.rotations import euler_from_matrix, matrix_from_quaternion
from onboard.telemetry.mp4_container import Track
from onboard.telemetry.row_events import ATTITUDE, GIMBAL, VELOCITY, Row, Rows
from onboard.telemetry.telemetry_log import NS_PER_S

KIND, DESCRIBED = "mett", b"com.parrot.videometadata3"
BASE_ID = 0x5033
# Identity, length; ground distance; latitude, longitude; height and satellites; velocity and airspeed; attitudes of the
# aircraft, of the view without and with the pilot's tilt; exposure, gain, white balance, fields of view.
BASE = struct.Struct(">HHi2ii4h4h4h4h4H2H")
DEGREES, METRES, METRES_A_SECOND, QUATERNION, ANGLE = 2.0**-22, 2.0**-8, 2.0**-8, 2.0**-14, 2.0**-8
MOST_OFF = 0.01  # of a unit quaternion's length: its steps make a hundredth of that


@dataclass(frozen=True)
class Flight:
    """The rows of a track at stamps from `began_ns` on, how many of its samples have no position, and the horizontal
    fields of view, degrees, each with its stamp.
    """

    rows: Rows
    without: int
    widths_deg: list[tuple[int, float | None]]


def is_read(track: Track) -> bool:
    return track.kind == KIND and DESCRIBED in track.description.lower()


def flight_of(track: Track, began_ns: int) -> Flight:
    """Return what a track holds, of a video that began then (Unix ns)."""
    rows, widths, without = [], list[tuple[int, float | None]](), 0
    for time_s, sample in zip(track.times_s, track.samples, strict=True):
        stamp_ns = began_ns + round(time_s * NS_PER_S)
        if len(sample) < BASE.size or struct.unpack_from(">H", sample)[0] != BASE_ID:
            continue
        _, _, _, lat, lon, height, *rest = BASE.unpack_from(sample)
        row = _place(lat, lon, height, rest[:3])
        without += not row
        for names, parts in ((ATTITUDE, rest[4:8]), (GIMBAL, rest[12:16])):
            if (angles := _angles_deg(parts)) is not None:
                row |= dict(zip(names, angles, strict=True))
        rows.append((stamp_ns, row))
        widths.append((stamp_ns, rest[20] * ANGLE))
    return Flight(rows, without, widths)


def _place(lat: int, lon: int, height: int, velocity: list[int]) -> Row:
    """Position and velocity; empty where it is not known, which is 500 degrees."""
    lat_deg, lon_deg = lat * DEGREES, lon * DEGREES
    if abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:
        return {}
    row = {"lat_deg": lat_deg, "lon_deg": lon_deg, "height_amsl_m": (height >> 8) * METRES}
    row["satellites"] = height & 0xFF
    return row | {name: part * METRES_A_SECOND for name, part in zip(VELOCITY, velocity, strict=True)}


def _angles_deg(parts: list[int]) -> list[float] | None:
    """Roll, pitch, yaw of a quaternion against north-east-down; None of what is no unit quaternion."""
    q = np.array(parts) * QUATERNION
    length = float(np.linalg.norm(q))
    if abs(math.log(max(length, 1e-9))) > MOST_OFF:
        return None
    angles: list[float] = np.degrees(euler_from_matrix(matrix_from_quaternion(q / length))).tolist()
    return angles
