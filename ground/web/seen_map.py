"""The ground that the page's aircraft have seen: counted from the source's sets in a thread, once anybody asks."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

from contract.camera import Camera
from ground.seen.area import Sector
from ground.seen.coverage import Coverage, coverage
from ground.seen.export import time_text
from ground.seen.pictures import MOST_PICTURES, Look, Shown
from ground.seen.tally import SeenGround, area_m2
from ground.watched_thread import WatchedThread
from ground.web.seen_tile import seen_tile
from ground.web.source import MOST_ROWS, SPARE_ROWS, FrameRow, Source

PERIOD_S = 0.05
BATCH_S = 0.1  # of counting between two pauses: clicks are answered meanwhile
AREA_EVERY_S = 2.0
LISTED = 48  # pictures of a place that are named; of more, evenly chosen ones


class SeenMap:
    """Thread-safe. Nothing is counted before the first question; then the newest pictures are first."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._seen = SeenGround()
        self._lock = threading.Lock()
        self._thread: WatchedThread | None = None
        self._versions: dict[str, int] = {}
        self._known: dict[str, dict[tuple[int, int], int]] = {}  # by vehicle: session and frame -> revision
        self._ahead: list[tuple[str, FrameRow]] = []  # to be counted, from its end on
        self._has_looked = False
        self._newest = (0, 0.0)  # of all: capture, and by the monotonic clock when it was noticed
        self._area = (-1, 0.0, 0.0)  # version, when computed, m2
        self._camera: tuple[int, Camera] | None = None  # of the newest picture that answers, with its capture

    def begin(self) -> None:
        with self._lock:
            if self._thread is None:
                self._thread = WatchedThread("counting of what was seen", self.count, PERIOD_S)

    def close(self) -> None:
        """Count no more."""
        with self._lock:
            thread = self._thread
        if thread is not None:
            thread.close()

    @property
    def trouble(self) -> str:
        """The reason why it cannot be counted, in a line; empty if nothing is wrong."""
        return "" if self._thread is None else self._thread.trouble

    def count(self, within_s: float = BATCH_S) -> None:
        """Look for news, and count for a while."""
        for vehicle in self._source.vehicles():
            self._take_news(vehicle)
        self._has_looked = True
        until_s = time.monotonic() + within_s
        while self._ahead and time.monotonic() < until_s:
            vehicle, row = self._ahead.pop()
            found = self._source.feature_set(vehicle, row.session, row.frame)
            if found is not None:
                with self._lock:
                    self._seen.add(found)
                    if found.is_ok and (self._camera is None or found.capture_unix_ns > self._camera[0]):
                        self._camera = found.capture_unix_ns, found.camera

    def state(self) -> dict[str, object]:
        with self._lock:
            seen, (version, at_s, m2) = self._seen, self._area
            if version != seen.version and (time.monotonic() - at_s > AREA_EVERY_S or not self._ahead):
                m2 = 0.0 if seen.cells is None else area_m2(seen.cells, seen.all_tiles())
                self._area = seen.version, time.monotonic(), m2
            return {
                "version": seen.version,
                "cell_m": None if seen.cells is None else seen.cells.cell_m,
                "area_m2": round(m2, 1),
                "pictures": seen.pictures,
                "ahead": len(self._ahead) if self._has_looked else None,
                "is_live": self._source.is_live,
                "left_out": seen.too_large,
                "is_full": seen.dropped_tiles > 0,
                "trouble": self.trouble,
            }

    def tile(self, z: int, x: int, y: int, by: str) -> bytes:
        """A tile of the map as PNG; `by` is "age" or "count"."""
        with self._lock:
            return seen_tile(self._seen, z, x, y, by, self._now_s())

    def looks(self, sectors: Sequence[Sector]) -> tuple[Coverage | None, list[Look]]:
        """The coverage of the sectors, of none the hull of what was seen, and the looks, both as they are now.

        None where nothing was seen. Raises InputError for sectors that reach too far.
        """
        with self._lock:
            return coverage(
                self._seen, [polygon for sector in sectors for polygon in sector.polygons] or None
            ), self._seen.looks()

    @property
    def camera(self) -> Camera | None:
        """The camera of the newest picture that answers clicks, of all aircraft; None before the first."""
        with self._lock:
            return None if self._camera is None else self._camera[1]

    @property
    def version(self) -> int:
        """A number that grows with every change."""
        with self._lock:
            return self._seen.version

    def at(self, lat_deg: float, lon_deg: float) -> dict[str, object]:
        """The pictures that have seen a place: how many, since when, how finely; and some of them by name."""
        with self._lock:
            cell = self._seen.cell(lat_deg, lon_deg)
            finest = None if cell is None else self._seen.finest(cell)
            shown = self._seen.showing(lat_deg, lon_deg, LISTED)
        return {
            "lat_deg": lat_deg,
            "lon_deg": lon_deg,
            "count": 0 if cell is None else int(cell["count"]),
            "first_utc": None if cell is None else time_text(int(cell["first_s"])),
            "last_utc": None if cell is None else time_text(int(cell["last_s"])),
            "gsd_m": None if cell is None else round(float(cell["gsd_m"]), 4),
            "finest": None if finest is None else _row(finest),
            "pictures": [_row(one) for one in shown],
        }

    def _now_s(self) -> float:
        """The Unix time, s, by the aircraft's clock; of a recording, its end."""
        capture_unix_ns, noticed_s = self._newest
        return capture_unix_ns * 1e-9 + (time.monotonic() - noticed_s if self._source.is_live else 0.0)

    def _take_news(self, vehicle: str) -> None:
        version, before = self._source.version(vehicle), self._versions.get(vehicle)
        if version == before:
            return
        known = self._known.setdefault(vehicle, {})
        is_whole = before is None or version - before > MOST_ROWS or len(known) > 2 * MOST_PICTURES
        rows = self._source.frames(vehicle, None if is_whole else SPARE_ROWS + version - (before or 0))
        if is_whole:
            listed = {(row.session, row.frame) for row in rows}
            known = self._known[vehicle] = {key: held for key, held in known.items() if key in listed}
        self._versions[vehicle] = version
        for row in rows:
            key = row.session, row.frame
            if known.get(key, -1) < row.revision:
                known[key] = row.revision
                self._ahead.append((vehicle, row))
            if row.capture_unix_ns > self._newest[0]:
                self._newest = row.capture_unix_ns, time.monotonic()


def _row(shown: Shown) -> dict[str, object]:
    return {
        "vehicle": shown.vehicle,
        "session": shown.session,
        "frame": shown.frame,
        "capture_unix_ns": str(shown.capture_unix_ns),
        "gsd_m": round(shown.gsd_m, 4),
    }
