"""The MBTiles file that keeps the tiles of downloaded areas."""

from __future__ import annotations

import contextlib
import sqlite3
import threading
from pathlib import Path
from typing import Any

from contract.errors import InputError
from ground.web.tiles import Bounds, is_of_map

Range = tuple[int, int, int, int]
"""First and last column, first and last row of tiles; rows count from the north."""

_SCHEMA = """
CREATE TABLE IF NOT EXISTS metadata (name TEXT PRIMARY KEY, value TEXT);
CREATE TABLE IF NOT EXISTS tiles (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, tile_data BLOB,
    PRIMARY KEY (zoom_level, tile_column, tile_row));
"""
BUSY_S = 10.0  # for another program's transaction


class TileKeep:
    """One file, made with the first tile that is kept. Raises InputError for one that is none, and for a full disk.

    Of one that has been damaged since, what cannot be read is not there: the map has the address.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._base: sqlite3.Connection | None = None
        if path.exists():
            self._open()

    def _open(self) -> sqlite3.Connection:
        if self._base is None:
            try:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                base = sqlite3.connect(self.path, timeout=BUSY_S, check_same_thread=False)
                base.executescript(_SCHEMA)
                self._base = base
            except (OSError, sqlite3.Error) as error:
                raise InputError(f"tiles {self.path}: {error}; remove the file, it is made again") from error
        return self._base

    def _rows(self, query: str, values: tuple[int, ...] = ()) -> list[tuple[Any, ...]]:
        with self._lock:
            if self._base is None:
                return []
            with contextlib.suppress(sqlite3.Error):
                return self._base.execute(query, values).fetchall()
            return []

    def about(self) -> dict[str, str]:
        return {str(name): str(value) for name, value in self._rows("SELECT name, value FROM metadata")}

    def count(self, zoom: int, within: Range) -> int:
        """The number of tiles that are kept of a range."""
        west, east, north, south = within
        last = (1 << zoom) - 1
        query = (
            "SELECT count(*) FROM tiles WHERE zoom_level = ? AND tile_column BETWEEN ? AND ? "
            "AND tile_row BETWEEN ? AND ?"
        )
        return sum(int(count) for (count,) in self._rows(query, (zoom, west, east, last - south, last - north)))

    def mean_bytes(self) -> float | None:
        """Return the mean size of the tiles that are kept, bytes; None without any."""
        return next((mean for (mean,) in self._rows("SELECT avg(length(tile_data)) FROM tiles")), None)

    def tile(self, z: int, x: int, y: int) -> bytes | None:
        """A tile as it was kept; None for one that is not here."""
        if not is_of_map(z, x, y):
            return None
        query = "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?"
        return next((bytes(data) for (data,) in self._rows(query, (z, x, (1 << z) - 1 - y))), None)

    def keep(self, tiles: list[tuple[int, int, int, bytes]], about: dict[str, str], bounds: Bounds) -> None:
        """Keep tiles, the metadata, and zooms and bounds that hold the earlier ones too, in one transaction."""
        with self._lock:
            base = self._open()
            held = dict(base.execute("SELECT name, value FROM metadata").fetchall())
            zooms = [z for z, _, _, _ in tiles]
            if "bounds" in held:
                west, south, east, north = (float(part) for part in str(held["bounds"]).split(","))
                bounds = min(west, bounds[0]), min(south, bounds[1]), max(east, bounds[2]), max(north, bounds[3])
                zooms += [int(held["minzoom"]), int(held["maxzoom"])]
            all_about = {
                **about,
                "bounds": ",".join(f"{part:.6f}" for part in bounds),
                "minzoom": str(min(zooms)),
                "maxzoom": str(max(zooms)),
            }
            rows = [(z, x, (1 << z) - 1 - y, tile) for z, x, y, tile in tiles]
            try:
                with base:
                    base.executemany("INSERT OR REPLACE INTO tiles VALUES (?, ?, ?, ?)", rows)
                    base.executemany("INSERT OR REPLACE INTO metadata VALUES (?, ?)", all_about.items())
            except sqlite3.Error as error:
                raise InputError(f"tiles {self.path}: {error}") from error

    def close(self) -> None:
        with self._lock:
            if self._base is not None:
                self._base.close()
                self._base = None
