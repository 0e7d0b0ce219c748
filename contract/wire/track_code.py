"""A track's report as a small packet, at most 60 bytes. docs/wire-format.md, section 14."""

from __future__ import annotations

import math
import struct

from contract.answer import Ellipse, Place
from contract.errors import CorruptPayload, NewerPayload, TruncatedPayload
from contract.feature_set import Status
from contract.track import Course, TrackReport, TrackState, Unseen
from contract.wire.covariance_code import sigma_code, sigma_from_code
from contract.wire.small_packet import HEIGHT_STEP_M, first_byte, heights_of

MAJOR, MAX_TRACK_BYTES = 1, 60
KIND = MAJOR << 4 | 1
DEGREE, TIME_STEP_NS = 1e-9, 10_000
AGE_STEP_S, SPEED_STEP_M_S, ANGLE_STEP_DEG, PIXEL_STEP, SIZE_STEP = 0.1, 0.01, 360.0 / 65536.0, 1.0 / 8.0, 1.0 / 4.0
NO_COURSE = 0xFFFF  # in place of the sigma of a course: at rest
HAS_ELLIPSOID, HAS_AMSL, HAS_PLACE, HAS_SPEED, HAS_AGE = 1, 2, 4, 8, 16
_STATES, _UNSEEN, _STATUSES = tuple(TrackState), tuple(Unseen), tuple(Status)

# kind, number, state and unseen, flags, status, session, frame, time, u, v, size
_HEAD = struct.Struct("<BBBBBII6sHHB")
# latitude, longitude, height, undulation, axes, azimuth, sigma of the height
_PLACE = struct.Struct("<5s5si3sHHHH")
_SPEED = struct.Struct("<HHHH")


def encode_track(report: TrackReport) -> bytes:
    """24 bytes, 25 more with a place, 8 with a speed, 1 with an age. Raises ValueError for what has no encoding."""
    r, p = report, report.place
    age = min(round(r.unseen_s / AGE_STEP_S), 255)
    flags = (p is not None) * HAS_PLACE | (r.course is not None) * HAS_SPEED | (age > 0) * HAS_AGE
    if p is not None:
        flags |= (p.height_ellipsoid_m is not None) * HAS_ELLIPSOID | (p.height_amsl_m is not None) * HAS_AMSL
    try:
        pixels = [min(max(round((c + 0.5) / PIXEL_STEP), 0), 0xFFFF) for c in (r.u_px, r.v_px)]
        head = _HEAD.pack(
            KIND, r.number, _STATES.index(r.state) << 4 | _UNSEEN.index(r.unseen), flags, r.status.code, r.session,
            r.frame, round(r.capture_unix_ns / TIME_STEP_NS).to_bytes(6, "little"), *pixels,
            min(round(r.size_px / SIZE_STEP), 255),
        )  # fmt: skip
        parts = head, b"" if p is None else _place(p), b"" if r.course is None else _speed(r.course)
        return b"".join(parts) + (bytes([age]) if age else b"")
    except (struct.error, OverflowError, ValueError) as error:
        raise ValueError(f"track {r.number} has no encoding: {error}") from error


def decode_tracks(payload: bytes, vehicle: str = "") -> list[TrackReport]:
    """Decode a message: packets one after the other. Raises as `decode_track`."""
    out: list[TrackReport] = []
    while payload:
        length = _length(payload)
        out.append(decode_track(payload[:length], vehicle))
        payload = payload[length:]
    return out


def _length(payload: bytes) -> int:
    """The length of the packet that a message begins with, as far as its head can be read."""
    flags = payload[3] if len(payload) >= _HEAD.size else 0
    extra = bool(flags & HAS_PLACE) * _PLACE.size + bool(flags & HAS_SPEED) * _SPEED.size
    return _HEAD.size + extra + bool(flags & HAS_AGE)


def decode_track(payload: bytes, vehicle: str = "") -> TrackReport:
    """Raises TruncatedPayload, CorruptPayload or NewerPayload, and nothing else."""
    if (kind := first_byte(payload, "tracks", MAJOR)) != KIND & 15:
        raise CorruptPayload(f"tracks of kind {kind}")
    if len(payload) < _HEAD.size:
        raise TruncatedPayload(f"{len(payload)} bytes")
    _, number, state, flags, status, session, frame, time, u, v, size = _HEAD.unpack_from(payload)
    length = _length(payload)
    if len(payload) != length or flags > 31:
        raise (
            TruncatedPayload(f"{len(payload)} bytes of {length}") if len(payload) < length else CorruptPayload("flags")
        )
    if state >> 4 >= len(_STATES) or state & 15 >= len(_UNSEEN):
        raise CorruptPayload(f"state {state:#x}")
    if status >= len(_STATUSES):
        raise NewerPayload(f"status {status}")
    place = _read_place(payload, flags) if flags & HAS_PLACE else None
    age_s = payload[-1] * AGE_STEP_S if flags & HAS_AGE else 0.0
    tail = payload[:-1] if flags & HAS_AGE else payload
    return TrackReport(
        number, _STATES[state >> 4], _UNSEEN[state & 15], session, frame, int.from_bytes(time, "little") * TIME_STEP_NS,
        u * PIXEL_STEP - 0.5, v * PIXEL_STEP - 0.5, size * SIZE_STEP, _STATUSES[status], place,
        _read_speed(tail[-_SPEED.size :]) if flags & HAS_SPEED else None, vehicle, age_s,
    )  # fmt: skip


def _place(p: Place) -> bytes:
    known = p.height_ellipsoid_m if p.height_amsl_m is None else p.height_amsl_m
    undulation = 0.0
    if p.height_ellipsoid_m is not None and p.height_amsl_m is not None:
        undulation = p.height_ellipsoid_m - p.height_amsl_m
    e = p.ellipse
    return _PLACE.pack(
        round(p.lat_deg / DEGREE).to_bytes(5, "little", signed=True),
        round(p.lon_deg / DEGREE).to_bytes(5, "little", signed=True),
        round((known or 0.0) / HEIGHT_STEP_M),
        round(undulation / HEIGHT_STEP_M).to_bytes(3, "little", signed=True),
        sigma_code(e.semi_major_m),
        sigma_code(e.semi_minor_m),
        round(e.azimuth_deg / (0.5 * ANGLE_STEP_DEG)) % 65536,
        sigma_code(p.sigma_height_m),
    )


def _read_place(payload: bytes, flags: int) -> Place:
    lat, lon, height, undulation, major, minor, azimuth, sigma = _PLACE.unpack_from(payload, _HEAD.size)
    lat_deg, lon_deg = (int.from_bytes(part, "little", signed=True) * DEGREE for part in (lat, lon))
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
        raise CorruptPayload(f"a place at {lat_deg} {lon_deg}")
    amsl, ellipsoid = heights_of(height, undulation, (flags & HAS_AMSL) > 0, (flags & HAS_ELLIPSOID) > 0)
    ellipse = Ellipse(sigma_from_code(major), sigma_from_code(minor), azimuth * 0.5 * ANGLE_STEP_DEG)
    return Place(lat_deg, lon_deg, amsl, ellipsoid, ellipse, sigma_from_code(sigma))


def _speed(c: Course) -> bytes:
    if not (math.isfinite(c.speed_m_s) and c.speed_m_s >= 0.0):
        raise ValueError(f"a speed of {c.speed_m_s!r}")
    course, sigma = 0, NO_COURSE
    if c.course_deg is not None and c.sigma_course_deg is not None:
        course = round(c.course_deg / ANGLE_STEP_DEG) % 65536
        sigma = min(round(c.sigma_course_deg / ANGLE_STEP_DEG), NO_COURSE - 1)
    return _SPEED.pack(min(round(c.speed_m_s / SPEED_STEP_M_S), 0xFFFF), sigma_code(c.sigma_speed_m_s), course, sigma)


def _read_speed(payload: bytes) -> Course:
    speed, sigma_speed, course, sigma = _SPEED.unpack(payload)
    out = speed * SPEED_STEP_M_S, sigma_from_code(sigma_speed)
    return Course(*out) if sigma == NO_COURSE else Course(*out, course * ANGLE_STEP_DEG, sigma * ANGLE_STEP_DEG)
