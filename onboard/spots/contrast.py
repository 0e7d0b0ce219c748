"""A picture against its own surroundings, for things of one size: background, clutter, and what stands out.

(25.3) to (25.5)
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

WINDOW = 5  # parts to a side, of which the median is taken
THING_PX, BLUR_PX = 3.0, 0.6  # a thing's side in the picture that is made as coarse as may be
CLUTTER_SIDES = 6.0  # of a thing, to the side of a part whose clutter is one figure
LEAST_SHARE = 0.3  # of the picture's usual clutter, below which no part's is taken to be: flat water has none
EACH = 3  # row and column that the whole picture's figures are made of
TO_SIGMA = 1.4826  # of a median absolute deviation


@dataclass(frozen=True, eq=False)
class Contrast:
    """The contrast of a picture (H, W) made coarser `times`: in its own unit, and in sigmas of the clutter."""

    side_m: float  # of the things that it is for
    times: float
    values: Image
    background: Image
    excess: Image  # smoothed at the thing's size
    in_clutter: Image
    power: Image  # (h, w), the mean square of what stands out, in each part of the picture
    clutter: Image  # (h, w), of each of them
    is_ground: Mask  # likewise

    @property
    def size_px(self) -> tuple[int, int]:
        return self.values.shape[1], self.values.shape[0]


def contrast(values: Image, is_ground: Mask, side_m: float, pixel_m: float) -> Contrast:
    """Return the contrast of things of that side; `is_ground` (h, w) has one value for each part of the picture."""
    height, width = values.shape
    times = max(side_m / pixel_m / THING_PX, 1.0)
    if times > 1.0:
        size = max(round(width / times), 2 * WINDOW), max(round(height / times), 2 * WINDOW)
        values = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)
        times = width / size[0]
    side_px = max(side_m / pixel_m / times, 1.0)
    # A spot covers a few of the window's parts: their median is the ground about it.
    low = _parts(values, side_px)
    background = stretched(np.asarray(cv2.medianBlur(low, WINDOW), np.float32), values)
    excess = np.asarray(cv2.GaussianBlur(values - background, (0, 0), BLUR_PX), np.float32)
    power = _parts(excess * excess, CLUTTER_SIDES * side_px)
    local = np.sqrt(np.asarray(cv2.medianBlur(power, WINDOW), np.float32))
    ground = stretched(is_ground.astype(np.float32), local) > 0.5
    floor = max(LEAST_SHARE * float(np.median(local[ground] if ground.any() else local)), 1e-6)
    local = np.maximum(local, np.float32(floor))
    in_clutter = excess / stretched(local, values)
    in_clutter[stretched(is_ground.astype(np.float32), values) < 0.99] = 0.0
    return Contrast(side_m, times, values, background, excess, in_clutter, power, local, ground)


def in_picture(values: Image, is_ground: Mask) -> tuple[Image, float]:
    """Return how far each pixel (H, W) is above the median of the ground's, in sigmas of them, and that median. (25.9)

    Pixels that show no ground are 0.
    """
    outside = stretched(is_ground.astype(np.float32), values) < 0.99
    some = values[::EACH, ::EACH]
    some = some if outside.all() else some[~outside[::EACH, ::EACH]]
    usual = float(np.median(some))
    spread = max(TO_SIGMA * float(np.median(np.abs(some - usual))), 1e-3)
    out: Image = (values - np.float32(usual)) / np.float32(spread)
    out[outside] = 0.0
    return out, usual


def _parts(values: Image, part_px: float) -> Image:
    """Means of parts of about so many pixels to a side; at least a window of them."""
    height, width = values.shape
    size = max(round(width / part_px), WINDOW), max(round(height / part_px), WINDOW)
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)


def stretched(coarse: Image, like: Image) -> Image:
    """A coarse picture (h, w) as large as another (H, W), linear in between."""
    return np.asarray(cv2.resize(coarse, like.shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
