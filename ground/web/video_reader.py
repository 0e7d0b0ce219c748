"""A video read in a thread of its own into a ring, and opened again when it ends or breaks."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import numpy as np

from contract.errors import InputError
from contract.secrets import without_secrets
from contract.supervised_thread import Policy, Stop, SupervisedThread
from ground.web.video_frames import (
    Ring,
    is_file,
    kept_frame,
    open_video,
    position_s,
    retrieved,
)

MAX_HZ = 20.0  # of a faster video frames are dropped
FIRST_RETRY_S, MAX_RETRY_S = 1.0, 30.0
CLOCK_FRAMES = 300
LATE_S = 0.1


class FrameClock:
    """The times when frames were sent, from when they arrived and from the stream's own stamps.

    A network that holds frames back and then delivers several at once does not make them later. Stamps that do not
    agree with the ground's clock are not used.
    """

    def __init__(self) -> None:
        self._last: deque[tuple[float, float]] = deque(maxlen=CLOCK_FRAMES)  # arrival, arrival minus stamp
        self._newest_s = -np.inf
        self._stamp_s = -np.inf

    def time_s(self, arrival_s: float, stamp_s: float) -> float:
        """The time on the ground's clock when the frame was sent; grows from frame to frame."""
        if stamp_s <= self._stamp_s:  # none, or begun again
            self._last.clear()
        self._stamp_s = stamp_s
        self._last.append((arrival_s, arrival_s - stamp_s))
        behind = np.array([ahead for _, ahead in self._last])
        least = float(np.min(behind))
        is_usable = len(behind) > 1 and float(np.median(behind)) - least < LATE_S
        self._newest_s = max(stamp_s + least if is_usable else arrival_s, self._newest_s + 1e-4)
        return self._newest_s


class VideoReader:
    """Reads until it is closed. Raises InputError if the video cannot be opened at first."""

    def __init__(self, source: str, ring: Ring, retry_s: tuple[float, float] = (FIRST_RETRY_S, MAX_RETRY_S)) -> None:
        self.name = without_secrets(source)
        self._trouble = ""
        self._source = source
        self._ring = ring
        self._retry_s = retry_s
        self._capture: Any = open_video(source)
        # A read may take as long as its own time limit, and gives no heartbeat during that time.
        self._thread = SupervisedThread("reader of the video", self._run, Policy.RESTART, late_after_s=None)
        self._thread.start()

    @property
    def trouble(self) -> str:
        """The reason why no frames come, as a text for users; empty if nothing is wrong."""
        report = self._thread.report()
        return self._trouble if report.is_well else f"{self.name}: {report.last_error}; it is begun again"

    def close(self) -> None:
        """A read that hangs ends at its time limit."""
        self._thread.end()
        self._thread.join(2.0)

    def _run(self, stop: Stop) -> None:
        wait_s = self._retry_s[0]
        capture, self._capture = self._capture, None
        while not stop.is_set():
            what = "is not there"
            if capture is not None:
                what = "ended or broke off"
                try:
                    if self._read(capture, stop):
                        wait_s = self._retry_s[0]
                except Exception as error:  # OpenCV's own: a stream may hold anything, and may go on after it
                    what = f"broke off ({str(error).strip()[:200] or type(error).__name__})"
                finally:
                    capture.release()
            self._trouble = f"{self.name}: {what}; opened again in {wait_s:.0f} s"
            if stop.wait(wait_s):
                return
            wait_s = min(2.0 * wait_s, self._retry_s[1])
            try:
                capture = open_video(self._source)
            except InputError:
                capture = None

    def _read(self, capture: Any, stop: Stop) -> bool:
        """Read until the video ends; returns whether any frame came."""
        self._ring.restart()
        clock, start_s, kept_s = FrameClock(), time.monotonic(), -np.inf
        came = False
        while not stop.is_set() and capture.grab():
            stamp_s = position_s(capture)
            if is_file(self._source) and stop.wait(max(start_s + stamp_s - time.monotonic(), 0.0)):
                break
            arrival_s = time.monotonic()
            at_s = clock.time_s(arrival_s, stamp_s)
            if at_s - kept_s < 0.8 / MAX_HZ:
                continue
            image = retrieved(capture)
            if image is None:
                continue
            kept_s = at_s
            self._ring.put(kept_frame(image, at_s))
            came, self._trouble = True, ""
        return came
