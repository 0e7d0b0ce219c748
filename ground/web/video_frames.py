"""A video opened with OpenCV (extra `video`), its frames made small and kept: as JPEG, with where their corners are.

Imports OpenCV only when a video is opened.
"""

from __future__ import annotations

import os
import re
import threading
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError

MAX_FRAMES, MAX_BYTES = 600, 160_000_000
MAX_SIDE_PX = 1280  # a larger frame is kept smaller
QUALITY = 80
STRENGTH_WIDTH_PX = 640  # at most
STRENGTH_UNIT = 20.0  # steps of a standard deviation
AROUND_PX = 25  # what a corner is compared with: forest is all corners, and a meadow has some too
TIMEOUT_MS = 8000
_GRABBER = re.compile(r"/dev/video(\d+)")


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """One frame. `strength` is how much more of a corner each place of a reduced picture is than those around it:
    of the whole frame mean 0, standard deviation STRENGTH_UNIT.
    """

    time_s: float  # of the video's clock: arrival on the ground's monotonic one, or since a file's beginning
    size_px: tuple[int, int]  # of the video, before it was made small
    strength: NDArray[np.int8]
    jpeg: bytes

    @property
    def size(self) -> int:
        return len(self.jpeg) + self.strength.nbytes


class Ring:
    """The last frames, bounded in number and bytes. Thread-safe. `epoch` counts the openings of the video, of which
    each has delays of its own: frames of an earlier one are dropped.
    """

    def __init__(self, max_frames: int = MAX_FRAMES, max_bytes: int = MAX_BYTES) -> None:
        self._bounds = max_frames, max_bytes
        self._lock = threading.Lock()
        self._frames: deque[VideoFrame] = deque()
        self._bytes = 0
        self.epoch = 0

    def put(self, frame: VideoFrame) -> None:
        """Frames come in the order of their times."""
        with self._lock:
            self._frames.append(frame)
            self._bytes += frame.size
            while len(self._frames) > self._bounds[0] or self._bytes > self._bounds[1]:
                self._bytes -= self._frames.popleft().size

    def restart(self) -> None:
        with self._lock:
            self._frames.clear()
            self._bytes = 0
            self.epoch += 1

    def frames(self) -> tuple[int, list[VideoFrame]]:
        with self._lock:
            return self.epoch, list(self._frames)


def open_video(source: str) -> Any:
    """A `cv2.VideoCapture` of a file, an address or /dev/videoN. Raises InputError for what cannot be opened."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # its own messages on standard error do not help
    import cv2  # noqa: PLC0415  the extra `video`

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    if is_file(source) and not Path(source).is_file():
        raise InputError(f"--video {source}: there is no such file")
    grabber = _GRABBER.fullmatch(source)
    if grabber:
        capture = cv2.VideoCapture(int(grabber[1]), cv2.CAP_V4L2)
    else:
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, TIMEOUT_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, TIMEOUT_MS]
        capture = cv2.VideoCapture(source, cv2.CAP_FFMPEG, [] if is_file(source) else limits)
    if not capture.isOpened():
        capture.release()
        what = (
            "is it plugged in, and used by no other program?"
            if grabber
            else "is it a video, and does its address answer?"
        )
        raise InputError(f"--video {source}: cannot be opened; {what}")
    return capture


def is_file(source: str) -> bool:
    """Or an address, or a grabber. A file gives its frames as fast as they are asked for."""
    return "://" not in source and not source.startswith("/dev/")


def position_s(capture: Any) -> float:
    """The stream's own time of the frame grabbed last."""
    import cv2  # noqa: PLC0415

    return float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0


def retrieved(capture: Any) -> NDArray[np.uint8] | None:
    """The picture grabbed last, (H, W) or (H, W, 3); None for one that is damaged."""
    good, image = capture.retrieve()
    return np.asarray(image, np.uint8) if good and image is not None and image.ndim in (2, 3) and image.size else None


def corner_strength(image: NDArray[np.uint8]) -> NDArray[np.int8]:
    """`VideoFrame.strength` of a picture: STRENGTH_WIDTH_PX wide or as the picture is, its rows in proportion."""
    import cv2  # noqa: PLC0415

    height, width = image.shape[:2]
    columns = min(STRENGTH_WIDTH_PX, width)
    small = cv2.resize(image, (columns, max(round(height * columns / width), 8)), interpolation=cv2.INTER_AREA)
    grey = cv2.cvtColor(small, cv2.COLOR_BGR2GRAY) if small.ndim == 3 else small
    contrast = np.sqrt(np.maximum(cv2.cornerMinEigenVal(grey, 3), 0.0))
    response = contrast / (cv2.blur(contrast, (AROUND_PX, AROUND_PX)) + 1e-4)
    mean, deviation = (float(x[0, 0]) for x in cv2.meanStdDev(response))
    if deviation < 1e-3:
        return np.zeros(response.shape, np.int8)  # one colour
    return np.asarray(np.clip((response - mean) * (STRENGTH_UNIT / deviation), -127, 127), np.int8)


def to_jpeg(image: NDArray[np.uint8]) -> bytes:
    """The JPEG that is kept and shown, with no side longer than MAX_SIDE_PX."""
    import cv2  # noqa: PLC0415

    height, width = image.shape[:2]
    share = MAX_SIDE_PX / max(height, width)
    if share < 1.0:
        image = np.asarray(
            cv2.resize(image, (round(width * share), round(height * share)), interpolation=cv2.INTER_AREA), np.uint8
        )
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes())


def kept_frame(image: NDArray[np.uint8], time_s: float) -> VideoFrame:
    """A picture as it is kept."""
    height, width = image.shape[:2]
    return VideoFrame(time_s, (width, height), corner_strength(image), to_jpeg(image))
