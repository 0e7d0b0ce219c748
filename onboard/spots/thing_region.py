"""The outline and contrast of a thing that a net has found in a picture."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.spots.contrast import TO_SIGMA, Image
from onboard.spots.detector import are_one
from onboard.spots.regions import LENS_PX, Part, Region, region_in
from onboard.spots.thing_net import Peak

Array = NDArray[np.float64]

LEAST_PX = 3.0  # to the side of a thing's box
LARGER = 2.0  # than a thing's box, to whose side no region is the thing's
ABOUT = 1.0  # of its box, the ground that it is compared with lies about it


def region_of_thing(values: Image, peak: Peak) -> Region:
    """The part of a picture (H, W) in a peak's box that stands out of what is about it, above or below.

    Contrast is in sigmas of the ground about it, less than 0 where the thing is colder. Where nothing stands out its
    outline is the box.
    """
    height, width = values.shape
    half = 0.5 * np.maximum((peak.width_px, peak.height_px), LEAST_PX)
    middle = np.array([peak.u_px, peak.v_px])
    size = np.array([width, height])
    low, high = _whole(middle - half, size), _whole(middle + half, size)
    around, beyond = _whole(middle - (1.0 + ABOUT) * half, size), _whole(middle + (1.0 + ABOUT) * half, size)
    ring = np.ones((beyond - around + 1)[::-1], bool)
    ring[low[1] - around[1] : high[1] - around[1] + 1, low[0] - around[0] : high[0] - around[0] + 1] = False
    ground_about = values[around[1] : beyond[1] + 1, around[0] : beyond[0] + 1][ring]
    ground = float(np.median(ground_about)) if len(ground_about) else float(np.median(values))
    spread = max(TO_SIGMA * float(np.median(np.abs(ground_about - ground))) if len(ground_about) else 0.0, 1e-3)
    inside = values[low[1] : high[1] + 1, low[0] : high[0] + 1] - np.float32(ground)
    sign = 1.0 if float(inside.max()) >= -float(inside.min()) else -1.0
    level = _joined_to_top(np.float32(sign) * inside)
    part = Part(level, int(low[1]), int(low[0]))
    found = region_in(np.float32(sign) * values, np.full(level.shape, sign * ground, np.float32), part)
    corners = np.array([low - 0.5, [high[0] + 0.5, low[1] - 0.5], high + 0.5, [low[0] - 0.5, high[1] + 0.5]])
    outline = corners if found is None else found.outline_px
    most = sign * float(np.float32(sign * inside).max())
    is_cut = bool((low == 0).any() or (high == size - 1).any())
    region = Region(middle, outline, most / spread, ground + most, most, is_cut)
    return region if found is None else replace(region, blur_px=float(np.sqrt(LENS_PX**2 + 1.0 / 12.0)))


def is_of_thing(hot: Region, peak: Peak, region: Region) -> bool:
    """Return whether a region that was found by its heat is the one of a thing; a fire about the thing is not."""
    size = hot.outline_px.max(axis=0) - hot.outline_px.min(axis=0)
    return are_one(hot, region) and bool((size <= LARGER * np.maximum((peak.width_px, peak.height_px), LEAST_PX)).all())


def _joined_to_top(excess: Image) -> Image:
    """Above 0 within half of the greatest excess (h, w), where that is joined to it."""
    level = excess - np.float32(0.5 * float(excess.max()))
    _, labels = cv2.connectedComponents((level > 0.0).astype(np.uint8), connectivity=8)
    row, column = np.unravel_index(int(np.argmax(excess)), excess.shape)
    return np.where(labels == labels[row, column], level, np.minimum(level, np.float32(0.0)))


def _whole(at_px: Array, size_px: NDArray[np.int64]) -> NDArray[np.int64]:
    """The pixel (2,) of the picture that is nearest to a place in it."""
    return np.clip(np.round(at_px), 0, size_px - 1).astype(np.int64)
