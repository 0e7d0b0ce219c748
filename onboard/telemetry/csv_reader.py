"""Telemetry as a table (CSV), for everything that has no reader of its own. The columns are in docs/logs.md."""

from __future__ import annotations

import csv
import io
import math
from decimal import Decimal, InvalidOperation
from pathlib import Path

from contract.errors import InputError
from contract.stated_values import number_or_nan
from onboard.telemetry.row_events import (
    ATTITUDE,
    GIMBAL,
    LIMITS,
    MAX_UNIX_S,
    MIN_UNIX_S,
    POSITION,
    RATE,
    SIGMAS,
    VELOCITY,
    Row,
    log_of_rows,
)
from onboard.telemetry.telemetry_log import TelemetryLog

OTHERS = ("height_above_home_m", "fix_type", "satellites", "undulation_m", "range_down_m")
COLUMNS = ("unix_time_s", *POSITION, *VELOCITY, *ATTITUDE, *RATE, *GIMBAL, *SIGMAS, *OTHERS)
NEEDED = ("unix_time_s", *POSITION)


def looks_like_table(head: bytes) -> bool:
    return "unix_time_s" in _names(head)


def has_positions(head: bytes) -> bool:
    """Return whether a file that begins so is such a table with all that it needs, and nothing else."""
    names = _names(head)
    return set(NEEDED) <= names <= set(COLUMNS)


def is_table(head: bytes) -> bool:
    """Return whether a file that begins so is a table of any kind: as many cells in two lines, three or more."""
    counts = [line.count(b",") for line in head.splitlines()[:2]]
    return len(counts) == 2 and counts[0] == counts[1] > 1


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
    try:
        return log_of_rows(read)
    except InputError as error:
        raise InputError(f"telemetry {path}: {error}") from error


def _row(row: dict[str | None, str | None], where: str) -> tuple[int, Row]:
    """A line's stamp (ns) and numbers; empty cells are left out."""
    if None in row or None in row.values():
        raise InputError(f"{where}: not as many cells as the header has columns")
    out: Row = {}
    for name, cell in row.items():
        text = (cell or "").strip()
        if name is None or name == "unix_time_s" or not text:
            continue
        value = number_or_nan(text)
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
