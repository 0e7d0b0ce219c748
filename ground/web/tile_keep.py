"""The MBTiles file that keeps the tiles of downloaded areas."""

from __future__ import annotations

import sqlite3
import threading
from pathlib import Path

from contract.errors import InputError
from ground.web.tiles import Bounds

Range = tuple[int, int, int, int]
"""First and last column, first and last row of tiles; rows count from the north."""

_SCHEMA = """
CREATE TABLE IF NOT EXISTS metadata (name TEXT PRIMARY KEY, value TEXT);
CREATE TABLE IF NOT EXISTS tiles (zoom_level INTEGER, tile_column INTEGER, tile_row INTEGER, tile_data BLOB,
    PRIMARY KEY (zoom_level, tile_column, tile_row));
"""
BUSY_S = 10.0  # for another program's transaction


class TileKeep:
    """One file, made with the first tile that is kept. Raises InputError for one that is none, and for a full disk."""

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

    def about(self) -> dict[str, str]:
        """The metadata; empty where nothing is kept."""
        with self._lock:
            if self._base is None:
                return {}
            return {str(name): str(value) for name, value in self._base.execute("SELECT name, value FROM metadata")}

    def count(self, zoom: int, within: Range) -> int:
        """The number of tiles that are kept of a range."""
        with self._lock:
            if self._base is None:
                return 0
            west, east, north, south = within
            query = "SELECT count(*) FROM tiles WHERE zoom_level = ? AND tile_column BETWEEN ? AND ? "
            last = (1 << zoom) - 1
            found = self._base.execute(
                query + "AND tile_row BETWEEN ? AND ?", (zoom, west, east, last - south, last - north)
            )
            return int(found.fetchone()[0])

    def mean_bytes(self) -> float | None:
        """Return the mean size of the tiles that are kept, bytes; None without any."""
        with self._lock:
            if self._base is None:
                return None
            (mean,) = self._base.execute("SELECT avg(length(tile_data)) FROM tiles").fetchone()
            return None if mean is None else float(mean)

    def tile(self, z: int, x: int, y: int) -> bytes | None:
        """A tile as it was kept; None for one that is not here."""
        if not 0 <= z <= 30 or not 0 <= x < 1 << z or not 0 <= y < 1 << z:
            return None
        query = "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?"
        with self._lock:
            if self._base is None:
                return None
            found = self._base.execute(query, (z, x, (1 << z) - 1 - y)).fetchone()
        return None if found is None else bytes(found[0])

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
