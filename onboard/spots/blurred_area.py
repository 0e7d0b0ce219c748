"""The size of a thing with a blurred outline: the disc that has the same area at half of its height. (25.10)"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chndtr

Array = NDArray[np.float64]

LARGEST = 12.0  # radius over the blur
STEPS, HALVINGS = 240, 50
LEAST = 0.5  # of a blur's area, below which nothing is reported of a thing but that it is small


def unblurred(area: float, blur: float) -> float:
    """The area of a disc of which a Gaussian blur (one sigma) has made one of `area` at half of its own height.

    In any unit and its square. No less than LEAST of the blur's area: what is smaller looks the same.
    """
    if blur <= 0.0:
        return area
    unit = float(np.pi * blur**2)
    true, seen = _table()
    beyond = max(area / unit - float(seen[-1]), 0.0)  # where a larger disc loses no more than a large one
    return (float(np.interp(area / unit, seen, true)) + beyond) * unit


@lru_cache(maxsize=1)
def _table() -> tuple[Array, Array]:
    """True areas (N,) of discs and those at half of their height, both over pi times the blur's variance."""
    radius = np.linspace(np.sqrt(LEAST), LARGEST, STEPS)
    half = 0.5 * chndtr(radius**2, 2.0, 0.0)
    # A blurred disc at a distance from its middle is the chance of a point so far away to be shaken into it.
    low, high = np.zeros(STEPS), radius + 3.0
    for _ in range(HALVINGS):
        at = 0.5 * (low + high)
        is_inside = chndtr(radius**2, 2.0, at**2) > half
        low, high = np.where(is_inside, at, low), np.where(is_inside, high, at)
    return radius**2, at**2
