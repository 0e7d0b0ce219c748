"""The frames of a video file for the sets of a recording: read for the delay, then to match, then frame by frame.

The file's own time stamps are its clock, from its beginning; capture times count from the recording's first picture.
So the delay is how far into the file that picture is, negative if the file was begun later.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator
from typing import Any

import numpy as np

from contract.errors import InputError
from contract.feature_set import FeatureSet, Status
from contract.secrets import without_secrets
from contract.supervised_thread import Policy, SupervisedThread
from ground.web.source import FrameRow, Source
from ground.web.video_delay import (
    MIN_FEATURES,
    NEAR_S,
    Array,
    DelayEstimate,
    best_time_s,
    corners_at,
    interval_of,
    is_ahead,
    is_seen,
    nearest_within,
)
from ground.web.video_frames import corner_strength, open_video, position_s, retrieved, to_jpeg
from ground.web.video_live import unsettled
from ground.web.video_reader import MAX_HZ
from ground.web.with_video import aspect_trouble

ASKED = 40  # sets that the delay is measured with
KEPT = 32  # frames, as JPEG
SEEK_BEFORE_S = 1.0
SAME_S = 5e-4


class FileFootage:
    """Serves `Footage`. Raises InputError for a file that cannot be opened."""

    def __init__(self, source: str, inner: Source, vehicle: str, delay_s: float | None) -> None:
        self.vehicle = vehicle
        self.version = 0
        self._source = source
        self._name = without_secrets(source)
        self._inner = inner
        self._entered_s = delay_s
        self._rows = [row for row in inner.frames(vehicle) if row.status is Status.OK]
        self._first_ns = min((row.capture_unix_ns for row in inner.frames(vehicle)), default=0)
        self._times_s: dict[tuple[int, int], float] = {}  # of sets: session, frame
        self._seeking = threading.Lock()
        self._capture: Any = open_video(source)
        self._kept: OrderedDict[float, bytes] = OrderedDict()
        self._note = f"{self._name} is being read"
        self._refused = 0
        self._stop = threading.Event()
        # A video without what it takes from the file is no reason to begin again: the page goes on without.
        self._thread = SupervisedThread("search in the video", self._run, Policy.DEGRADE, late_after_s=None)
        self._thread.start()

    def has(self, session: int, frame: int) -> bool:
        return (session, frame) in self._times_s

    def picture(self, session: int, frame: int) -> bytes | None:
        """The frame that was found for it, read now."""
        time_s = self._times_s.get((session, frame))
        if time_s is None:
            return None
        with self._seeking:
            if time_s not in self._kept:
                jpeg = self._read_at(time_s)
                if jpeg is None:
                    return None
                self._kept[time_s] = jpeg
                while len(self._kept) > KEPT:
                    self._kept.popitem(last=False)
            return self._kept[time_s]

    def notes(self) -> list[str]:
        """The file, its delay, and pictures that were left out."""
        report = self._thread.report()
        lines = [self._note if report.is_well else f"{self._name}: stopped by {report.last_error}"]
        if self._refused:
            lines.append(f"{self._refused} of its frames do not show their sets' features: left out")
        return [f"video: {line}" for line in lines]

    def close(self) -> None:
        """Stops reading the file."""
        self._stop.set()
        self._thread.join(5.0)
        with self._seeking:
            self._capture.release()

    def _run(self, thread: SupervisedThread) -> None:
        try:
            self._measure_and_match()
        except InputError as error:
            self._note = str(error)
        thread.end()  # finished

    def _measure_and_match(self) -> None:
        step = max(len(self._rows) / ASKED, 1.0)
        asked = [self._rows[int(k * step)] for k in range(min(ASKED, len(self._rows)))]
        sets = [(row, found) for row in asked if (found := self._set(row)) is not None]
        if not sets:
            self._note = "no set of the recording has enough features to find its frame by"
            return
        times_s: list[float] = []
        columns: list[list[float]] = []
        for time_s, image in self._frames():
            if not times_s:
                trouble = aspect_trouble((image.shape[1], image.shape[0]), sets[0][1].camera.size_px)
                if trouble:
                    self._note = trouble
                    return
            times_s.append(time_s)
            if self._entered_s is None:
                strength = corner_strength(image)
                columns.append([corners_at(strength, s.uv_px, s.camera.size_px) for _, s in sets])
        if self._stop.is_set():
            return
        if len(times_s) < 2:
            self._note = f"{self._name} has no frames with time stamps"
            return
        interval_s = interval_of(np.array(times_s))
        delay_s = self._delay_s(sets, np.array(times_s), np.array(columns), interval_s)
        if delay_s is not None:
            self._match(np.array(times_s), delay_s, interval_s)

    def _delay_s(
        self, sets: list[tuple[FrameRow, FeatureSet]], times_s: Array, corners: Array, interval_s: float
    ) -> float | None:
        if self._entered_s is not None:
            self._note = f"delay {self._entered_s:.2f} s, as entered"
            return self._entered_s
        estimate = DelayEstimate(ASKED)
        for (row, _), of_set in zip(sets, corners.T, strict=True):
            best_s = best_time_s(times_s, of_set)
            if best_s is not None:
                estimate.vote(best_s - self._since(row))
        settled = estimate.settled(interval_s)
        if settled is None:
            self._note = unsettled(estimate.stated(), interval_s)
            return None
        self._note = (
            f"delay {settled.seconds:.2f} s, measured from {settled.pictures} pictures (+- {settled.scatter_s:.3f} s)"
        )
        return settled.seconds

    def _match(self, times_s: Array, delay_s: float, interval_s: float) -> None:
        """Through the file once more: each set's nearest frame, if it shows its features and none near does better."""
        waiting: list[tuple[FrameRow, float]] = []
        for row in sorted(self._rows, key=lambda row: row.capture_unix_ns):
            near = nearest_within(times_s, self._since(row) + delay_s, interval_s)
            if near is not None:
                waiting.append((row, float(times_s[near])))
        near_frames: list[tuple[float, Any]] = []
        for time_s, image in self._frames():
            near_frames.append((time_s, corner_strength(image)))
            while waiting and waiting[0][1] + NEAR_S < time_s:
                self._judge(*waiting.pop(0), near_frames)
            # What the next set in line does not look back to is not kept.
            keep_s = (waiting[0][1] if waiting else time_s) - NEAR_S
            near_frames = [pair for pair in near_frames if pair[0] >= keep_s]
        while waiting and not self._stop.is_set():
            self._judge(*waiting.pop(0), near_frames)
        self.version += len(self._rows)

    def _judge(self, row: FrameRow, time_s: float, near: list[tuple[float, Any]]) -> None:
        found = self._set(row)
        near = [pair for pair in near if abs(pair[0] - time_s) <= NEAR_S]
        k = next((k for k, pair in enumerate(near) if abs(pair[0] - time_s) < SAME_S), None)
        if found is None or k is None:
            return
        camera_px = found.camera.size_px
        corners = np.array([corners_at(strength, found.uv_px, camera_px) for _, strength in near])
        if is_seen(near[k][1], found.uv_px, camera_px) and is_ahead(np.array([at_s for at_s, _ in near]), corners, k):
            self._times_s[row.session, row.frame] = time_s
        else:
            self._refused += 1

    def _frames(self) -> Iterator[tuple[float, Any]]:
        """All frames from the beginning with their stamps, at most MAX_HZ of them a second."""
        capture = open_video(self._source)
        newest_s = -np.inf
        try:
            while not self._stop.is_set() and capture.grab():
                time_s = position_s(capture)
                if time_s - newest_s < 0.8 / MAX_HZ:
                    continue
                image = retrieved(capture)
                if image is not None:
                    newest_s = time_s
                    yield time_s, image
        finally:
            capture.release()

    def _read_at(self, time_s: float) -> bytes | None:
        """The frame of that stamp and no other: by a seek to a little before, or else read from the beginning."""
        for start_s in (max(time_s - SEEK_BEFORE_S, 0.0), 0.0):
            self._capture.release()
            self._capture = open_video(self._source)
            if start_s > 0.0:
                _seek(self._capture, start_s)
            while self._capture.grab() and not self._stop.is_set():
                at_s = position_s(self._capture)
                if at_s < time_s - SAME_S:
                    continue
                if at_s <= time_s + SAME_S:
                    image = retrieved(self._capture)
                    return None if image is None else to_jpeg(image)
                break
        return None

    def _since(self, row: FrameRow) -> float:
        return (row.capture_unix_ns - self._first_ns) / 1e9

    def _set(self, row: FrameRow) -> FeatureSet | None:
        found = self._inner.feature_set(self.vehicle, row.session, row.frame)
        return found if found is not None and found.is_ok and len(found) >= MIN_FEATURES else None


def _seek(capture: Any, time_s: float) -> None:
    import cv2  # noqa: PLC0415

    capture.set(cv2.CAP_PROP_POS_MSEC, 1000.0 * time_s)
