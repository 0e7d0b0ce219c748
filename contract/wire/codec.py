"""FeatureSet <-> bytes. docs/wire-format.md is the specification; section numbers below are its own.

`encode` writes version 4.0, of a fisheye 5.0, with a clicked pixel 4.1 and 5.1, with a swing 4.2 and 5.2, and sorts
features by row; what `decode` returns encodes to the same bytes again.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Any

from contract.camera import Camera
from contract.errors import CorruptPayload, NewerPayload, TruncatedPayload
from contract.feature_set import COMMON_STATES, DepthSource, FeatureSet, HeightDatum, Status
from contract.lens import FISHEYE, MODELS, PINHOLE
from contract.wire.byte_cursor import ByteCursor
from contract.wire.clicked_code import NO_PIXEL, decode_clicked, encode_clicked
from contract.wire.common_code import common_from_numbers, common_numbers, shared_codes, shared_from_codes
from contract.wire.covariance_code import sigma_code, sigma_from_code
from contract.wire.feature_code import feature_numbers, features_from_numbers
from contract.wire.geometry_code import decode_shutter, encode_shutter, pose_from_numbers, pose_numbers
from contract.wire.number_code import decode_numbers, encode_numbers
from contract.wire.swing_code import decode_swing, encode_swing

MAGIC = b"PC"
MAJORS = {PINHOLE: 4, FISHEYE: 5}  # a ground that knows no fisheye refuses its sets by their version
CLICKED_MINOR, SWING_MINOR = 1, 2  # the first that have these
MINOR = SWING_MINOR  # the newest that is read whole
MAX_VEHICLE_BYTES = 32

# Section 2: magic, version, length, flags, status, session, frame, revision, capture time, vehicle's length.
_HEAD = struct.Struct("<2sBHBBIIHQB")
_CAMERA = struct.Struct("<HH4f")
_CRC = struct.Struct("<I")
# Section 4: latitude, longitude, height, undulation, rotation; plane, its spread, roughness; sigmas of the fresh
# states; correlation times, alignment, span; number of features and their smallest sigma.
_GEOMETRY = struct.Struct(f"<IbIbiHb{3 * 'Hb'}3fHH{COMMON_STATES}H6H2hBH")
_POSE, _FRESH, _SHARED = 16, slice(18, 18 + COMMON_STATES), slice(18 + COMMON_STATES, -2)

_KEYFRAME, _ELLIPSOID, _UNDULATION, _DISTORTED, _POSED, _ROLLING = 1, 2, 4, 8, 64, 128
_SOURCE_SHIFT, _SOURCE_MASK = 4, 3
_SOURCES = tuple(DepthSource)
_STATUSES = tuple(Status)
_MODELS = {major: model for model, major in MAJORS.items()}


@dataclass(frozen=True)
class Identity:
    """The identity of a payload's set, read from its first bytes without decoding (and without checking) the rest."""

    vehicle: str
    session: int
    frame: int
    revision: int
    capture_unix_ns: int
    status: Status


def peek(payload: bytes) -> Identity:
    """The identity of a payload. Raises WireError as `decode` does, but checks nothing behind the vehicle's name."""
    head = _read_head(payload)
    vehicle = _vehicle(ByteCursor(payload, _HEAD.size, len(payload)), head[9])
    return Identity(vehicle, head[5], head[6], head[7], head[8], _status(head[4]))


def encode(feature_set: FeatureSet) -> bytes:
    """A set's payload. Raises ValueError that states which field cannot be written and why.

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
    body, minor, appended = vehicle + _encode_camera(camera), *_appended(s, camera)
    if s.is_ok:
        flags |= _POSED | (_ELLIPSOID if s.height_datum is HeightDatum.ELLIPSOID else 0)
        flags |= _SOURCES.index(s.depth_source) << _SOURCE_SHIFT
        flags |= 0 if math.isnan(s.undulation_m) else _UNDULATION
        flags |= 0 if s.shutter is None else _ROLLING
        body += _encode_geometry(s, camera) + appended
    elif appended:
        raise ValueError(f"a set with status {s.status.value!r} carries neither a clicked pixel nor a swing")
    elif len(s):
        raise ValueError(f"a set with status {s.status.value!r} carries no features, this one has {len(s)}")
    head = _HEAD.pack(
        MAGIC,
        MAJORS[camera.model] << 4 | minor,
        _HEAD.size + len(body) + _CRC.size,
        flags,
        s.status.code,
        s.session,
        s.frame,
        s.revision,
        s.capture_unix_ns,
        len(vehicle),
    )
    return head + body + _CRC.pack(zlib.crc32(head + body))


def _appended(s: FeatureSet, camera: Camera) -> tuple[int, bytes]:
    """The minor version that a set needs, and what it has behind its features. Sections 6.1 and 6.2"""
    clicked = b"" if s.clicked is None else encode_clicked(s.clicked, camera)
    if s.swing is None:
        return CLICKED_MINOR * bool(clicked), clicked
    return SWING_MINOR, (clicked or NO_PIXEL) + encode_swing(s.swing)


def decode(payload: bytes) -> FeatureSet:
    """The set in a payload. Raises TruncatedPayload, CorruptPayload or NewerPayload, and nothing else."""
    head = _read_head(payload)
    _, version, length, flags, status_code, session, frame, revision, capture_unix_ns, vehicle_bytes = head
    if len(payload) < length:
        raise TruncatedPayload(f"payload has {len(payload)} of {length} bytes")
    if len(payload) > length:
        raise CorruptPayload(f"payload has {len(payload)} bytes where its header states {length}")
    if zlib.crc32(payload[: -_CRC.size]) != _CRC.unpack(payload[-_CRC.size :])[0]:
        raise CorruptPayload("checksum does not match")
    cursor = ByteCursor(payload, _HEAD.size, length - _CRC.size)
    vehicle = _vehicle(cursor, vehicle_bytes)
    camera = _decode_camera(cursor, _MODELS[version >> 4], bool(flags & _DISTORTED))
    geometry = _decode_geometry(cursor, camera, flags) if flags & _POSED else {}
    clicked = decode_clicked(cursor, camera) if version & 15 >= CLICKED_MINOR and geometry else None
    swing = decode_swing(cursor) if version & 15 >= SWING_MINOR and geometry else None
    if version & 15 <= MINOR and cursor.position != cursor.end:
        raise CorruptPayload(f"{cursor.end - cursor.position} bytes are left over")
    status = _status(status_code)
    if (status is Status.OK) != bool(geometry):
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
        clicked=clicked,
        swing=swing,
        **geometry,
    )


def _read_head(payload: bytes) -> tuple[Any, ...]:
    if payload[:2] != MAGIC[: len(payload)]:
        raise CorruptPayload(f"payload starts with {payload[:2]!r}, not {MAGIC!r}")
    if len(payload) < 3:
        raise TruncatedPayload(f"payload has {len(payload)} bytes")
    if (major := payload[2] >> 4) not in _MODELS:
        known = " and ".join(f"{each}.x" for each in _MODELS)
        read = f"payload has version {major}.{payload[2] & 15}, this program reads {known}"
        raise NewerPayload(f"{read}: update it") if major > max(_MODELS) else CorruptPayload(read)
    if len(payload) < _HEAD.size:
        raise TruncatedPayload(f"payload has {len(payload)} bytes, its head alone takes {_HEAD.size}")
    head = _HEAD.unpack_from(payload)
    if head[2] < _HEAD.size + _CRC.size:
        raise CorruptPayload(f"payload states a length of {head[2]} bytes, which is less than its head")
    return head


def _vehicle(cursor: ByteCursor, vehicle_bytes: int) -> str:
    try:
        vehicle = cursor.take(vehicle_bytes).decode()
    except UnicodeDecodeError as error:
        raise CorruptPayload(f"vehicle name is not UTF-8: {error}") from error
    if not 1 <= vehicle_bytes <= MAX_VEHICLE_BYTES:
        raise CorruptPayload(f"vehicle name of {vehicle_bytes} bytes")
    return vehicle


def _status(code: int) -> Status:
    if code >= len(_STATUSES):
        raise NewerPayload(f"payload has status {code}, this program knows {len(_STATUSES)}: update it")
    return _STATUSES[code]


def _rounded(camera: Camera) -> Camera:
    """The camera as its receiver will decode it. Raises ValueError if it is none."""
    if not (1 <= camera.width_px <= 65535 and 1 <= camera.height_px <= 65535):
        raise ValueError(f"picture size {camera.size_px} must be between 1 and 65535")
    numbers = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion)
    try:
        rounded = struct.unpack(f"<{len(numbers)}f", struct.pack(f"<{len(numbers)}f", *numbers))
    except OverflowError:
        rounded = (math.inf,)
    if not all(map(math.isfinite, rounded)) or min(rounded[:2]) <= 0.0:
        raise ValueError(f"intrinsics and distortion {numbers} must be finite, focal lengths positive")
    fx, fy, cx, cy, *distortion = rounded
    return Camera(camera.width_px, camera.height_px, fx, fy, cx, cy, tuple(distortion), camera.model)


def _encode_camera(camera: Camera) -> bytes:
    out = _CAMERA.pack(camera.width_px, camera.height_px, camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
    return out + struct.pack(f"<{len(camera.distortion)}f", *camera.distortion) if any(camera.distortion) else out


def _decode_camera(cursor: ByteCursor, model: str, distorted: bool) -> Camera:
    width, height, fx, fy, cx, cy = cursor.unpack(_CAMERA)
    count = len(MODELS[model].names)
    distortion = cursor.unpack(struct.Struct(f"<{count}f")) if distorted else (0.0,) * count
    if not (all(map(math.isfinite, (fx, fy, cx, cy, *distortion))) and min(width, height, fx, fy) > 0):
        raise CorruptPayload("intrinsics are not those of a camera")
    return Camera(width, height, fx, fy, cx, cy, tuple(distortion), model)


def _encode_geometry(s: FeatureSet, camera: Camera) -> bytes:
    pose = pose_numbers(s)
    spread = sigma_code(s.plane_sigma_relative, "plane_sigma_relative"), sigma_code(s.roughness, "roughness")
    sigmas, common = common_numbers(s.common_cov, s.shared)
    base, columns = feature_numbers(s, camera)
    fixed = _GEOMETRY.pack(*pose, *spread, *sigmas, *shared_codes(s.shared), columns.shape[1], base)
    return fixed + (b"" if s.shutter is None else encode_shutter(s.shutter)) + encode_numbers(common, columns)


def _decode_geometry(cursor: ByteCursor, camera: Camera, flags: int) -> dict[str, Any]:
    """The fields of a FeatureSet behind its camera."""
    source = flags >> _SOURCE_SHIFT & _SOURCE_MASK
    if source >= len(_SOURCES):
        raise CorruptPayload(f"depth source {source} means nothing")
    out: dict[str, Any] = {
        "height_datum": HeightDatum.ELLIPSOID if flags & _ELLIPSOID else HeightDatum.AMSL,
        "depth_source": _SOURCES[source],
    }
    fixed = cursor.unpack(_GEOMETRY)
    spread, roughness = fixed[_POSE : _POSE + 2]
    count, base = fixed[-2:]
    out |= pose_from_numbers(fixed[:_POSE], has_undulation=bool(flags & _UNDULATION))
    out["plane_sigma_relative"], out["roughness"] = sigma_from_code(spread), sigma_from_code(roughness)
    out["shutter"] = decode_shutter(cursor) if flags & _ROLLING else None
    numbers, columns = decode_numbers(cursor, count)
    common = common_from_numbers(list(fixed[_FRESH]), numbers)
    out |= shared_from_codes(common.pop("by_nuisance"), fixed[_SHARED]) | common
    if count:
        out |= features_from_numbers(camera, list(fixed[_POSE - 3 : _POSE]), base, columns)
    elif base:
        raise CorruptPayload("a smallest sigma of no features")
    return out
