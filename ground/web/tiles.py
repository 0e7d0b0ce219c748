"""The base map: a PMTiles or MBTiles file of the operator's own, or tiles from a URL."""

from __future__ import annotations

import contextlib
import math
import sqlite3
import struct
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from contract.errors import InputError
from ground.web.guard import origin_of

PMTILES_MAGIC = b"PMTiles"
_GZIP = b"\x1f\x8b"
MEDIA = {
    "png": "image/png",
    "jpg": "image/jpeg",
    "jpeg": "image/jpeg",
    "webp": "image/webp",
    "pbf": "application/x-protobuf",
}
_PMTILES_TYPE_AT, _VECTOR = 99, 1  # of the header's byte that specifies the tiles' type
_PMTILES_ZOOMS_AT = 100  # two bytes; then west, south, east, north as little-endian 1e-7 degrees
LAST_ZOOM = 30  # of any map
MERCATOR_LAT_DEG = 85.051129  # where the square map of the world ends
Bounds = tuple[float, float, float, float]
"""West, south, east, north, in degrees."""


@dataclass(frozen=True)
class Tiles:
    """The source of tiles. `kind`: pmtiles, mbtiles, tilejson, template (a URL with {z}, {x} and {y}).

    Of a URL the page itself reads zooms and bounds; a template has none.
    """

    kind: str
    path: Path | None
    url: str  # for the page
    origin: str  # another origin that the page then loads from; empty for none
    format: str = ""  # of MBTiles: png, jpg, webp, pbf
    max_zoom: int = 0
    attribution: str = ""
    min_zoom: int = 0
    bounds: Bounds | None = None  # of what there are tiles of; None: not known here

    def to_dict(self) -> dict[str, Any]:
        return {
            "kind": self.kind, "url": self.url, "format": self.format, "max_zoom": self.max_zoom,
            "attribution": self.attribution, "min_zoom": self.min_zoom, "bounds": self.bounds,
        }  # fmt: skip


def open_tiles(source: str, attribution: str = "") -> Tiles:
    """Open the tiles that the option names. Raises InputError for a file that holds none, before anything is served.

    `attribution`: as the user states it, instead of the one that the file or the address has.
    """
    if source.startswith(("http://", "https://")):
        ending = Path(source.split("?", maxsplit=1)[0]).suffix
        kind = {".pmtiles": "pmtiles", ".json": "tilejson"}.get(ending, "template")
        if kind == "template" and not all(f"{{{axis}}}" in source for axis in "zxy"):
            raise InputError(f"tiles {source}: a URL must end with .pmtiles or .json, or hold {{z}}, {{x}} and {{y}}")
        return Tiles(kind, None, source, origin_of(source), attribution=attribution)
    path = Path(source)
    try:
        with path.open("rb") as stream:
            start = stream.read(127)
    except OSError as error:
        raise InputError(f"tiles {source}: {error.strerror}") from error
    if start.startswith(PMTILES_MAGIC):
        return _pmtiles(path, start, attribution)
    if start.startswith(b"SQLite format 3\x00"):
        return _mbtiles(path, attribution)
    raise InputError(f"tiles {source}: neither a PMTiles nor an MBTiles file")


def _pmtiles(path: Path, header: bytes, attribution: str) -> Tiles:
    if len(header) < 127:
        raise InputError(f"tiles {path}: ends within its header")
    least, most = header[_PMTILES_ZOOMS_AT], header[_PMTILES_ZOOMS_AT + 1]
    corners = (n / 1e7 for n in struct.unpack_from("<4i", header, _PMTILES_ZOOMS_AT + 2))
    kind = "pbf" if header[_PMTILES_TYPE_AT] == _VECTOR else ""
    return Tiles("pmtiles", path, "/tiles/base.pmtiles", "", kind, most, attribution, least, _bounds(*corners))


def _mbtiles(path: Path, attribution: str) -> Tiles:
    try:
        with contextlib.closing(_connected(path)) as base:
            about = dict(base.execute("SELECT name, value FROM metadata").fetchall())
            ((most,),) = base.execute("SELECT max(zoom_level) FROM tiles")
            ((least,),) = base.execute("SELECT min(zoom_level) FROM tiles")
            edges_of = "min(tile_column), max(tile_column), min(tile_row), max(tile_row)"
            (edges,) = base.execute(f"SELECT {edges_of} FROM tiles WHERE zoom_level = ?", (least,))
    except sqlite3.Error as error:
        raise InputError(f"tiles {path}: not an MBTiles file ({error})") from error
    if most is None:
        raise InputError(f"tiles {path}: holds no tiles")
    if not all(isinstance(n, int) for n in (least, most, *edges)) or not 0 <= least <= most <= LAST_ZOOM:
        raise InputError(f"tiles {path}: not an MBTiles file (its zooms, columns and rows are not those of a map)")
    kind = str(about.get("format", "png"))
    bounds = _stated_bounds(str(about.get("bounds", ""))) or _tiles_bounds(int(least), *edges)
    text = attribution or str(about.get("attribution", ""))[:300]
    return Tiles("mbtiles", path, "/tiles/{z}/{x}/{y}", "", kind, int(most), text, int(least), bounds)


def is_of_map(z: int, x: int, y: int) -> bool:
    """Return whether there is a tile of that zoom, column and row on a map of the world."""
    return 0 <= z <= LAST_ZOOM and 0 <= x < 1 << z and 0 <= y < 1 << z


def _connected(path: Path | None) -> sqlite3.Connection:
    """An MBTiles file to read from; its name may have any characters, also those that end a URI's path."""
    return sqlite3.connect(f"file:{quote(str(path))}?mode=ro", uri=True, check_same_thread=False)


def _stated_bounds(text: str) -> Bounds | None:
    """The bounds as the metadata have them: west,south,east,north. None if they cannot be read."""
    try:
        west, south, east, north = (float(part) for part in text.split(","))
    except ValueError:
        return None
    return _bounds(west, south, east, north)


def _bounds(west: float, south: float, east: float, north: float) -> Bounds | None:
    """None for what cannot be the bounds of a map; some writers leave them at nothing, or go beyond the poles."""
    is_possible = -180.0 <= west < east <= 180.0 and -90.0 <= south < north <= 90.0
    return (west, max(south, -MERCATOR_LAT_DEG), east, min(north, MERCATOR_LAT_DEG)) if is_possible else None


def _tiles_bounds(zoom: int, west: int, east: int, south: int, north: int) -> Bounds | None:
    """The bounds of columns and rows of tiles; rows count from the south."""
    n = float(1 << zoom)

    def latitude(row: int) -> float:
        return math.degrees(math.atan(math.sinh(math.pi * (2.0 * row / n - 1.0))))

    return _bounds(360.0 * west / n - 180.0, latitude(south), 360.0 * (east + 1) / n - 180.0, latitude(north + 1))


class MbTiles:
    """One tile after the other out of a file; rows count from the south there."""

    def __init__(self, tiles: Tiles) -> None:
        self._lock = threading.Lock()
        self._base = _connected(tiles.path)
        self.media_type = MEDIA.get(tiles.format, "application/octet-stream")

    def tile(self, z: int, x: int, y: int) -> tuple[bytes, bool] | None:
        """A tile, and whether it is compressed by gzip; None if the file has none there."""
        if not is_of_map(z, x, y):
            return None
        query = "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?"
        with self._lock:
            found = self._base.execute(query, (z, x, (1 << z) - 1 - y)).fetchone()
        is_one = found is not None and isinstance(found[0], bytes)  # SQLite keeps anything in any column
        return (found[0], found[0][:2] == _GZIP) if is_one else None
