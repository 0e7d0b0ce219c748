"""Some of many: which, where all would take too long."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def evenly(count: int, most: int) -> NDArray[np.intp]:
    """Indices of at most `most` of `count`, evenly over all of them, the first and the last included."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.intp)
