"""Telemetry as a table (CSV), for everything that has no reader of its own. The columns are in docs/logs.md."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace
from decimal import Decimal, InvalidOperation
from pathlib import Path

from contract.errors import InputError
from onboard.events.types import Attitude, GimbalAttitude, GpsQuality, NavEvent, PositionFix, RangeFinder
from onboard.telemetry.contradictions import agreeing
from onboard.telemetry.telemetry_log import TelemetryLog, quaternion, vouched

POSITION = ("lat_deg", "lon_deg", "height_amsl_m")
VELOCITY = ("velocity_north_m_s", "velocity_east_m_s", "velocity_down_m_s")
ATTITUDE = ("roll_deg", "pitch_deg", "yaw_deg")
RATE = ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s")
GIMBAL = ("gimbal_roll_deg", "gimbal_pitch_deg", "gimbal_yaw_deg")
SIGMAS = ("sigma_horizontal_m", "sigma_vertical_m", "sigma_velocity_m_s", "sigma_datum_m")
OTHERS = ("height_above_home_m", "fix_type", "satellites", "undulation_m", "range_down_m")
COLUMNS = ("unix_time_s", *POSITION, *VELOCITY, *ATTITUDE, *RATE, *GIMBAL, *SIGMAS, *OTHERS)
NEEDED = ("unix_time_s", *POSITION)
# Between 2000 and 2100: outside of it a time has another unit.
MIN_UNIX_S, MAX_UNIX_S = 946_684_800, 4_102_444_800
LIMITS = {"lat_deg": 90.0, "lon_deg": 360.0, "height_amsl_m": 1e5}
DOWN = (0.0, 0.0, 1.0)

Row = dict[str, float]


def looks_like_table(head: bytes) -> bool:
    """Return whether a file that begins with `head` is such a table."""
    return "unix_time_s" in _names(head)


def has_positions(head: bytes) -> bool:
    """Return whether a file that begins so is such a table with all that it needs, and nothing else."""
    names = _names(head)
    return set(NEEDED) <= names <= set(COLUMNS)


def _names(head: bytes) -> set[str]:
    return {name.strip().strip('"') for name in head.decode("utf-8-sig", "replace").partition("\n")[0].split(",")}


def read_csv(path: Path | str) -> TelemetryLog:
    """Read a table; raises InputError, one line with its line number, for what is not one."""
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"telemetry {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"telemetry {path}: not UTF-8 text (byte {error.start})") from error
    rows = csv.DictReader(io.StringIO(text, newline=""), skipinitialspace=True)
    try:
        header = [name.strip() for name in rows.fieldnames or []]
        rows.fieldnames = header
        missing = [name for name in NEEDED if name not in header]
        if missing:
            raise InputError(f"telemetry {path}, line 1: no column {', '.join(missing)}; needed are {','.join(NEEDED)}")
        unknown = [name for name in header if name not in COLUMNS]
        if unknown:
            raise InputError(f"telemetry {path}, line 1: unknown column '{unknown[0]}'; known are {','.join(COLUMNS)}")
        read = [_row(row, f"telemetry {path}, line {rows.line_num}") for row in rows]
    except csv.Error as error:
        raise InputError(f"telemetry {path}, line {rows.line_num}: {error}") from error
    ordered = sorted(read, key=lambda item: item[0])
    positions = [_position(stamp_ns, row) for stamp_ns, row in ordered if "lat_deg" in row]
    if not positions:
        raise InputError(f"telemetry {path}: no position in it ({', '.join(POSITION)} all in one line)")
    claims = [_claim(stamp_ns, row) for stamp_ns, row in ordered if "lat_deg" in row]
    try:
        agree, contradictions = agreeing(positions)
    except InputError as error:
        raise InputError(f"telemetry {path}: {error}") from error
    events = vouched([positions[at] for at in agree], [claims[at] for at in agree])
    for stamp_ns, row in ordered:
        events += _others(stamp_ns, row)
    return replace(TelemetryLog.by_stamp(events), notes=tuple(contradictions))


def _row(row: dict[str | None, str | None], where: str) -> tuple[int, Row]:
    """A line's stamp (ns) and numbers; empty cells are left out."""
    if None in row or None in row.values():
        raise InputError(f"{where}: not as many cells as the header has columns")
    out: Row = {}
    for name, cell in row.items():
        text = (cell or "").strip()
        if name is None or name == "unix_time_s" or not text:
            continue
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or abs(value) > LIMITS.get(name, math.inf):
            raise InputError(f"{where}: {name} '{text}' is not a number that it can be")
        out[name] = value
    for group in (POSITION, ATTITUDE, GIMBAL, RATE):
        if 0 < sum(name in out for name in group) < len(group):
            raise InputError(f"{where}: {', '.join(group)} go together, or all are empty")
    return _stamp(row["unix_time_s"] or "", where), out


def _stamp(text: str, where: str) -> int:
    try:
        seconds = Decimal(text.strip())
        usable = MIN_UNIX_S <= seconds <= MAX_UNIX_S
    except InvalidOperation:
        usable = False
    if not usable:
        raise InputError(f"{where}: '{text.strip()}' is not a Unix time in seconds between 2000 and 2100")
    return int(seconds * 1_000_000_000)


def _position(stamp_ns: int, row: Row) -> PositionFix:
    velocity = None
    if VELOCITY[0] in row and VELOCITY[1] in row:
        velocity = row[VELOCITY[0]], row[VELOCITY[1]], row.get(VELOCITY[2], math.nan)
    lon_deg = (row["lon_deg"] + 180.0) % 360.0 - 180.0
    return PositionFix(
        stamp_ns, row["lat_deg"], lon_deg, row["height_amsl_m"], velocity, row.get("height_above_home_m")
    )


def _claim(stamp_ns: int, row: Row) -> GpsQuality:
    satellites = row.get("satellites")
    horizontal_m, vertical_m, velocity_m_s, datum_m = (row.get(name) or None for name in SIGMAS)
    return GpsQuality(
        stamp_ns,
        int(row.get("fix_type", 3)),
        None if satellites is None else int(satellites),
        horizontal_m,
        vertical_m,
        velocity_m_s,
        row.get("undulation_m"),
        datum_m,
    )


def _others(stamp_ns: int, row: Row) -> list[NavEvent]:
    out: list[NavEvent] = []
    if ATTITUDE[0] in row:
        rate = (row[RATE[0]], row[RATE[1]], row[RATE[2]]) if RATE[0] in row else None
        out.append(Attitude(stamp_ns, _quaternion(row, ATTITUDE), rate))
    if GIMBAL[0] in row:
        out.append(GimbalAttitude(stamp_ns, _quaternion(row, GIMBAL), "earth", is_of_camera=True))
    if row.get("range_down_m", 0.0) > 0.0:
        out.append(RangeFinder(stamp_ns, row["range_down_m"], DOWN))
    return out


def _quaternion(row: Row, names: tuple[str, str, str]) -> tuple[float, float, float, float]:
    roll, pitch, yaw = (row[name] for name in names)
    return quaternion((roll, pitch, yaw))
