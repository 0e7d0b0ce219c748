"""Every report of every track of the last hour in the order of capture, and what has come since. Thread-safe."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections import deque
from collections.abc import Iterable

from contract.track import TrackReport, TrackState
from contract.wire.message import TRACK_REPORTS
from ground.report_view import ReportView

MOST_TRACKS = 500  # paths: a peer may invent vehicles and numbers
MOST_OF_ONE = 7200  # reports: an hour of one track
MOST_NEWS = 1000  # reports that somebody who asks for what is new may not have had yet

Path = tuple[TrackReport, ...]
_Key = tuple[str, int, int]  # vehicle, session, number


class TrackPaths(ReportView[TrackReport]):
    """A number that comes again after its track was lost is another thing."""

    payload = TRACK_REPORTS

    def __init__(self) -> None:
        self._paths: dict[_Key, list[TrackReport]] = {}
        self._news: deque[TrackReport] = deque(maxlen=MOST_NEWS)
        self._version = 0
        self._lock = threading.Lock()

    def add(self, reports: Iterable[TrackReport]) -> None:
        """Reports in any order; one that is known, as of an aircraft received twice, changes nothing."""
        with self._lock:
            for report in reports:
                if self._put(report):
                    self._version += 1
                    self._news.append(report)

    @property
    def version(self) -> int:
        with self._lock:
            return self._version

    def since(self, version: int) -> tuple[int, list[TrackReport] | None]:
        """The version now, and the reports that came after another; None in their place where they are too many."""
        with self._lock:
            count = self._version - version
            return self._version, list(self._news)[len(self._news) - count :] if count <= len(self._news) else None

    def paths(self, most: int = MOST_OF_ONE) -> list[Path]:
        """The paths by vehicle, session and number; of longer ones every nth report and the newest."""
        with self._lock:
            held = sorted(self._paths.items(), key=lambda item: item[0])
            return [tuple(path[::-1][:: max(1, -(-len(path) // most))][::-1]) for _, path in held]

    def _put(self, report: TrackReport) -> bool:
        key = report.vehicle, report.session, report.number
        path = self._paths.setdefault(key, [])
        if path and path[-1].state is TrackState.LOST and report.state is not TrackState.LOST:
            if report.capture_unix_ns < path[-1].capture_unix_ns:
                return self._insert(path, report)
            path.clear()
        if len(self._paths) > MOST_TRACKS:
            oldest = min((p[-1].capture_unix_ns, k) for k, p in self._paths.items() if p)
            del self._paths[oldest[1]]
        return self._insert(path, report)

    def _insert(self, path: list[TrackReport], report: TrackReport) -> bool:
        at = bisect_left(path, report.capture_unix_ns, key=lambda held: held.capture_unix_ns)
        if at < len(path) and path[at].capture_unix_ns == report.capture_unix_ns:
            return False
        path.insert(at, report)
        if len(path) > MOST_OF_ONE:
            del path[0]
        return True
