"""The whole picture's motion by matched descriptors and a homography, where prediction and phase correlation fail.

Rublee et al. 2011 (ORB), Lowe 2004 (the ratio test), Fischler and Bolles 1981 (RANSAC). An exposure that drops by
three and a half times defeats correlation of thumbnails where photographs overlap little or are turned against each
other; ORB's descriptors compare brightness within a patch and are not affected. It costs more than a tracking step and
is therefore tried last.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.vision.contrast_normalisation import Picture

Array = NDArray[np.float64]

WIDTH_PX = 640  # at most, of the pictures that corners are looked for in
CORNERS = 500
RATIO = 0.8  # best distance over the second best, above which a match is not one
MAX_MISS_PX = 4.0  # of the homography, at WIDTH_PX: points off the ground plane deviate from it
MIN_AGREEING = 20


@dataclass(frozen=True, eq=False)
class Described:
    """Corners of a picture: pixels (N, 2) and descriptors (N, 32)."""

    uv_px: Array
    rows: NDArray[np.uint8]


def describe(prepared: Picture) -> Described:
    """Corners of a normalised picture (H, W) with their descriptors."""
    height, width = prepared.shape
    scale = min(1.0, WIDTH_PX / width)
    size = (round(width * scale), round(height * scale))
    small = prepared if scale == 1.0 else cv2.resize(prepared, size, interpolation=cv2.INTER_AREA)
    corners, rows = cv2.ORB.create(CORNERS).detectAndCompute(small, None)
    if rows is None or not len(corners):
        return Described(np.zeros((0, 2)), np.zeros((0, 32), np.uint8))
    at = np.array([c.pt for c in corners]) + 0.5
    return Described(at * (width / size[0], height / size[1]) - 0.5, np.asarray(rows, np.uint8))


def motion_between(first: Described, second: Described, width_px: int) -> Array | None:
    """H (3, 3) from pixels of the first picture to the second's; None where too few corners agree on one."""
    if min(len(first.rows), len(second.rows)) < MIN_AGREEING:
        return None
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(first.rows, second.rows, k=2)
    best = [pair[0] for pair in pairs if len(pair) == 2 and pair[0].distance < RATIO * pair[1].distance]
    if len(best) < MIN_AGREEING:
        return None
    at = first.uv_px[[m.queryIdx for m in best]]
    to = second.uv_px[[m.trainIdx for m in best]]
    H, agree = cv2.findHomography(at, to, cv2.RANSAC, MAX_MISS_PX * max(1.0, width_px / WIDTH_PX))
    if H is None or agree is None or np.count_nonzero(agree) < MIN_AGREEING:
        return None
    return np.asarray(H, float)
