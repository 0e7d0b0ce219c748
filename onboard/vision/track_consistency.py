"""Track residual dispersion: distinguishes features of the ground from artefacts of rounding or compression.

A blurred picture without noise shows contour lines of rounded brightness in place of texture, and strong compression
shows blocks. After normalisation both look like the ground's own detail, and their patches look the same: the tracker
finds some again, pixels from where they belong, and the patches' differences do not show it. Comparison with
neighbouring tracks does: heights off the ground plane move neighbours by nearly the same amount, and where roofs stand
next to streets, along one direction only. What remains across that direction is the tracks' own error.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.geometry.plane_homography import move
from onboard.geometry.robust import middle

Array = NDArray[np.float64]

NEIGHBOURS = 4
DIRECTIONS = 16
MAX_DISPERSION_PX = 1.3  # one sigma at 640 px width, where all features were found again
WORTH_ASKING = 0.8  # of the limit: tracks closer than this to one homography are not far off each other


def dispersion_px(motion: Array, at: Array, to: Array) -> float:
    """One sigma (px) of tracks `at` -> `to`, (N, 2) each, N > 4, about their neighbours', where it is least.

    `motion` (3, 3) is the homography of the whole picture, beyond which tracks move as their neighbours do.
    """
    beyond = to - move(motion, at)
    apart = np.square(at[:, None, 0] - at[:, 0]) + np.square(at[:, None, 1] - at[:, 1])
    nearest = np.argpartition(apart, NEIGHBOURS, axis=1)[:, : NEIGHBOURS + 1]  # itself among them
    own = (beyond - beyond[nearest].mean(axis=1)) / np.sqrt(NEIGHBOURS / (NEIGHBOURS + 1.0))
    angle = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    along = own @ np.stack([np.cos(angle), np.sin(angle)])
    return 1.4826 * float(np.median(np.abs(along), axis=0).min())


def are_inconsistent(motion: Array, at: Array, to: Array, share: float, width_px: int) -> bool:
    """Return whether tracks disagree too much with each other to be of the ground.

    `share`: of the features that were found again. The lost ones were the worst, so the fewer are left, the more their
    dispersion understates the error.
    """
    limit_px = MAX_DISPERSION_PX * width_px / 640.0 * min(share, 1.0) ** 2
    miss = np.linalg.norm(to - move(motion, at), axis=1)
    if middle(miss) < WORTH_ASKING * limit_px:
        return False
    return dispersion_px(motion, at, to) > limit_px
