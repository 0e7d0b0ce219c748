"""FeatureSet <-> bytes. docs/wire-format.md is the specification; section numbers below are its own.

`encode` sorts features by quantised row; what `decode` returns encodes to the same bytes again.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.errors import CorruptPayload, NewerPayload, TruncatedPayload
from contract.feature_set import DepthSource, FeatureSet, HeightDatum, Status
from contract.rolling_shutter import RollingShutter
from contract.rotations import exp_so3, log_of_one
from contract.wire.byte_cursor import ByteCursor
from contract.wire.common_code import decode_common, encode_common
from contract.wire.covariance_code import sigma_code, sigma_from_code
from contract.wire.feature_code import decode_features, encode_features

Array = NDArray[np.float64]

MAGIC = b"PC"
MAJOR, MINOR = 2, 1
STATUSES_OF_FIRST = 16  # that version 2.0 knows; those after it are written as 2.1
# A set whose rows were not exposed at once: a reader that knows nothing of that would give wrong places, so it refuses.
ROLLING_MAJOR = 3
MAX_VEHICLE_BYTES = 32
# What a set is to take where that depends on the step of its shared errors: to so many features, and beyond.
MANY_FEATURES = 100
MOST_BYTES = 600
PACKET_BYTES = 1200

# Section 2: magic, version, length, flags, status, session, frame, revision, capture time, vehicle's length.
_HEAD = struct.Struct("<2sBHBBIIHQB")
_CAMERA = struct.Struct("<HH4f")
_DISTORTION = struct.Struct("<5f")
_NINE = struct.Struct("<9f")  # both: focal lengths, principal point, distortion
_CRC = struct.Struct("<I")
# Section 4: integers of 5, 4 and 3 bytes are written apart; then the plane, its spread and roughness.
_PLANE = struct.Struct("<3fHH")

_KEYFRAME, _ELLIPSOID, _UNDULATION, _DISTORTED, _GEOMETRY = 1, 2, 4, 8, 64
# Section 4.5: readout, its sigma, angular rate, velocity.
_SHUTTER = struct.Struct("<fH6h")
_SOURCE_SHIFT, _SOURCE_MASK = 4, 3
_SOURCES = tuple(DepthSource)
_STATUSES = tuple(Status)

DEGREE_STEPS = 10**9  # a degree
METRE_STEPS = 1000  # a metre
ROTATION_STEP = math.pi / (2**23 - 1)
RATE_STEPS = 2000  # a rad/s
VELOCITY_STEPS = 100  # a m/s
MAX_READOUT_S = 1.0


@dataclass(frozen=True)
class Identity:
    """Which set a payload is, read from its first bytes without decoding (and without checking) the rest."""

    session: int
    frame: int
    revision: int
    capture_unix_ns: int
    status: Status


def peek(payload: bytes) -> Identity:
    """The identity of a payload. Raises WireError as `decode` does, but checks nothing behind the head."""
    head = _read_head(payload)
    return Identity(head[5], head[6], head[7], head[8], _status(head[4]))


def encode(feature_set: FeatureSet) -> bytes:
    """A set's payload. Raises ValueError saying which field cannot be written and why.

    A set whose status is not OK travels without its pose and covariances; it must have no features.
    """
    s = feature_set
    vehicle = s.vehicle.encode()
    if not 1 <= len(vehicle) <= MAX_VEHICLE_BYTES:
        raise ValueError(f"vehicle name {s.vehicle!r} must take 1 to {MAX_VEHICLE_BYTES} UTF-8 bytes")
    for name, value, bytes_ in (
        ("session", s.session, 4),
        ("frame", s.frame, 4),
        ("revision", s.revision, 2),
        ("capture_unix_ns", s.capture_unix_ns, 8),
    ):
        if not 0 <= value < 256**bytes_:
            raise ValueError(f"{name} must be between 0 and {256**bytes_ - 1}, not {value}")
    camera = _rounded(s.camera)
    flags = _KEYFRAME * s.is_keyframe | _DISTORTED * any(camera.distortion)
    body = vehicle + _encode_camera(camera)
    if s.is_ok:
        flags |= _GEOMETRY | (_ELLIPSOID if s.height_datum is HeightDatum.ELLIPSOID else 0)
        flags |= _SOURCES.index(s.depth_source) << _SOURCE_SHIFT
        flags |= 0 if math.isnan(s.undulation_m) else _UNDULATION
        body += _encode_geometry(s) + (b"" if s.shutter is None else _encode_shutter(s.shutter))
        features = encode_features(s, camera)
        most = MOST_BYTES if len(s) <= MANY_FEATURES else PACKET_BYTES
        room = most - _HEAD.size - len(body) - len(features) - _CRC.size
        body += encode_common(s.common_cov, s.shared, room) + features
    elif len(s):
        raise ValueError(f"a set with status {s.status.value!r} carries no features, this one has {len(s)}")
    length = _HEAD.size + len(body) + _CRC.size
    is_rolling = s.is_ok and s.shutter is not None
    head = _HEAD.pack(
        MAGIC,
        ROLLING_MAJOR << 4 if is_rolling else MAJOR << 4 | (MINOR if s.status.code >= STATUSES_OF_FIRST else 0),
        length,
        flags,
        s.status.code,
        s.session,
        s.frame,
        s.revision,
        s.capture_unix_ns,
        len(vehicle),
    )
    return head + body + _CRC.pack(zlib.crc32(head + body))


def decode(payload: bytes) -> FeatureSet:
    """The set in a payload. Raises TruncatedPayload, CorruptPayload or NewerPayload, and nothing else."""
    head = _read_head(payload)
    _, version, length, flags, status_code, session, frame, revision, capture_unix_ns, vehicle_bytes = head
    if len(payload) < length:
        raise TruncatedPayload(f"payload has {len(payload)} of {length} bytes")
    if len(payload) > length:
        raise CorruptPayload(f"payload has {len(payload)} bytes where its header says {length}")
    if zlib.crc32(payload[: -_CRC.size]) != _CRC.unpack(payload[-_CRC.size :])[0]:
        raise CorruptPayload("checksum does not match")
    cursor = ByteCursor(payload, _HEAD.size, length - _CRC.size)
    try:
        vehicle = cursor.take(vehicle_bytes).decode()
    except UnicodeDecodeError as error:
        raise CorruptPayload(f"vehicle name is not UTF-8: {error}") from error
    if not 1 <= vehicle_bytes <= MAX_VEHICLE_BYTES:
        raise CorruptPayload(f"vehicle name of {vehicle_bytes} bytes")
    camera = _decode_camera(cursor, bool(flags & _DISTORTED))
    geometry: dict[str, Any] = {}
    if flags & _GEOMETRY:
        geometry = _decode_geometry(cursor, flags, is_rolling=version >> 4 == ROLLING_MAJOR)
        geometry |= decode_features(cursor, camera, geometry["plane_per_m"])
    if version & 15 <= (MINOR if version >> 4 == MAJOR else 0) and cursor.position != cursor.end:
        raise CorruptPayload(f"{cursor.end - cursor.position} bytes are left over")
    status = _status(status_code)
    if version >> 4 == ROLLING_MAJOR and not geometry:
        raise CorruptPayload("a refused set has no rows to tell apart")
    if (status is Status.OK) != bool(flags & _GEOMETRY):
        raise CorruptPayload(f"status {status.value!r} with{'' if geometry else 'out'} a pose")
    return FeatureSet(
        vehicle=vehicle,
        session=session,
        frame=frame,
        capture_unix_ns=capture_unix_ns,
        status=status,
        camera=camera,
        revision=revision,
        is_keyframe=bool(flags & _KEYFRAME),
        **geometry,
    )


def _read_head(payload: bytes) -> tuple[Any, ...]:
    if payload[:2] != MAGIC[: len(payload)]:
        raise CorruptPayload(f"payload starts with {payload[:2]!r}, not {MAGIC!r}")
    if len(payload) < 3:
        raise TruncatedPayload(f"payload has {len(payload)} bytes")
    if not MAJOR <= (major := payload[2] >> 4) <= ROLLING_MAJOR:
        read = f"payload has version {major}.{payload[2] & 15}, this program reads {MAJOR}.x and {ROLLING_MAJOR}.x"
        raise NewerPayload(f"{read}: update it") if major > MAJOR else CorruptPayload(read)
    if len(payload) < _HEAD.size:
        raise TruncatedPayload(f"payload has {len(payload)} bytes, its head alone takes {_HEAD.size}")
    head = _HEAD.unpack_from(payload)
    if head[2] < _HEAD.size + _CRC.size:
        raise CorruptPayload(f"payload says it is {head[2]} bytes long, which is less than its head")
    return head


def _status(code: int) -> Status:
    if code >= len(_STATUSES):
        raise NewerPayload(f"payload has status {code}, this program knows {len(_STATUSES)}: update it")
    return _STATUSES[code]


def _signed(name: str, value: float, steps: int, count: int) -> bytes:
    """`value` in so many steps a unit, as a signed integer of `count` bytes."""
    limit = 256**count // 2 - 1
    if not (math.isfinite(value) and abs(value) * steps < limit):
        raise ValueError(f"{name} must be within {limit / steps:.6g} either way, not {value!r}")
    return round(value * steps).to_bytes(count, "little", signed=True)


def _rounded(camera: Camera) -> Camera:
    """The camera as its receiver will know it. Raises ValueError if it is none."""
    if not (1 <= camera.width_px <= 65535 and 1 <= camera.height_px <= 65535):
        raise ValueError(f"picture size {camera.size_px} must be between 1 and 65535")
    numbers = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion)
    try:
        rounded = _NINE.unpack(_NINE.pack(*numbers))
    except OverflowError:
        rounded = (math.inf,)
    if not all(map(math.isfinite, rounded)) or min(rounded[:2]) <= 0.0:
        raise ValueError(f"intrinsics and distortion {numbers} must be finite, focal lengths positive")
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = rounded
    return Camera(camera.width_px, camera.height_px, fx, fy, cx, cy, (k1, k2, p1, p2, k3))


def _encode_camera(camera: Camera) -> bytes:
    out = _CAMERA.pack(camera.width_px, camera.height_px, camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
    return out + _DISTORTION.pack(*camera.distortion) if any(camera.distortion) else out


def _decode_camera(cursor: ByteCursor, distorted: bool) -> Camera:
    width, height, fx, fy, cx, cy = cursor.unpack(_CAMERA)
    k1, k2, p1, p2, k3 = cursor.unpack(_DISTORTION) if distorted else (0.0,) * 5
    if not (all(map(math.isfinite, (fx, fy, cx, cy, k1, k2, p1, p2, k3))) and min(width, height, fx, fy) > 0):
        raise CorruptPayload("intrinsics are not those of a camera")
    return Camera(width, height, fx, fy, cx, cy, (k1, k2, p1, p2, k3))


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
    """Whether rows are of length one, at right angles to each other, and right-handed."""
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


def _encode_geometry(s: FeatureSet) -> bytes:
    """All but the common errors."""
    if not (abs(s.camera_lat_deg) <= 90.0 and abs(s.camera_lon_deg) <= 180.0):
        raise ValueError(f"camera position {s.camera_lat_deg!r}, {s.camera_lon_deg!r} is not a latitude and longitude")
    parts = [
        _signed("camera_lat_deg", s.camera_lat_deg, DEGREE_STEPS, 5),
        _signed("camera_lon_deg", s.camera_lon_deg, DEGREE_STEPS, 5),
        _signed("camera_height_m", s.camera_height_m, METRE_STEPS, 4),
    ]
    if not math.isnan(s.undulation_m):
        parts.append(_signed("undulation_m", s.undulation_m, METRE_STEPS, 3))
    parts += [n.to_bytes(3, "little", signed=True) for n in _rotation_steps(np.asarray(s.R_enu_cam, float))]
    plane = np.asarray(s.plane_per_m, float).tolist()
    if np.shape(plane) != (3,) or not all(abs(x) <= 3e38 for x in plane):
        raise ValueError(f"plane_per_m must be three finite numbers, not {plane}")
    spread = sigma_code(s.plane_sigma_relative, "plane_sigma_relative")
    parts.append(_PLANE.pack(*plane, spread, sigma_code(s.roughness, "roughness")))
    return b"".join(parts)


def _encode_shutter(shutter: RollingShutter) -> bytes:
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


def _decode_shutter(cursor: ByteCursor) -> RollingShutter:
    readout_s, sigma, *steps = cursor.unpack(_SHUTTER)
    if not abs(readout_s) <= MAX_READOUT_S:
        raise CorruptPayload(f"a readout of {readout_s} s")
    rate, velocity = np.array(steps[:3]) / RATE_STEPS, np.array(steps[3:]) / VELOCITY_STEPS
    return RollingShutter(readout_s, rate, velocity, sigma_from_code(sigma))


def _decode_geometry(cursor: ByteCursor, flags: int, *, is_rolling: bool) -> dict[str, Any]:
    lat, lon = cursor.signed(5) / DEGREE_STEPS, cursor.signed(5) / DEGREE_STEPS
    if abs(lat) > 90.0 or abs(lon) > 180.0:
        raise CorruptPayload(f"camera position {lat}, {lon} is not a latitude and longitude")
    height = cursor.signed(4) / METRE_STEPS
    undulation = cursor.signed(3) / METRE_STEPS if flags & _UNDULATION else math.nan
    steps = [cursor.signed(3) for _ in range(3)]
    if math.hypot(*steps) * ROTATION_STEP > math.pi:
        raise CorruptPayload(f"rotation vector {steps} is longer than half a turn")
    *plane, spread, roughness = cursor.unpack(_PLANE)
    if not all(map(math.isfinite, plane)):
        raise CorruptPayload("the ground plane is not finite")
    source = flags >> _SOURCE_SHIFT & _SOURCE_MASK
    if source >= len(_SOURCES):
        raise CorruptPayload(f"depth source {source} means nothing")
    shutter = _decode_shutter(cursor) if is_rolling else None
    return {
        "camera_lat_deg": lat,
        "camera_lon_deg": lon,
        "camera_height_m": height,
        "height_datum": HeightDatum.ELLIPSOID if flags & _ELLIPSOID else HeightDatum.AMSL,
        "undulation_m": undulation,
        "R_enu_cam": exp_so3(np.array(steps, float) * ROTATION_STEP),
        "depth_source": _SOURCES[source],
        "plane_per_m": np.array(plane),
        "plane_sigma_relative": sigma_from_code(spread),
        "roughness": sigma_from_code(roughness),
        "shutter": shutter,
    } | decode_common(cursor)
