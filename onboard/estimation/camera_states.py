"""Errors of a camera file, estimated in flight: focal length, principal point, radial distortion.

Five states, each relative to the camera file: the focal length's relative error, the principal point's shift (in focal
lengths, x and y), and the errors of k1 and k2, (15.1) and (15.2). If the readout of the rows is not known for sure, its
excess over `camera.readout_s` (s) is a sixth, see `rolling_shutter`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.lens import FISHEYE, PINHOLE
from onboard.estimation.information import with_own_variance
from onboard.estimation.platform_states import STATES
from onboard.geometry import camera_errors

Array = NDArray[np.float64]

FOCAL_LENGTH, K1, COUNT = 0, 3, camera_errors.COUNT  # focal length, principal point (x, y), k1, k2
CERTAIN = 1e-6  # one sigma of a state that is taken to be 0
READOUT = COUNT  # where that state is, if it is one
# Of the camera in the state directory: the same coefficient of two models is another number.
NUMBERS = {
    PINHOLE: ("focal_px", "cx_px", "cy_px", "k1", "k2"),
    FISHEYE: ("focal_px", "cx_px", "cy_px", "fisheye_k1", "fisheye_k2"),
}


def corrected(camera: Camera, states: Array) -> Camera:
    """The camera file's camera with the states (5,) or (6,) applied; the same camera for none (0,)."""
    if not len(states):
        return camera
    grown = float(np.exp(states[0]))
    k1, k2, *others = camera.distortion
    return replace(
        camera,
        fx_px=camera.fx_px * grown,
        fy_px=camera.fy_px * grown,
        cx_px=camera.cx_px + camera.focal_px * float(states[1]),
        cy_px=camera.cy_px + camera.focal_px * float(states[2]),
        distortion=(k1 + float(states[3]), k2 + float(states[4]), *others),
    )


def readout_s(states: Array) -> float:
    """The readout's excess over the configured one, s, by the states (0,), (5,) or (6,)."""
    return float(states[READOUT]) if len(states) > READOUT else 0.0


def first_sigmas(camera: Camera | None, sigma_readout_s: float) -> tuple[float, ...]:
    """One sigma of every state before take-off: five and the readout's, or none where nothing may be wrong."""
    lens = camera.sigma if camera is not None else (0.0,) * COUNT
    if sigma_readout_s > 0.0:
        return *lens, sigma_readout_s
    return lens if any(lens) else ()


def without_readout(mean: Array, covariance: Array, given: Array, given_covariance: Array) -> tuple[Array, Array]:
    """A posterior (B,), (B, B) of which the readout, if it is a state, is what was given: it teaches nothing of it."""
    if len(mean) <= STATES + READOUT:
        return mean, covariance
    covariance = with_own_variance(covariance, -1, given_covariance[-1, -1])
    return np.append(mean[:-1], given[-1]), covariance


def taken(states: Array) -> Array:
    """The states that rays were made with: pixels keep the time of their row, whatever the readout is."""
    return np.where(np.arange(len(states)) == READOUT, 0.0, states)


def seen_through(camera_file: Camera, camera: Camera, states: Array, xy: Array) -> tuple[Camera, Array, Array]:
    """The camera with these states, what `taken` makes of them, and the coordinates xy (..., 2) of `camera` by it.

    (15.2) is the first order of a camera's errors. Without attitude the principal point and the lens trade with the
    poses, so that what the second order leaves, a fifth of a pixel at a hundredth of the focal length, moves them.
    """
    better = corrected(camera_file, states)
    return better, taken(states), better.unproject(camera.pixels(xy), xy)[0][..., :2]


def as_numbers(camera: Camera, states: Array, configured_s: float = 0.0) -> dict[str, float]:
    """The corrected camera, for the state directory: what it is, not how far it is from a file that may be replaced."""
    c = corrected(camera, states)
    out = dict(zip(NUMBERS[c.model], (c.focal_px, c.cx_px, c.cy_px, *c.distortion[:2]), strict=True))
    return {**out, "readout_s": configured_s + readout_s(states)} if len(states) > READOUT else out


def from_numbers(camera: Camera, numbers: dict[str, float], configured_s: float = 0.0) -> Array:
    """The states (5,) or (6,) that make the file's camera such a one. Raises KeyError, TypeError, ValueError."""
    if NUMBERS[camera.model][-1] not in numbers:
        raise ValueError(f"its lens is not the {camera.model} that the camera file states; delete it")
    f, x, y, k1, k2 = (float(numbers[key]) for key in NUMBERS[camera.model])
    off = np.array([x - camera.cx_px, y - camera.cy_px]) / camera.focal_px
    out = [np.log(f / camera.focal_px), *off, k1 - camera.distortion[0], k2 - camera.distortion[1]]
    return np.array([*out, float(numbers["readout_s"]) - configured_s] if "readout_s" in numbers else out)
