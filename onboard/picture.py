"""Local contrast normalisation: pictures whose brightness swings between frames become comparable patch by patch.

Mean and spread over a neighbourhood are taken at quarter size, where they cost little, and stretched back over the
picture; the floor keeps sensor noise on featureless ground from being blown up into texture.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

SPREAD = 40.0  # grey levels: one sigma of every neighbourhood with texture
NOISE_FLOOR = 2.0  # grey levels of local spread that count as no texture
_SHRINK = 4


def prepare(image: Picture) -> Picture:
    """Grey picture (H, W) -> its locally normalised form, mean 128 and one sigma `SPREAD` in every neighbourhood."""
    height, width = image.shape
    reach = max(5, round(width / 40 / _SHRINK) * 2 + 1)  # about a twentieth of the picture's width
    small = cv2.resize(
        image, (max(width // _SHRINK, 1), max(height // _SHRINK, 1)), interpolation=cv2.INTER_AREA
    ).astype(np.float32)
    mean = cv2.blur(small, (reach, reach))
    # The spread is that of the full picture's detail against the smooth mean, gathered by area.
    spread = np.sqrt(np.maximum(cv2.blur(small * small, (reach, reach)) - mean * mean, 0.0))
    gain = SPREAD / (1.5 * spread + NOISE_FLOOR)
    offset = 128.0 - mean * gain
    full_gain = cv2.resize(gain, (width, height), interpolation=cv2.INTER_LINEAR)
    full_offset = cv2.resize(offset, (width, height), interpolation=cv2.INTER_LINEAR)
    out = cv2.multiply(image, full_gain, dtype=cv2.CV_32F)
    out = cv2.add(out, full_offset, dst=out)
    prepared: Picture = np.asarray(cv2.convertScaleAbs(np.maximum(out, 0.0, out=np.asarray(out))), np.uint8)
    return prepared


def thumbnail(prepared: Picture, width_px: int = 160) -> NDArray[np.float32]:
    """A small float copy for aligning whole pictures, about `width_px` wide."""
    height, width = prepared.shape
    scale = min(1.0, width_px / width)
    small = cv2.resize(
        prepared, (max(round(width * scale), 8), max(round(height * scale), 8)), interpolation=cv2.INTER_AREA
    )
    return small.astype(np.float32)
