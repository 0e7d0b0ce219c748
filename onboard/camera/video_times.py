"""The times of a video's frames by its container.

A camera that dropped frames wrote the others at their own times, not evenly.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import cv2
import numpy as np

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
