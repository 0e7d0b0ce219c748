"""A thermal camera's counts -> the grey picture that is tracked, its brightness steady from picture to picture.

Ground that differs by a kelvin is spread over the grey scale by the spread of its middle half, so that a fire or the
sky does not take the scale from it, and the stretch changes slowly. What the sensor adds by itself, another amount for
each pixel and column, stays in the picture while the ground moves: it is estimated from what stays, and taken off.
Once it is no longer found in the picture, as after a shutter event, it is forgotten and learned anew.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.uint8]
ThermalCounts = NDArray[np.uint16]
Grid = NDArray[np.float32]

QUARTILES = (25.0, 50.0, 75.0)  # per cent
MIDDLE_LEVELS = 40.0  # grey levels from the first to the last of these: a normal spread then fills the scale
MOST_GAIN = 4.0  # grey levels a count
GAIN_STEP = 0.02  # by which the stretch may change from picture to picture
SAMPLE_STEP = 4

ROUND_PX = 3  # what of a pixel is not in the mean of so many around it may be the sensor's own
MOST_SIGMAS = 3.0  # of that, what is more is the ground's: edges, and what is hot
LEARNED_FROM = 48  # pictures of other ground, in the mean
ENOUGH = 8  # of these, before anything is taken off
MOVED = 0.5  # correlation of two pictures' ground below which they show other ground
STILL_THERE = 0.5  # of the pattern that must be found in a picture again, else it is another by now


class ThermalGrey:
    """Counts in capture order, of one camera, to grey. The same counts again give the same picture."""

    def __init__(self) -> None:
        self._last: tuple[ThermalCounts, Grey] | None = None
        self._gain: float | None = None
        self._pattern = FixedPattern()

    def picture(self, raw: ThermalCounts | Grey) -> tuple[Grey, ThermalCounts]:
        """What a camera gave (H, W), 8 or 16 bits -> grey and counts. Eight bits the camera has stretched itself."""
        if raw.dtype == np.uint8:
            return raw.astype(np.uint8, copy=False), raw.astype(np.uint16)
        counts = raw.astype(np.uint16, copy=False)
        return self._grey(counts), counts

    def _grey(self, counts: ThermalCounts) -> Grey:
        if self._last is not None and np.array_equal(self._last[0], counts):
            return self._last[1]  # the shutter is closed, or it is an old picture: nothing is learned of it
        low, middle, high = np.percentile(counts[::SAMPLE_STEP, ::SAMPLE_STEP], QUARTILES)
        wanted = min(MIDDLE_LEVELS / max(float(high - low), 1.0), MOST_GAIN)
        before = wanted if self._gain is None else self._gain
        gain = min(max(wanted, before / (1.0 + GAIN_STEP)), before * (1.0 + GAIN_STEP))
        level = counts.astype(np.float32) - np.float32(middle)
        level -= self._pattern.learn(level)
        level *= np.float32(gain)
        grey: Grey = np.clip(level + np.float32(128.5), 0.0, 255.0).astype(np.uint8)
        self._last, self._gain = (counts, grey), gain
        return grey


class FixedPattern:
    """The mean of what pictures of different ground have in each pixel beyond the mean of the pixels around it."""

    def __init__(self) -> None:
        self._forget()

    def _forget(self) -> None:
        self._mean: Grid | None = None
        self._seen = 0
        self._ground: Grid | None = None  # of the newest picture that was learned from

    def learn(self, level: Grid) -> Grid | np.float32:
        """Counts (H, W) of one more picture -> what of them is the sensor's own, as is known by now."""
        own = level - cv2.blur(level, (ROUND_PX, ROUND_PX), borderType=cv2.BORDER_REFLECT_101)
        reach = np.float32(MOST_SIGMAS * 1.4826) * np.float32(np.median(np.abs(own[::SAMPLE_STEP, ::SAMPLE_STEP])))
        np.clip(own, -reach, reach, out=own)
        if self._mean is None:
            self._mean, self._ground, self._seen = own.copy(), own, 1
            return np.float32(0.0)
        if self._seen >= ENOUGH and _dot(own, self._mean) < STILL_THERE * _dot(self._mean, self._mean):
            self._forget()
            return self.learn(level)
        ground = own - self._mean
        if self._ground is None or _alike(ground, self._ground) < MOVED:
            self._seen = min(self._seen + 1, LEARNED_FROM)
            self._mean += ground * np.float32(1.0 / self._seen)
            self._ground = ground
        return self._mean if self._seen >= ENOUGH else np.float32(0.0)


def _dot(a: Grid, b: Grid) -> float:
    return float(np.vdot(a, b))


def _alike(a: Grid, b: Grid) -> float:
    """Correlation of two grids of mean zero; 0 where one is empty."""
    return _dot(a, b) / max(math.sqrt(_dot(a, a) * _dot(b, b)), 1e-12)
