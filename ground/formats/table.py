"""CSV (RFC 4180) out and in, safe to open in a spreadsheet: no text of a person becomes a formula."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from contract.errors import InputError
from ground.circular_error import CE90_SIGMAS, LE90_SIGMAS
from ground.formats.coordinates import Grid
from ground.formats.imported import Imported, entered_pin
from ground.formats.mark import Mark

# What a spreadsheet takes for the beginning of a formula, also after blanks (OWASP, CSV injection).
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")
_QUOTE = "'"
COLUMNS = (
    "number", "name", "category", "status", "lat_deg", "lon_deg", "height_ellipsoid_m", "height_amsl_m", "ce90_m",
    "le90_m", "semi_major_m", "semi_minor_m", "azimuth_deg", "time_utc", "who", "vehicle", "frame", "u_px", "v_px",
    "method", "clicks", "note", "reason", "id",
)  # fmt: skip
_GRID = ("crs", "x", "y")


def header(grid: Grid | None = None) -> str:
    """The first line."""
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
    """With a header."""
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
    """Rows with lat_deg and lon_deg; the other columns of ours if they are there. Raises InputError with the line."""
    out = Imported()
    try:
        text = data.decode("utf-8-sig")
        rows = csv.DictReader(io.StringIO(text, newline=""), strict=True)
        if not {"lat_deg", "lon_deg"} <= set(rows.fieldnames or ()):
            raise InputError("CSV: its first line must name the columns lat_deg and lon_deg")
        for cells in rows:
            got = {name: value or "" for name, value in cells.items() if isinstance(name, str)}
            if not got["lat_deg"].strip():
                out.left_out += 1
                continue
            try:
                number = {
                    name: float(got[name]) if got.get(name, "").strip() else None
                    for name in ("lat_deg", "lon_deg", "height_ellipsoid_m", "height_amsl_m", "ce90_m", "le90_m")
                }
                lat, lon, ce90, le90 = (number[name] for name in ("lat_deg", "lon_deg", "ce90_m", "le90_m"))
                if lat is None or lon is None:
                    raise InputError("no longitude")
                pin = entered_pin(
                    lat_deg=lat, lon_deg=lon, height_ellipsoid_m=number["height_ellipsoid_m"],
                    height_amsl_m=number["height_amsl_m"], sigma_m=None if ce90 is None else ce90 / CE90_SIGMAS,
                    sigma_height_m=None if le90 is None else le90 / LE90_SIGMAS, name=_unsafe(got.get("name", "")),
                    note=_unsafe(got.get("note", "")), category=got.get("category"), who=who,
                    time_text=got.get("time_utc", ""), now_unix_ns=now_unix_ns,
                )  # fmt: skip
            except (ValueError, InputError) as error:
                raise InputError(f"CSV, line {rows.line_num}: {error}") from error
            out.pins.append(pin)
    except (csv.Error, UnicodeDecodeError) as error:
        raise InputError(f"not a CSV file ({error})") from error
    return out
