"""Seen ground as tiles of a web map: PNG, coloured by how long ago, by how often, or by who would have been found.

The page has the words.
"""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ground.seen.coverage import Coverage
from ground.seen.tally import TILE, SeenGround

SIDE = 256  # pixels
# The same steps stand in frontend/src/seen.ts, in words. Bright to dark as viridis, for every kind of eye.
COLOURS = ((253, 231, 37), (94, 201, 98), (33, 145, 140), (59, 82, 139), (68, 1, 84))
ALPHA = 150
AGES_S = (60.0, 300.0, 1200.0, 3600.0)  # younger than each: its colour; older than all: the last
COUNTS = (20, 5, 2, 1)  # at least so often: its colour
PROBABILITIES = (0.9, 0.7, 0.5, 0.2)  # at least so likely: its colour; less than all: the last


def seen_tile(seen: SeenGround, z: int, x: int, y: int, by: str, now_s: float) -> bytes:
    """PNG of tile (x, y) at zoom z; transparent where nothing was seen. `now_s`: what ages are counted to."""
    classes = np.zeros((SIDE, SIDE), np.uint8)  # 0: nothing; else the colour's number plus 1
    if seen.cells is not None:
        lat, lon = _places(z, x, y)
        row, _ = seen.cells.at(lat, np.full(SIDE, lon[0]))
        _, column = seen.cells.at(np.full(SIDE, lat[0]), lon)
        rows, columns = set((row // TILE).tolist()), set((column // TILE).tolist())
        for at in seen.tiles():
            tile = seen.tile(at) if at[0] in rows and at[1] in columns else None
            if tile is None:
                continue
            v, u = np.flatnonzero(row // TILE == at[0]), np.flatnonzero(column // TILE == at[1])
            classes[np.ix_(v, u)] = _classes(tile[np.ix_(row[v] % TILE, column[u] % TILE)], by, now_s)
    return _png(classes)


def detection_tile(over: Coverage, probability: NDArray[np.float64], z: int, x: int, y: int) -> bytes:
    """PNG of tile (x, y) at zoom z of probabilities (rows, columns) over a coverage; transparent where not seen."""
    lat, lon = _places(z, x, y)
    row, _ = over.cells.at(lat, np.full(SIDE, lon[0]))
    _, column = over.cells.at(np.full(SIDE, lat[0]), lon)
    v = np.flatnonzero((row >= over.row0) & (row < over.row0 + over.seen.shape[0]))
    u = np.flatnonzero((column >= over.column0) & (column < over.column0 + over.seen.shape[1]))
    at = np.ix_(row[v] - over.row0, column[u] - over.column0)
    classes = np.zeros((SIDE, SIDE), np.uint8)
    found = 1 + (probability[at][..., None] < np.array(PROBABILITIES)).sum(axis=-1)
    classes[np.ix_(v, u)] = np.where(over.seen[at], found, 0)
    return _png(classes)


def _png(classes: NDArray[np.uint8]) -> bytes:
    """Numbers of colours, from 1, as a picture (SIDE, SIDE) of them."""
    image = Image.fromarray(classes, "P")
    image.putpalette([0, 0, 0, *(part for colour in COLOURS for part in colour)])
    out = io.BytesIO()
    image.save(out, "PNG", transparency=bytes([0, *[ALPHA] * len(COLOURS)]))
    return out.getvalue()


def _places(z: int, x: int, y: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Latitudes from the top and longitudes of a tile's pixels (SIDE,). Web Mercator."""
    middle = (np.arange(SIDE) + 0.5) / SIDE
    lon = (x + middle) / 2.0**z * 360.0 - 180.0
    lat = np.degrees(np.arctan(np.sinh(np.pi * (1.0 - 2.0 * (y + middle) / 2.0**z))))
    return lat, lon


def _classes(cells: NDArray[np.void], by: str, now_s: float) -> NDArray[np.uint8]:
    """Numbers of the colours, from 1; 0 where nothing was seen."""
    if by == "count":
        found = 1 + (cells["count"][..., None] < np.array(COUNTS)[:-1]).sum(axis=-1)
    else:
        found = 1 + (now_s - cells["last_s"][..., None] >= np.array(AGES_S)).sum(axis=-1)
    return np.where(cells["count"] > 0, found, 0).astype(np.uint8)


def empty_tile() -> bytes:
    return _png(np.zeros((SIDE, SIDE), np.uint8))
