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
from contract.wire.byte_cursor import Reader
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


def _plane_inverse_depth(camera: Camera, plane_per_m: Array, uv_px: Array) -> Array:
    """What the plane predicts at pixels (N, 2): the reference both sides code inverse depths against.

    Three fixed steps undo the distortion well enough to predict, cheaply and alike on both sides; what they leave is
    part of the residual. Where they run away (a calibration that folds) the distorted coordinates have to do.
    """
    target = (uv_px - (camera.cx_px, camera.cy_px)) / (camera.fx_px, camera.fy_px)
    xy = target
    with np.errstate(all="ignore"):
        for _ in range(3 if any(camera.distortion) else 0):
            xy = xy - (camera.distort(xy) - target)
        moved = np.max(np.abs(xy - target), axis=-1, keepdims=True)
        xy = np.where(moved < MAX_UNDISTORTION, xy, target)
        predicted: Array = plane_per_m[0] + xy @ plane_per_m[1:]
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
    if not np.all(np.isfinite(w)):
        raise ValueError(f"inverse_depth_per_m of feature {int(np.argmin(np.isfinite(w)))} is not finite")
    if not np.all((sigma >= SIGMA_FLOOR) & (sigma < 1e3)):
        raise ValueError(f"sigma_inverse_depth_per_m must be between {SIGMA_FLOOR} and 1000: {sigma.tolist()}")
    if not np.all(s.camera.contains(uv)):
        raise ValueError(f"feature {int(np.argmin(s.camera.contains(uv)))} is off the picture")

    uv_steps = np.rint((uv + 0.5) * PIXEL_STEPS).astype(np.int64)
    order = np.argsort(uv_steps[:, 1], kind="stable")
    uv_steps, w, sigma = uv_steps[order], w[order], sigma[order]
    base = sigma_code(float(sigma.min()))
    smallest = sigma_from_code(base)
    sigma_steps = np.rint(np.log(sigma / smallest) / (SIGMA_UNIT * SIGMA_STEPS)).astype(np.int64)
    sigma_steps = np.maximum(sigma_steps, 0)
    # The receiver knows the plane rounded to float32; predict with that, as with its camera.
    plane = np.asarray(s.plane_per_m, np.float32).astype(float)
    residual = (w - _plane_inverse_depth(camera, plane, uv_steps / PIXEL_STEPS - 0.5)) * (DEPTH_STEPS / smallest)
    if not np.max(np.abs(residual)) <= MAX_DEPTH_STEPS or smallest < 1e-11 * np.max(np.abs(w)):
        raise ValueError(f"the smallest sigma {smallest:.3g} 1/m is too small beside the inverse depths to be coded")
    columns = [
        np.diff(uv_steps[:, 1], prepend=0),
        bits.zigzag(np.rint(residual).astype(np.int64)),
        sigma_steps,
    ]
    ks = [bits.rice_parameter(column) for column in columns]
    lows = [(column & ((1 << k) - 1), k) for column, k in zip(columns, ks, strict=True)]
    fixed = bits.fixed_to_bits([(uv_steps[:, 0], _u_width(camera)), *lows])
    unary = bits.unary_to_bits(np.concatenate([column >> k for column, k in zip(columns, ks, strict=True)]))
    packed = np.packbits(np.concatenate([fixed, unary])).tobytes()
    if len(packed) > 60000:
        raise ValueError("inverse depths or sigmas differ too much within the set to be coded")
    return bytes([n]) + _FEATURES.pack(base, *ks) + packed


def decode_features(reader: Reader, camera: Camera, plane_per_m: Array) -> dict[str, Any]:
    """The feature columns of a FeatureSet, in the order of the wire. Raises CorruptPayload."""
    n = reader.take(1)[0]
    if not n:
        return {}
    base, *ks = reader.unpack(_FEATURES)
    if max(ks) >= bits.MAX_WIDTH or base == 0:
        raise CorruptPayload(f"feature codes are {ks} bits wide, smallest sigma {base}")
    widths = [_u_width(camera), *ks]
    stream = np.unpackbits(np.frombuffer(reader.payload, np.uint8, reader.end - reader.position, reader.position))
    fixed_bits = n * sum(widths)
    unary = bits.bits_to_unary(stream[fixed_bits:], 3 * n)
    if unary is None:
        raise CorruptPayload(f"{n} features do not fit into the {len(stream) // 8} bytes that are there")
    quotients, unary_bits = unary
    used = fixed_bits + unary_bits
    if np.any(stream[used : -(-used // 8) * 8]):
        raise CorruptPayload("padding bits are not zero")
    reader.take(-(-used // 8))
    u_steps, *lows = bits.bits_to_fixed(stream[:fixed_bits], widths)
    rows, residual, sigma_steps = (
        (quotients[i * n : (i + 1) * n] << k) + low for i, (k, low) in enumerate(zip(ks, lows, strict=True))
    )
    v_steps = np.cumsum(np.minimum(rows, 2**32))
    if (
        u_steps.max() > camera.width_px * PIXEL_STEPS
        or v_steps[-1] > camera.height_px * PIXEL_STEPS
        or residual.max() > 2 * MAX_DEPTH_STEPS
        or sigma_steps.max() > (MAX_SIGMA_CODE - base) // SIGMA_STEPS
    ):
        raise CorruptPayload("a feature lies off the picture or beyond what can be written")
    uv_px = np.stack([u_steps, v_steps], axis=-1) / PIXEL_STEPS - 0.5
    smallest = sigma_from_code(base)
    steps = bits.unzigzag(residual)
    inverse_depth = _plane_inverse_depth(camera, plane_per_m, uv_px) + steps * (smallest / DEPTH_STEPS)
    if not np.all(np.isfinite(inverse_depth)):
        raise CorruptPayload("the plane has no finite inverse depth at a feature")
    return {
        "uv_px": uv_px,
        "inverse_depth_per_m": inverse_depth,
        "sigma_inverse_depth_per_m": smallest * np.exp(SIGMA_UNIT * SIGMA_STEPS * sigma_steps),
    }
