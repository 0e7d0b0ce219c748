"""CSV (RFC 4180) out and in, safe to open in a spreadsheet: no text of a person becomes a formula.

Read are other programs' tables too: semicolons or tabs, decimal commas, Latin-1 and UTF-16, and usual column names.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from contract.circular_error import CE90_SIGMAS, LE90_SIGMAS
from contract.errors import InputError
from ground.formats.coordinate_text import read_coordinate
from ground.formats.coordinates import Grid, coordinate, projected
from ground.formats.imported import Imported, entered_pin
from ground.formats.mark import Mark
from ground.formats.split_columns import HALVES, SplitColumns
from ground.pins.model import Pin

# What a spreadsheet takes for the beginning of a formula, also after blanks (OWASP, CSV injection).
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")
_QUOTE = "'"
_SEPARATOR = re.compile(r'"?sep=([,;\t])"?\r?\n', re.IGNORECASE)  # a spreadsheet's own line before the first
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
        p = projected(mark, grid)
        cells += ["", "", ""] if p is None else [safe(p.crs), coordinate(p, p.x), coordinate(p, p.y)]
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
        stated = _SEPARATOR.match(text)
        text = text[stated.end() :] if stated else text
        delimiter = stated[1] if stated else _delimiter(text)
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
        names = next(reader, [])
        columns = _columns(names)
        rows = [(reader.line_num + bool(stated), cells) for cells in reader]
        split = SplitColumns.of(names, {name: which[0] for name, which in columns.items()}, [row for _, row in rows])
        head = _Head(len(names), columns, split, delimiter != ",")
        for line, cells in rows:
            if not _filled(cells, columns["lat_deg"]).strip():
                out.left_out += any(cell.strip() for cell in cells)
                continue
            out.take(f"CSV, line {line}", partial(_pin, head, cells, who, now_unix_ns))
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


def _columns(names: Sequence[str]) -> dict[str, list[int]]:
    """Our name of each column that is known -> the indexes of those that are it: of our own spelling, else of others.

    A latitude of ours goes only with a longitude of ours: of two pairs of columns each is a place of its own.
    """
    plain = [name.strip().lower() for name in names]
    found: dict[str, list[int]] = {}
    for k, name in enumerate(plain):
        found.setdefault(_COLUMN_OF.get(name, name), []).append(k)
    own = {name: [k for k, other in enumerate(plain) if other == name] for name in COLUMNS}
    if not all(own[half] for half in HALVES):
        own |= {half: [] for half in HALVES}
    found |= {name: which for name, which in own.items() if which}
    if not set(HALVES) <= set(found):
        raise InputError(
            "CSV: its first line must name the columns, among them lat and lon (or latitude and longitude)"
        )
    return found


@dataclass(frozen=True)
class _Head:
    """The first line of a table: its width, where each of our columns is, and what else is part of a place."""

    width: int
    columns: Mapping[str, Sequence[int]]
    split: SplitColumns
    has_decimal_commas: bool


def _filled(cells: Sequence[str], which: Sequence[int]) -> str:
    """The first of some columns' cells that is not empty."""
    return next((cells[k] for k in which if k < len(cells) and cells[k].strip()), "")


def _check_agree(cells: Sequence[str], columns: Mapping[str, Sequence[int]]) -> None:
    """Raise InputError for a row with two latitudes or longitudes that differ: which of them is meant is not known."""
    for half, word in zip(HALVES, ("latitude", "longitude"), strict=True):
        texts = {cells[k].strip() for k in columns[half] if k < len(cells)} - {""}
        if len({_as_number(text) for text in texts}) > 1:
            raise InputError(f"has two {word}s that differ: leave one of them")


def _as_number(text: str) -> float | str:
    """The value of a text that is a number, to a decimetre of a place; else the text."""
    try:
        return round(float(text.replace(",", ".")), 6)
    except ValueError:
        return text


def _pin(head: _Head, cells: Sequence[str], who: str, now_unix_ns: int) -> Pin:
    """One row's. Raises InputError."""
    if "".join(cells[head.width :]).strip():
        raise InputError("more cells than the first line names: a text or a number with a comma needs quotes")
    head.split.check_system(cells)
    _check_agree(cells, head.columns)
    got = {name: _filled(cells, which) for name, which in head.columns.items()}

    def number(name: str) -> float | None:
        text = got.get(name, "").strip()
        text = text.replace(",", ".") if head.has_decimal_commas else text
        try:
            return float(text) if text else None
        except ValueError as error:
            raise InputError(f"{name}: {text[:40]!r} is not a number") from error

    degrees = {name: got.get(name, "") for name in HALVES}
    if not degrees["lon_deg"].strip():
        raise InputError("no longitude")
    place = head.split.place(cells, degrees)
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
