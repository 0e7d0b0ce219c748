"""Outlines made simpler until all of them fit into so many bytes. (25.1)"""

from __future__ import annotations

import heapq
from collections.abc import Sequence

Point = tuple[float, float]
Outline = tuple[Point, ...]

LEAST_POINTS, MOST_POINTS = 3, 255


def outline_bytes(points: int) -> int:
    """Bytes of an outline in addition to its number of points."""
    return 1 + 2 * points if points else 0


def fitted(outlines: Sequence[Outline], spare: int) -> list[Outline]:
    """The outlines without the points that change their areas least, so that they take `spare` bytes or fewer.

    The point goes whose triangle with its neighbours has the least area, wherever it is (Visvalingam and Whyatt 1993):
    so bytes go where the ground is, and a small spot's outline goes altogether before a large one's loses its shape.
    """
    rings = [_Ring(outline) for outline in outlines]
    left = sum(outline_bytes(ring.count) for ring in rings)
    heap = [(ring.area(i), which, i) for which, ring in enumerate(rings) for i in range(ring.count)]
    heapq.heapify(heap)
    while heap and (left > spare or max(ring.count for ring in rings) > MOST_POINTS):
        area, which, i = heapq.heappop(heap)
        ring = rings[which]
        if ring.is_gone[i] or area < ring.area(i):  # a stale entry: its neighbours have gone
            continue
        left -= outline_bytes(ring.count)
        for neighbour in ring.drop(i):
            # Never less than what has gone: else a curve would fall point by point.
            ring.floor[neighbour] = max(ring.floor[neighbour], area)
            heapq.heappush(heap, (ring.area(neighbour), which, neighbour))
        left += outline_bytes(ring.count)
    return [ring.outline() for ring in rings]


class _Ring:
    """A polygon whose points go one by one; with fewer than LEAST_POINTS it is none."""

    def __init__(self, points: Sequence[Point]) -> None:
        self._points = list(points) if len(points) >= LEAST_POINTS else []
        self.count = n = len(self._points)
        self.is_gone = [False] * n
        self.floor = [0.0] * n
        self._before, self._after = [(i - 1) % n for i in range(n)], [(i + 1) % n for i in range(n)]

    def area(self, i: int) -> float:
        """The area of a point's triangle with its neighbours, at least its `floor`."""
        (ax, ay), (bx, by), (cx, cy) = (self._points[j] for j in (self._before[i], i, self._after[i]))
        return max(0.5 * abs((bx - ax) * (cy - ay) - (cx - ax) * (by - ay)), self.floor[i])

    def drop(self, i: int) -> tuple[int, ...]:
        """Let a point go; the points whose triangles have changed."""
        self.is_gone[i] = True
        self.count -= 1
        if self.count < LEAST_POINTS:
            self.is_gone, self.count = [True] * len(self.is_gone), 0
            return ()
        before, after = self._before[i], self._after[i]
        self._after[before], self._before[after] = after, before
        return before, after

    def outline(self) -> Outline:
        return tuple(point for point, gone in zip(self._points, self.is_gone, strict=True) if not gone)
