"""OpenDroneMap's file of positions of photographs by their names (geo.txt). It has no times: it is no log.

Its camera angles are not read: their zero is not specified, and tools write 0 where they have none.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from contract.errors import InputError

_SYSTEM = re.compile(r"(?:EPSG:\d+|WGS84 UTM \d+[NS]|\+proj=\S.*)\s*", re.IGNORECASE)
_DEGREES = re.compile(r"EPSG:4326|\+proj=(?:longlat|latlong)\b.*", re.IGNORECASE)
HEIGHT, SIGMAS = 3, (7, 8)  # cells of a line
MAX_HEIGHT_M = 1e5


@dataclass(frozen=True)
class GeoPlace:
    """A photograph's position: degrees, metres above an unnamed origin, and its one sigma where it is stated."""

    lat_deg: float
    lon_deg: float
    height_m: float
    sigma_horizontal_m: float | None
    sigma_vertical_m: float | None


def begins_geo(head: bytes) -> bool:
    return _SYSTEM.fullmatch(head.decode("utf-8-sig", "replace").partition("\n")[0]) is not None


def read_geo(path: Path) -> dict[str, GeoPlace]:
    """Read positions by the photographs' names. Raises InputError, one line, for coordinates that are not degrees, for
    a position without a height, and for a line that cannot be read.
    """
    try:
        system, *lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except (OSError, ValueError) as error:
        raise InputError(f"positions {path}: {getattr(error, 'strerror', None) or 'the file is empty'}") from error
    if _DEGREES.fullmatch(system.strip()) is None:
        raise InputError(f"positions {path}: its coordinates are in {system.strip()[:60]}: write it in EPSG:4326")
    out = {}
    for number, line in enumerate(lines, start=2):
        if cells := line.split():
            try:
                out[cells[0]] = _place(cells)
            except (ValueError, IndexError) as error:
                raise InputError(
                    f"positions {path}, line {number}: not name, longitude, latitude and height, in degrees and metres"
                ) from error
    return out


def _place(cells: list[str]) -> GeoPlace:
    lon_deg, lat_deg, height_m = map(float, cells[1 : HEIGHT + 1])
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0 and abs(height_m) <= MAX_HEIGHT_M):
        raise ValueError
    horizontal_m, vertical_m = (float(cells[at]) if len(cells) > at else 0.0 for at in SIGMAS)
    return GeoPlace(lat_deg, lon_deg, height_m, _sigma(horizontal_m), _sigma(vertical_m))


def _sigma(value_m: float) -> float | None:
    return value_m if 0.0 < value_m < 1e4 else None
