"""The acceleration of things that speed up, brake and turn, and that go on with it for a while. (24.12)"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from contract.track_age import LOST_AFTER_S

Array = NDArray[np.float64]

MANNER_S = LOST_AFTER_S  # over which an acceleration is forgotten: (24.19) takes it as constant while a thing coasts
UNSTEADY_S = 0.1  # of an acceleration besides that changes from one moment to the next, and is as large


def transition(dt: float) -> Array:
    """Return what (place, velocity, acceleration) become in `dt` seconds (3, 3)."""
    kept = math.exp(-dt / MANNER_S)
    return np.array([
        [1.0, dt, MANNER_S**2 * (kept - 1.0 + dt / MANNER_S)],
        [0.0, 1.0, MANNER_S * (1.0 - kept)],
        [0.0, 0.0, kept],
    ])  # fmt: skip


def pushed(dt: float) -> Array:
    """Return one sigma (3,) of (place, velocity, acceleration) by what is new in `dt` seconds of an acceleration of 1:
    all three by the same.
    """
    new = math.sqrt(1.0 - math.exp(-2.0 * dt / MANNER_S))
    return new * np.array([dt**2 / math.sqrt(20.0), dt / math.sqrt(3.0), 1.0])


def on_both_axes(T: Array) -> Array:
    """Return the matrix (6, 6) that is `T` (3, 3), of place, velocity and acceleration, on each of two axes."""
    return np.asarray((T[:, None, :, None] * np.eye(2)[:, None]).reshape(6, 6))
