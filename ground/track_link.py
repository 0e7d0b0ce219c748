"""Tracks over the link: begun, ended and listed by a question, reported as they are sent."""

from __future__ import annotations

import queue
import time
from typing import Any

import zenoh

from contract.closing import Closing
from contract.errors import LinkError, WireError
from contract.link_config import Tls
from contract.topics import FOLLOW, TRACKS
from contract.track import ListTracks, StartTrack, TrackReport, TrackRequest, parameters_of
from contract.wire.message import TRACK_REPORTS
from ground.client import only_vehicle, open_link, running_session
from ground.put_request import put_request

MOST_WAITING = 1000  # reports that have not been taken
ASK_AGAIN_S = 5.0  # which session runs, where reports of another come
TRIES = 3  # a question to begin the same track again is answered with the same track


class TrackLink(Closing):
    """A session with one aircraft: `vehicle`, or the only one there is. Raises LinkError."""

    def __init__(self, endpoint: str, vehicle: str | None, tls: Tls | None = None) -> None:
        self._session: Any = open_link("client", endpoint, tls)
        self._reports: queue.Queue[TrackReport] = queue.Queue(MOST_WAITING)
        self.unreadable = self.left_out = 0
        self._running: int | None = None  # session, as the aircraft answered last; None: it gives no answer
        self._asked_s = -ASK_AGAIN_S
        try:
            self.vehicle = vehicle or only_vehicle(self._session, endpoint)
            self._subscriber = self._session.declare_subscriber(TRACKS.key(self.vehicle), self._receive)
        except (zenoh.ZError, ValueError) as error:
            self.close()
            raise LinkError(f"cannot listen to tracks at {endpoint}: {error}") from error
        except LinkError:
            self.close()
            raise

    def ask(self, request: TrackRequest) -> dict[str, Any]:
        """The aircraft's answer. Raises RequestRefused with its reason, LinkError if it gives none."""
        parameters = parameters_of(request)
        selector = FOLLOW.key(self.vehicle) + (f"?{parameters}" if parameters else "")
        is_same_again = isinstance(request, ListTracks) or (
            isinstance(request, StartTrack) and request.frame is not None
        )
        answer = put_request(self._session, selector, tries=TRIES if is_same_again else 1)
        if answer is None:
            raise LinkError(f"aircraft {self.vehicle!r} does not answer; may this certificate follow?")
        return answer

    def next(self, timeout_s: float) -> TrackReport | None:
        """The next report; None if none came in time. One of a session that does not run is left out and counted."""
        try:
            report = self._reports.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if report.session != self._running and time.monotonic() - self._asked_s >= ASK_AGAIN_S:
            self._asked_s = time.monotonic()
            self._running = running_session(self._session, self.vehicle) or self._running
        if self._running in (None, report.session):
            return report
        self.left_out += 1
        return None

    def close(self) -> None:
        self._session.close()

    def _receive(self, sample: zenoh.Sample) -> None:
        """Queue a message's reports, called in zenoh's thread; the oldest go where the queue is full."""
        try:
            reports = TRACK_REPORTS.read(str(sample.key_expr), sample.payload.to_bytes())
        except (WireError, ValueError):
            self.unreadable += 1
            return
        for report in reports:
            if self._reports.full():
                self._reports.get_nowait()
            self._reports.put_nowait(report)
