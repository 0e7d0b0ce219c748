"""A mean over flights, and how well so many flights know it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def mean_and_sigma(values: Sequence[float] | NDArray[np.float64]) -> tuple[float, float]:
    """The mean of one value for each flight (N,), NaN of none, and one sigma of it by how they scatter, NaN of one."""
    known = np.asarray(values, dtype=float)
    if len(known) < 2:
        return (float(known[0]) if len(known) else float("nan")), float("nan")
    return float(known.mean()), float(known.std(ddof=1) / np.sqrt(len(known)))
