"""Coarse-to-fine flow disagreement: over water, large patterns move otherwise than small ones. Equation (6.8)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.geometry.plane_homography import move
from onboard.vision.contrast_normalisation import Picture

Array = NDArray[np.float64]

HALVINGS = 2  # of the picture's size: patterns four times as large as those that are tracked
WINDOW_PX = 21


def flow_disagreement(was: Picture, now: Picture, motion: Array, at: Array, to: Array) -> Array:
    """Coarse flow minus fine flow (2,), px, between two prepared pictures.

    `at` (N, 2) are the features in `was`, `to` where they were found in `now`, `motion` the homography of the whole
    picture. The median over features of what LK finds at a quarter of the size, beyond where the feature itself went.
    """
    shrink = np.diag([0.5**HALVINGS, 0.5**HALVINGS, 1.0])
    for _ in range(HALVINGS):
        was, now = np.asarray(cv2.pyrDown(was), np.uint8), np.asarray(cv2.pyrDown(now), np.uint8)
    was = np.asarray(cv2.GaussianBlur(was, (0, 0), 1.0), np.uint8)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    H: Array = np.asarray(shrink @ motion @ np.linalg.inv(shrink), np.float64)
    size = was.shape[1], was.shape[0]
    warped = cv2.warpPerspective(now, H, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    now = np.asarray(cv2.GaussianBlur(warped, (0, 0), 1.0), np.uint8)
    start = move(shrink, at)
    fine = move(shrink @ np.linalg.inv(motion), to)
    coarse, status, _ = cv2.calcOpticalFlowPyrLK(
        was,
        now,
        start.astype(np.float32),
        fine.astype(np.float32).copy(),
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=1,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    found = status[:, 0] == 1
    if not found.any():
        return np.zeros(2)
    out: Array = np.median((np.asarray(coarse, float) - fine)[found], axis=0) / shrink[0, 0]
    return out
