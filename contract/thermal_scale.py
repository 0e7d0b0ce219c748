"""A thermal camera's counts to kelvin: linear where the camera is radiometric, and nothing where it is not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class ThermalScale:
    """kelvin = scale * count + offset. Temperatures are apparent ones: what a black body would have to look the same.

    A camera without one is uncalibrated: its counts rise with the heat that it sees, and give no temperature.
    """

    scale: float
    offset: float = 0.0

    def kelvin(self, counts: ArrayLike) -> NDArray[np.float32]:
        """Apparent temperatures, K, of counts of any shape."""
        return np.asarray(counts, np.float32) * np.float32(self.scale) + np.float32(self.offset)

    def counts(self, kelvin: ArrayLike) -> NDArray[np.uint16]:
        """The nearest counts, 0 to 65535, of apparent temperatures, K, of any shape."""
        counts = np.rint((np.asarray(kelvin, np.float64) - self.offset) / self.scale)
        return np.clip(counts, 0, 65535).astype(np.uint16)
