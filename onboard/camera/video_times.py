"""The times of a video's frames by its container, and when it began.

A camera that dropped frames wrote the others at their own times, not evenly.
"""

from __future__ import annotations

import itertools
import struct
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np

NS_PER_S = 1_000_000_000
EPOCH_1904_S = -2_082_844_800  # of MP4 and QuickTime, as Unix time
MIN_UNIX_S, MAX_UNIX_S = 946_684_800, 4_102_444_800  # 2000 to 2100: outside of it no clock was set
EVEN = 0.1  # of the usual interval: by how much the others may differ in a video of constant rate
GAP = 1.5  # usual spacings: a longer one has lost a frame
UNDECODED = -1  # of CAP_PROP_FORMAT: packets as they are, which costs next to nothing


def frame_times_s(path: Path) -> list[float]:
    """Return the time of each frame, s, in the order in which they are shown; empty if they do not increase."""
    capture = cv2.VideoCapture(str(path))
    capture.set(cv2.CAP_PROP_FORMAT, UNDECODED)  # if it cannot be set, the frames are decoded
    times_s: list[float] = []
    try:
        while capture.grab():
            times_s.append(float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1e3)
    finally:
        capture.release()
    times_s.sort()  # packets come in the order of decoding
    if any(later <= earlier for earlier, later in itertools.pairwise(times_s)):
        return []
    return times_s


def dropped_note(times_s: list[float]) -> str:
    """Return a note on frames that are missing between others; empty if none is."""
    apart_s = np.diff(times_s)
    if not len(apart_s):
        return ""
    usual_s = float(np.median(apart_s))
    gaps = apart_s > GAP * usual_s
    if not gaps.any():
        return ""
    lost = round(float(np.sum(apart_s[gaps] / usual_s - 1.0)))
    return (
        f"the video lacks about {lost} frames in {int(gaps.sum())} gaps, the longest {apart_s.max():.2f} s: frames "
        "are taken at the container's own times"
    )


def rate_text(times_s: list[float]) -> str:
    """Return in words how many frames a second there are."""
    apart_s = np.diff(times_s)
    if not len(apart_s):
        return "one frame"
    usual_s = float(np.median(apart_s))
    if np.abs(apart_s - usual_s).max() <= EVEN * usual_s:
        return f"{1.0 / usual_s:.3g} frames a second"
    return f"a variable rate, {1.0 / apart_s.max():.2g} to {1.0 / apart_s.min():.3g} frames a second"


def creation_ns(path: Path) -> int | None:
    """Return when an MP4 or QuickTime file states that it began, to the second (Unix ns, taken as UTC); None if not."""
    try:
        with path.open("rb") as stream:
            moov = _box(stream, 0, path.stat().st_size, b"moov")
            header = None if moov is None else _box(stream, *moov, b"mvhd")
            if header is None:
                return None
            stream.seek(header[0])
            (version,) = struct.unpack(">B3x", stream.read(4))
            (created_s,) = struct.unpack(">Q", stream.read(8)) if version else struct.unpack(">I", stream.read(4))
    except (OSError, struct.error):
        return None
    unix_s = int(created_s) + EPOCH_1904_S
    return unix_s * NS_PER_S if MIN_UNIX_S < unix_s < MAX_UNIX_S else None


def _box(stream: BinaryIO, start: int, end: int, name: bytes) -> tuple[int, int] | None:
    """Return begin and end of a box's content among those between two places (ISO 14496-12, 4.2); None if absent."""
    at = start
    while at + 8 <= end:
        stream.seek(at)
        size, kind = struct.unpack(">I4s", stream.read(8))
        head = 8
        if size == 1:
            (size,) = struct.unpack(">Q", stream.read(8))
            head = 16
        if size == 0:
            size = end - at
        if size < head:
            return None
        if kind == name:
            return at + head, at + size
        at += size
    return None
