"""The net's input: a grey picture without its camera's gain, offset and unit."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.spots.thing_net import Image, channels

WHITE = 255.0
LEAST_SPREAD = 1e-3  # of the range of grey


class Level(NamedTuple):
    """The mean and the standard deviation of a picture's grey values."""

    mean: float
    spread: float


def level_of(grey: NDArray[np.uint8]) -> Level:
    mean, spread = cv2.meanStdDev(grey)
    return Level(float(mean[0, 0]), float(spread[0, 0]))


def level_of_histogram(histogram: NDArray[np.float64], greys: NDArray[np.float64]) -> Level:
    """Return the level of a picture whose 256 grey values have become others, from how often each occurs."""
    share = histogram / histogram.sum()
    mean = float(share @ greys)
    return Level(mean, float(np.sqrt(share @ (greys - mean) ** 2)))


def net_input(grey: Image | NDArray[np.uint8], level: Level) -> Image:
    """Return both channels (2, H, W) of a picture (H, W), grey values 0 to 255, or of a part of it.

    The first is the picture over its own mean and spread; the second its difference from a mean of 33 x 33 pixels,
    over the spread there. Neither changes with gain or offset.
    """
    y = (grey.astype(np.float32) - np.float32(level.mean)) / np.float32(level.spread + LEAST_SPREAD * WHITE)
    return channels(y)
