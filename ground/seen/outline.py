"""Polygons and masks of cells: outlines of what is marked, the cells inside of polygons, the hull of what is marked.

Coordinates are (column, row), x eastwards and y northwards; cell (row, column) reaches from them to them plus one.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.kriging import convex_hull

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Corner = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Patch:
    """Cells that touch along edges: rings (K, 2) of corners, counter-clockwise the outer one, clockwise its holes."""

    outer: Array
    holes: list[Array]


def patches(mask: Mask) -> list[Patch]:
    """The connected parts of what is marked in (rows, columns); cells that touch at a corner only are apart."""
    rings = [np.array(ring, float) for ring in _rings(mask)]
    outers = [Patch(ring, []) for ring in rings if ring_area(ring) > 0.0]
    boxes = np.array([[*p.outer.min(axis=0), *p.outer.max(axis=0)] for p in outers]).reshape(-1, 4)
    for hole in (ring for ring in rings if ring_area(ring) < 0.0):
        # The cell that is marked next to the hole's lowest edge, its left end, is the outer ring's.
        x, y = _cell_left_of_edge(hole)
        near = np.flatnonzero((boxes[:, 0] < x) & (x < boxes[:, 2]) & (boxes[:, 1] < y) & (y < boxes[:, 3]))
        inside = [k for k in near if _is_inside(outers[k].outer, x, y)]
        # Of several the innermost: outer rings are nested only through holes of each other.
        outers[min(inside, key=lambda k: ring_area(outers[k].outer))].holes.append(hole)
    return outers


def ring_area(ring: Array) -> float:
    """Signed, positive counter-clockwise, in cells."""
    x, y = ring.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def cells_inside(rings: Iterable[Array], rows: int, columns: int) -> Mask:
    """Mask (rows, columns) of the cells whose middles are inside of an odd number of rings (K, 2)."""
    crossed = np.zeros((rows, columns + 1), np.int64)
    for ring in rings:
        begin, end = np.asarray(ring, float), np.roll(ring, -1, axis=0)
        ends = np.ceil(np.sort([begin[:, 1], end[:, 1]], axis=0) - 0.5)
        first, last = np.clip(ends, 0, rows).astype(np.int64)
        counts = last - first
        # Every edge with every row whose middle it crosses.
        edge = np.repeat(np.arange(len(begin)), counts)
        row = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts) + first[edge]
        (x0, y0), (x1, y1) = begin[edge].T, end[edge].T
        x = x0 + (row + 0.5 - y0) * (x1 - x0) / (y1 - y0)
        np.add.at(crossed, (row, np.clip(np.ceil(x - 0.5), 0, columns).astype(np.int64)), 1)
    out: Mask = np.cumsum(crossed, axis=1)[:, :columns] % 2 == 1
    return out


def cells_within(polygons: Iterable[Iterable[Array]], rows: int, columns: int) -> Mask:
    """Mask (rows, columns) of the cells whose middles are inside of any polygon, each an outer ring with its holes."""
    out: Mask = np.zeros((rows, columns), bool)
    for rings in polygons:
        out |= cells_inside(rings, rows, columns)
    return out


def hull(mask: Mask) -> Array:
    """Corners (K, 2) of the convex hull of what is marked, counter-clockwise."""
    rows = np.flatnonzero(mask.any(axis=1))
    first, last = mask[rows].argmax(axis=1), mask.shape[1] - mask[rows, ::-1].argmax(axis=1)
    ends = [np.column_stack([x, rows + y]) for x in (first, last) for y in (0, 1)]
    return convex_hull(np.concatenate(ends).astype(float))


def _rings(mask: Mask) -> list[list[Corner]]:
    """Closed walks along the edges of what is marked, which is on the left; only corners where they turn."""
    padded = np.pad(mask, 1)
    ahead: dict[Corner, list[Corner]] = {}

    def walk(edges: Mask, start: Corner, end: Corner) -> None:
        for b, a in np.argwhere(edges).tolist():
            ahead.setdefault((a + start[0], b + start[1]), []).append((a + end[0], b + end[1]))

    middle = padded[1:-1, 1:-1]
    walk(middle & ~padded[:-2, 1:-1], (0, 0), (1, 0))  # southern edges eastwards
    walk(middle & ~padded[1:-1, 2:], (1, 0), (1, 1))  # eastern ones northwards
    walk(middle & ~padded[2:, 1:-1], (1, 1), (0, 1))
    walk(middle & ~padded[1:-1, :-2], (0, 1), (0, 0))
    rings = []
    while ahead:
        start = next(iter(ahead))
        at, ring, came = start, [start], (0, 0)
        while True:
            at, came = _step(ahead, at, came)
            if at == start:
                break
            ring.append(at)
        rings.append(_turning(ring))
    return rings


def _step(ahead: dict[Corner, list[Corner]], at: Corner, came: Corner) -> tuple[Corner, Corner]:
    """Along one edge, which is then gone; where two go on, to the left: cells that touch at a corner stay apart."""
    ways = ahead[at]
    if len(ways) > 1 and came != (0, 0):
        ways.sort(key=lambda to: came[0] * (to[1] - at[1]) - came[1] * (to[0] - at[0]))
    to = ways.pop()
    if not ways:
        del ahead[at]
    return to, (to[0] - at[0], to[1] - at[1])


def _turning(ring: list[Corner]) -> list[Corner]:
    """Without the corners that lie on a straight way."""
    out = []
    for before, at, after in zip([ring[-1], *ring[:-1]], ring, [*ring[1:], ring[0]], strict=True):
        if (at[0] - before[0]) * (after[1] - at[1]) != (at[1] - before[1]) * (after[0] - at[0]):
            out.append(at)
    return out


def _cell_left_of_edge(ring: Array) -> tuple[float, float]:
    """The middle of the marked cell left of a ring's first edge."""
    (x0, y0), (x1, y1) = ring[0], ring[1]
    along = np.sign([x1 - x0, y1 - y0])
    return float(x0 + 0.5 * along[0] - 0.5 * along[1]), float(y0 + 0.5 * along[1] + 0.5 * along[0])


def _is_inside(ring: Array, x: float, y: float) -> bool:
    """Return whether a place that is on no edge is inside of a ring."""
    (x0, y0), (x1, y1) = ring.T, np.roll(ring, -1, axis=0).T
    crosses = (y0 > y) != (y1 > y)
    at = x0[crosses] + (y - y0[crosses]) * (x1[crosses] - x0[crosses]) / (y1[crosses] - y0[crosses])
    return bool(np.count_nonzero(at > x) % 2)
