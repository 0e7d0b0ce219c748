"""The map of who would have been found, for the page: `pc-ground seen --pod` computed again when more was seen."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

from ground.seen.area import Sector
from ground.seen.coverage import Coverage
from ground.seen.detection import detection
from ground.seen.searched import ASSUMED, BELOW, Searched, sector_lines
from ground.watched_thread import WatchedThread
from ground.web.seen_map import SeenMap
from ground.web.seen_tile import detection_tile, empty_tile
from ground.web.source import Source

PERIOD_S = 0.5
ASKED_S = 30.0  # after the last question nothing is computed any more
REST = 4.0  # times as long as it took nothing is computed again: clicks are answered meanwhile


@dataclass(frozen=True, eq=False)
class _Found:
    """A result; `version` of what it was computed from."""

    version: tuple[int, int, int]
    over: Coverage | None
    searched: Searched | None


class FoundMap:
    """Thread-safe. Nothing is computed but while somebody asks; it follows what the map of seen ground has counted."""

    def __init__(self, seen_map: SeenMap, source: Source) -> None:
        self._seen_map, self._source = seen_map, source
        self._lock = threading.Lock()
        self._thread: WatchedThread | None = None
        self._sectors: list[Sector] = []
        self._choice = 0  # grows with every choice of sectors
        self._asked_s = 0.0
        self._due_s = 0.0
        self._found = _Found((-1, -1, -1), None, None)

    def close(self) -> None:
        """Compute no more."""
        with self._lock:
            thread = self._thread
        if thread is not None:
            thread.close()

    def choose(self, sectors: Sequence[Sector]) -> None:
        """Have the probabilities of these sectors; of none, of all that was seen."""
        with self._lock:
            self._sectors, self._choice, self._due_s = list(sectors), self._choice + 1, 0.0

    def compute(self) -> None:
        """Compute what is asked for, if there is more than the last time. Raises InputError, as for a tiny sector."""
        with self._lock:
            sectors, choice, found = self._sectors, self._choice, self._found
            is_due = self._due_s <= time.monotonic() < self._asked_s + ASKED_S
        spots = self._source.views.spots
        version = self._seen_map.version, spots.version, choice
        if not is_due or version == found.version:
            return
        began_s = time.monotonic()
        try:
            self._found = self._computed(version, sectors)
        finally:
            ended_s = time.monotonic()
            with self._lock:
                if choice == self._choice:
                    self._due_s = ended_s + max(REST * (ended_s - began_s), PERIOD_S)

    def _computed(self, version: tuple[int, int, int], sectors: list[Sector]) -> _Found:
        over, looks = self._seen_map.looks(sectors)
        if over is None:
            return _Found(version, None, None)
        by = detection(looks, over, self._source.views.spots.searched())
        return _Found(version, over, Searched.of(by, over, sectors, None, BELOW))

    def state(self) -> dict[str, object]:
        """The numbers of each sector, in words too, and the sectors' outlines."""
        with self._lock:
            self._asked_s = time.monotonic()
            if self._thread is None:
                self._thread = WatchedThread("computing of who would have been found", self.compute, PERIOD_S)
            found, sectors, choice, thread = self._found, self._sectors, self._choice, self._thread
        searched = found.searched
        lines = [] if searched is None else [sector_lines(sector, BELOW) for sector in searched.sectors]
        return {
            "version": ".".join(map(str, found.version)),
            "is_current": found.version == (self._seen_map.version, self._source.views.spots.version, choice),
            "assumed": ASSUMED,
            "lines": {who: [line[who] for line in lines if who in line] for who in ASSUMED},
            "detection": None if searched is None else searched.to_dict(),
            "sectors": [{"name": sector.name, "rings": [ring.tolist() for ring in sector.rings]} for sector in sectors],
            "trouble": thread.trouble,
        }

    def tile(self, z: int, x: int, y: int, who: str) -> bytes:
        """A tile of the map as PNG: the probability by `who`, machine or operator."""
        with self._lock:
            found = self._found
        by = None if found.searched is None else found.searched.detection.of(who)
        return empty_tile() if by is None or found.over is None else detection_tile(found.over, by[0], z, x, y)
