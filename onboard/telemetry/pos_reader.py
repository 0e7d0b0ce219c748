"""Solutions of RTKLIB (.pos) -> events: positions after the flight, each with its own sigmas."""

from __future__ import annotations

import math
import re
from pathlib import Path

from contract.errors import InputError
from onboard.telemetry.civil_time import moment_ns
from onboard.telemetry.gps_time import GPS_EPOCH_UNIX_S, WEEK_S, leap_seconds
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.row_events import ABOVE_ELLIPSOID, LIMITS, Row, Rows, log_of_rows, with_heights
from onboard.telemetry.telemetry_log import NS_PER_S, TelemetryLog

_HEADS = re.compile(r"^%\s*(GPST|UTC|JST)\b[\s,;]*(.*)$", re.MULTILINE)
FIX_TYPES = {1: 6, 2: 5, 3: 4, 4: 4, 5: 3, 6: 6}  # its Q -> GPS_FIX_TYPE
JST_NS = 9 * 3600 * NS_PER_S
LEAST = 7  # date, time, latitude, longitude, height, Q, satellites


def begins_pos(head: bytes) -> bool:
    return _HEADS.search(head.decode("utf-8", "replace")) is not None


def read_pos(path: Path, options: ReadOptions) -> TelemetryLog:
    """Read a solution in degrees. Raises InputError, without the file's name, for coordinates of another kind."""
    text = path.read_bytes().decode("utf-8", "replace")
    heads = _HEADS.search(text)
    if heads is None or "latitude(deg)" not in heads[2] or "longitude(deg)" not in heads[2]:
        raise InputError("its solution is not in degrees: write it as Lat/Lon/Height with decimal degrees")
    # RTKLIB's geodetic heights are above the geoid of its own model.
    height = "height_amsl_m" if "height=WGS84/geodetic" in text else ABOVE_ELLIPSOID
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("%")]
    rows: Rows = []
    for line in lines:
        if (row := _row(line, heads[1], height)) is not None:
            rows.append(row)
    if not rows:
        raise InputError("no line of a solution in it: nothing was solved")
    notes = [f"{len(lines) - len(rows)} of {len(lines)} lines cannot be read"] if len(rows) < len(lines) else []
    placed, of_heights = with_heights(rows, None, options.undulation_m, None)
    return log_of_rows(placed, [*notes, *of_heights])


def _row(line: str, system: str, height: str) -> tuple[int, Row] | None:
    cells = [cell for cell in re.split(r"[\s,;]+", line) if cell]
    if len(cells) < LEAST:
        return None
    try:
        stamp_ns = _stamp(cells[0], cells[1], system)
        lat_deg, lon_deg, height_m = map(float, cells[2:5])
        quality, satellites = int(cells[5]), int(cells[6])
        sigmas = [float(cell) for cell in cells[7:10]]
    except ValueError:
        return None
    values = {"lat_deg": lat_deg, "lon_deg": lon_deg, height: height_m}
    if stamp_ns is None or quality not in FIX_TYPES or any(not abs(v) <= LIMITS[name] for name, v in values.items()):
        return None
    row = values | {"fix_type": float(FIX_TYPES[quality]), "satellites": float(satellites)}
    if len(sigmas) == 3 and all(0.0 < sigma < 1e4 for sigma in sigmas):
        row |= {"sigma_horizontal_m": math.hypot(*sigmas[:2]) / 2.0**0.5, "sigma_vertical_m": sigmas[2]}
    return stamp_ns, row


def _stamp(first: str, second: str, system: str) -> int | None:
    """A date and a time, or a week and its seconds, both of the system that the head names, on Unix time."""
    if "/" not in first:
        week, seconds = int(first), float(second)
        if not (0 < week < 10_000 and 0.0 <= seconds < 604_800.0):
            return None
        counted_ns = (GPS_EPOCH_UNIX_S + week * WEEK_S) * NS_PER_S + round(seconds * 1e9)
    else:
        found = moment_ns(f"{first} {second}")
        if found is None:
            return None
        counted_ns = found[0]
    if system == "GPST":
        return counted_ns - leap_seconds(counted_ns / NS_PER_S) * NS_PER_S
    return counted_ns - (JST_NS if system == "JST" else 0)
