"""The map of who would have been found, for the page: `pc-ground seen --pod` computed again when more was seen."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

from contract.camera import Camera
from contract.errors import InputError
from ground.seen.area import Sector, Woods, sectors_document
from ground.seen.coverage import Coverage
from ground.seen.detection import detection
from ground.seen.flight_rows import OVERLAP, FlightRows, rows_over
from ground.seen.searched import ASSUMED, BELOW, Searched, sector_lines
from ground.watched_thread import WatchedThread
from ground.web.seen_map import SeenMap
from ground.web.seen_tile import detection_tile, empty_tile
from ground.web.source import Source

PERIOD_S = 0.5
ASKED_S = 30.0  # after the last question nothing is computed any more
MOST_SECTORS = 200
REST = 4.0  # times as long as it took nothing is computed again: clicks are answered meanwhile


@dataclass(frozen=True, eq=False)
class _Found:
    """A result; `version` and `sectors` of what it was computed from, `camera` of the newest picture then."""

    version: tuple[int, int, int]
    over: Coverage | None
    searched: Searched | None
    sectors: Sequence[Sector] = ()
    camera: Camera | None = None


class FoundMap:
    """Thread-safe. Nothing is computed but while somebody asks; it follows what the map of seen ground has counted."""

    def __init__(self, seen_map: SeenMap, source: Source) -> None:
        self._seen_map, self._source = seen_map, source
        self._lock = threading.Lock()
        self._thread: WatchedThread | None = None
        self._sectors: list[Sector] = []
        self._woods: list[Woods] = []
        self._choice = 0  # grows with every choice of sectors or woods
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
            self._choose(sectors, self._woods)

    def add(self, sector: Sector) -> int:
        """Have one more sector, and return how many there are; without a name it gets the first number that is free.

        Raises InputError for a name that there is already, or one too many.
        """
        with self._lock:
            names = {one.name for one in self._sectors}
            if sector.name in names:
                raise InputError(f"there is a sector {sector.name} already")
            if len(names) >= MOST_SECTORS:
                raise InputError(f"there are {MOST_SECTORS} sectors already")
            name = sector.name or next(str(n) for n in range(1, len(names) + 2) if str(n) not in names)
            self._choose([*self._sectors, Sector(name, sector.polygons)], self._woods)
            return len(self._sectors)

    def remove(self, name: str) -> int:
        """Have a sector no longer, and return how many are left. Raises InputError for a name that there is not."""
        with self._lock:
            left = [one for one in self._sectors if one.name != name]
            if len(left) == len(self._sectors):
                raise InputError(f"there is no sector {name}")
            self._choose(left, self._woods)
            return len(left)

    def choose_woods(self, woods: Sequence[Woods]) -> None:
        """Have so much of the ground hidden by trees; of none, none."""
        with self._lock:
            self._choose(self._sectors, woods)

    def _choose(self, sectors: Sequence[Sector], woods: Sequence[Woods]) -> None:
        self._sectors, self._woods = list(sectors), list(woods)
        self._choice, self._due_s = self._choice + 1, 0.0

    def sectors(self) -> dict[str, object]:
        """The sectors as GeoJSON, to be kept and chosen again."""
        with self._lock:
            return sectors_document(self._sectors)

    def gaps(self, who: str | None, below: float) -> tuple[Coverage, Searched]:
        """Where less than `below` would be found by `who`, and of which ground. Raises InputError where unknown."""
        over, searched, _ = self._judged(who, below)
        return over, searched

    def rows(
        self, who: str | None, below: float, height_m: float | None = None, overlap: float = OVERLAP
    ) -> FlightRows:
        """Rows over these gaps for the newest picture's camera. Raises InputError where there can be none."""
        over, searched, camera = self._judged(who, below)
        return rows_over(searched, over, camera, height_m, overlap)

    def _judged(self, who: str | None, below: float) -> tuple[Coverage, Searched, Camera]:
        with self._lock:
            found = self._found
        if found.over is None or found.searched is None or found.camera is None:
            raise InputError("it is not computed yet who would have been found: wait for the numbers")
        by = found.searched.detection
        if who == "machine" and by.machine is None:
            raise InputError("no picture of a calibrated thermal camera was searched for people")
        return found.over, Searched.of(by, found.over, found.sectors, who, below), found.camera

    def compute(self) -> None:
        """Compute what is asked for, if there is more than the last time. Raises InputError, as for a tiny sector."""
        with self._lock:
            sectors, woods, choice, found = self._sectors, self._woods, self._choice, self._found
            is_due = self._due_s <= time.monotonic() < self._asked_s + ASKED_S
        spots = self._source.views.spots
        version = self._seen_map.version, spots.version, choice
        if not is_due or version == found.version:
            return
        began_s = time.monotonic()
        try:
            self._found = self._computed(version, sectors, woods)
        finally:
            ended_s = time.monotonic()
            with self._lock:
                if choice == self._choice:
                    self._due_s = ended_s + max(REST * (ended_s - began_s), PERIOD_S)

    def _computed(self, version: tuple[int, int, int], sectors: list[Sector], woods: list[Woods]) -> _Found:
        over, looks = self._seen_map.looks(sectors)
        if over is None:
            return _Found(version, None, None)
        by = detection(looks, over, self._source.views.spots.searched(), woods)
        searched = Searched.of(by, over, sectors, None, BELOW)
        return _Found(version, over, searched, sectors, self._seen_map.camera)

    def state(self) -> dict[str, object]:
        """The numbers of each sector, in words too, and the sectors' outlines."""
        with self._lock:
            self._asked_s = time.monotonic()
            if self._thread is None:
                self._thread = WatchedThread("computing of who would have been found", self.compute, PERIOD_S)
            found, sectors, choice, thread = self._found, self._sectors, self._choice, self._thread
            woods = len(self._woods)
        searched = found.searched
        lines = [] if searched is None else [sector_lines(sector, BELOW) for sector in searched.sectors]
        return {
            "version": ".".join(map(str, found.version)),
            "is_current": found.version == (self._seen_map.version, self._source.views.spots.version, choice),
            "assumed": ASSUMED,
            "lines": {who: [line[who] for line in lines if who in line] for who in ASSUMED},
            "detection": None if searched is None else searched.to_dict(),
            "sectors": [{"name": sector.name, "rings": [ring.tolist() for ring in sector.rings]} for sector in sectors],
            "woods": woods,
            "trouble": thread.trouble,
        }

    def tile(self, z: int, x: int, y: int, who: str) -> bytes:
        """A tile of the map as PNG: the probability by `who`, machine or operator."""
        with self._lock:
            found = self._found
        by = None if found.searched is None else found.searched.detection.of(who)
        return empty_tile() if by is None or found.over is None else detection_tile(found.over, by[0], z, x, y)
