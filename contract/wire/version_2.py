"""The geometry of versions 2 and 3, which are read and no longer written: docs/wire-format.md, appendix A.

Common errors and features each have bits of their own here, pixels are in quarters, and inverse depths in steps of the
smallest sigma. `contract/wire/codec.py` reads what all versions have in common.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.errors import CorruptPayload
from contract.feature_set import COMMON_STATES, NUISANCES
from contract.wire import bits
from contract.wire.byte_cursor import ByteCursor
from contract.wire.common_code import GROUPS, common_from_numbers, shared_from_codes
from contract.wire.covariance_code import MAX_SIGMA_CODE, SIGMA_UNIT, sigma_from_code
from contract.wire.geometry_code import DEGREE_STEPS, METRE_STEPS, checked_pose, decode_shutter

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_PLANE = struct.Struct("<3fHH")
_COMMON = struct.Struct(f"<{COMMON_STATES}H6H2h")
_FEATURES = struct.Struct("<HBBB")
MAX_HALVINGS = 2  # of the step of shared errors
EMPTY = 15  # the Rice parameter of a group of zeros
_PLACES = np.array([8, 4, 2, 1])
_PARAMETERS = 4 * (2 + NUISANCES)  # bits: halvings, then Rice parameters
PIXEL_STEPS = 4  # a pixel
SIGMA_STEPS = 80  # units of SIGMA_UNIT between two feature sigmas
DEPTH_STEPS = 3  # to the smallest sigma
MAX_DEPTH_STEPS = 2**40
MAX_UNDISTORTION = 0.5  # of normalised image coordinates


def decode_geometry(cursor: ByteCursor, camera: Camera, *, has_undulation: bool, is_rolling: bool) -> dict[str, Any]:
    """The fields of a FeatureSet behind its camera. Raises CorruptPayload."""
    lat, lon = cursor.signed(5) / DEGREE_STEPS, cursor.signed(5) / DEGREE_STEPS
    height = cursor.signed(4) / METRE_STEPS
    undulation = cursor.signed(3) / METRE_STEPS if has_undulation else math.nan
    steps = (cursor.signed(3), cursor.signed(3), cursor.signed(3))
    *plane, spread, roughness = cursor.unpack(_PLANE)
    out = checked_pose(lat, lon, height, steps, plane)
    out |= {
        "undulation_m": undulation,
        "plane_sigma_relative": sigma_from_code(spread),
        "roughness": sigma_from_code(roughness),
        "shutter": decode_shutter(cursor) if is_rolling else None,
    }
    return out | _decode_common(cursor) | _decode_features(cursor, camera, plane)


def _decode_common(cursor: ByteCursor) -> dict[str, Any]:
    numbers = cursor.unpack(_COMMON)
    halvings, written = _decode_groups(cursor)
    common = common_from_numbers(list(numbers[:COMMON_STATES]), written, halvings)
    return common | shared_from_codes(common.pop("by_nuisance"), numbers[COMMON_STATES:])


def _decode_groups(cursor: ByteCursor) -> tuple[int, Ints]:
    """Halvings of the step of shared errors, and all numbers of the common errors."""
    stream = np.unpackbits(np.frombuffer(cursor.payload, np.uint8, cursor.end - cursor.position, cursor.position))
    if len(stream) < _PARAMETERS:
        raise CorruptPayload("content ends within the common errors")
    parameters = stream[:_PARAMETERS].reshape(-1, 4) @ _PLACES
    halvings = int(parameters[0])
    if halvings > MAX_HALVINGS:
        raise CorruptPayload(f"steps of shared errors halved {halvings} times")
    k = parameters[1:].take(GROUPS)
    written = k != EMPTY
    k = k[written]
    fixed_end = _PARAMETERS + int(k.sum())
    unary = bits.bits_to_unary(stream[fixed_end:], len(k))
    if unary is None:
        raise CorruptPayload("content ends within the common errors")
    quotients, unary_bits = unary
    used = fixed_end + unary_bits
    if stream[used : -(-used // 8) * 8].any():
        raise CorruptPayload("padding bits behind the common errors are not zero")
    lows = bits.windows(cursor.payload, cursor.position, _PARAMETERS, k)
    cursor.take(-(-used // 8))
    numbers = np.zeros(len(written), np.int64)
    numbers[written] = (quotients << k) + lows
    return halvings, numbers


def _plane_inverse_depth(camera: Camera, plane_per_m: list[float], uv_px: Array) -> Array:
    """What the plane predicts at pixels (2, N), rows u and v."""
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


def _decode_features(cursor: ByteCursor, camera: Camera, plane_per_m: list[float]) -> dict[str, Any]:
    n = cursor.take(1)[0]
    if not n:
        return {}
    base, *ks = cursor.unpack(_FEATURES)
    if max(ks) >= bits.MAX_WIDTH or base == 0:
        raise CorruptPayload(f"feature codes are {ks} bits wide, smallest sigma {base}")
    widths = [(camera.width_px * PIXEL_STEPS).bit_length(), *ks]
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
    predicted = _plane_inverse_depth(camera, plane_per_m, uv_px)
    inverse_depth = predicted + bits.unzigzag(residual) * (smallest / DEPTH_STEPS)
    if not np.isfinite(inverse_depth).all():
        raise CorruptPayload("the plane has no finite inverse depth at a feature")
    return {
        "uv_px": np.ascontiguousarray(uv_px.T),
        "inverse_depth_per_m": inverse_depth,
        "sigma_inverse_depth_per_m": smallest * np.exp(SIGMA_UNIT * SIGMA_STEPS * sigma_steps),
    }
