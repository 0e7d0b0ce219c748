"""CSV (RFC 4180) out and in, safe to open in a spreadsheet: no text of a person becomes a formula.

Read are other programs' tables too: semicolons or tabs, decimal commas, Latin-1 and UTF-16, and usual column names.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from functools import partial

from contract.circular_error import CE90_SIGMAS, LE90_SIGMAS
from contract.errors import InputError
from ground.formats.coordinate_text import read_coordinate
from ground.formats.coordinates import Grid
from ground.formats.imported import Imported, entered_pin
from ground.formats.mark import Mark
from ground.formats.split_columns import HALVES, SplitColumns
from ground.pins.model import Pin

# What a spreadsheet takes for the beginning of a formula, also after blanks (OWASP, CSV injection).
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")
_QUOTE = "'"
COLUMNS = (
    "number", "name", "category", "status", "lat_deg", "lon_deg", "height_ellipsoid_m", "height_amsl_m", "ce90_m",
    "le90_m", "semi_major_m", "semi_minor_m", "azimuth_deg", "time_utc", "who", "vehicle", "frame", "u_px", "v_px",
    "method", "clicks", "note", "reason", "id",
)  # fmt: skip
_GRID = ("crs", "x", "y")
# Other names of our columns, in small letters.
_ALIASES = {
    "lat_deg": ("lat", "latitude"), "lon_deg": ("lon", "long", "lng", "longitude"), "name": ("title", "label"),
    "note": ("notes", "description", "desc", "comment"), "category": ("type",), "time_utc": ("time", "timestamp"),
}  # fmt: skip
_COLUMN_OF = {alias: name for name, aliases in _ALIASES.items() for alias in (name, *aliases)}


def header(grid: Grid | None = None) -> str:
    return _line([*COLUMNS, *(_GRID if grid is not None else ())])


def row(mark: Mark, grid: Grid | None = None) -> str:
    """One line; cells that are not known are empty."""
    e = mark.ellipse
    lat, lon = mark.position if mark.is_placed else (None, None)
    cells: list[str] = [
        "" if mark.number is None else str(mark.number), safe(mark.name), safe(mark.category), safe(mark.status),
        _figure(lat, 9), _figure(lon, 9), _figure(mark.height_ellipsoid_m), _figure(mark.height_amsl_m),
        _figure(mark.ce90_m), _figure(mark.le90_m),
        *(("", "", "") if e is None else (_figure(e.semi_major_m), _figure(e.semi_minor_m), _figure(e.azimuth_deg, 2))),
        mark.time_text, safe(mark.who), safe(mark.vehicle), "" if mark.frame is None else str(mark.frame),
        _figure(mark.u_px), _figure(mark.v_px), safe(mark.method), str(mark.clicks), safe(mark.note),
        safe(mark.reason), safe(mark.id),
    ]  # fmt: skip
    if grid is not None:
        p = grid.of(mark) if mark.is_placed else None
        cells += ["", "", ""] if p is None else [safe(p.crs), _figure(p.x, 9 if p.is_degrees else 3), _figure(p.y, 9)]
    return _line(cells)


def write(marks: Sequence[Mark], grid: Grid | None = None) -> str:
    return header(grid) + "".join(row(mark, grid) for mark in marks)


def safe(text: str) -> str:
    """A text as a cell that no spreadsheet calculates: an apostrophe before a formula, or before another one."""
    begins = text.lstrip(" \u00a0\ufeff").startswith(_FORMULA) or text.startswith(_QUOTE)
    return f"{_QUOTE}{text}" if begins else text


def _unsafe(text: str) -> str:
    return text[1:] if text.startswith(_QUOTE) else text


def _line(cells: Sequence[str]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\r\n").writerow(cells)
    return out.getvalue()


def _figure(value: float | None, digits: int = 3) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def read(data: bytes, who: str = "", now_unix_ns: int = 0) -> Imported:
    """Rows with latitude and longitude (WGS84), and other columns of ours. Raises InputError with the line."""
    out = Imported()
    try:
        text = _decoded(data)
        delimiter = _delimiter(text)
        rows = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
        names = next(rows, [])
        columns = _columns(names)
        split = SplitColumns.of(names, columns)
        for cells in rows:
            got = {name: cells[k] for name, k in columns.items() if k < len(cells)}
            if not got.get("lat_deg", "").strip():
                out.left_out += any(cell.strip() for cell in cells)
                continue
            make = partial(_pin, got, cells, len(names), split, delimiter != ",", who, now_unix_ns)
            out.take(f"CSV, line {rows.line_num}", make)
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"not a CSV file ({error})") from error
    return out.checked()


def _decoded(data: bytes) -> str:
    """UTF-8, or what older spreadsheets write: UTF-16 with its mark, else Windows' Latin-1."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace")


def _delimiter(text: str) -> str:
    """The one of comma, semicolon and tab that parts most names in the first line."""
    first = text.lstrip("\r\n").partition("\n")[0]
    return max(",;\t", key=first.count)


def _columns(names: Sequence[str]) -> dict[str, int]:
    """Our name of each column that is known -> its index; our own spelling goes before another."""
    plain = [name.strip().lower() for name in names]
    found = {_COLUMN_OF.get(name, name): k for k, name in reversed(list(enumerate(plain)))}
    found |= {name: k for k, name in enumerate(plain) if name in COLUMNS}
    if not {"lat_deg", "lon_deg"} <= set(found):
        raise InputError(
            "CSV: its first line must name the columns, among them lat and lon (or latitude and longitude)"
        )
    return found


def _pin(
    got: dict[str, str],
    cells: Sequence[str],
    width: int,
    split: SplitColumns,
    has_decimal_commas: bool,
    who: str,
    now_unix_ns: int,
) -> Pin:
    """One row's, of a table whose first line names `width` columns. Raises InputError."""
    if "".join(cells[width:]).strip():
        raise InputError("more cells than the first line names: a text or a number with a comma needs quotes")
    split.check_system(cells)

    def number(name: str) -> float | None:
        text = got.get(name, "").strip()
        text = text.replace(",", ".") if has_decimal_commas else text
        try:
            return float(text) if text else None
        except ValueError as error:
            raise InputError(f"{name}: {text[:40]!r} is not a number") from error

    degrees = {name: got.get(name, "") for name in HALVES}
    if not degrees["lon_deg"].strip():
        raise InputError("no longitude")
    place = split.place(cells, degrees)
    try:
        lat, lon = place or (number("lat_deg"), number("lon_deg"))
    except InputError:  # degrees with minutes, or with letters
        read = read_coordinate(" ".join(text.replace(",", ".") for text in degrees.values()))
        lat, lon = read.lat_deg, read.lon_deg
    assert lat is not None
    assert lon is not None
    ce90, le90 = number("ce90_m"), number("le90_m")
    return entered_pin(
        lat_deg=lat, lon_deg=lon, height_ellipsoid_m=number("height_ellipsoid_m"),
        height_amsl_m=number("height_amsl_m"), sigma_m=None if ce90 is None else ce90 / CE90_SIGMAS,
        sigma_height_m=None if le90 is None else le90 / LE90_SIGMAS, name=_unsafe(got.get("name", "")),
        note=_unsafe(got.get("note", "")), category=got.get("category", "").strip().lower(), who=who,
        time_text=got.get("time_utc", ""), now_unix_ns=now_unix_ns,
    )  # fmt: skip
