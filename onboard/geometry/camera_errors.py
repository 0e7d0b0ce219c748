"""Rays of pixels that stay where they are, by the errors of their camera. (15.2)

Five errors: the focal length's relative one, the principal point's shift (in focal lengths, x and y), those of k1 and
of k2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.lens import MIN_DETERMINANT

Array = NDArray[np.float64]

COUNT = 5


def by_states(camera: Camera, x: Array, y: Array) -> Array:
    """The derivative (K, 5, 2, P) of normalised image coordinates (K, P) of fixed pixels by the states. (15.2)

    `camera` is the one that they were computed with.
    """
    rows = np.stack([x.ravel(), y.ravel()])
    there, along, cross = camera.lens.linearised(rows)
    there, along = (each.reshape(2, *x.shape).swapaxes(0, 1) for each in (there, along))  # (K, 2, P)
    out = np.zeros((len(x), COUNT, 2, x.shape[1]))
    # The change of the distorted coordinates less the distortion's own: both sides of the model must stay equal.
    np.negative(there, out=out[:, 0])
    out[:, 1, 0] = -camera.focal_px / camera.fx_px
    out[:, 2, 1] = -camera.focal_px / camera.fy_px
    np.negative(camera.lens.by_coefficients(rows).reshape(2, 2, *x.shape).transpose(2, 0, 1, 3), out=out[:, 3:])
    if camera.lens.is_ideal:
        return out
    along, cross = along[:, None], cross.reshape(len(x), 1, 1, -1)
    det = along.prod(axis=2, keepdims=True) - cross * cross
    det = np.where(np.abs(det) < MIN_DETERMINANT, MIN_DETERMINANT, det)
    return (along[:, :, ::-1] * out - cross * out[:, :, ::-1]) / det
