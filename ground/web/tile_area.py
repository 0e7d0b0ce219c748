"""Downloading an area of the base map from the configured address, and serving what was kept before the address."""

from __future__ import annotations

import hashlib
import math
import re
import sqlite3
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from contract.errors import InputError
from ground.web.tile_fetch import DEEPEST, TRIES, Description, Fetcher, described, fetching, image_format
from ground.web.tile_keep import Range, TileKeep
from ground.web.tiles import MERCATOR_LAT_DEG, Bounds, Tiles

MOST_TILES, MOST_BYTES = 5000, 200_000_000  # of one download
USUAL_BYTES = 25_000.0  # of a tile, where none is known
TOGETHER = 20  # tiles that are written in one transaction
ASK_AGAIN_S = 60.0  # after an address did not describe its tiles


@dataclass(frozen=True)
class View:
    """The part that the map shows: bounds in degrees, and the zoom of the tiles there."""

    bounds: Bounds
    zoom: int


def tile_range(bounds: Bounds, zoom: int) -> Range:
    """First and last column, first and last row of the tiles that cover bounds, in the square map of the world."""
    n = 1 << zoom

    def column(lon_deg: float) -> int:
        return min(max(int((lon_deg + 180.0) / 360.0 * n), 0), n - 1)

    def row(lat_deg: float) -> int:
        lat_rad = math.radians(min(max(lat_deg, -MERCATOR_LAT_DEG), MERCATOR_LAT_DEG))
        return min(max(int((1.0 - math.asinh(math.tan(lat_rad)) / math.pi) / 2.0 * n), 0), n - 1)

    return column(bounds[0]), column(bounds[2]), row(bounds[3]), row(bounds[1])


def _size(within: Range) -> int:
    return (within[1] - within[0] + 1) * (within[3] - within[2] + 1)


class TileArea:
    """The tiles of an address and the file of what was downloaded. One download at a time, in a thread of its own."""

    def __init__(self, tiles: Tiles, folder: Path) -> None:
        self._tiles = tiles
        name = re.sub(r"[^a-z0-9.-]", "_", Fetcher(tiles.url).host.lower())[:60]
        self._keep = TileKeep(folder / f"{name}-{hashlib.sha256(tiles.url.encode()).hexdigest()[:12]}.mbtiles")
        self._lock = threading.Lock()
        self._asking = threading.Lock()
        self._about: Description | None = None
        self._ask_after_s = 0.0
        self._thread: threading.Thread | None = None
        self._fetcher: Fetcher | None = None
        self._is_cancelled = False
        self._state: dict[str, Any] = {"state": "idle", "words": "", "tiles": 0, "of": 0, "gaps": 0, "bytes": 0}

    def plan(self, view: View) -> dict[str, Any]:
        """For each deepest zoom that is allowed: how many tiles, how many of them are here, about how many bytes.

        One tile is fetched, to know their size and that the address answers. Raises InputError.
        """
        with fetching(self._tiles.url, tries=1) as fetcher:
            about = self._about = described(self._tiles, fetcher)
            first, last = _zooms(view, about)
            columns = tile_range(view.bounds, first)
            middle = (columns[0] + columns[1]) // 2, (columns[2] + columns[3]) // 2
            sample = fetcher.tile(about, first, *middle)
        mean = self._keep.mean_bytes() or (USUAL_BYTES if sample is None else float(len(sample)))
        choices: list[dict[str, int]] = []
        count, held = 0, 0
        for zoom in range(first, last + 1):
            within = tile_range(view.bounds, zoom)
            count += _size(within)
            held += self._keep.count(zoom, within) if count <= MOST_TILES else 0
            if count > MOST_TILES or (count - held) * mean > MOST_BYTES:
                break
            choices.append({"deepest": zoom, "tiles": count, "held": held, "bytes": round((count - held) * mean)})
        if not choices:
            raise InputError(f"too many tiles ({count}; {MOST_TILES} and {MOST_BYTES / 1e6:.0f} MB at most): zoom in")
        return {"first": first, "choices": choices, "attribution": about.attribution}

    def begin(self, view: View, deepest: int) -> None:
        """Begin to download what was planned. Raises InputError where it is too much, or while another is under way."""
        about = self._about
        if about is None:
            with fetching(self._tiles.url, tries=1) as fetcher:
                about = self._about = described(self._tiles, fetcher)
        first, last = _zooms(view, about)
        zooms = range(first, min(deepest, last) + 1)
        count = sum(_size(tile_range(view.bounds, zoom)) for zoom in zooms)
        if not 0 < count <= MOST_TILES:
            raise InputError(f"too many tiles ({count}; {MOST_TILES} at most): zoom in" if count else "no such zoom")
        with self._lock:
            if self._thread is not None and self._thread.is_alive():
                raise InputError("an area is being downloaded: wait for it, or cancel it")
            self._is_cancelled = False
            self._state = {"state": "running", "words": "", "tiles": 0, "of": count, "gaps": 0, "bytes": 0}
            self._fetcher = Fetcher(self._tiles.url, TRIES)
            work = (self._fetcher, about, view.bounds, zooms)
            self._thread = threading.Thread(target=self._download, args=work, name="tiles", daemon=True)
            self._thread.start()

    def cancel(self) -> None:
        """End the download; what has been received stays."""
        with self._lock:
            if self._fetcher is not None:
                self._is_cancelled = True
                self._fetcher.abort()

    def state(self) -> dict[str, Any]:
        with self._lock:
            return {**self._state, "format": self._keep.about().get("format", "")}

    def tile(self, z: int, x: int, y: int) -> bytes | None:
        return self._keep.tile(z, x, y)

    def elsewhere(self, z: int, x: int, y: int) -> str | None:
        """The URL of a tile at the address; None while that does not describe its tiles."""
        about = self._about
        if about is None:
            with self._asking:
                about = self._about
                if about is None and time.monotonic() >= self._ask_after_s:
                    try:
                        with fetching(self._tiles.url, tries=1) as fetcher:
                            about = self._about = described(self._tiles, fetcher)
                    except InputError:
                        self._ask_after_s = time.monotonic() + ASK_AGAIN_S
        return None if about is None else about.url(z, x, y)

    def to_dict(self) -> dict[str, Any]:
        """The base map for the page: the address alone, until something of it is kept."""
        held = self._keep.about()
        if "bounds" not in held:
            return self._tiles.to_dict()
        return {
            "kind": "kept",
            "url": "/tiles/{z}/{x}/{y}",
            "format": held["format"],
            "kept_from": int(held["minzoom"]),
            "min_zoom": int(held.get("address_minzoom", 0)),
            "max_zoom": int(held.get("address_maxzoom", 0)),
            "attribution": self._tiles.attribution or held["attribution"],
            "bounds": tuple(float(part) for part in held["bounds"].split(",")),
        }

    def close(self) -> None:
        """End the download; no call after this."""
        self.cancel()
        if self._thread is not None:
            self._thread.join(5.0)
        self._keep.close()

    def _download(self, fetcher: Fetcher, about: Description, bounds: Bounds, zooms: range) -> None:
        ended, words = "stopped", "it ended without a reason that is known"
        try:
            self._fetch(fetcher, about, bounds, zooms)
            ended, words = "done", ""
        except (InputError, sqlite3.Error) as error:
            words = str(error)
        finally:
            fetcher.close()
            with self._lock:
                if self._is_cancelled:
                    ended, words = "cancelled", ""
                self._state.update(state=ended, words=words)

    def _fetch(self, fetcher: Fetcher, about: Description, bounds: Bounds, zooms: range) -> None:
        waiting: list[tuple[int, int, int, bytes]] = []
        total = 0
        try:
            for z, x, y in _each(bounds, zooms):
                if self._is_cancelled:
                    return
                if self._keep.tile(z, x, y) is not None:
                    self._add(tiles=1)
                    continue
                tile = fetcher.tile(about, z, x, y)
                if tile is None:
                    self._add(gaps=1)
                    continue
                total += len(tile)
                if total > MOST_BYTES:
                    raise InputError(f"{MOST_BYTES / 1e6:.0f} MB are the most of one download")
                self._check_kind(waiting, tile)
                waiting.append((z, x, y, tile))
                self._add(tiles=1, bytes=len(tile))
                if len(waiting) >= TOGETHER:
                    held, waiting = waiting, []
                    self._write(held, about, bounds)
        finally:
            if waiting:
                self._write(waiting, about, bounds)

    def _check_kind(self, waiting: list[tuple[int, int, int, bytes]], tile: bytes) -> None:
        """Refuse images among vector tiles, and the reverse: a map has one kind."""
        before = image_format(waiting[0][3]) if waiting else self._keep.about().get("format", "")
        if before and (before == "pbf") != (image_format(tile) == "pbf"):
            raise InputError("the address sends images and vector tiles mixed: no map has both")

    def _write(self, tiles: list[tuple[int, int, int, bytes]], about: Description, bounds: Bounds) -> None:
        address = {"address_minzoom": str(about.min_zoom), "address_maxzoom": str(about.max_zoom or 0)}
        kind = image_format(tiles[0][3])
        stated = {"name": self._keep.path.stem, "format": kind, "type": "baselayer", "attribution": about.attribution}
        self._keep.keep(tiles, {**stated, **address}, bounds)

    def _add(self, **more: int) -> None:
        with self._lock:
            for name, count in more.items():
                self._state[name] += count


def _zooms(view: View, about: Description) -> tuple[int, int]:
    """The first and the deepest zoom of a view that the address has tiles of. Raises InputError for no area."""
    west, south, east, north = view.bounds
    if not (-180.0 <= west < east <= 180.0 and south < north):
        raise InputError("the map shows no area within 180 degrees west and east: zoom in, or move it")
    last = DEEPEST if about.max_zoom is None else about.max_zoom
    return min(max(view.zoom, about.min_zoom), last), last


def _each(bounds: Bounds, zooms: range) -> Iterator[tuple[int, int, int]]:
    for zoom in zooms:
        west, east, north, south = tile_range(bounds, zoom)
        for y in range(north, south + 1):
            for x in range(west, east + 1):
                yield zoom, x, y


def why_no_area(tiles: Tiles | None) -> str:
    """The reason why nothing can be downloaded."""
    if tiles is None:
        return "no tile address is configured: start the server with --tiles URL"
    if tiles.path is not None:
        return "the base map is a file already: nothing is to be downloaded"
    return "a PMTiles address is one file: copy that file, and name the copy with --tiles"


def area_of(tiles: Tiles | None, folder: Path) -> TileArea | None:
    """The area of an address that tiles can be downloaded from one by one; None for anything else."""
    return TileArea(tiles, folder) if tiles is not None and tiles.kind in ("template", "tilejson") else None
