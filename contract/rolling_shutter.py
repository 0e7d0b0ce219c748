"""A sensor that reads its rows one after the other: what moves between them, and what a pixel of any row has seen.

A picture has one pose, that of the moment its middle row was exposed. What a row sees earlier or later has moved on the
picture by then, to first order by its image velocity. Equations (18.1) to (18.5) of docs/mathematics-camera.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RollingShutter:
    """The camera's motion while a picture was read, and the time that took.

    `readout_s` is the time in which all rows are read, positive if the first row comes first. `sigma_readout_s` is one
    sigma of what it may be wrong by beyond what the picture's other errors already hold.
    """

    readout_s: float
    rate_cam_rad_s: Array = field(default_factory=lambda: np.zeros(3))  # angular rate, camera axes
    velocity_cam_m_s: Array = field(default_factory=lambda: np.zeros(3))  # of the camera over ground, camera axes
    sigma_readout_s: float = 0.0

    def image_velocity(self, xy: Array, inverse_depth_per_m: Array | float) -> Array:
        """The velocity (..., 2), 1/s, of normalised places (..., 2) of the picture."""
        moved = image_velocity(xy[..., 0], xy[..., 1], inverse_depth_per_m, self.rate_cam_rad_s, self.velocity_cam_m_s)
        return np.stack(moved, axis=-1)


def row_share(v_px: Array | float, height_px: int) -> Array | float:
    """The moment at which a row is exposed, from the middle row's, as a share of the readout: -1/2 to 1/2. (18.1)"""
    return (v_px - 0.5 * (height_px - 1)) / height_px


def image_velocity(
    x: Array,
    y: Array,
    inverse_depth_per_m: Array | float,
    rate: Sequence[Array] | Array,
    velocity: Sequence[Array] | Array,
) -> tuple[Array, Array]:
    """d x / dt and d y / dt (1/s) of normalised image coordinates of points that do not move. (18.2)

    `rate` (rad/s) and `velocity` (m/s) are three numbers each, camera axes, or three arrays that broadcast with x.
    """
    (rx, ry, rz), (vx, vy, vz), w = rate, velocity, inverse_depth_per_m
    across = rx * y - ry * x
    return across * x - ry + rz * y + w * (x * vz - vx), across * y + rx - rz * x + w * (y * vz - vy)
