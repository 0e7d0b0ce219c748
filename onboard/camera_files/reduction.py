"""A stated lens becomes a camera of ours: as it is, or by the least squares over its whole picture."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import (
    COEFFICIENTS,
    PIXEL_ASPECT,
    UNKNOWN_SIGMA,
    Camera,
    Sigma,
    is_nearly_square,
)
from contract.errors import InputError
from contract.lens import FISHEYE, MAX_ANGLE, MAX_RADIUS, MIN_RADIAL_SLOPE
from onboard.camera_files.stated_lens import Array, Further, StatedLens

GRID = (33, 25)
STEP = 1e-6  # of derivatives, normalised
MIDDLE = 0.25  # of width and height: a centre further off the middle is a cropped picture's, or counted from elsewhere


def reduced(stated: StatedLens) -> tuple[Camera, float]:
    """Return the camera, and how far its pixels are off those of the stated lens at worst, px: 0 where it is one.

    Raises InputError for what no lens is, and where the terms that we do not have cannot be done without: the bound is
    what `calibrate` accepts of its own calibrations, one sigma in the worst direction.
    """
    if not is_nearly_square(stated.fx_px, stated.fy_px):
        raise InputError(
            f"fy is {stated.fy_px / stated.fx_px:.4g} times fx: one is wrong, or pixels are not square; if so write "
            f'its numbers into a camera.json that declares it ("{PIXEL_ASPECT}")'
        )
    _check_centre(stated)
    if not stated.further.names():
        return _camera(stated, stated.sigma), 0.0
    from onboard.calibration.verdict import RAY_SIGMA_SHARE  # noqa: PLC0415  draws with OpenCV

    pixels = _grid(stated)
    xy, has_ray = _rays(stated, pixels)
    if np.mean(has_ray) < 0.5:
        raise InputError(f"by its distortion only {100.0 * np.mean(has_ray):.0f} % of the picture can be used")
    fitted = _fitted(stated, xy[has_ray], pixels[has_ray])
    off_px = float(np.hypot(*(fitted.project(xy[has_ray]) - pixels[has_ray]).T).max())
    limit_px = RAY_SIGMA_SHARE * stated.size_px[0]
    if not off_px <= limit_px:
        raise InputError(
            f"without {' and '.join(stated.further.names())} its pixels are up to {off_px:.2g} px off, and no "
            f"calibration is taken that is uncertain by more than {limit_px:.2g}: calibrate the lens with pc-onboard "
            "calibrate"
        )
    sigma = None if stated.sigma is None else _with_reduction(stated.sigma, off_px, fitted, xy[has_ray])
    camera = _camera(fitted, sigma)
    kept = camera.unproject(pixels)[1]
    if np.mean(kept) < np.mean(has_ray) - 0.05:
        raise InputError(
            f"without {' and '.join(stated.further.names())} {100.0 * np.mean(has_ray & ~kept):.0f} % of the picture "
            "would have no ray: calibrate the lens with pc-onboard calibrate"
        )
    return camera, off_px


def _check_centre(lens: StatedLens) -> None:
    """Raise InputError for a principal point that is far off the picture's middle."""
    for name, value, length in zip("xy", (lens.cx_px, lens.cy_px), lens.size_px, strict=True):
        off = (value - 0.5 * (length - 1)) / length
        if abs(off) > MIDDLE:
            raise InputError(
                f"its principal point is {value:.4g} px in {name}, {100.0 * abs(off):.0f} % of the picture off its "
                "middle: it is counted from elsewhere, of another picture size, or the picture is cropped; if it is "
                "right, write its numbers into a camera.json"
            )


def _camera(lens: StatedLens, sigma: Sigma | None) -> Camera:
    """Return the camera, by all checks of a camera file; without sigmas it has those for where none are stated."""
    raw = {
        "size_px": list(lens.size_px),
        **{"fx_px": lens.fx_px, "fy_px": lens.fy_px, "cx_px": lens.cx_px, "cy_px": lens.cy_px},
        "model": lens.model,
        COEFFICIENTS[lens.model]: list(lens.distortion),
    }
    camera = Camera.from_text(json.dumps(raw), "as a camera file")
    return replace(camera, stated_sigma=UNKNOWN_SIGMA if sigma is None else sigma)


def _grid(lens: StatedLens) -> Array:
    axes = (np.linspace(0.0, n - 1.0, count) for n, count in zip(lens.size_px, GRID, strict=True))
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


def _rays(lens: StatedLens, pixels: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Pixels (N, 2) -> undistorted coordinates (N, 2), those that `StatedLens.project` takes, and whether they are the
    pixel's own. Newton, as (2.4).

    Those beyond a fold are not: there the radius no longer grows as fast as our camera wants it to.
    """
    xy = (pixels - (lens.cx_px, lens.cy_px)) / (lens.fx_px, lens.fy_px)
    with np.errstate(all="ignore"):
        for _ in range(40):
            there = lens.project(xy)
            across = (lens.project(xy + (STEP, 0.0)) - there) / STEP
            down = (lens.project(xy + (0.0, STEP)) - there) / STEP
            off = there - pixels
            det = across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]
            det = np.where(np.abs(det) < 1e-3 * lens.fx_px * lens.fy_px, np.inf, det)
            step = np.stack(
                [
                    (down[:, 1] * off[:, 0] - down[:, 0] * off[:, 1]) / det,
                    (across[:, 0] * off[:, 1] - across[:, 1] * off[:, 0]) / det,
                ],
                axis=1,
            )
            xy = np.clip(np.nan_to_num(xy - np.clip(step, -0.3, 0.3)), -_end(lens), _end(lens))
        off = lens.project(xy) - pixels
        is_found = np.hypot(off[:, 0], off[:, 1]) < 1e-3
    return xy, np.asarray(is_found & (np.hypot(*xy.T) <= _fold(lens)))


def _fold(lens: StatedLens) -> float:
    """Return the radius up to which the radial part, tangential terms aside, grows."""
    plain = replace(
        lens, fx_px=1.0, fy_px=1.0, cx_px=0.0, cy_px=0.0,
        distortion=_radial(lens),
        further=Further(lens.further.eighth, lens.further.below),
    )  # fmt: skip
    radius = np.linspace(0.0, _end(lens), 3001)
    with np.errstate(all="ignore"):
        there = plain.project(np.stack([radius, np.zeros_like(radius)], axis=1))[:, 0]
        slope = np.diff(there) / np.diff(radius)
    bad = np.flatnonzero(~(slope >= MIN_RADIAL_SLOPE))
    return float(radius[bad[0]]) if bad.size else _end(lens)


def _end(lens: StatedLens) -> float:
    """Return the radius at which rays end: an angle off the axis, rad, of a fisheye."""
    return MAX_ANGLE if lens.model == FISHEYE else MAX_RADIUS


def _radial(lens: StatedLens) -> tuple[float, ...]:
    """Return the coefficients without a pinhole's tangential ones; a fisheye's have none."""
    return lens.distortion if lens.model == FISHEYE else (*lens.distortion[:2], 0.0, 0.0, lens.distortion[4])


def _fitted(stated: StatedLens, xy: Array, pixels: Array) -> StatedLens:
    """Return the lens of ours, of nine numbers or, a fisheye, of eight, whose pixels of the directions xy (N, 2) are
    nearest to `pixels` (N, 2).
    """
    from scipy.optimize import least_squares  # noqa: PLC0415  slow to import

    focal_px = stated.fx_px

    def lens(values: Array) -> StatedLens:
        fx, fy, cx, cy, *distortion = (float(v) for v in values)
        return replace(
            stated, fx_px=fx * focal_px, fy_px=fy * focal_px, cx_px=cx * focal_px, cy_px=cy * focal_px,
            distortion=tuple(distortion), further=Further(),
        )  # fmt: skip

    none = [0.0] * len(stated.distortion)
    start = np.array([1.0, stated.fy_px / focal_px, stated.cx_px / focal_px, stated.cy_px / focal_px, *none])
    found = least_squares(lambda values: (lens(values).project(xy) - pixels).ravel(), start, method="lm")
    return lens(found.x)


def _with_reduction(sigma: Sigma, off_px: float, lens: StatedLens, xy: Array) -> Sigma:
    """Return stated sigmas that hold for the reduced lens: what it is off at worst is one sigma of each more."""
    off, radius = off_px / lens.fx_px, float(np.hypot(*xy.T).max())
    added = (off / radius, off, off, off / radius**3, off / radius**5)
    f, x, y, k1, k2 = (float(np.hypot(s, more)) for s, more in zip(sigma, added, strict=True))
    return f, x, y, k1, k2
