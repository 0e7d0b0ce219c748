"""The base map: a PMTiles or MBTiles file of the operator's own, or somebody's tiles by URL."""

from __future__ import annotations

import sqlite3
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from contract.errors import InputError
from ground.web.guard import origin_of

PMTILES_MAGIC = b"PMTiles"
_GZIP = b"\x1f\x8b"
_MEDIA = {
    "png": "image/png",
    "jpg": "image/jpeg",
    "jpeg": "image/jpeg",
    "webp": "image/webp",
    "pbf": "application/x-protobuf",
}
_PMTILES_TYPE_AT, _VECTOR = 99, 1  # of the header's byte that says what tiles are


@dataclass(frozen=True)
class Tiles:
    """Where tiles come from. `kind`: pmtiles, mbtiles, template (a URL with {z}, {x} and {y})."""

    kind: str
    path: Path | None
    url: str  # for the page
    origin: str  # another origin that the page then loads from; empty for none
    format: str = ""  # of MBTiles: png, jpg, webp, pbf
    max_zoom: int = 0
    attribution: str = ""

    def to_dict(self) -> dict[str, Any]:
        """For the page."""
        return {
            "kind": self.kind, "url": self.url, "format": self.format, "max_zoom": self.max_zoom,
            "attribution": self.attribution,
        }  # fmt: skip


def open_tiles(said: str) -> Tiles:
    """As the option says. Raises InputError for a file that holds no tiles, before anything is served."""
    if said.startswith(("http://", "https://")):
        kind = "pmtiles" if said.split("?", maxsplit=1)[0].endswith(".pmtiles") else "template"
        if kind == "template" and not all(f"{{{axis}}}" in said for axis in "zxy"):
            raise InputError(f"tiles {said}: a URL must end with .pmtiles or hold {{z}}, {{x}} and {{y}}")
        return Tiles(kind, None, said, origin_of(said), "pbf" if kind == "pmtiles" else "")
    path = Path(said)
    try:
        with path.open("rb") as stream:
            start = stream.read(127)
    except OSError as error:
        raise InputError(f"tiles {said}: {error.strerror}") from error
    if start.startswith(PMTILES_MAGIC):
        is_vector = len(start) > _PMTILES_TYPE_AT and start[_PMTILES_TYPE_AT] == _VECTOR
        return Tiles("pmtiles", path, "/tiles/base.pmtiles", "", "pbf" if is_vector else "")
    if start.startswith(b"SQLite format 3\x00"):
        return _mbtiles(path)
    raise InputError(f"tiles {said}: neither a PMTiles nor an MBTiles file")


def _mbtiles(path: Path) -> Tiles:
    try:
        with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as base:
            about = dict(base.execute("SELECT name, value FROM metadata").fetchall())
            (deepest,) = base.execute("SELECT max(zoom_level) FROM tiles").fetchone()
    except sqlite3.Error as error:
        raise InputError(f"tiles {path}: not an MBTiles file ({error})") from error
    if deepest is None:
        raise InputError(f"tiles {path}: holds no tiles")
    kind = str(about.get("format", "png"))
    return Tiles("mbtiles", path, "/tiles/{z}/{x}/{y}", "", kind, int(deepest), str(about.get("attribution", ""))[:300])


class MbTiles:
    """One tile after the other out of a file; rows count from the south there."""

    def __init__(self, tiles: Tiles) -> None:
        self._lock = threading.Lock()
        self._base = sqlite3.connect(f"file:{tiles.path}?mode=ro", uri=True, check_same_thread=False)
        self.media_type = _MEDIA.get(tiles.format, "application/octet-stream")

    def tile(self, z: int, x: int, y: int) -> tuple[bytes, bool] | None:
        """A tile, and whether it is compressed by gzip; None if the file has none there."""
        if not 0 <= z <= 30 or not 0 <= x < 1 << z or not 0 <= y < 1 << z:
            return None
        query = "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?"
        with self._lock:
            found = self._base.execute(query, (z, x, (1 << z) - 1 - y)).fetchone()
        return None if found is None else (bytes(found[0]), bytes(found[0][:2]) == _GZIP)
