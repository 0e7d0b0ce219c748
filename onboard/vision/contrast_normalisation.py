"""Local contrast normalisation: pictures whose brightness swings between frames become comparable patch by patch.

Mean and spread over a neighbourhood are taken at quarter size, where they cost little, and enlarged to the picture's
size; the floor keeps sensor noise on featureless ground from being amplified into texture. The full picture is worked
on in 16-bit integers and in place: allocating and freeing a megabyte for every picture costs more than the arithmetic.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

SPREAD = 40.0  # grey levels: one sigma of every neighbourhood with texture
NOISE_FLOOR = 2.0  # grey levels of local spread that count as no texture
_SHRINK = 4
_MEAN_STEPS, _GAIN_STEPS = 32, 256  # of the fixed-point mean and gain; both fit 16 bits with headroom


class Normaliser:
    """Normalises pictures of one size, with buffers that stay."""

    def __init__(self, size_px: tuple[int, int]) -> None:
        self.size_px = size_px
        width, height = size_px
        self._difference = np.empty((height, width), np.int16)
        self._stretched = np.empty((height, width), np.int16)

    def __call__(self, image: Picture) -> Picture:
        """Grey picture (H, W) -> a new one, mean 128 and one sigma `SPREAD` in every neighbourhood with texture."""
        width, _ = self.size_px
        reach = max(5, round(width / 40 / _SHRINK) * 2 + 1)  # about a twentieth of the picture's width
        small = _halved(_halved(image))
        mean = np.asarray(cv2.boxFilter(small, cv2.CV_32F, (reach, reach)), np.float32)
        square = np.asarray(cv2.sqrBoxFilter(small, cv2.CV_32F, (reach, reach)), np.float32)
        # The spread of the picture's detail against the smooth mean, gathered by area.
        spread = np.sqrt(np.maximum(square - mean * mean, 0.0))
        gain = np.float32(SPREAD) / (np.float32(1.5) * spread + np.float32(NOISE_FLOOR))
        d = self._difference
        np.copyto(d, image)
        d *= _MEAN_STEPS
        d -= self._stretch(mean, _MEAN_STEPS)
        cv2.multiply(d, self._stretch(gain, _GAIN_STEPS), dst=d, scale=1.0 / (_MEAN_STEPS * _GAIN_STEPS))
        np.clip(d, -128, 127, out=d)
        out: Picture = d.astype(np.uint8)
        out ^= 128  # two's complement to excess 128
        return out

    def _stretch(self, small: NDArray[np.float32], steps: int) -> NDArray[np.int16]:
        """A quarter-size map in fixed point over the whole picture; the next call overwrites it."""
        fixed = np.rint(small * steps).astype(np.int16)
        cv2.resize(fixed, self.size_px, dst=self._stretched, interpolation=cv2.INTER_LINEAR)
        return self._stretched


def prepare(image: Picture) -> Picture:
    """One picture alone, (H, W) -> its normalised form. For a stream keep a `Normaliser`."""
    height, width = image.shape
    return Normaliser((width, height))(image)


def _halved(image: Picture) -> Picture:
    # Halve twice: OpenCV has fast code for that, and not for four at once.
    height, width = image.shape
    half = cv2.resize(image, (max(width // 2, 1), max(height // 2, 1)), interpolation=cv2.INTER_AREA)
    return np.asarray(half, np.uint8)


def thumbnail(prepared: Picture, width_px: int = 160) -> NDArray[np.float32]:
    """A small float copy for aligning whole pictures, about `width_px` wide."""
    height, width = prepared.shape
    scale = min(1.0, width_px / width)
    small = cv2.resize(
        prepared, (max(round(width * scale), 8), max(round(height * scale), 8)), interpolation=cv2.INTER_AREA
    )
    return small.astype(np.float32)
