"""All formats by name: what `--format` may be, and which file holds what."""

from __future__ import annotations

import contextlib
import gc
import json
import re
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from contract.errors import InputError
from ground.formats import cot, geojson, gpx, kml, table
from ground.formats.coordinates import Grid, has_utm, latlon_text, mgrs_text, projected, utm_text
from ground.formats.imported import Imported
from ground.formats.mark import Mark
from ground.formats.rounded import rounded_text

COT_STALE_S = 3600.0
MAX_IMPORT_BYTES = 500_000_000


@dataclass(frozen=True)
class Format:
    """One format. `line` writes one mark, where a format is lines; `write` several at once."""

    name: str
    media_type: str
    suffix: str
    write: Callable[[Sequence[Mark], Grid | None], str]
    line: Callable[[Mark, Grid | None], str | None] | None = None


def text_line(mark: Mark, grid: Grid | None = None) -> str:
    """The mark in a line for people."""
    p = projected(mark, grid)
    if mark.answer is not None and mark.is_placed:
        rest = mark.answer.to_text()
        return rest if p is None else f"{p.text}  {p.crs} {rest.partition('  ')[2]}"
    if mark.answer is not None:
        return mark.answer.to_text()
    where = rounded_text("degrees", *mark.position, mark.ce90_m) if mark.is_placed else "-"
    if p is not None:
        where = f"{p.text}  {p.crs}"
    name = one_line(mark.name)
    words = (mark.number_text or "-", mark.category, name or "(no name)", where, mark.accuracy_text, mark.time_text)
    return "  ".join(words).rstrip()


def json_line(mark: Mark, grid: Grid | None = None) -> str:
    """One JSON object: of a click its answer's own, with the grid's numbers if there is one."""
    if mark.answer is not None:
        base = mark.answer.to_json()
    else:
        lat, lon = mark.position if mark.is_placed else (None, None)
        e = mark.ellipse
        ellipse = None
        if e is not None:
            axes = {"semi_major_m": round(e.semi_major_m, 3), "semi_minor_m": round(e.semi_minor_m, 3)}
            ellipse = {"confidence": 0.9, **axes, "azimuth_deg": round(e.azimuth_deg, 2)}
        base = json.dumps(
            {
                "status": mark.status, "number": mark.number, "name": mark.name, "category": mark.category,
                "lat_deg": _rounded(lat, 9), "lon_deg": _rounded(lon, 9),
                "height_ellipsoid_m": _rounded(mark.height_ellipsoid_m), "height_amsl_m": _rounded(mark.height_amsl_m),
                "ce90_m": _rounded(mark.ce90_m), "le90_m": _rounded(mark.le90_m), "ellipse": ellipse,
                "reason": mark.reason, "note": mark.note, "who": mark.who, "vehicle": mark.vehicle,
                "time_utc": mark.time_text or None, "clicks": mark.clicks, "ties": mark.tied, "id": mark.id,
            }
        )  # fmt: skip
    p = projected(mark, grid)
    if p is None:
        return base
    digits = 9 if p.is_degrees else 3
    more = {
        "name": p.crs, "x": round(p.x, digits), "y": round(p.y, digits), "x_axis": p.x_name, "y_axis": p.y_name,
        "accuracy_m": p.accuracy_m,
    }  # fmt: skip
    return f'{base[:-1]}, "crs": {json.dumps(more)}}}'


def _coordinate_line(of: Callable[[float, float], str]) -> Callable[[Mark, Grid | None], str | None]:
    def line(mark: Mark, grid: Grid | None = None) -> str | None:
        if not mark.is_placed:
            return None
        name = "" if mark.number is None else f"  {one_line(mark.title)}"
        return f"{of(*mark.position)}  {mark.accuracy_text}{name}"

    return line


def _utm_or_degrees(lat_deg: float, lon_deg: float) -> str:
    """UTM where it reaches: beyond it one pin's line must not cost all others theirs."""
    if not has_utm(lat_deg):
        return f"{latlon_text(lat_deg, lon_deg)} (degrees: no UTM beyond 80 S and 84 N)"
    return utm_text(lat_deg, lon_deg)


def _cot_line(mark: Mark, grid: Grid | None = None) -> str | None:
    return cot.event(mark, time.time_ns(), COT_STALE_S)


def _lines(line: Callable[[Mark, Grid | None], str | None]) -> Callable[[Sequence[Mark], Grid | None], str]:
    def write(marks: Sequence[Mark], grid: Grid | None = None) -> str:
        return "".join(f"{text}\n" for mark in marks if (text := line(mark, grid)) is not None)

    return write


def _of_lines(
    name: str, line: Callable[[Mark, Grid | None], str | None], media_type: str = "text/plain", suffix: str = ".txt"
) -> Format:
    return Format(name, media_type, suffix, _lines(line), line)


FORMATS: dict[str, Format] = {
    f.name: f
    for f in (
        _of_lines("text", text_line),
        _of_lines("json", json_line, "application/x-ndjson", ".ndjson"),
        Format("geojson", "application/geo+json", ".geojson", geojson.write),
        Format("kml", "application/vnd.google-earth.kml+xml", ".kml", kml.write),
        Format("gpx", "application/gpx+xml", ".gpx", gpx.write),
        Format("csv", "text/csv", ".csv", table.write),
        _of_lines("cot", _cot_line, "application/xml", ".cot"),
        _of_lines("mgrs", _coordinate_line(mgrs_text)),
        _of_lines("utm", _coordinate_line(_utm_or_degrees)),
        _of_lines("dms", _coordinate_line(lambda lat, lon: latlon_text(lat, lon, "seconds"))),
        _of_lines("dm", _coordinate_line(lambda lat, lon: latlon_text(lat, lon, "minutes"))),
    )
}

_READERS: dict[str, Callable[[bytes, str, int], Imported]] = {
    "geojson": geojson.read, "kml": kml.read, "gpx": gpx.read, "csv": table.read, "cot": cot.read,
}  # fmt: skip
IMPORTED = tuple(_READERS)
_KINDS = {
    ".geojson": "geojson", ".json": "geojson", ".kml": "kml", ".gpx": "gpx", ".csv": "csv", ".tsv": "csv",
    ".cot": "cot", ".xml": "cot", ".kmz": "kml",
}  # fmt: skip


def read_pins(path: Path, kind: str | None = None, who: str = "") -> Imported:
    """The places of a file, whose kind is known from its name unless it is given. Raises InputError."""
    try:
        if path.stat().st_size > MAX_IMPORT_BYTES:
            raise InputError(f"{path}: larger than {MAX_IMPORT_BYTES // 1_000_000} MB")
        return read_pins_of(str(path), path.read_bytes(), kind, who)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from error


def read_pins_of(name: str, data: bytes, kind: str | None = None, who: str = "") -> Imported:
    """The same of a file's name and content, as a browser sends them. Raises InputError, which names the file."""
    chosen = kind or _KINDS.get(Path(name).suffix.lower())
    if chosen not in _READERS:
        raise InputError(f"{name}: of which kind? its name should end in {', '.join(_KINDS)}; or give --format")
    try:
        with _no_collection():
            return _READERS[chosen](data, who, time.time_ns())
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


@contextlib.contextmanager
def _no_collection() -> Iterator[None]:
    """Without the collector of cycles: a document that is read has none, and it would be walked again and again.

    Of the 2.0 s of processor that a document of 390,000 elements takes, that is 1.4 s.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def one_line(text: str) -> str:
    """A text for a terminal: no line feeds, and nothing that steers it."""
    return re.sub(r"\s+", " ", "".join(c if c.isprintable() or c.isspace() else "\ufffd" for c in text)).strip()


def _rounded(value: float | None, digits: int = 3) -> float | None:
    return None if value is None else round(value, digits)
