"""The newest report of every track, as they are received with the sets. Thread-safe."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable

from contract.track import TrackReport, Unseen
from contract.track_age import as_of
from contract.wire.message import TRACK_REPORTS
from ground.report_view import ReportView

MOST = 1000  # tracks: a peer may invent vehicles
OLD_S = 60.0  # an older report is no track that is followed now, though it came just now
SILENT_S = 5.0  # after which a track is no longer there: it is reported twice a second


class ReceivedTracks(ReportView[TrackReport]):
    """A view of the newest; what is read at once is taken for received at once."""

    payload = TRACK_REPORTS

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._monotonic_s = monotonic_s
        self._received: dict[tuple[str, int], tuple[TrackReport, float]] = {}
        self._lock = threading.Lock()

    def add(self, reports: Iterable[TrackReport]) -> None:
        """Take reports that have just come."""
        now_s = self._monotonic_s()
        with self._lock:
            self._received = {key: held for key, held in self._received.items() if now_s - held[1] <= SILENT_S}
            for report in reports:
                if len(self._received) < MOST or (report.vehicle, report.number) in self._received:
                    self._received[report.vehicle, report.number] = report, now_s

    def newest(self, ago_s: Callable[[str, int], float] | None = None) -> list[TrackReport]:
        """The newest report of each track that sent one in the last SILENT_S, by vehicle and number, as of now.

        `ago_s` of a vehicle and a time (`SetCache.stamped_ago_s`): how long ago it stamped something so; without it
        reports are as old as the time since they came. One stamped more than OLD_S ago is no report of now.
        """
        now_s = self._monotonic_s()
        with self._lock:
            held = sorted(self._received.items(), key=lambda item: item[0])
        out = []
        for _, (report, received_s) in held:
            silent_s = now_s - received_s
            stamped_s = 0.0 if ago_s is None else ago_s(report.vehicle, report.capture_unix_ns)
            if silent_s <= SILENT_S and stamped_s <= OLD_S:
                out.append(as_of(report, max(silent_s, stamped_s), silent_s, Unseen.NO_REPORT))
        return out
