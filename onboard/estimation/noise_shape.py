"""The shape of a pixel's noise in a fisheye's undistorted coordinates: greater along the radius than across it. (30.4)

Weights know one size of it for both directions, that of the same area, as is near enough for a pinhole.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.lens import FISHEYE, MIN_DETERMINANT

Array = NDArray[np.float64]


def shape_of(camera: Camera | None, xy: Array) -> Array | None:
    """What makes noise at undistorted coordinates (K, 2, P) round: x x, y y and x y (K, 3, P) of symmetric matrices of
    determinant 1; None where it is taken for round.
    """
    if camera is None or camera.model != FISHEYE:
        return None
    _, along, cross = camera.lens.linearised(xy.transpose(1, 0, 2).reshape(2, -1))
    det = np.maximum(along[0] * along[1] - cross * cross, MIN_DETERMINANT)
    rows = np.concatenate([along, cross[None]]) / np.sqrt(det)
    return np.ascontiguousarray(rows.reshape(3, len(xy), -1).transpose(1, 0, 2))


def rounded(shape: Array | None, moved: Array) -> Array:
    """Residuals or derivatives (K, ..., 2, P) in coordinates whose noise is round; themselves where it is already."""
    if shape is None:
        return moved
    xx, yy, xy = (shape[:, i].reshape(len(shape), *[1] * (moved.ndim - 3), -1) for i in range(3))
    x, y = moved[..., 0, :], moved[..., 1, :]
    return np.stack([xx * x + xy * y, xy * x + yy * y], axis=-2)
