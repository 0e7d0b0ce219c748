"""The tally of seen ground: of each cell how often, when first and last, and by which picture most finely.

Sets are added as they come, in any order, from any number of aircraft. A picture counts once: until its aircraft's
newest one is SETTLED_S younger a later revision takes its place; then it is settled and nothing changes it. Memory is
bounded: of the ground by MOST_TILES, of the pictures by MOST_PICTURES; the oldest go first.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError
from contract.feature_set import FeatureSet
from ground.seen.cells import LEAST_CELL_M, MOST_CELL_M, Cells
from ground.seen.picture_cells import NO_CELLS, PictureCells, TooManyCells, picture_cells
from ground.seen.pictures import MOST_PICTURES, Key, Look, Pictures, Shown

Index = NDArray[np.int64]

TILE = 64  # cells along each side of a tile
MOST_TILES = 2048  # 90 kB each: 8.4 million cells
MOST_PENDING_CELLS = 4_000_000
SETTLED_S = 60.0  # a window of keyframes has passed by then
# Times are whole Unix seconds; `frame` and `by` (a number of `SeenGround.sources`) are of the finest picture.
CELL = np.dtype([("count", "u4"), ("first_s", "u4"), ("last_s", "u4"), ("gsd_m", "f4"), ("frame", "u4"), ("by", "u2")])
# A cell's side as a share of the height above ground, and which sides there are.
CELL_SHARE, DIGITS = 0.01, (1.0, 2.0, 5.0)

Tile = NDArray[np.void]
_Part = tuple[tuple[Index, Index], NDArray[np.float64]]  # rows and columns within a tile; ground sample distances


@dataclass(eq=False)
class _Pending:
    """A picture that a later revision may still change."""

    key: Key
    revision: int
    capture_unix_ns: int
    cells: PictureCells
    parts: dict[tuple[int, int], _Part] = field(init=False)

    def __post_init__(self) -> None:
        self.parts = _split(self.cells)


@dataclass(eq=False)
class SeenGround:
    """`cell_m` None: a hundredth of the height that the first set has above its ground, as 1, 2 or 5 times ten to some
    power. Not thread-safe.
    """

    cell_m: float | None = None
    cells: Cells | None = None  # once a set has answered
    sources: list[tuple[str, int]] = field(default_factory=list)  # vehicle and session
    too_large: int = 0  # pictures left out because they cover too many cells
    dropped_tiles: int = 0
    version: int = 0  # grows with every change

    def __post_init__(self) -> None:
        self._tiles: dict[tuple[int, int], Tile] = {}
        self._pending: dict[Key, _Pending] = {}
        self._pending_cells = 0
        self._pictures = Pictures()
        self._newest_ns: dict[str, int] = {}

    def add(self, s: FeatureSet) -> bool:
        """One set; whether anything may have changed. Raises InputError where there can be no cells."""
        key = s.vehicle, s.session, s.frame
        held = self._pending.get(key)
        if self._pictures.knows(key, s.capture_unix_ns) or (held is not None and held.revision >= s.revision):
            return False
        found = self._cells_of(s)
        if held is not None:
            self._pending_cells -= len(held.cells)
        self._pending[key] = _Pending(key, s.revision, s.capture_unix_ns, found)
        self._pending_cells += len(found)
        self._newest_ns[s.vehicle] = max(s.capture_unix_ns, self._newest_ns.get(s.vehicle, 0))
        self._settle()
        self.version += 1
        return True

    @property
    def pictures(self) -> int:
        return self._pictures.counted + sum(len(p.cells) > 0 for p in self._pending.values())

    def tiles(self) -> list[tuple[int, int]]:
        """Row and column of all tiles that hold something, in TILE cells."""
        found = set(self._tiles)
        for pending in self._pending.values():
            found.update(pending.parts)
        return sorted(found)

    def tile(self, at: tuple[int, int]) -> Tile | None:
        """A tile's cells (TILE, TILE) by row and column, of CELL; None where nothing was seen."""
        held = self._tiles.get(at)
        out = None if held is None else held.copy()
        for pending in self._pending.values():
            if at in pending.parts:
                out = _empty() if out is None else out
                self._count(out, pending.parts[at], pending)
        return out

    def all_tiles(self) -> Iterator[tuple[tuple[int, int], Tile]]:
        for at in self.tiles():
            found = self.tile(at)
            if found is not None:
                yield at, found

    def looks(self) -> list[Look]:
        """The pictures that are held, session by session, each session's in order of capture."""
        pending = [Look(p.key, p.capture_unix_ns, partial(_same, p.cells)) for p in self._pending.values()]
        return sorted([*self._pictures.looks(), *pending], key=lambda look: (look.key[:2], look.capture_unix_ns))

    @property
    def forgotten(self) -> int:
        """The number of pictures that are counted, but of which no look is held any more."""
        return self._pictures.forgotten

    def showing(self, lat_deg: float, lon_deg: float, most: int = MOST_PICTURES) -> list[Shown]:
        """The pictures that have seen the cell of a place, in capture order; of more than `most` evenly chosen ones."""
        at = self._at(lat_deg, lon_deg)
        if at is None:
            return []
        pending = [Shown(*held.key, held.capture_unix_ns, float(gsd_m[0])) for held, gsd_m in self._pending_at(*at)]
        shown = self._pictures.showing(*at, most) + pending
        shown.sort(key=lambda one: (one.capture_unix_ns, one.vehicle))
        if len(shown) <= most:
            return shown
        return [shown[k] for k in np.linspace(0, len(shown) - 1, most).round().astype(int)]

    def finest(self, cell: np.void) -> Shown | None:
        """The picture that has seen a cell most finely; None if it is not kept any more."""
        vehicle, session = self.sources[cell["by"]]
        key = vehicle, session, int(cell["frame"])
        pending = self._pending.get(key)
        at_ns = self._pictures.capture_unix_ns(key) if pending is None else pending.capture_unix_ns
        return None if at_ns is None else Shown(vehicle, session, key[2], at_ns, float(cell["gsd_m"]))

    def cell(self, lat_deg: float, lon_deg: float) -> np.void | None:
        """The cell of a place, of CELL; None where nothing was seen."""
        at = self._at(lat_deg, lon_deg)
        if at is None:
            return None
        tile = self._tiles.get((at[0] // TILE, at[1] // TILE))
        one = _empty(1) if tile is None else tile[at[0] % TILE, at[1] % TILE].reshape(1, 1).copy()
        nothing = np.zeros(1, np.int64)
        for held, gsd_m in self._pending_at(*at):
            self._count(one, ((nothing, nothing), gsd_m), held)
        found: np.void = one[0, 0]
        return found if found["count"] else None

    def _pending_at(self, row: int, column: int) -> Iterator[tuple[_Pending, NDArray[np.float64]]]:
        """The pending pictures that have seen a cell, each with its ground sample distance there (1,)."""
        at, where = (row // TILE, column // TILE), (row % TILE, column % TILE)
        for held in self._pending.values():
            if at in held.parts:
                (rows, columns), gsd_m = held.parts[at]
                found = np.flatnonzero((rows == where[0]) & (columns == where[1]))
                if len(found):
                    yield held, gsd_m[found]

    def _at(self, lat_deg: float, lon_deg: float) -> tuple[int, int] | None:
        if self.cells is None:
            return None
        row, column = self.cells.at(lat_deg, lon_deg)
        return int(row), int(column)

    def _cells_of(self, s: FeatureSet) -> PictureCells:
        if not s.is_ok:
            return NO_CELLS
        if self.cells is None:
            height_m = 1.0 / max(float(np.linalg.norm(s.plane_per_m)), 1e-6)
            cell_m = round_cell_m(CELL_SHARE * height_m) if self.cell_m is None else self.cell_m
            self.cells = Cells.about(s.camera_lat_deg, s.camera_lon_deg, cell_m)
        try:
            return picture_cells(s, self.cells)
        except TooManyCells:
            self.too_large += 1
            return NO_CELLS

    def _settle(self) -> None:
        """Count what nothing changes any more; the oldest first, if too much is pending."""
        for pending in sorted(self._pending.values(), key=lambda p: p.capture_unix_ns):
            age_s = (self._newest_ns[pending.key[0]] - pending.capture_unix_ns) * 1e-9
            if age_s <= SETTLED_S and self._pending_cells <= MOST_PENDING_CELLS:
                continue
            del self._pending[pending.key]
            self._pending_cells -= len(pending.cells)
            self._pictures.add(pending.key, pending.capture_unix_ns, pending.cells)
            for at, part in pending.parts.items():
                self._count(self._tiles.setdefault(at, _empty()), part, pending)
        while len(self._tiles) > MOST_TILES:
            oldest = min(self._tiles, key=lambda at: int(self._tiles[at]["last_s"].max()))
            del self._tiles[oldest]
            self.dropped_tiles += 1

    def _count(self, tile: Tile, cells: _Part, by: _Pending) -> None:
        (where, found_m), source, frame = cells, by.key[:2], by.key[2]
        if source not in self.sources:
            if len(self.sources) >= np.iinfo(np.uint16).max:
                raise InputError("too many sessions for one map of what was seen")
            self.sources.append(source)
        gsd_m, time_s = found_m.astype(np.float32), by.capture_unix_ns // 1_000_000_000
        part = tile[where]
        is_new, is_finer = part["count"] == 0, gsd_m < part["gsd_m"]
        is_finer |= (gsd_m == part["gsd_m"]) & (frame < part["frame"])  # in whatever order they come
        part["count"] += 1
        part["first_s"] = np.where(is_new, time_s, np.minimum(part["first_s"], time_s))
        part["last_s"] = np.maximum(part["last_s"], time_s)
        part["frame"] = np.where(is_finer, frame, part["frame"])
        part["by"] = np.where(is_finer, self.sources.index(source), part["by"])
        part["gsd_m"] = np.minimum(part["gsd_m"], gsd_m)
        tile[where] = part


def round_cell_m(wanted_m: float) -> float:
    """The next smaller one of 1, 2 and 5 times a power of ten, of those that cells may have."""
    wanted_m = min(max(wanted_m, LEAST_CELL_M), MOST_CELL_M) * (1.0 + 1e-9)
    power = 10.0 ** np.floor(np.log10(wanted_m))
    return float(max(d for d in DIGITS if d * power <= wanted_m) * power)


def area_m2(cells: Cells, tiles: Iterable[tuple[tuple[int, int], Tile]], times: int | None = None) -> float:
    """The area of the cells of tiles that were seen, or that were seen exactly `times` times."""
    rows = np.arange(TILE)
    counted = ((at, tile["count"] > 0 if times is None else tile["count"] == times) for at, tile in tiles)
    return sum(float(mask.sum(axis=1) @ cells.area_m2(at[0] * TILE + rows)) for at, mask in counted)


def _same(cells: PictureCells) -> PictureCells:
    return cells


def _empty(side: int = TILE) -> Tile:
    tile = np.zeros((side, side), CELL)
    tile["gsd_m"] = np.inf
    return tile


def _split(cells: PictureCells) -> dict[tuple[int, int], _Part]:
    """Cells by the tiles that they are in."""
    out: dict[tuple[int, int], _Part] = {}
    if not len(cells):
        return out
    row, column = cells.row // TILE, cells.column // TILE
    wide = int(np.ptp(column)) + 1
    number = (row - row.min()) * wide + (column - column.min())
    for n in np.unique(number).tolist():
        of = np.flatnonzero(number == n)
        at = n // wide + int(row.min()), n % wide + int(column.min())
        out[at] = (cells.row[of] - at[0] * TILE, cells.column[of] - at[1] * TILE), cells.gsd_m[of]
    return out
