"""The frames of a video that runs, for the sets that come over the link.

The video's clock is the ground's monotonic one at arrival, the sets' is the aircraft's; the two need not agree, because
their difference is measured together with the delay. A frame becomes a set's picture only if it shows corners where the
set has its features: a stall, a cut or another camera must not put a click on a picture that is not the set's.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict, deque

import numpy as np

from contract.feature_set import FeatureSet, Status
from ground.watched_thread import WatchedThread
from ground.web.source import FrameRow, Source
from ground.web.video_delay import (
    MIN_FEATURES,
    MIN_VOTES,
    Array,
    Delay,
    DelayEstimate,
    best_time_s,
    corners_at,
    interval_of,
    is_ahead,
    is_seen,
    nearest_within,
)
from ground.web.video_frames import Ring, VideoFrame
from ground.web.video_reader import VideoReader
from ground.web.with_video import aspect_trouble

SEARCHED_S = (-1.0, 5.0)  # delays against the picture's age as the page gives it
PERIOD_S = 0.1
NEWEST = 300  # sets that are used
VOTE_EVERY_S = 0.3  # of capture: pictures that follow at once give the same
MAX_PICTURES, MAX_BYTES = 1000, 96_000_000
RECENT = 20

Key = tuple[int, int]
"""Session, frame."""


class LiveFootage:
    """Serves `Footage`. Raises InputError if the video cannot be opened. `delay_s`: entered; None: it is measured."""

    def __init__(
        self,
        source: str,
        inner: Source,
        vehicle: str | None,
        delay_s: float | None,
        searched_s: tuple[float, float] = SEARCHED_S,
    ) -> None:
        self.vehicle = vehicle or ""
        self.version = 0
        self._inner = inner
        self._entered_s = delay_s
        self._searched_s = searched_s
        self._lock = threading.Lock()
        self._kept: OrderedDict[Key, bytes] = OrderedDict()
        self._bytes = 0
        self._estimate = DelayEstimate()
        self._of: tuple[int, int] | None = None  # epoch and session of what was estimated
        self._base_ns = 0  # capture times count from here
        self._voted_s = -np.inf
        self._judged: OrderedDict[Key, None] = OrderedDict()
        self._shown: deque[bool] = deque(maxlen=RECENT)
        self._seen_version = -1
        self._rows: list[FrameRow] = []
        self._ahead_s: float | None = None  # the video's clock minus capture times, without any delay
        self._note = "waiting for sets"
        self._trouble = ""
        self._ring = Ring()
        self._reader = VideoReader(source, self._ring)
        self._thread = WatchedThread("matching of the video", self._look, PERIOD_S)

    def has(self, session: int, frame: int) -> bool:
        with self._lock:
            return (session, frame) in self._kept

    def picture(self, session: int, frame: int) -> bytes | None:
        """The frame that was found for it: once found it stays."""
        with self._lock:
            return self._kept.get((session, frame))

    def notes(self) -> list[str]:
        """The video, its delay, and pictures that were left out."""
        lines = [self._reader.trouble, self._thread.trouble or self._trouble or self._note]
        shown = list(self._shown)
        if not all(shown):
            lines.append(f"{shown.count(False)} of the last {len(shown)} pictures do not show their features: left out")
        return [f"video: {line}" for line in lines if line]

    def close(self) -> None:
        """Ends both threads."""
        self._thread.close()
        self._reader.close()

    def _look(self) -> None:
        vehicle = self._vehicle_now()
        if not vehicle:
            return
        version = self._inner.version(vehicle)
        if version != self._seen_version:
            self._seen_version, self._rows = version, self._inner.frames(vehicle, NEWEST)
        epoch, frames = self._ring.frames()
        rows = [row for row in self._rows if row.status is Status.OK]
        if not rows or len(frames) < 3:
            return
        if self._of != (epoch, rows[-1].session):
            self._of = epoch, rows[-1].session
            self._base_ns, self._voted_s, self._ahead_s = rows[-1].capture_unix_ns, -np.inf, None
            self._estimate.forget()
            self._shown.clear()
        newest = self._set(rows[-1])
        if newest is None:
            return
        self._trouble = aspect_trouble(frames[-1].size_px, newest.camera.size_px)
        age_s = self._inner.age_s(newest)
        if self._trouble or age_s is None:
            return
        self._ahead_s = time.monotonic() - age_s - self._since(newest.capture_unix_ns)
        times_s = np.array([frame.time_s for frame in frames])
        interval_s = interval_of(times_s[-100:])
        self._vote(rows, frames, times_s, interval_s)
        delay_s = self._delay_s(interval_s)
        if delay_s is not None:
            self._match(frames, times_s, interval_s, delay_s)

    def _vehicle_now(self) -> str:
        if not self.vehicle:
            there = self._inner.vehicles()
            if len(there) == 1:
                self.vehicle = there[0]
            elif there:
                self._note = f"whose is it, of {', '.join(there)[:80]}? Start again with --video-vehicle"
        return self.vehicle

    def _since(self, capture_unix_ns: int) -> float:
        return (capture_unix_ns - self._base_ns) / 1e9

    def _set(self, row: FrameRow) -> FeatureSet | None:
        found = self._inner.feature_set(self.vehicle, row.session, row.frame)
        return found if found is not None and found.is_ok and len(found) >= MIN_FEATURES else None

    def _vote(self, rows: list[FrameRow], frames: list[VideoFrame], times_s: Array, interval_s: float) -> None:
        """Vote with one set that was not used yet and of whose time all possible frames have come."""
        assert self._ahead_s is not None
        for row in rows:
            capture_s = self._since(row.capture_unix_ns)
            first_s, last_s = (capture_s + self._ahead_s + delay_s for delay_s in self._searched_s)
            if capture_s < self._voted_s + VOTE_EVERY_S or first_s < times_s[0] or last_s > times_s[-1]:
                continue
            self._voted_s = capture_s
            found = self._set(row)
            if found is None:
                continue
            inside = np.flatnonzero((times_s >= first_s) & (times_s <= last_s))
            corners = np.array([corners_at(frames[k].strength, found.uv_px, found.camera.size_px) for k in inside])
            best_s = best_time_s(times_s[inside], corners)
            if best_s is not None:
                self._estimate.take(best_s - capture_s, interval_s)
            return

    def _delay_s(self, interval_s: float) -> float | None:
        """The video's clock minus capture times; None while it is not known."""
        assert self._ahead_s is not None
        if self._entered_s is not None:
            self._note = f"delay {self._entered_s:.2f} s, as entered"
            return self._ahead_s + self._entered_s
        settled = self._estimate.settled(interval_s)
        if settled is not None:
            self._note = (
                f"delay {settled.seconds - self._ahead_s:.2f} s, measured from {settled.pictures} pictures "
                f"(+- {settled.scatter_s:.3f} s)"
            )
            return settled.seconds
        self._note = unsettled(self._estimate.stated(), interval_s)
        return None

    def _match(self, frames: list[VideoFrame], times_s: Array, interval_s: float, delay_s: float) -> None:
        """Every set that answers and whose frame must have come by now gets it, or never."""
        for count, row in enumerate(reversed(self._rows), start=1):
            key = row.session, row.frame
            target_s = self._since(row.capture_unix_ns) + delay_s
            if row.status is not Status.OK or key in self._judged or target_s > times_s[-1] or target_s < times_s[0]:
                continue
            k, found = nearest_within(times_s, target_s, interval_s), self._set(row)
            self._judged[key] = None
            while len(self._judged) > 4 * NEWEST:
                self._judged.popitem(last=False)
            if k is None or found is None:
                continue
            camera_px = found.camera.size_px
            is_it = is_seen(frames[k].strength, found.uv_px, camera_px)
            if is_it:
                near = range(max(0, k - 30), min(len(frames), k + 31))
                corners = np.array([corners_at(frames[j].strength, found.uv_px, camera_px) for j in near])
                is_it = is_ahead(times_s[near.start : near.stop], corners, k - near.start)
            self._shown.append(is_it)
            if is_it:
                self._keep(key, frames[k].jpeg, count)

    def _keep(self, key: Key, jpeg: bytes, count: int) -> None:
        with self._lock:
            self._kept[key] = jpeg
            self._bytes += len(jpeg)
            while len(self._kept) > MAX_PICTURES or self._bytes > MAX_BYTES:
                self._bytes -= len(self._kept.popitem(last=False)[1])
            self.version += count


def unsettled(stated: Delay | None, interval_s: float) -> str:
    """Explain for people why the delay is not known yet."""
    if stated is None or stated.pictures < MIN_VOTES:
        count = 0 if stated is None else stated.pictures
        return f"its delay is not known yet: found in {count} pictures of {MIN_VOTES} (or enter it: --video-delay)"
    return (
        f"its delay is not known: {stated.pictures} pictures differ by {stated.scatter_s:.2f} s, "
        f"more than half of its frames' interval of {interval_s:.2f} s"
    )
