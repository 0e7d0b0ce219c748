"""The seen share of a searched area, and its gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError
from contract.geodesy import within_180
from ground.seen.cells import Cells
from ground.seen.outline import Patch, cells_inside, cells_within, hull, patches
from ground.seen.tally import TILE, SeenGround, area_m2

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_AREA_CELLS = 100_000_000  # a byte each


@dataclass(frozen=True, eq=False)
class Gap:
    """Cells of the searched area that touch and were not seen."""

    patch: Patch  # in columns and rows from those of the coverage
    area_m2: float
    lat_deg: float  # about its middle
    lon_deg: float


@dataclass(frozen=True, eq=False)
class Coverage:
    """Masks of (rows, columns) whose first cell is (`row0`, `column0`). Times are whole Unix seconds."""

    cells: Cells
    row0: int
    column0: int
    seen: Mask
    searched: Mask
    is_hull: bool  # the searched area is the hull of what was seen, as none was given
    seen_m2: float
    searched_m2: float
    seen_of_searched_m2: float
    once_m2: float  # of what was seen, in one picture only
    first_s: int
    last_s: int
    gsd_m: tuple[float, float, float]  # finest, median, coarsest
    gaps: list[Gap]  # the largest first

    def lon_lat(self, ring: Array) -> Array:
        """Corners (K, 2) in columns and rows -> longitude and latitude (K, 2)."""
        lon, lat = self.cells.lon_deg(self.column0 + ring[:, 0]), self.cells.lat_deg(self.row0 + ring[:, 1])
        return np.column_stack([lon, lat])

    def from_lon_lat(self, ring: Array) -> Array:
        """Longitude and latitude (K, 2) -> columns and rows (K, 2)."""
        return _in_cells(self.cells, ring) - (self.column0, self.row0)

    @property
    def cell_m2(self) -> Array:
        """The area (rows,) of a cell of each row."""
        return self.cells.area_m2(self.row0 + np.arange(len(self.seen)))


def coverage(seen: SeenGround, area: Sequence[Sequence[Array]] | None = None) -> Coverage | None:
    """The coverage of polygons, each of rings (K, 2) of longitude and latitude, or of the convex hull of what was seen.

    None if nothing was seen. Raises InputError for an area of too many cells.
    """
    cells, tiles = seen.cells, list(seen.all_tiles())
    tiles = [(at, tile) for at, tile in tiles if np.any(tile["count"])]
    if cells is None or not tiles:
        return None
    areas = None if area is None else [[_in_cells(cells, ring) for ring in rings] for rings in area]
    row0, column0, mask = _canvas(cells, [at for at, _ in tiles], [ring for rings in areas or [] for ring in rings])
    for (row, column), tile in tiles:
        y, x = row * TILE - row0, column * TILE - column0
        mask[y : y + TILE, x : x + TILE] = tile["count"] > 0
    within = [] if areas is None else [[ring - (column0, row0) for ring in rings] for rings in areas]
    searched = cells_within([[hull(mask)]] if areas is None else within, *mask.shape)
    cell_m2 = cells.area_m2(row0 + np.arange(len(mask)))
    every = np.concatenate([tile[tile["count"] > 0] for _, tile in tiles])
    once = area_m2(cells, tiles, 1)
    low, middle, high = np.quantile(every["gsd_m"], [0.0, 0.5, 1.0]).tolist()
    return Coverage(
        cells,
        row0,
        column0,
        mask,
        searched,
        areas is None,
        float(mask.sum(axis=1) @ cell_m2),
        float(searched.sum(axis=1) @ cell_m2),
        float((searched & mask).sum(axis=1) @ cell_m2),
        once,
        int(every["first_s"].min()),
        int(every["last_s"].max()),
        (low, middle, high),
        gaps(cells, row0, column0, searched & ~mask),
    )


def _in_cells(cells: Cells, ring: Array) -> Array:
    """Longitude and latitude (K, 2) -> columns and rows."""
    row, column = cells.places(ring[:, 1], ring[:, 0])
    return np.column_stack([column, row])


def _canvas(cells: Cells, tiles: list[tuple[int, int]], rings: list[Array]) -> tuple[int, int, Mask]:
    """First row and column, and an empty mask, about all tiles and rings."""
    corners = np.array(tiles) * TILE
    low, high = corners.min(axis=0), corners.max(axis=0) + TILE
    for ring in rings:
        low = np.minimum(low, np.floor(ring.min(axis=0)[::-1]).astype(np.int64))
        high = np.maximum(high, np.ceil(ring.max(axis=0)[::-1]).astype(np.int64))
    rows, columns = (int(n) for n in high - low)
    if rows * columns > MOST_AREA_CELLS:
        raise InputError(
            f"the area is {rows} by {columns} cells of {cells.cell_m:g} m, and at most {MOST_AREA_CELLS} are counted: "
            "choose larger cells"
        )
    return int(low[0]), int(low[1]), np.zeros((rows, columns), bool)


def gaps(cells: Cells, row0: int, column0: int, mask: Mask) -> list[Gap]:
    """The connected parts of a mask, the largest first."""
    out = []
    for patch in patches(mask):
        x0, y0 = patch.outer.min(axis=0).astype(int)
        x1, y1 = patch.outer.max(axis=0).astype(int)
        rings = [ring - (x0, y0) for ring in (patch.outer, *patch.holes)]
        inside = cells_inside(rings, y1 - y0, x1 - x0)
        area_m2 = float(inside.sum(axis=1) @ cells.area_m2(row0 + y0 + np.arange(y1 - y0)))
        # The cell nearest to the middle of all: a bent gap's own middle may be outside of it.
        row, column = np.nonzero(inside)
        at = int(np.argmin((row - row.mean()) ** 2 + (column - column.mean()) ** 2))
        lat = float(cells.lat_deg(row0 + y0 + int(row[at]) + 0.5))
        lon = within_180(float(cells.lon_deg(column0 + x0 + int(column[at]) + 0.5)))
        out.append(Gap(patch, area_m2, lat, lon))
    return sorted(out, key=lambda gap: -gap.area_m2)
