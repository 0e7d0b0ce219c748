"""A thermal camera's counts -> the grey picture that is tracked, its brightness steady from picture to picture.

Ground that differs by a kelvin is spread over the grey scale by the spread of its middle half, so that a fire or the
sky does not take the scale from it, and the stretch changes slowly. What the sensor adds by itself, another amount for
each pixel and column, stays in the picture while the ground moves: it is estimated from what stays, and taken off.
Once it is no longer found in the picture, as after a shutter event, it is forgotten and learned again. What is left of
a bland picture is noise from pixel to pixel, and is smoothed.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError
from onboard.config.schema import ThermalConfig

Grey = NDArray[np.uint8]
ThermalCounts = NDArray[np.uint16]
Grid = NDArray[np.float32]

LIGHTEST = np.uint8(255)
QUARTILES = (25.0, 50.0, 75.0)  # per cent
MIDDLE_LEVELS = 40.0  # grey levels from the first to the last of these: a normal spread then fills the scale
MOST_GAIN = 4.0  # grey levels a count
GAIN_STEP = 0.02  # by which the stretch may change from picture to picture
SMOOTHED_PX = 0.6  # one sigma: of what is so small most is noise
SAMPLE_STEP = 4

ROUND_PX = 7  # what of a pixel is not in the mean of so many around it may be the sensor's own
MOST_SIGMAS = 3.0  # of that, what is more is the ground's: edges, and what is hot
LEARNED_FROM = 48  # pictures of other ground, in the mean
ENOUGH = 16  # of these, from which the mean is more the sensor's than the ground's if there is anything to be found
STILL_THERE = 0.5  # of such a mean that must be found in a picture, else the pattern is another by now
CELL_PX, CELLS_ROUND = 4, 9
COLOURED_LEVELS, MOST_COLOURED = 30, 0.02  # between a pixel's channels; the share of such pixels: marks, no palette
MOVED = 0.5  # correlation of two pictures' cells below which they show other ground


class ThermalGrey:
    """Counts in capture order, of one camera, to grey. The same counts again give the same picture.

    `black_hot`: of pictures of 8 bits what is dark is hot; their counts are turned round, and rise with heat again.
    """

    def __init__(self, black_hot: bool = False) -> None:
        self._black_hot = black_hot
        self._last: tuple[ThermalCounts, Grey] | None = None
        self._gain: float | None = None
        self._pattern = FixedPattern()

    def picture(self, raw: ThermalCounts | Grey) -> tuple[Grey, ThermalCounts]:
        """Return a camera's picture (H, W), of 8 or 16 bits, as grey and as counts."""
        is_turned = self._black_hot and raw.dtype == np.uint8
        counts = (LIGHTEST - raw if is_turned else raw).astype(np.uint16, copy=False)
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
        level = np.asarray(cv2.GaussianBlur(level, (0, 0), SMOOTHED_PX), np.float32)
        level *= np.float32(gain)
        grey: Grey = np.clip(level + np.float32(128.5), 0.0, 255.0).astype(np.uint8)
        self._last, self._gain = (counts, grey), gain
        return grey


def thermal_grey(config: ThermalConfig) -> ThermalGrey | None:
    """The counts to grey of a camera as configured; None of one that is no thermal one."""
    return ThermalGrey(config.black_hot) if config.enabled else None


def refuse_palette(colour: NDArray[np.uint8], what: str) -> None:
    """Raise InputError for a thermal picture (H, W, 3) in a palette of colours, whose brightness is not its heat."""
    apart = colour.max(axis=2).astype(np.int16) - colour.min(axis=2)
    if np.mean(apart > COLOURED_LEVELS) > MOST_COLOURED:
        raise InputError(
            f"{what}: shown in a colour palette, whose brightness does not rise with heat; record in white hot, or "
            "pictures with counts (R-JPEG, 16 bit TIFF)"
        )


class FixedPattern:
    """The mean of what pictures of different ground have in each pixel beyond the mean of the pixels around it."""

    def __init__(self) -> None:
        self._forget()

    def _forget(self) -> None:
        self._mean: Grid | None = None
        self._seen = 0
        self._share = 0.0  # of the mean that was found in the newest picture of other ground
        self._ground: Grid | None = None  # of the newest picture that was learned from

    def learn(self, level: Grid) -> Grid | np.float32:
        """Counts (H, W) of one more picture -> what of them is the sensor's own, as is known by now.

        Of the mean so much is taken off as is found in the picture: as long as it is of few pictures, most of it is
        their ground.
        """
        own = _clipped(level - cv2.blur(level, (ROUND_PX, ROUND_PX), borderType=cv2.BORDER_REFLECT_101))
        known = np.float32(self._share) * self._mean if self._mean is not None else np.float32(0.0)
        ground = _coarse(level - known)
        if self._mean is None or self._ground is None:
            self._mean, self._ground, self._seen = own, ground, 1
            return known
        if _likeness(ground, self._ground) >= MOVED:
            return known
        share = min(max(_dot(own, self._mean) / max(_dot(self._mean, self._mean), 1e-12), 0.0), 1.0)
        if self._seen >= ENOUGH and share < STILL_THERE:
            self._forget()
            return self.learn(level)
        known = np.float32(share) * self._mean
        self._share, self._ground, self._seen = share, ground, min(self._seen + 1, LEARNED_FROM)
        self._mean += (own - self._mean) * np.float32(1.0 / self._seen)
        return known


def _clipped(values: Grid) -> Grid:
    """Without what is far more than usual, in place."""
    reach = np.float32(MOST_SIGMAS * 1.4826) * np.float32(np.median(np.abs(values[::SAMPLE_STEP, ::SAMPLE_STEP])))
    return np.asarray(np.clip(values, -reach, reach, out=values), np.float32)


def _coarse(level: Grid) -> Grid:
    """The ground in cells of `CELL_PX`, in which pixels' own errors are small, without what is smooth over many."""
    height, width = level.shape
    cells = cv2.resize(level, (max(width // CELL_PX, 1), max(height // CELL_PX, 1)), interpolation=cv2.INTER_AREA)
    return _clipped(np.asarray(cells - cv2.blur(cells, (CELLS_ROUND, CELLS_ROUND)), np.float32))


def _dot(a: Grid, b: Grid) -> float:
    return float(np.vdot(a, b))


def _likeness(a: Grid, b: Grid) -> float:
    """Correlation of two grids of mean zero; 0 where one is empty."""
    return _dot(a, b) / max(math.sqrt(_dot(a, a) * _dot(b, b)), 1e-12)
