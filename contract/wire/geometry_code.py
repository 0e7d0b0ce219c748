"""Pose, ground plane and rolling shutter <-> numbers and bytes: sections 4.1, 4.2 and 4.5 of docs/wire-format.md."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.errors import CorruptPayload
from contract.feature_set import FeatureSet
from contract.rolling_shutter import RollingShutter
from contract.rotations import exp_of_plain, log_of_one
from contract.wire.byte_cursor import ByteCursor
from contract.wire.covariance_code import sigma_code, sigma_from_code

Array = NDArray[np.float64]

DEGREE_STEPS = 10**9  # a degree
METRE_STEPS = 1000  # a metre
ROTATION_STEP = math.pi / (2**23 - 1)
RATE_STEPS = 2000  # a rad/s
VELOCITY_STEPS = 100  # a m/s
MAX_READOUT_S = 1.0

# Section 4.5: readout, its sigma, angular rate, velocity.
_SHUTTER = struct.Struct("<fH6h")


def pose_numbers(s: FeatureSet) -> list[float]:
    """The first numbers of the codec's `GEOMETRY`: whole numbers, those of 5 and 3 bytes in two parts, then the plane.

    Raises ValueError.
    """
    if not (abs(s.camera_lat_deg) <= 90.0 and abs(s.camera_lon_deg) <= 180.0):
        raise ValueError(f"camera position {s.camera_lat_deg!r}, {s.camera_lon_deg!r} is not a latitude and longitude")
    lat, lon = round(s.camera_lat_deg * DEGREE_STEPS), round(s.camera_lon_deg * DEGREE_STEPS)
    height = _metres("camera_height_m", s.camera_height_m, 4)
    undulation = 0 if math.isnan(s.undulation_m) else _metres("undulation_m", s.undulation_m, 3)
    x, y, z = _rotation_steps(np.asarray(s.R_enu_cam, float))
    plane = np.asarray(s.plane_per_m, float).tolist()
    if len(plane) != 3 or not all(abs(n) <= 3e38 for n in plane):
        raise ValueError(f"plane_per_m must be three finite numbers, not {plane}")
    return [
        lat & 0xFFFFFFFF, lat >> 32, lon & 0xFFFFFFFF, lon >> 32, height, undulation & 0xFFFF, undulation >> 16,
        x & 0xFFFF, x >> 16, y & 0xFFFF, y >> 16, z & 0xFFFF, z >> 16,
        *plane,
    ]  # fmt: skip


def pose_from_numbers(numbers: Sequence[Any], *, has_undulation: bool) -> dict[str, Any]:
    """Inverse of `pose_numbers`: fields of a FeatureSet. Raises CorruptPayload."""
    lat, lat_high, lon, lon_high, height, und, und_high, x, x_high, y, y_high, z, z_high, *plane = numbers
    steps = (x_high << 16) + x, (y_high << 16) + y, (z_high << 16) + z
    lat_deg, lon_deg = ((lat_high << 32) + lat) / DEGREE_STEPS, ((lon_high << 32) + lon) / DEGREE_STEPS
    if abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:
        raise CorruptPayload(f"camera position {lat_deg}, {lon_deg} is not a latitude and longitude")
    if math.hypot(*steps) * ROTATION_STEP > math.pi:
        raise CorruptPayload(f"rotation vector {steps} is longer than half a turn")
    if not all(map(math.isfinite, plane)):
        raise CorruptPayload("the ground plane is not finite")
    return {
        "camera_lat_deg": lat_deg,
        "camera_lon_deg": lon_deg,
        "camera_height_m": height / METRE_STEPS,
        "R_enu_cam": np.array(exp_of_plain(*(n * ROTATION_STEP for n in steps))),
        "plane_per_m": np.array(plane),
        "undulation_m": ((und_high << 16) + und) / METRE_STEPS if has_undulation else math.nan,
    }


def _metres(name: str, value: float, count: int) -> int:
    """`value` (m) in steps, as fits a signed integer of `count` bytes."""
    limit = 256**count // 2 - 1
    if not (math.isfinite(value) and abs(value) * METRE_STEPS < limit):
        raise ValueError(f"{name} must be within {limit / METRE_STEPS:.6g} either way, not {value!r}")
    return round(value * METRE_STEPS)


def _rotation_steps(R: Array) -> list[int]:
    """Rotation vector in steps, of length below pi so that its logarithm is itself again (section 4.2)."""
    rows = R.tolist()
    if R.shape != (3, 3) or not _is_rotation(rows):
        raise ValueError(f"R_enu_cam is not a rotation: {rows}")
    v = [x / ROTATION_STEP for x in log_of_one(rows)]
    limit = math.pi * (1.0 - 1e-9) / ROTATION_STEP
    steps = [round(x) for x in v]
    if math.hypot(*steps) > limit:
        steps = [int(x) for x in v]
    if math.hypot(*steps) > limit:
        longest = max(range(3), key=lambda i: abs(steps[i]))
        steps[longest] -= 1 if steps[longest] > 0 else -1
    return steps


def _is_rotation(rows: list[list[float]]) -> bool:
    """Return whether rows are of length one, at right angles to each other, and right-handed."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    off = (
        a * a + b * b + c * c - 1.0,
        d * d + e * e + f * f - 1.0,
        g * g + h * h + i * i - 1.0,
        a * d + b * e + c * f,
        a * g + b * h + c * i,
        d * g + e * h + f * i,
    )
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    return all(abs(x) < 1e-6 for x in off) and determinant > 0.0


def encode_shutter(shutter: RollingShutter) -> bytes:
    """Section 4.5. Raises ValueError."""
    if not abs(shutter.readout_s) <= MAX_READOUT_S:
        raise ValueError(f"readout_s must be within {MAX_READOUT_S:g} either way, not {shutter.readout_s!r}")
    steps = []
    for name, values, scale in (
        ("rate_cam_rad_s", shutter.rate_cam_rad_s, RATE_STEPS),
        ("velocity_cam_m_s", shutter.velocity_cam_m_s, VELOCITY_STEPS),
    ):
        numbers = np.asarray(values, float).tolist()
        if np.shape(numbers) != (3,) or not all(abs(x) * scale <= 32767.0 for x in numbers):
            raise ValueError(f"{name} must be three numbers within {32767 / scale:g} either way, not {numbers}")
        steps += [round(x * scale) for x in numbers]
    return _SHUTTER.pack(shutter.readout_s, sigma_code(shutter.sigma_readout_s, "sigma_readout_s"), *steps)


def decode_shutter(cursor: ByteCursor) -> RollingShutter:
    """Inverse of `encode_shutter`. Raises CorruptPayload."""
    readout_s, sigma, *steps = cursor.unpack(_SHUTTER)
    if not abs(readout_s) <= MAX_READOUT_S:
        raise CorruptPayload(f"a readout of {readout_s} s")
    rate, velocity = np.array(steps[:3]) / RATE_STEPS, np.array(steps[3:]) / VELOCITY_STEPS
    return RollingShutter(readout_s, rate, velocity, sigma_from_code(sigma))
