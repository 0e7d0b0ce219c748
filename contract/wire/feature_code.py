"""The features of a set <-> numbers: sections 5 and 6 of docs/wire-format.md.

The pixel that a feature lies in, counted row by row; inverse depth as what is left of the ground plane's prediction, in
steps of the feature's own sigma; sigmas in logarithmic steps.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.errors import CorruptPayload
from contract.feature_set import FeatureSet
from contract.lens import FISHEYE, MAX_ANGLE, SMALL_RADIUS
from contract.wire import bits
from contract.wire.covariance_code import MAX_SIGMA_CODE, SIGMA_FLOOR, SIGMA_UNIT, sigma_code, sigma_from_code

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

MAX_FEATURES = 255
SIGMA_STEPS = 128  # units of SIGMA_UNIT between two feature sigmas: 8 %
DEPTH_STEPS = 3  # to a feature's own sigma, whose variance rounding so raises by under 1 %
MAX_DEPTH_STEPS = 2**40
MAX_UNDISTORTION = 0.5  # of normalised image coordinates
LEAST_TERM = 2.0**-20  # of the series that undoes distortion


def feature_numbers(s: FeatureSet, camera: Camera) -> tuple[int, Ints]:
    """Sigma code of the smallest sigma (0 if there are no features), and three rows (3, n) of numbers >= 0.

    `camera` is the set's own as its receiver will decode it. Raises ValueError.
    """
    n = len(s)
    uv, w = np.asarray(s.uv_px, float), np.asarray(s.inverse_depth_per_m, float)
    sigma = np.asarray(s.sigma_inverse_depth_per_m, float)
    if n > MAX_FEATURES:
        raise ValueError(f"a set carries at most {MAX_FEATURES} features, this one has {n}")
    if uv.shape != (n, 2) or w.shape != (n,) or sigma.shape != (n,):
        raise ValueError(f"feature columns disagree: uv_px {uv.shape}, inverse depth {w.shape}, sigma {sigma.shape}")
    if not n:
        return 0, np.zeros((3, 0), np.int64)
    least = float(np.minimum.reduce(sigma))
    if not (least >= SIGMA_FLOOR and np.maximum.reduce(sigma) < 1e3):
        raise ValueError(f"sigma_inverse_depth_per_m must be between {SIGMA_FLOOR} and 1000: {sigma.tolist()}")
    cells, at = _cells(camera, uv)
    order = cells.argsort(kind="stable")
    base = sigma_code(least)
    smallest = sigma_from_code(base)
    # Rounding may have made the smallest sigma greater than itself.
    levels = np.maximum(np.rint(np.log(sigma / smallest) * (1.0 / (SIGMA_UNIT * SIGMA_STEPS))), 0.0)
    # The receiver has the plane rounded to float32; predict with that, as with its camera.
    plane = np.asarray(s.plane_per_m, np.float32).tolist()
    # Off the plane at the feature's own place: it is moved to the middle of its pixel along the plane.
    residual = (w - _plane_inverse_depth(camera, plane, at)) / (_sigmas(smallest, levels) * (1.0 / DEPTH_STEPS))
    off, deepest = np.maximum.reduce(np.abs([residual, w]), axis=1).tolist()
    if not off <= MAX_DEPTH_STEPS or smallest < 1e-11 * deepest:
        if not np.isfinite(w).all():
            raise ValueError(f"inverse_depth_per_m of feature {int(np.argmin(np.isfinite(w)))} is not finite")
        raise ValueError(
            f"the smallest sigma {smallest:.3g} 1/m is too small relative to the inverse depths to be coded"
        )
    columns = np.empty((3, n), np.int64)
    columns[0] = cells
    columns[1] = np.rint(residual)
    columns[2] = levels
    columns = columns.take(order, axis=1)
    columns[0, 1:] -= columns[0, :-1].copy()
    columns[1] = bits.zigzag(columns[1])
    return base, columns


def features_from_numbers(camera: Camera, plane_per_m: list[float], base: int, columns: Ints) -> dict[str, Any]:
    """The feature columns of a FeatureSet, in the order of the wire. Raises CorruptPayload."""
    if base == 0:
        raise CorruptPayload("the smallest sigma is 0")
    apart, residual, levels = columns
    cells = apart.cumsum()
    farthest, largest, highest = np.maximum.reduce(columns, axis=1).tolist()
    pixels = camera.width_px * camera.height_px
    if (
        farthest >= pixels  # so that 255 of them cannot overflow either
        or cells[-1] >= pixels
        or largest > 2 * MAX_DEPTH_STEPS
        or highest > (MAX_SIGMA_CODE - base) // SIGMA_STEPS
    ):
        raise CorruptPayload("a feature lies off the picture or beyond what can be written")
    at = np.empty((2, len(cells)))
    v = cells // camera.width_px
    at[1] = v
    v *= camera.width_px
    cells -= v
    at[0] = cells
    sigma = _sigmas(sigma_from_code(base), levels)
    inverse_depth = _plane_inverse_depth(camera, plane_per_m, at) + bits.unzigzag(residual) * (
        sigma * (1.0 / DEPTH_STEPS)
    )
    if not math.isfinite(np.add.reduce(inverse_depth)):
        raise CorruptPayload("the plane has no finite inverse depth at a feature")
    return {"uv_px": at.T.copy(), "inverse_depth_per_m": inverse_depth, "sigma_inverse_depth_per_m": sigma}


def _cells(camera: Camera, uv_px: Array) -> tuple[Ints, Array]:
    """Return the pixels that features (N, 2) lie in, counted row by row (N,), and their positions as rows (2, N).

    Raises ValueError for a feature off the picture.
    """
    at = np.ascontiguousarray(uv_px.T)
    u, v = cell = np.floor(at + 0.5)
    most_u, most_v = np.maximum.reduce(cell, axis=1).tolist()
    # At the edge, and beyond, ask.
    if not (np.minimum.reduce(cell, axis=None) >= 0 and most_u < camera.width_px and most_v < camera.height_px):
        inside = camera.contains(uv_px)
        if not inside.all():
            raise ValueError(f"feature {int(np.argmin(inside))} is off the picture")
        last = np.array([[camera.width_px - 1.0], [camera.height_px - 1.0]])
        u, v = np.minimum(np.maximum(cell, 0.0), last)
    return (v * camera.width_px + u).astype(np.int64), at


def _sigmas(smallest: float, levels: NDArray[Any]) -> Array:
    return smallest * np.exp(SIGMA_UNIT * SIGMA_STEPS * levels)


def _plane_inverse_depth(camera: Camera, plane_per_m: list[float], uv_px: Array) -> Array:
    """The plane's inverse depths at pixels (2, N), rows u and v: the reference both sides code inverse depths against.

    A series undoes the distortion well enough to predict, cheaply and identically on both sides; the rest is part of
    the residual. Where it diverges (a calibration that folds) the distorted coordinates have to do. Of a fisheye it
    gives the angle off the axis.
    """
    a, b, c = plane_per_m
    p1, p2 = (0.0, 0.0) if camera.model == FISHEYE else camera.distortion[2:4]
    with np.errstate(all="ignore"):
        x = (uv_px[0] - camera.cx_px) * (1.0 / camera.fx_px)
        y = (uv_px[1] - camera.cy_px) * (1.0 / camera.fy_px)
        if p1 or p2:
            across, r2 = 2.0 * (p2 * x + p1 * y), x * x + y * y
            x, y = x - (across * x + p2 * r2), y - (across * y + p1 * r2)
        along: Array = x * b
        along += y * c
        terms, is_small = _undistortion(camera)
        if terms or camera.model == FISHEYE:
            x *= x
            y *= y
            x += y
            grown = _stretch(x, terms, is_small) if terms else np.zeros_like(x)
            along += along * (_by_angle(x, grown) if camera.model == FISHEYE else grown)
        along += a
    return along


@lru_cache(maxsize=64)
def _undistortion(camera: Camera) -> tuple[list[float], bool]:
    """Coefficients of r^2, r^4, ... by which distorted coordinates grow to undo the radial distortion, and whether
    that is surely less than `MAX_UNDISTORTION`.

    The first four terms of the series that inverts (2.1) without its tangential part, or (30.1) (Drap and Lefevre
    2016), less the last ones that are next to nothing in the farthest corner.
    """
    k1, k2, *others = camera.distortion
    k3, k4 = others if camera.model == FISHEYE else (others[2], 0.0)
    k11 = k1 * k1
    terms = [
        -k1,
        3.0 * k11 - k2,
        k1 * (8.0 * k2 - 12.0 * k11) - k3,
        55.0 * k11 * (k11 - k2) + 5.0 * k2 * k2 + 10.0 * k1 * k3 - k4,
    ]
    x = max(camera.cx_px + 0.5, camera.width_px - 0.5 - camera.cx_px) / camera.fx_px
    y = max(camera.cy_px + 0.5, camera.height_px - 0.5 - camera.cy_px) / camera.fy_px
    r2 = x * x + y * y
    sizes = [abs(term) * r2 * r2**i for i, term in enumerate(terms)]
    while sizes and sizes[-1] < LEAST_TERM:
        sizes.pop()
    return terms[: len(sizes)], sum(sizes) * math.sqrt(r2) < MAX_UNDISTORTION


def _by_angle(r2: Array, grown: Array) -> Array:
    """The growth of a fisheye's distorted coordinates to tangents, at squared radii (N,), whose angles `grown` has.

    (30.1)
    """
    radius = np.sqrt(r2)
    angle = np.minimum(radius + radius * grown, MAX_ANGLE)
    return np.where(radius > SMALL_RADIUS, np.tan(angle) / np.maximum(radius, SMALL_RADIUS) - 1.0, 0.0)


def _stretch(r2: Array, terms: list[float], is_small: bool) -> Array:
    """The series at squared radii (N,): 0 where that moves them by more than `MAX_UNDISTORTION`."""
    out: Array = r2 * terms[-1]
    for term in terms[-2::-1]:
        out += term
        out *= r2
    if not is_small:
        out = np.where(out * out * r2 < MAX_UNDISTORTION**2, out, 0.0)
    return out
