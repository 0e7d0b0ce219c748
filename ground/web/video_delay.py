"""The lead of a video's clock over the sets' capture times, and whether a frame is a set's picture. NumPy only.

A set states where in its picture corners were tracked. The frame that shows its picture has corners at these pixels,
and others have not: neither frames of another time, nor the same frame shifted by some pixels. All measures are in
standard deviations of a mean over as many places of the frame taken at random.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.web.video_frames import STRENGTH_UNIT

Array = NDArray[np.float64]

CLEAR = 4.0  # standard deviations by which the right one must be ahead of others
MIN_FEATURES = 12
RING_PX = 6.0  # of the reduced picture: so far from a corner there is none
NEAR_S = 0.7  # frames within this of the best one may look like it: the aircraft has hardly moved
MIN_RIVALS = 5
MIN_VOTES = 8
MAX_VOTES = 31
MAX_DISAGREE = 3  # votes in a row after which those before are dropped
TOLERANCE_S = 0.01  # of arrivals: how much earlier or later than their own interval frames come
_RING = RING_PX * np.array([[np.cos(a), np.sin(a)] for a in np.arange(8) * np.pi / 4])


def corners_at(strength: NDArray[np.int8], uv_px: Array, camera_size_px: tuple[int, int]) -> float:
    """The frame's corner response at a set's pixels (N, 2) of its camera, above chance, in sigmas; 0 for few pixels."""
    return _mean_at(strength, _places(strength, uv_px, camera_size_px))


def is_seen(strength: NDArray[np.int8], uv_px: Array, camera_size_px: tuple[int, int]) -> bool:
    """Return whether a frame has its corners at a set's pixels, and clearly fewer at pixels shifted a little."""
    places = _places(strength, uv_px, camera_size_px)
    here = _mean_at(strength, places)
    return here >= CLEAR and here - max(_mean_at(strength, places + step) for step in _RING) >= CLEAR


def best_time_s(times_s: Array, corners: Array) -> float | None:
    """The time of a set's picture in the video, by its `corners_at` of all frames (F,); None where that is not clear.

    It is not at either end (there the frame may be missing), and clearly ahead of all that are not near it.
    """
    if len(times_s) < MIN_RIVALS + 3:
        return None
    k = int(np.argmax(corners))
    rivals = corners[np.abs(times_s - times_s[k]) > NEAR_S]
    if k in (0, len(times_s) - 1) or len(rivals) < MIN_RIVALS or corners[k] < CLEAR:
        return None
    if corners[k] - float(np.max(rivals)) < CLEAR:
        return None
    before_s, after_s = times_s[k - 1] - times_s[k], times_s[k + 1] - times_s[k]
    # The top of the parabola through three frames: between frames the picture was taken, too.
    (a, b), *_ = np.linalg.lstsq(
        np.array([[before_s**2, before_s], [after_s**2, after_s]]), corners[[k - 1, k + 1]] - corners[k], rcond=None
    )
    top_s = -b / (2.0 * a) if a < 0.0 else 0.0
    return float(times_s[k] + np.clip(top_s, 0.5 * before_s, 0.5 * after_s))


def nearest_within(times_s: Array, target_s: float, interval_s: float) -> int | None:
    """The frame nearest a time, if it is within half of an interval and TOLERANCE_S."""
    if not len(times_s):
        return None
    k = int(np.argmin(np.abs(times_s - target_s)))
    return k if abs(times_s[k] - target_s) <= 0.5 * interval_s + TOLERANCE_S else None


def is_ahead(times_s: Array, corners: Array, k: int) -> bool:
    """Return whether no frame near a chosen one is clearly the better one."""
    near = corners[np.abs(times_s - times_s[k]) <= NEAR_S]
    return float(np.max(near)) - float(corners[k]) < CLEAR


@dataclass(frozen=True)
class Delay:
    """The video's clock minus capture times."""

    seconds: float
    scatter_s: float  # one sigma of a picture's, not of the median's
    pictures: int


class DelayEstimate:
    """The median of the last pictures' delays. Not for use by several threads."""

    def __init__(self, most: int = MAX_VOTES) -> None:
        self._votes: deque[float] = deque(maxlen=most)

    def vote(self, vote_s: float) -> None:
        self._votes.append(vote_s)

    def take(self, vote_s: float, interval_s: float) -> None:
        """The delay of the next picture. Some in a row that contradict all before are accepted: the video was cut."""
        self.vote(vote_s)
        stated = self.stated()
        last = list(self._votes)[-MAX_DISAGREE:]
        if stated is None or len(self._votes) <= MAX_DISAGREE:
            return
        if all(abs(vote - stated.seconds) > interval_s + TOLERANCE_S for vote in last):
            self._votes = deque(last, maxlen=self._votes.maxlen)

    def forget(self) -> None:
        """Drop all votes: they were of another opening of the video, or of another session."""
        self._votes.clear()

    def stated(self) -> Delay | None:
        """The median and its scatter, however few they are; None of none."""
        if not self._votes:
            return None
        votes = np.array(self._votes)
        middle = float(np.median(votes))
        return Delay(middle, 1.4826 * float(np.median(np.abs(votes - middle))), len(votes))

    def settled(self, interval_s: float) -> Delay | None:
        """The delay, once enough pictures agree to less than half of the frames' interval."""
        stated = self.stated()
        return stated if stated and stated.pictures >= MIN_VOTES and stated.scatter_s < 0.5 * interval_s else None


def interval_of(times_s: Array) -> float:
    """The frames' interval; 0 of fewer than two."""
    return float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0


def _places(strength: NDArray[np.int8], uv_px: Array, camera_size_px: tuple[int, int]) -> Array:
    rows, columns = strength.shape
    scale = np.array([columns / camera_size_px[0], rows / camera_size_px[1]])
    return np.asarray((np.asarray(uv_px, np.float64) + 0.5) * scale, np.float64)


def _mean_at(strength: NDArray[np.int8], places: Array) -> float:
    rows, columns = strength.shape
    at = np.floor(places).astype(np.intp)
    at = at[(at[:, 0] >= 0) & (at[:, 1] >= 0) & (at[:, 0] < columns) & (at[:, 1] < rows)]
    if len(at) < MIN_FEATURES:
        return 0.0
    return float(np.mean(strength[at[:, 1], at[:, 0]], dtype=np.float64)) / STRENGTH_UNIT * float(np.sqrt(len(at)))
