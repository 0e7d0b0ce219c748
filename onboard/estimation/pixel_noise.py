"""The noise of features by what a solution leaves of it: the scale of whitened residuals. Equation (6.11)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.factors import OWN_STATES, WAVES, Layout

Array = NDArray[np.float64]

# Median length of a residual (of noise of one sigma an axis) of a point seen in so many views, from 2 on: along the
# travel the point's place and depth have been fitted, across it its place. First: without any fit (Rayleigh).
MEDIAN_LENGTH = np.array([1.1774, np.inf, 0.4769, 0.7833, 0.9085, 0.9732, 1.0112, 1.0373, 1.0560, 1.0713, 1.0816])


def fit_of(sigmas: Array, layout: Layout) -> float:
    """Robust one sigma per axis of whitened residual lengths (K, P): their median over what it should be. (6.11)

    Residuals are smaller than the noise by the degrees of freedom fitted: of a point seen twice, three out of four, and
    by all the states of each picture that its own features determine. Infinite where no point is seen twice.
    """
    known = np.isfinite(sigmas)
    seen = np.count_nonzero(known, axis=0)
    several = seen >= 2
    if not np.any(several):
        return float("inf")
    many = MEDIAN_LENGTH[0] * np.sqrt(1.0 - 1.5 / np.arange(len(MEDIAN_LENGTH), len(sigmas) + 1))
    ratio = (sigmas / np.append(MEDIAN_LENGTH, many)[seen])[known & several]
    left = float(np.sum(2 * seen[several] - 3))
    fitted = (6 + OWN_STATES[WAVES] * (WAVES in layout.blocks)) * len(sigmas)
    return float(np.median(ratio) * np.sqrt(left / max(left - fitted, 0.2 * left)))
