"""The thread that follows things, next to the pipeline: what is asked of it, and what it reports twice a second.

The pipeline's thread only hands references over, and a request only joins a short queue: whatever is asked for, and
however long it takes, the flight's own sets do not wait. What this thread cannot keep up with is passed over.
"""

from __future__ import annotations

import json
import logging
import time
from collections import deque
from collections.abc import Callable, Sequence

from contract.errors import InputError
from contract.feature_set import FeatureSet
from contract.supervised_thread import SupervisedThread, WokenWork
from contract.track import MOST_TRACKS, ListTracks, StartTrack, StopTrack, TrackReport, read_request, refused
from contract.wire.track_code import encode_track
from onboard.config.schema import Config
from onboard.events.kept_pictures import KeptPictures
from onboard.events.types import Event, Frame
from onboard.events.waiting_pictures import WaitingPictures
from onboard.tracks.ground_steps import Pictures
from onboard.tracks.track_book import TrackBook

MAX_HELD = 64  # pictures that wait for their set
MAX_ORDERS = 32  # that wait for this thread
MAX_BEHIND = 4  # pictures with a set that wait for this thread: where it cannot keep up, older ones are passed over
REPORT_S = 0.5
EDGE_PX = 16.0  # a click nearer to the picture's edge has nothing around it to be known by
REST = 1.0  # of the time that it worked, in which it leaves the processor to others
MOST_REST_S = 0.2
LATE_S = 20.0  # a click that is seconds old runs through all pictures since

Outlet = Callable[[int, bytes], object]

log = logging.getLogger("pointclick")


class TrackThread(WokenWork):
    """A sink of the daemon. `outlets` take the newest picture's capture time (Unix ns) and the reports of all tracks
    as one packet; `monotonic_s` is a clock, `pictures` a ring that is shared.
    """

    def __init__(
        self,
        config: Config,
        outlets: Sequence[Outlet] = (),
        monotonic_s: Callable[[], float] = time.monotonic,
        *,
        pictures: KeptPictures | None = None,
    ) -> None:
        super().__init__("tracks", late_after_s=LATE_S)
        self._vehicle, self._monotonic_s = config.vehicle.id, monotonic_s
        self.outlets = list(outlets)
        self._kept = KeptPictures(round(config.tracks.keep_mb * 1e6)) if pictures is None else pictures
        self._book = self._new_book()
        self._held = WaitingPictures(MAX_HELD)  # touched by the pipeline's thread alone
        self._ready: deque[tuple[Frame, FeatureSet]] = deque(maxlen=MAX_BEHIND)
        self._orders: deque[StopTrack | tuple[int, StartTrack]] = deque()
        self._active: dict[int, StartTrack] = {}  # tracks that were asked for, by number
        self._newest = -1, -1  # session and frame of what was handed over last
        self._frames: frozenset[int] = frozenset()
        self._size_px = 0, 0
        self._number = 0
        self._picture_s = self._reported_s = monotonic_s()

    def event(self, arrival_ns: int, event: Event) -> None:
        self._held.event(event)

    def feature_set(self, output: FeatureSet) -> None:
        """A picture's first set: both are this thread's now. One that is older than the last is not looked at."""
        frame = self._held.take(output.frame)
        identity = output.session, output.frame
        if frame is not None and frame.image is not None and identity > self._newest:
            self._newest = identity
            self._kept.add(frame.image, output, frame.stamp_ns)
            with self._changed:
                self._ready.append((frame, output))
                self._changed.notify()

    def answer(self, parameters: str) -> tuple[bytes, bool]:
        """Return the answer to a query, at once: JSON, and whether it is a refusal. From any thread."""
        try:
            request = read_request(parameters)
        except InputError as error:
            return refused("bad_request", str(error)), True
        with self._changed:
            if len(self._orders) >= MAX_ORDERS and not isinstance(request, ListTracks):
                return refused("busy", "too much is asked at once: ask again"), True
            if isinstance(request, StartTrack):
                return self._start(request)
            if isinstance(request, StopTrack):
                if request.number not in self._active:
                    return refused("unknown_track", f"there is no track {request.number}"), True
                del self._active[request.number]
                self._orders.append(request)
                self._changed.notify()
            assert isinstance(request, StopTrack | ListTracks)
            return _json({"tracks": sorted(self._active)}), False

    def _start(self, request: StartTrack) -> tuple[bytes, bool]:
        frame = max(self._frames, default=None) if request.frame is None else request.frame
        if frame is None or frame not in self._frames:
            return refused("unknown_frame", "that picture is not kept: click on one of the last seconds"), True
        width, height = self._size_px
        if not (EDGE_PX <= request.u_px <= width - EDGE_PX and EDGE_PX <= request.v_px <= height - EDGE_PX):
            return refused("outside", "the pixel is off the picture or too near to its edge"), True
        asked = StartTrack(request.u_px, request.v_px, frame)
        number = next((n for n, known in self._active.items() if known == asked), None)
        if number is None:  # else it was asked for again
            if len(self._active) >= MOST_TRACKS:
                return refused("full", f"{MOST_TRACKS} things are followed already: stop one"), True
            number = self._next_number()
            self._active[number] = asked
            self._orders.append((number, asked))
            self._changed.notify()
        return _json({"track": number, "frame": frame}), False

    def _next_number(self) -> int:
        while True:
            self._number = self._number % 255 + 1
            if self._number not in self._active:
                return self._number

    def _run(self, thread: SupervisedThread) -> None:
        if thread.error is not None:  # begun again: what brought it down may be one of the tracks
            self._book = self._new_book()
            with self._changed:
                self._active.clear()
                self._orders.clear()
        while not thread.is_set():
            with self._changed:
                if not self._ready and not self._orders:
                    self._changed.wait(max(min(self._reported_s + REPORT_S - self._monotonic_s(), REPORT_S), 0.01))
            thread.wait(min(REST * self.work(), MOST_REST_S))

    def work(self) -> float:
        """Do what waits: orders, pictures, and the reports if they are due. Returns the processor's time, s."""
        began_s = time.thread_time()
        while self._obey() or self._look():
            self.thread.beat()
        self._report()
        return time.thread_time() - began_s

    def _obey(self) -> bool:
        with self._changed:
            if not self._orders:
                return False
            order = self._orders.popleft()
        if isinstance(order, StopTrack):
            self._book.stop(order.number)
            return True
        number, asked = order
        if not self._book.start(number, (asked.u_px, asked.v_px), asked.frame):
            log.info(
                "track %d: nothing to be followed at %g %g of frame %s", number, asked.u_px, asked.v_px, asked.frame
            )
            with self._changed:
                self._active.pop(number, None)
        return True

    def _look(self) -> bool:
        with self._changed:
            if not self._ready:
                return False
            frame, its_set = self._ready.popleft()
        self._book.picture(frame, its_set)
        self._picture_s = self._monotonic_s()
        with self._changed:
            self._frames = self._book.frames
            if frame.image is not None:
                self._size_px = frame.image.shape[1], frame.image.shape[0]
        self._end_lost()
        self._report()
        return True

    def _end_lost(self) -> None:
        alive = set(self._book.numbers)
        with self._changed:
            waiting = {order[0] for order in self._orders if isinstance(order, tuple)}
            for number in [n for n in self._active if n not in alive and n not in waiting]:
                del self._active[number]

    def _report(self) -> None:
        now_s = self._monotonic_s()
        if now_s - self._reported_s < REPORT_S:
            return
        self._reported_s = now_s
        reports = self._book.reports(now_s - self._picture_s)
        if reports:
            self._end_lost()
            payload = b"".join(self._encoded(report) for report in reports)
            for outlet in self.outlets:
                outlet(max(report.capture_unix_ns for report in reports), payload)

    def _encoded(self, report: TrackReport) -> bytes:
        try:
            return encode_track(report)
        except ValueError as error:
            log.warning("%s", error)
            return b""

    def _new_book(self) -> TrackBook:
        return TrackBook(self._vehicle, Pictures(self._kept))


def _json(content: dict[str, object]) -> bytes:
    return json.dumps(content, separators=(",", ":")).encode()
