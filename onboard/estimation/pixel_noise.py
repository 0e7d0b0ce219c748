"""The noise of features by what a solution leaves of it: the scale of whitened residuals. Equation (6.11)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.factors import OWN_STATES, WAVES, Layout

Array = NDArray[np.float64]

# Median length of a residual (of noise of one sigma an axis) of a point seen in so many views, from 2 on: along the
# travel the point's place and depth have been fitted, across it its place. First: without any fit (Rayleigh).
MEDIAN_LENGTH = np.array([1.1774, np.inf, 0.4769, 0.7833, 0.9085, 0.9732, 1.0112, 1.0373, 1.0560, 1.0713, 1.0816])


def view_states(layout: Layout) -> int:
    """How many states each picture has that its own features tell."""
    return 6 + OWN_STATES[WAVES] * (WAVES in layout.blocks)


def fit_of(sigmas: Array, view_states: int = 6) -> float:
    """Robust one sigma per axis of whitened residual lengths (K, P): their median over what it should be. (6.11)

    Residuals are smaller than the noise by the degrees of freedom fitted: of a point seen twice, three out of four.
    """
    known = np.isfinite(sigmas)
    seen = np.count_nonzero(known, axis=0)
    several = seen >= 2
    if not np.any(several):
        return float("inf")
    many = MEDIAN_LENGTH[0] * np.sqrt(1.0 - 1.5 / np.maximum(seen, 2))
    last = len(MEDIAN_LENGTH) - 1
    expected = np.where(seen <= last, MEDIAN_LENGTH[np.minimum(seen, last)], many)
    ratio = (sigmas / expected)[known & several]
    left = float(np.sum(2 * seen[several] - 3))
    return float(np.median(ratio) * np.sqrt(left / max(left - view_states * len(sigmas), 0.2 * left)))
