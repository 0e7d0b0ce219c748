"""The newest report of every track, as they are received with the sets. Thread-safe."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from contract.errors import WireError
from contract.track import TrackReport, Unseen
from contract.track_age import as_of
from contract.wire.message import read_tracks

MOST = 1000  # tracks: a peer may invent vehicles
OLD_S = 60.0  # an older report is no track that is followed now, though it came just now
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
