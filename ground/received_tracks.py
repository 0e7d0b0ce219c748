"""The newest report of every track, as they are received with the sets. Thread-safe."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from contract.errors import WireError
from contract.track import TrackReport
from contract.wire.message import read_tracks

MOST = 1000  # tracks: a peer may invent vehicles
SILENT_S = 5.0  # after which a track is no longer there: it is reported twice a second


def reports_in(key: str, payload: bytes) -> list[TrackReport]:
    """The track reports in a message of the link; none if it is no message of tracks."""
    try:
        return read_tracks(key, payload)
    except (ValueError, WireError):
        return []


class ReceivedTracks:
    """`take` is for a subscription (`SetCache`'s `subscriptions`)."""

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._monotonic_s = monotonic_s
        self._received: dict[tuple[str, int], tuple[TrackReport, float]] = {}
        self._lock = threading.Lock()

    def take(self, key: str, payload: bytes) -> None:
        """A message; what is none of ours is passed over."""
        reports = reports_in(key, payload)
        now_s = self._monotonic_s()
        with self._lock:
            self._received = {key: held for key, held in self._received.items() if now_s - held[1] <= SILENT_S}
            for report in reports:
                if len(self._received) < MOST or (report.vehicle, report.number) in self._received:
                    self._received[report.vehicle, report.number] = report, now_s

    def newest(self) -> list[TrackReport]:
        """The newest report of each track that sent one in the last SILENT_S, by vehicle and number."""
        now_s = self._monotonic_s()
        with self._lock:
            held = sorted(self._received.items(), key=lambda item: item[0])
            return [report for _, (report, received_s) in held if now_s - received_s <= SILENT_S]
