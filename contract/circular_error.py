"""90 % figures of a covariance, as CoT, ASPRS and people on the radio use them: a circle, and an interval of height."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LE90_SIGMAS = 1.6448536269514722  # of a normal distribution, both sides
CE90_SIGMAS = 2.145966026289347  # of a circular one: sqrt(-2 ln 0.1)
_HALF_ANGLES = (np.arange(64) + 0.5) * (math.pi / 128.0)
_COS2 = np.cos(_HALF_ANGLES) ** 2


def ce90_m(covariance_en_m2: Array) -> float:
    """Radius about the answer that holds the truth with 90 %: of a 2 x 2 covariance in east, north. (17.7)"""
    minor, major = (max(float(value), 0.0) for value in np.linalg.eigvalsh(covariance_en_m2))
    if not major > 0.0:
        return 0.0
    variance = minor / major + (1.0 - minor / major) * _COS2  # along each direction, of the major axis's
    r = LE90_SIGMAS + (CE90_SIGMAS - LE90_SIGMAS) * minor / major
    for _ in range(8):
        left = np.exp(-0.5 * r * r / variance)
        r += float((np.mean(left) - 0.1) / np.mean(r / variance * left))
    return r * math.sqrt(major)


def le90_m(sigma_m: float) -> float:
    """Half the interval of a height that holds the truth with 90 %."""
    return LE90_SIGMAS * sigma_m
