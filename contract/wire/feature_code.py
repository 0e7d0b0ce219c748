"""The features of a set <-> bits: sections 5 and 6 of docs/wire-format.md.

Pixels on a grid, sorted by row; inverse depth as what is left of the ground plane's prediction, in steps of the set's
smallest sigma; sigmas in logarithmic steps.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.errors import CorruptPayload
from contract.feature_set import FeatureSet
from contract.wire import bits
from contract.wire.byte_cursor import ByteCursor
from contract.wire.covariance_code import MAX_SIGMA_CODE, SIGMA_FLOOR, SIGMA_UNIT, sigma_code, sigma_from_code

Array = NDArray[np.float64]

MAX_FEATURES = 255
_FEATURES = struct.Struct("<HBBB")

PIXEL_STEPS = 4  # a pixel
SIGMA_STEPS = 80  # units of SIGMA_UNIT between two feature sigmas: 4.9 %
DEPTH_STEPS = 3  # to the smallest sigma, whose variance rounding so raises by under 1 %
MAX_DEPTH_STEPS = 2**40
MAX_UNDISTORTION = 0.5  # of normalised image coordinates


def _u_width(camera: Camera) -> int:
    return (camera.width_px * PIXEL_STEPS).bit_length()


def _plane_inverse_depth(camera: Camera, plane_per_m: list[float], uv_px: Array) -> Array:
    """What the plane predicts at pixels (2, N), rows u and v: the reference both sides code inverse depths against.

    Three fixed steps undo the distortion well enough to predict, cheaply and alike on both sides; what they leave is
    part of the residual. Where they run away (a calibration that folds) the distorted coordinates have to do.
    """
    a, b, c = plane_per_m
    target = np.empty_like(uv_px)
    with np.errstate(all="ignore"):
        np.divide(uv_px[0] - camera.cx_px, camera.fx_px, out=target[0])
        np.divide(uv_px[1] - camera.cy_px, camera.fy_px, out=target[1])
        xy = target
        if any(camera.distortion):
            for _ in range(3):
                xy = target - camera.displacement(xy)
            moved = np.abs(xy - target)
            if not moved.max() < MAX_UNDISTORTION:
                xy = np.where(np.maximum(moved[0], moved[1]) < MAX_UNDISTORTION, xy, target)
        predicted: Array = a + (xy[0] * b + xy[1] * c)
    return predicted


def encode_features(s: FeatureSet, camera: Camera) -> bytes:
    """Section 5 of a payload; `camera` is the set's own as its receiver will know it. Raises ValueError."""
    n = len(s)
    uv, w = np.asarray(s.uv_px, float), np.asarray(s.inverse_depth_per_m, float)
    sigma = np.asarray(s.sigma_inverse_depth_per_m, float)
    if n > MAX_FEATURES:
        raise ValueError(f"a set carries at most {MAX_FEATURES} features, this one has {n}")
    if uv.shape != (n, 2) or w.shape != (n,) or sigma.shape != (n,):
        raise ValueError(f"feature columns disagree: uv_px {uv.shape}, inverse depth {w.shape}, sigma {sigma.shape}")
    if not n:
        return b"\0"
    least = float(sigma.min())
    if not (least >= SIGMA_FLOOR and sigma.max() < 1e3):
        raise ValueError(f"sigma_inverse_depth_per_m must be between {SIGMA_FLOOR} and 1000: {sigma.tolist()}")
    steps = np.rint((uv.T + 0.5) * PIXEL_STEPS)
    order = steps[1].argsort(kind="stable")
    steps = steps.take(order, axis=1)
    u_steps, v_steps = steps
    # Where the rounded ones are all within, so is what they are rounded from; at the edge, and beyond, ask.
    most_u, most_v = camera.width_px * PIXEL_STEPS, camera.height_px * PIXEL_STEPS
    if not (u_steps.min() > 0 and u_steps.max() < most_u and v_steps[0] > 0 and v_steps[-1] < most_v):
        inside = camera.contains(uv)
        if not inside.all():
            raise ValueError(f"feature {int(np.argmin(inside))} is off the picture")
    w, sigma = w.take(order), sigma.take(order)
    base = sigma_code(least)
    smallest = sigma_from_code(base)
    # The receiver knows the plane rounded to float32; predict with that, as with its camera.
    plane = np.asarray(s.plane_per_m, np.float32).tolist()
    residual = (w - _plane_inverse_depth(camera, plane, steps / PIXEL_STEPS - 0.5)) * (DEPTH_STEPS / smallest)
    if not np.abs(residual).max() <= MAX_DEPTH_STEPS or smallest < 1e-11 * np.abs(w).max():
        if not np.isfinite(w).all():
            first = int(np.argmin(np.isfinite(s.inverse_depth_per_m)))
            raise ValueError(f"inverse_depth_per_m of feature {first} is not finite")
        raise ValueError(f"the smallest sigma {smallest:.3g} 1/m is too small beside the inverse depths to be coded")
    columns = np.empty((3, n), np.int64)
    columns[0, 0] = v_steps[0]
    columns[0, 1:] = v_steps[1:] - v_steps[:-1]
    columns[1] = bits.zigzag(np.rint(residual).astype(np.int64))
    # Rounding may have made the smallest sigma greater than itself.
    columns[2] = np.maximum(np.rint(np.log(sigma / smallest) / (SIGMA_UNIT * SIGMA_STEPS)), 0.0)
    ks = bits.rice_parameters(columns)
    quotients = columns >> np.array(ks)[:, None]
    lows = [(column & ((1 << k) - 1), k) for column, k in zip(columns, ks, strict=True)]
    fixed = bits.fixed_to_bits([(u_steps.astype(np.int64), _u_width(camera)), *lows])
    return bytes([n]) + _FEATURES.pack(base, *ks) + bits.with_unary([fixed], quotients.ravel())


def decode_features(cursor: ByteCursor, camera: Camera, plane_per_m: Array) -> dict[str, Any]:
    """The feature columns of a FeatureSet, in the order of the wire. Raises CorruptPayload."""
    n = cursor.take(1)[0]
    if not n:
        return {}
    base, *ks = cursor.unpack(_FEATURES)
    if max(ks) >= bits.MAX_WIDTH or base == 0:
        raise CorruptPayload(f"feature codes are {ks} bits wide, smallest sigma {base}")
    widths = [_u_width(camera), *ks]
    stream = np.unpackbits(np.frombuffer(cursor.payload, np.uint8, cursor.end - cursor.position, cursor.position))
    fixed_bits = n * sum(widths)
    unary = bits.bits_to_unary(stream[fixed_bits:], 3 * n)
    if unary is None:
        raise CorruptPayload(f"{n} features do not fit into the {len(stream) // 8} bytes that are there")
    quotients, unary_bits = unary
    used = fixed_bits + unary_bits
    if stream[used : -(-used // 8) * 8].any():
        raise CorruptPayload("padding bits are not zero")
    cursor.take(-(-used // 8))
    u_steps, *lows = bits.bits_to_fixed(stream[:fixed_bits], widths)
    numbers = (quotients.reshape(3, n) << np.array(ks)[:, None]) + np.array(lows)
    rows, residual, sigma_steps = numbers
    v_steps = np.minimum(rows, 2**32).cumsum()
    if (
        u_steps.max() > camera.width_px * PIXEL_STEPS
        or v_steps[-1] > camera.height_px * PIXEL_STEPS
        or residual.max() > 2 * MAX_DEPTH_STEPS
        or sigma_steps.max() > (MAX_SIGMA_CODE - base) // SIGMA_STEPS
    ):
        raise CorruptPayload("a feature lies off the picture or beyond what can be written")
    uv_px = np.array([u_steps, v_steps]) / PIXEL_STEPS - 0.5
    smallest = sigma_from_code(base)
    predicted = _plane_inverse_depth(camera, plane_per_m.tolist(), uv_px)
    inverse_depth = predicted + bits.unzigzag(residual) * (smallest / DEPTH_STEPS)
    if not np.isfinite(inverse_depth).all():
        raise CorruptPayload("the plane has no finite inverse depth at a feature")
    return {
        "uv_px": np.ascontiguousarray(uv_px.T),
        "inverse_depth_per_m": inverse_depth,
        "sigma_inverse_depth_per_m": smallest * np.exp(SIGMA_UNIT * SIGMA_STEPS * sigma_steps),
    }
