"""Telemetry that ArduPilot's camera application (AP_CameraGimbal, on SIYI's cameras) has in each picture -> events.

Every picture of its H.264 and H.265 has a message for users (SEI) of one UUID, and in it JSON as its documentation
describes `apcg.telemetry.v1`: the picture's time on the video's own, the camera's clock, and values each with its age.
The UUID is looked for in the whole file, whatever its container; JSON has no bytes that a video would escape.
"""

from __future__ import annotations

import json
import math
import mmap
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any
from uuid import UUID

from contract.errors import InputError
from onboard.telemetry.field_of_view import focal_lengths
from onboard.telemetry.row_events import (
    ABOVE_HOME,
    ATTITUDE,
    GIMBAL,
    MAX_UNIX_S,
    MIN_UNIX_S,
    VELOCITY,
    Row,
    Rows,
    log_of_rows,
)
from onboard.telemetry.telemetry_log import NS_PER_S, SIGMA_BEGAN_S, TelemetryLog

MARK = UUID("8d646b4e-556f-4a90-8b7c-35e629510321").bytes
SCHEMA = "apcg.telemetry.v1"
MOST_JSON = 4096  # bytes; it has a fifth of that
NEAR_BYTES = 16_000_000  # within which the first picture lies
TICKS_HZ, WRAP = 90_000, 1 << 32
MOST, MOST_AGE_MS = 1e18, 1e5
US = 1000  # ns
SAME_NS = 5_000_000  # within which two stamps are those of one value, whose age is in whole milliseconds
SIGMA_UTC_S = 1.0  # of the camera's clock, which an autopilot's message sets once

Json = Mapping[str, Any]


def is_in(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return MARK in stream.read(NEAR_BYTES)
    except OSError:
        return False


def read(path: Path) -> TelemetryLog:
    """Read the messages of a video. Raises InputError, without the file's name, for one without positions in them."""
    try:
        messages = list(_messages(path))
    except OSError as error:
        raise InputError(f"{error.strerror}") from error
    rows = [row for message in messages for row in _rows(message)]
    if not any("lat_deg" in row for _, row in rows):
        raise InputError(f"none of its {len(messages)} messages (SEI) has a position: the camera had no autopilot")
    log = log_of_rows(_without_repeats(rows), utc_sigma_s=SIGMA_UTC_S, is_repeated=True)
    widths = [(_stamp_ns(message), _number(message, "hfov_deg")) for message in messages]
    return replace(log, video_began=_began(messages), focal_mm=focal_lengths(widths))


def _began(messages: list[Json]) -> tuple[int, float] | None:
    """When the first picture was (ns, by the camera's clock) and one sigma of that (s): a stream's times count from
    anywhere and begin again, so they count from the first's here.
    """
    timed = [(_stamp_ns(message), ticks) for message in messages if (ticks := _number(message, "pts90k")) is not None]
    if not timed:
        return None
    first = timed[0][1]
    began_ns = median(at_ns - (ticks - first) % WRAP / TICKS_HZ * NS_PER_S for at_ns, ticks in timed)
    return round(began_ns), SIGMA_BEGAN_S


def _messages(path: Path) -> Iterator[Json]:
    """The messages of a file in its order; what is damaged is left out."""
    decoder = json.JSONDecoder()
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = data.find(MARK)
        while at >= 0:
            at += len(MARK)
            text = data[at : at + MOST_JSON].decode("utf-8", "replace")
            try:
                message, _ = decoder.raw_decode(text)
            except (ValueError, RecursionError):
                message = None
            if isinstance(message, dict) and message.get("schema", SCHEMA) == SCHEMA and _has_time(message):
                yield message
            at = data.find(MARK, at)


def _has_time(message: Json) -> bool:
    time_us = _number(message, "utc_us")
    return time_us is not None and MIN_UNIX_S < time_us / 1e6 < MAX_UNIX_S


def _stamp_ns(message: Json) -> int:
    return int(message["utc_us"]) * US


def _number(values: Json, name: str) -> float | None:
    value = values.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < MOST:
        return None
    return float(value)


def _values(message: Json, name: str, names: tuple[str, ...]) -> tuple[int, list[float]] | None:
    """The stamp (ns) of one sensor's values, and these; None where any is missing."""
    part = message.get(name)
    if not isinstance(part, dict):
        return None
    found = [_number(part, each) for each in (*names, "age_ms")]
    known = [value for value in found if value is not None]
    if len(known) < len(found) or not 0.0 <= known[-1] < MOST_AGE_MS:
        return None
    return _stamp_ns(message) - round(known[-1] * 1e6), known[:-1]


ANGLES = ("roll_rad", "pitch_rad", "yaw_rad")


def _rows(message: Json) -> Iterator[tuple[int, Row]]:
    place = _values(message, "position", ("lat_e7", "lon_e7", "alt_amsl_m"))
    if place is not None and abs(place[1][0]) <= 9e8 and abs(place[1][1]) <= 1.8e9:
        stamp_ns, (lat, lon, height_m) = place
        row = {"lat_deg": lat / 1e7, "lon_deg": lon / 1e7, "height_amsl_m": height_m}
        above = _number(message["position"], "alt_relative_m")
        velocity = _values(message, "velocity", ("vn_m_s", "ve_m_s", "vd_m_s"))
        yield stamp_ns, row | ({} if above is None else {ABOVE_HOME: above}) | _named(VELOCITY, velocity)
    vehicle = _values(message, "vehicle_attitude", ANGLES)
    if vehicle is None:
        return
    at_ns, (roll, pitch, yaw) = vehicle
    yield at_ns, dict(zip(ATTITUDE, map(math.degrees, (roll, pitch, yaw)), strict=True))
    gimbal = _values(message, "gimbal_attitude", ANGLES)
    if gimbal is not None:
        stamp_ns, (roll, pitch, from_nose) = gimbal
        rate = _number(message["vehicle_attitude"], "yaw_rate_rad_s") or 0.0
        nose = yaw + rate * (stamp_ns - at_ns) / 1e9
        yield stamp_ns, dict(zip(GIMBAL, map(math.degrees, (roll, pitch, nose + from_nose)), strict=True))


def _named(names: tuple[str, ...], found: tuple[int, list[float]] | None) -> Row:
    return {} if found is None else dict(zip(names, found[1], strict=True))


def _without_repeats(rows: Rows) -> Rows:
    """The rows without repeats: each picture has the newest value of every sensor, with its age."""
    newest_ns: dict[frozenset[str], int] = {}
    out = []
    for stamp_ns, row in sorted(rows, key=lambda each: each[0]):
        kind = frozenset(row)
        if stamp_ns - newest_ns.get(kind, -SAME_NS) >= SAME_NS:
            newest_ns[kind] = stamp_ns
            out.append((stamp_ns, row))
    return out
