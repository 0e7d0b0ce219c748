"""What a camera file may be wrong about: focal length, principal point, radial distortion, estimated in flight.

Five states, each counted from the camera file: the focal length's relative error, the principal point's shift (in focal
lengths, x and y), and what k1 and k2 are larger by. Equation (15.2) of docs/mathematics.md.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera

Array = NDArray[np.float64]

NAMES = ("focal_length", "principal_point_x", "principal_point_y", "k1", "k2")
COUNT = len(NAMES)
MIN_DETERMINANT = 0.05  # of the distortion's Jacobian: where it folds over, nothing is measured


def corrected(camera: Camera, states: Array) -> Camera:
    """The camera file's camera with the states (5,) applied; the same camera for none (0,)."""
    if not len(states):
        return camera
    grown = float(np.exp(states[0]))
    k1, k2, p1, p2, k3 = camera.distortion
    return replace(
        camera,
        fx_px=camera.fx_px * grown,
        fy_px=camera.fy_px * grown,
        cx_px=camera.cx_px + camera.focal_px * float(states[1]),
        cy_px=camera.cy_px + camera.focal_px * float(states[2]),
        distortion=(k1 + float(states[3]), k2 + float(states[4]), p1, p2, k3),
    )


def by_states(camera: Camera, x: Array, y: Array) -> Array:
    """How normalised image coordinates (any shape ...) of fixed pixels move with the states: (..., 5, 2), as (15.2).

    `camera` is the one that they were computed with. The result has its two new axes first but one: x of shape (K, P)
    gives (K, 5, 2, P).
    """
    k1, k2, p1, p2, k3 = camera.distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    out = np.zeros((len(x), COUNT, 2, x.shape[1]))
    # Of the distorted coordinates, minus what the distortion itself adds: both sides of (2.1) must stay equal.
    out[:, 0, 0] = -(x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x))
    out[:, 0, 1] = -(y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y)
    out[:, 1, 0] = -camera.focal_px / camera.fx_px
    out[:, 2, 1] = -camera.focal_px / camera.fy_px
    np.multiply(-r2, x, out=out[:, 3, 0])
    np.multiply(-r2, y, out=out[:, 3, 1])
    np.multiply(out[:, 3], r2[:, None], out=out[:, 4])
    if not any(camera.distortion):
        return out
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
    cross = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    xx = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    yy = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    det = xx * yy - cross * cross
    det = np.where(np.abs(det) < MIN_DETERMINANT, MIN_DETERMINANT, det)
    moved_x = (yy[:, None] * out[:, :, 0] - cross[:, None] * out[:, :, 1]) / det[:, None]
    out[:, :, 1] = (xx[:, None] * out[:, :, 1] - cross[:, None] * out[:, :, 0]) / det[:, None]
    out[:, :, 0] = moved_x
    return out


def as_numbers(camera: Camera, states: Array) -> dict[str, float]:
    """The corrected camera, for the state directory: what it is, not how far it is from a file that may be replaced."""
    c = corrected(camera, states)
    return {"focal_px": c.focal_px, "cx_px": c.cx_px, "cy_px": c.cy_px, "k1": c.distortion[0], "k2": c.distortion[1]}


def from_numbers(camera: Camera, numbers: dict[str, float]) -> Array:
    """The states (5,) that make the file's camera such a one. Raises KeyError, TypeError, ValueError."""
    focal_px = camera.focal_px
    return np.array(
        [
            np.log(float(numbers["focal_px"]) / focal_px),
            (float(numbers["cx_px"]) - camera.cx_px) / focal_px,
            (float(numbers["cy_px"]) - camera.cy_px) / focal_px,
            float(numbers["k1"]) - camera.distortion[0],
            float(numbers["k2"]) - camera.distortion[1],
        ]
    )
