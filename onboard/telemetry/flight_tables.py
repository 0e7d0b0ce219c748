"""Tables (CSV) of flights that other programs write -> events: AirData's, DJI's flight record's, Skydio's.

A dialect names the columns by patterns of their heads, which have the unit in them; how a row becomes events is
`row_events`. Velocities are not read: AirData describes its x as east and DJI's record as north, of the same numbers.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from contract.errors import InputError
from contract.stated_values import number_or_nan
from onboard.telemetry.civil_time import moments_ns
from onboard.telemetry.contradictions import LEAST_SHARE, beginning
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.row_events import (
    ABOVE_HOME,
    GIMBAL,
    LIMITS,
    MAX_UNIX_S,
    MIN_UNIX_S,
    NO_FIX,
    SIGMA_GEOID_M,
    SIGMA_PRESSURE_HEIGHT_M,
    Row,
    log_of_rows,
    with_heights,
    with_steps,
)
from onboard.telemetry.telemetry_log import NS_PER_S, TelemetryLog

UNITS = {"m": 1.0, "meters": 1.0, "metres": 1.0, "ft": 0.3048, "feet": 0.3048}
UNIT = r"(?P<unit>m|meters|metres|ft|feet)"
NO_ZONE = "its times are local, of no stated zone: nothing ties them to UTC, so pictures must have the same clock"
SIGMA_PHONE_S = 1.0  # of the clock of a phone or controller that wrote a table, against UTC
MAX_DECIMALS = 9

Cells = list[str]


@dataclass(frozen=True)
class Stamps:
    """The time of each row, Unix ns or None, how well that is UTC (see `TelemetryLog`), and notes."""

    ns: list[int | None]
    utc_sigma_s: float | None
    notes: list[str]


@dataclass(frozen=True)
class Dialect:
    """One program's table: which heads it is recognised by, and its columns by ours.

    `columns`: patterns of whole heads in small letters, with a group `unit` where a length has one; `sigma_datum_m` one
    sigma of where its heights above sea level count from; `defaults` by which column another is replaced, or 0.
    """

    marks: tuple[str, ...]
    columns: Mapping[str, str]
    stamps: Callable[[Sequence[str], list[Cells], str], Stamps]
    sigma_datum_m: float
    defaults: Mapping[str, str]

    def begins(self, head: bytes) -> bool:
        """Return whether a file that begins with `head` is such a table."""
        lines = _lines(head.decode("utf-8-sig", "replace"))
        heads = {cell.strip().lower() for cell in next(csv.reader(lines[:1], delimiter=_delimiter(lines)), [])}
        return all(any(re.fullmatch(mark, one) for one in heads) for mark in self.marks)

    def read(self, path: Path, options: ReadOptions) -> TelemetryLog:
        """Read a table. Raises InputError, without the file's name, for one that lacks what is needed."""
        data = path.read_bytes().rstrip(b"\0")
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")
        lines = _lines(text)
        try:
            head, *table = csv.reader(lines, delimiter=_delimiter(lines))
        except csv.Error as error:
            raise InputError(f"its cells cannot be separated ({error})") from error
        if len(table) > 1 and not text.endswith("\n"):
            del table[-1]  # it may be cut within a number
        heads = [cell.strip().lower() for cell in head]
        at = {name: found for name, pattern in self.columns.items() if (found := _column(heads, pattern)) is not None}
        for name in ("lat_deg", "lon_deg"):
            if name not in at:
                raise InputError(f"no column for {name} in it")
        whole = [cells for cells in table if len(cells) == len(heads) and not any("\0" in cell for cell in cells)]
        mark = _decimal_mark(cells[at[name][0]] for cells in whole for name in ("lat_deg", "lon_deg"))
        stamps = self.stamps(heads, whole, mark)
        rows = [
            (stamp_ns, self._row(cells, at, mark))
            for stamp_ns, cells in zip(stamps.ns, whole, strict=True)
            if stamp_ns is not None and MIN_UNIX_S <= stamp_ns / NS_PER_S <= MAX_UNIX_S
        ]
        notes = stamps.notes + _damage(len(rows), sum(map(any, table)))
        decimals = max((_decimals(cells[at["lat_deg"][0]]) for cells in whole), default=0)
        rows, of_heights = with_heights(rows, options.home_amsl_m, options.undulation_m, self.sigma_datum_m)
        return log_of_rows(with_steps(rows, decimals), notes + of_heights, stamps.utc_sigma_s, is_repeated=True)

    def _row(self, cells: Cells, at: Mapping[str, tuple[int, float]], mark: str) -> Row:
        row: Row = {}
        for name, (index, factor) in at.items():
            value = _number(cells[index], mark) * factor
            if abs(value) <= LIMITS.get(name, math.inf):
                row[name] = value
        if "lat_deg" not in row or "lon_deg" not in row or (row["lat_deg"], row["lon_deg"]) == NO_FIX:
            row.pop("lat_deg", None)  # a receiver without a fix is written as 0, 0
            row.pop("lon_deg", None)
        if any(name in row for name in GIMBAL):
            for name, by in self.defaults.items():
                if name not in at:
                    row[name] = row.get(by, math.nan) if by else 0.0
        return {name: value for name, value in row.items() if math.isfinite(value)}


def _lines(text: str) -> list[str]:
    """The lines from the one with the heads on; spreadsheets write one with their separator before it."""
    lines = text.splitlines()
    return lines[1:] if lines and lines[0].strip().strip('"').lower().startswith("sep=") else lines


def _delimiter(lines: list[str]) -> str:
    head = lines[0] if lines else ""
    return max(",;\t", key=head.count)


def _column(heads: Sequence[str], pattern: str) -> tuple[int, float] | None:
    """The first column whose head matches, and what its numbers are multiplied by."""
    for index, head in enumerate(heads):
        if (found := re.fullmatch(pattern, head)) is not None:
            return index, UNITS[found["unit"]] if "unit" in found.groupdict() else 1.0
    return None


def _decimal_mark(degrees: Iterable[str]) -> str:
    """Return what stands before decimals, a point or, as some languages have it, a comma: in degrees it is clear."""
    cells = list(degrees)
    commas, points = (sum(mark in cell for cell in cells) for mark in ",.")
    return "," if commas > points else "."


def _number(cell: str, mark: str) -> float:
    """Return a cell's number; the other mark may group its digits by three. nan where it has none, or may be either."""
    text = cell.strip()
    other = "." if mark == "," else ","
    if mark == "," and re.fullmatch(r"[+-]?\d{1,3}\.\d{3}", text):
        return math.nan
    if re.fullmatch(rf"[+-]?\d{{1,3}}(?:[{other}]\d{{3}})+(?:[{mark}]\d*)?", text):
        text = text.replace(other, "")
    return number_or_nan(text.replace(mark, "."))


def _decimals(cell: str) -> int:
    return min(len(re.split("[.,]", cell.strip())[-1]) if re.search("[.,]", cell) else 0, MAX_DECIMALS)


def _damage(good: int, lines: int) -> list[str]:
    """Return a note on lines that cannot be read. Raises InputError where they are more than a few."""
    if good >= lines:
        return []
    if good < LEAST_SHARE * lines and lines - good > 1:
        raise InputError(f"{lines - good} of its {lines} lines have no time that can be read, or lack cells")
    return [f"{lines - good} of {lines} lines have no time that can be read, or lack cells, and are not used"]


def _elapsed(heads: Sequence[str], rows: list[Cells], mark: str) -> Stamps:
    """AirData's times: milliseconds, and a date cut to the second that they begin at."""
    elapsed, date = _column(heads, r"time\(millisecond\)"), _column(heads, r"datetime\((?:utc|local)\)")
    if elapsed is None or date is None:
        raise InputError("no column time(millisecond) or no datetime(utc) in it: its moments are not known")
    passed_ns = [
        round(value * 1e6) if math.isfinite(value := _number(cells[elapsed[0]], mark)) and abs(value) < 1e12 else None
        for cells in rows
    ]
    dates = moments_ns(cells[date[0]] for cells in rows)
    pairs = zip(dates, passed_ns, strict=True)
    began = [found[0] - passed for found, passed in pairs if found is not None and passed is not None]
    if not began:
        raise InputError("no line with a date and milliseconds in it")
    began_ns, notes = beginning(began, "the flight")
    is_utc = heads[date[0]].endswith("(utc)")
    out = [None if passed is None else began_ns + passed for passed in passed_ns]
    if not is_utc:
        return Stamps(out, None, [*notes, NO_ZONE])
    # A phone's clock that was set in flight: what its dates differ by, beyond the second that they are cut to.
    spread_s = (began_ns - sorted(began)[len(began) // 2]) / NS_PER_S
    return Stamps(out, max(SIGMA_PHONE_S, spread_s), notes)


def _dated(heads: Sequence[str], rows: list[Cells], _: str) -> Stamps:
    """Times of a DJI flight record: date and time of day in UTC where there are, else local, in two columns or one."""
    columns = {
        zone: (_column(heads, rf"custom\.date{zone}"), time)
        for zone in (r" \[utc\]", r" \[local\]", "")
        if (time := _column(heads, rf"custom\.updatetime{zone}")) is not None
    }
    if not columns:
        raise InputError("no column CUSTOM.updateTime in it: its moments are not known")
    zone, (date, time) = next(iter(columns.items()))
    is_utc = "utc" in zone
    found = moments_ns(
        cells[time[0]] if date is None else f"{cells[date[0]].strip()} {cells[time[0]].strip()}" for cells in rows
    )
    out = [None if one is None else one[0] for one in found]
    if not any(out):
        raise InputError(f"no time with its date in column {heads[time[0]]}: its moments are not known")
    return Stamps(out, SIGMA_PHONE_S if is_utc else None, [] if is_utc else [NO_ZONE])


def _stated(heads: Sequence[str], rows: list[Cells], _: str) -> Stamps:
    """Times in one column, each with its zone or without."""
    column = _column(heads, "timestamp")
    if column is None:
        raise InputError("no column Timestamp in it: its moments are not known")
    found = moments_ns(cells[column[0]] for cells in rows)
    is_utc = any(one is not None and one[1] for one in found)
    # Of a file in which some times have a zone the others are not known.
    out = [None if one is None or one[1] is not is_utc else one[0] for one in found]
    return Stamps(out, SIGMA_PHONE_S if is_utc else None, [] if is_utc else [NO_ZONE])


# AirData does not state from what it computes a height above sea level; DJI's is the barometer's; Skydio's pictures
# count theirs from the ellipsoid, so that its tables may, whatever the head of the column.
AIRDATA = Dialect(
    (r"time\(millisecond\)", r"datetime\((?:utc|local)\)", "latitude"),
    {
        "lat_deg": "latitude", "lon_deg": "longitude", ABOVE_HOME: rf"height_above_takeoff\({UNIT}\)",
        "height_amsl_m": rf"altitude_above_sealevel\({UNIT}\)", "satellites": "satellites",
        "roll_deg": r"roll\(degrees\)", "pitch_deg": r"pitch\(degrees\)", "yaw_deg": r"compass_heading\(degrees\)",
        GIMBAL[0]: r"gimbal_roll\(degrees\)", GIMBAL[1]: r"gimbal_pitch\(degrees\)",
        GIMBAL[2]: r"gimbal_heading\(degrees\)",
    },
    _elapsed, SIGMA_PRESSURE_HEIGHT_M, {GIMBAL[0]: ""},
)  # fmt: skip
DJI_RECORD = Dialect(
    (r"osd\.latitude", r"osd\.longitude"),
    {
        "lat_deg": r"osd\.latitude", "lon_deg": r"osd\.longitude", ABOVE_HOME: rf"osd\.height \[{UNIT}\]",
        "height_amsl_m": rf"osd\.altitude \[{UNIT}\]", "satellites": r"osd\.gpsnum",
        "roll_deg": r"osd\.roll(?: \[°\])?", "pitch_deg": r"osd\.pitch(?: \[°\])?",
        "yaw_deg": r"osd\.yaw(?: \[(?:360|°)\])?", GIMBAL[0]: r"gimbal\.roll(?: \[°\])?",
        GIMBAL[1]: r"gimbal\.pitch(?: \[°\])?", GIMBAL[2]: r"gimbal\.yaw(?: \[(?:360|°)\])?",
    },
    _dated, SIGMA_PRESSURE_HEIGHT_M, {GIMBAL[0]: ""},
)  # fmt: skip
SKYDIO = Dialect(
    ("timestamp", "latitude", "longitude", "gimbal pitch"),
    {
        "lat_deg": "latitude", "lon_deg": "longitude", "height_amsl_m": rf"altitude \({UNIT} msl\)",
        "yaw_deg": "heading", GIMBAL[1]: "gimbal pitch",
    },
    _stated, SIGMA_GEOID_M, {GIMBAL[0]: "", GIMBAL[2]: "yaw_deg"},
)  # fmt: skip
