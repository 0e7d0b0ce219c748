"""Ground that repeats itself: rows, tiles, chessboards. A track there may be off by a whole number of rows.

Every patch then has twins that the tracker cannot distinguish from it. Which one is followed depends on where the
search begins, and no residual shows the error: a whole scene that is off by a row is as rigid as the true one.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.geometry.sampling import evenly
from onboard.vision.contrast_normalisation import Picture

Array = NDArray[np.float64]

PATCH_PX = 21  # at half the picture's size
REACH_PX = 40  # at half the picture's size
SAMPLE = 12  # features tested
MIN_SAMPLE = 6
TWIN = 0.75  # correlation from which the tracker takes one patch for another
APART = 0.5  # two peaks of correlation are two things if it falls below this between them
SHARE = 0.5  # of the features tested that must have a twin


def repetition_px(picture: Picture, uv_px: Array) -> float | None:
    """Distance (px) at which a prepared picture repeats itself about its features (N, 2); None if it does not."""
    half = np.asarray(cv2.pyrDown(picture), np.uint8)
    height, width = half.shape
    margin = PATCH_PX // 2 + REACH_PX
    at = np.rint(uv_px / 2.0).astype(np.intp)
    inside = np.all((at >= margin) & (at < np.array([width, height]) - margin), axis=1)
    at = at[inside]
    if len(at) < MIN_SAMPLE:
        return None
    at = at[evenly(len(at), SAMPLE)]
    twins = [twin for u, v in at if (twin := _twin_px(half[v - margin : v + margin + 1, u - margin : u + margin + 1]))]
    return 2.0 * float(np.median(twins)) if len(twins) >= SHARE * len(at) else None


def _twin_px(around: Picture) -> float | None:
    """Distance from the middle of a square to the nearest other place that looks like it; None if there is none."""
    patch = around[REACH_PX:-REACH_PX, REACH_PX:-REACH_PX]
    likeness = np.asarray(cv2.matchTemplate(around, patch, cv2.TM_CCOEFF_NORMED), np.float32)
    _, name = cv2.connectedComponents((likeness > APART).astype(np.uint8))
    other = (likeness > TWIN) & (name != name[REACH_PX, REACH_PX])
    if not other.any():
        return None
    rows, columns = np.nonzero(other)
    nearest = np.hypot(rows - REACH_PX, columns - REACH_PX).argmin()
    twin = np.where(name == name[rows[nearest], columns[nearest]], likeness, -1.0)  # its peak, not its border
    row, column = (int(i) for i in np.unravel_index(int(twin.argmax()), twin.shape))
    # What repeats itself does so on the other side as well; a blurred picture has a twin on one side by chance.
    opposite = likeness[max(2 * REACH_PX - row - 2, 0) :, max(2 * REACH_PX - column - 2, 0) :][:5, :5]
    return float(np.hypot(row - REACH_PX, column - REACH_PX)) if opposite.max() > TWIN else None
