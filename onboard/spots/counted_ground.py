"""Ground that counts once, however often it is seen."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KEPT = 400  # pictures of ground of its own each
APART = 0.8  # of a picture's side, at which its ground counts as another's


class CountedGround:
    """The newest KEPT pictures of ground of its own."""

    def __init__(self) -> None:
        self._pictures: deque[tuple[Array, float]] = deque(maxlen=KEPT)  # place, area

    @property
    def km2(self) -> float:
        return sum(area for _, area in self._pictures)

    def is_new(self, place_m: Array, area_km2: float) -> bool:
        """Return whether a picture about a place (2,), east and north, m, shows ground that has not been counted."""
        side_m = 1000.0 * np.sqrt(area_km2)
        return all(float(np.hypot(*(place_m - other))) > APART * side_m for other, _ in self._pictures)

    def add(self, place_m: Array, area_km2: float) -> None:
        """Count a picture's ground."""
        self._pictures.append((place_m, area_km2))
