"""DJI's timestamp file (.MRK): when each photograph of a flight was exposed, by the receiver, and where the camera was.

Its positions are the camera's: the lever arm of the antenna is already allowed for.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

from contract.errors import InputError
from onboard.telemetry.gps_time import unix_ns_of_gps
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.row_events import ABOVE_ELLIPSOID, LIMITS, Row, Rows, log_of_rows, with_heights
from onboard.telemetry.telemetry_log import TelemetryLog

# Number, seconds of the GPS week, [week], then the lever arm and the position.
_LINE = re.compile(r"\s*\d+\s+(\d{1,6}\.\d+)\s+\[(\d{3,4})\]")
_VALUE = re.compile(r"(-?\d{1,9}(?:\.\d+)?)\s*,\s*(Lat|Lon|Ellh|Q)\b")
_SIGMAS = re.compile(r"Ellh\s+(\d+\.\d+)\s*,\s*(\d+\.\d+)\s*,\s*(\d+\.\d+)")  # north, east, up
FIX_TYPES = {16: 3, 34: 5, 50: 6}  # single, float, fixed -> GPS_FIX_TYPE; 0 is no position


def begins_mrk(head: bytes) -> bool:
    """Return whether a file that begins with `head` is one of these."""
    first = head.decode("utf-8", "replace").partition("\n")[0]
    return _LINE.match(first) is not None and ",Lat" in first.replace(" ", "")


def read_mrk(path: Path) -> tuple[int, ...]:
    """Exposures in the file's order, Unix ns. Raises InputError, one line, for a file without any."""
    try:
        return tuple(stamp_ns for stamp_ns, _ in _exposures(path))
    except InputError as error:
        raise InputError(f"timestamps {path}: {error}") from error


def read_mrk_log(path: Path, options: ReadOptions) -> TelemetryLog:
    """Read positions and exposures as a log. Raises InputError, without the file's name, for one without positions."""
    found = _exposures(path)
    rows: Rows = [(stamp_ns, row) for stamp_ns, line in found if (row := _row(line))]
    placed, notes = with_heights(rows, None, options.undulation_m, None)
    return replace(log_of_rows(placed, notes), shots_ns=tuple(sorted(stamp_ns for stamp_ns, _ in found)))


def _exposures(path: Path) -> list[tuple[int, str]]:
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise InputError(f"{error.strerror}") from error
    found = [(match, line) for line in lines if (match := _LINE.match(line)) is not None]
    if not found:
        raise InputError("no line of a photograph (number, GPS seconds, [week]) in it")
    return [(unix_ns_of_gps(int(match[2]), 0) + round(float(match[1]) * 1e9), line) for match, line in found]


def _row(line: str) -> Row:
    """The position of a line; empty where the receiver had none, or the line is cut."""
    value = {name: float(number) for number, name in _VALUE.findall(line)}
    quality = FIX_TYPES.get(int(value.get("Q", 0)))
    if quality is None or not {"Lat", "Lon", "Ellh"} <= set(value):
        return {}
    row = {"lat_deg": value["Lat"], "lon_deg": value["Lon"], ABOVE_ELLIPSOID: value["Ellh"], "fix_type": float(quality)}
    if any(abs(number) > LIMITS.get(name, math.inf) for name, number in row.items()):
        return {}
    if (sigmas := _SIGMAS.search(line)) is not None:
        north_m, east_m, up_m = map(float, sigmas.groups())
        row |= {"sigma_horizontal_m": math.hypot(north_m, east_m) / 2.0**0.5, "sigma_vertical_m": up_m}
    return row
