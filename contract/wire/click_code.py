"""A click and its answer, a small packet each, for links that carry no sets. docs/wire-format.md, section 13.

A question has 20 bytes, an answer at most 63: both go into a MAVLink TUNNEL, whose checksum covers them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from contract.answer import CHI2_2, Answer, Ellipse, Fix, Refusal
from contract.errors import CorruptPayload, NewerPayload, TruncatedPayload
from contract.feature_set import DepthSource, Measured, Status
from contract.wire.covariance_code import sigma_code, sigma_from_code
from contract.wire.small_packet import first_byte

TUNNEL_TYPE = 40_101  # MAVLink TUNNEL's payload_type; those from 32768 on are free
MAX_QUESTION_BYTES, MAX_ANSWER_BYTES, MAX_REFUSAL_BYTES = 24, 63, 60
MAJOR = 1
QUESTION, FIX, REFUSAL, TURNED_AWAY = 1, 2, 3, 4
NEWEST, BY_FRAME, BY_TIME = 0, 1, 2
MAX_NAME_BYTES = 8
MAX_NUMBER = 0xFFFF
NO_FRAME, NO_AGE = 0xFFFFFF, 0xFFFF
AGE_STEP_S, TIME_STEP_NS, OFFSET_STEP_M = 0.01, 10_000, 0.01
ANGLE_STEP_DEG, HEIGHT_STEP_M, DEGREE = 180.0 / 65536.0, 0.001, 1e-9
SHARE_STEP = 1.0 / 127.0  # of a correlation
_SCALE = math.sqrt(CHI2_2)  # an ellipse's axis, in sigmas
_METHODS = *(source.value for source in DepthSource), Measured.MEASURED.value
NO_HEIGHT, ABOVE_STEP_M = -0x8000, 0.1
_HAS_ELLIPSOID, _HAS_AMSL = 1, 2
_STATUSES = tuple(Status)

_QUESTION = struct.Struct("<BHBqff")
_TURNED_AWAY = struct.Struct("<BHBB")
_HEAD = struct.Struct("<BHB3s6sH")  # kind, number, status or flags, frame, time, age
_FIX = struct.Struct("<5s5si3sHHHHbb3s3s3s")
_ABOVE = struct.Struct("<hH")  # of what was measured by itself: height above the ground and its sigma


@dataclass(frozen=True)
class ClickQuestion:
    """A click that asks for its answer: pixel, and the picture by its number, its time, or (neither) the newest. The
    click was made `waited_s` ago, and means the picture of then.

    `number` is the ground's own, 0 to 65535: a question that is sent again has the same, and so has its answer.
    """

    number: int
    u_px: float
    v_px: float
    frame: int | None = None
    capture_unix_ns: int | None = None
    waited_s: float = 0.0


@dataclass(frozen=True, eq=False)
class ClickAnswer:
    """The answer to question `number`. Its age is the picture's when the click was made, but for the question's way."""

    number: int
    answer: Answer


@dataclass(frozen=True)
class TurnedAway:
    """The aircraft does not speak to this ground: its MAVLink system number is one of the autopilot's ground stations.

    Their range is `low` to `high`. What a ground sends under such a number hides from the autopilot that it has lost
    its ground station.
    """

    number: int
    low: int
    high: int


def encode_question(question: ClickQuestion) -> bytes:
    """20 bytes. Raises ValueError for numbers that are not finite or out of range."""
    q = question
    if not (math.isfinite(q.u_px) and math.isfinite(q.v_px)):
        raise ValueError(f"a pixel of {q.u_px!r}, {q.v_px!r}")
    which, value = NEWEST, round(q.waited_s * 1000.0)
    if q.frame is not None:
        which, value = BY_FRAME, q.frame
    elif q.capture_unix_ns is not None:
        which, value = BY_TIME, q.capture_unix_ns
    try:
        return _QUESTION.pack(MAJOR << 4 | QUESTION, q.number, which, value, q.u_px, q.v_px)
    except (struct.error, OverflowError) as error:
        raise ValueError(f"{q}: {error}") from error


def encode_answer(reply: ClickAnswer | TurnedAway) -> bytes:
    """Encode in at most 63 bytes; a vehicle's name is cut at 8, a reason where the packet ends. Raises ValueError."""
    if isinstance(reply, TurnedAway):
        return _TURNED_AWAY.pack(MAJOR << 4 | TURNED_AWAY, reply.number, reply.low, reply.high)
    a = reply.answer
    name = cut_name(a.vehicle or "").encode()
    if isinstance(a, Refusal):
        head = _head(REFUSAL, reply.number, a.status.code, a)
        text = _cut(a.detail, MAX_REFUSAL_BYTES - len(head) - 1 - len(name))
        return head + bytes([len(name)]) + name + text
    flags = _METHODS.index(a.method) << 2
    flags |= (a.height_ellipsoid_m is not None) * _HAS_ELLIPSOID | (a.height_amsl_m is not None) * _HAS_AMSL
    above = _above_ground(a) if a.method == Measured.MEASURED.value else b""
    return _head(FIX, reply.number, flags, a) + _place(a) + above + name


def turned_away(payload: bytes) -> TurnedAway | None:
    """A refusal to speak to this ground, whatever it was the answer to; None for all else."""
    if len(payload) != _TURNED_AWAY.size or payload[0] != MAJOR << 4 | TURNED_AWAY:
        return None
    return TurnedAway(*_TURNED_AWAY.unpack(payload)[1:])


def decode(payload: bytes) -> ClickQuestion | ClickAnswer | TurnedAway:
    """A packet of either way. Raises TruncatedPayload, CorruptPayload or NewerPayload, and nothing else."""
    if (kind := first_byte(payload, "clicks", MAJOR)) not in _READERS:
        raise CorruptPayload(f"clicks of kind {kind}")
    try:
        return _READERS[kind](payload)
    except struct.error as error:
        raise TruncatedPayload(f"{len(payload)} bytes: {error}") from error


def cut_name(vehicle: str) -> str:
    """A vehicle's name as far as an answer holds it."""
    return _cut(vehicle, MAX_NAME_BYTES).decode()


def _cut(text: str, most: int) -> bytes:
    """Return the first whole characters that fit into `most` bytes, UTF-8."""
    return text.encode()[:most].decode(errors="ignore").encode()


def _head(kind: int, number: int, code: int, a: Answer) -> bytes:
    frame = NO_FRAME if a.frame is None else min(a.frame, NO_FRAME - 1)
    time = 0 if a.capture_unix_ns is None else round(a.capture_unix_ns / TIME_STEP_NS)
    age = NO_AGE if a.age_s is None else min(round(a.age_s / AGE_STEP_S), NO_AGE - 1)
    try:
        return _HEAD.pack(MAJOR << 4 | kind, number, code, _int(frame, 3), _int(time, 6), max(age, 0))
    except (struct.error, OverflowError) as error:
        raise ValueError(f"frame {a.frame}, time {a.capture_unix_ns}: {error}") from error


def _place(a: Fix) -> bytes:
    """Position, heights, errors and the way from the camera."""
    known = a.height_ellipsoid_m if a.height_amsl_m is None else a.height_amsl_m
    both = a.height_ellipsoid_m is not None and a.height_amsl_m is not None
    undulation = a.height_ellipsoid_m - a.height_amsl_m if both else 0.0  # type: ignore[operator]
    e, offset = a.ellipse, (round(float(c) / OFFSET_STEP_M) for c in a.offset_enu_m)
    try:
        return _FIX.pack(
            _int(round(a.lat_deg / DEGREE), 5, signed=True),
            _int(round(a.lon_deg / DEGREE), 5, signed=True),
            round((known or 0.0) / HEIGHT_STEP_M),
            _int(round(undulation / HEIGHT_STEP_M), 3, signed=True),
            sigma_code(e.semi_major_m),
            sigma_code(e.semi_minor_m),
            round(e.azimuth_deg / ANGLE_STEP_DEG) % 65536,
            sigma_code(a.sigma_height_m),
            *_height_shares(a),
            *(_int(c, 3, signed=True) for c in offset),
        )
    except (struct.error, OverflowError) as error:
        raise ValueError(f"an answer that has no encoding: {error}") from error


def _above_ground(a: Fix) -> bytes:
    if a.above_ground_m is None or a.sigma_above_ground_m is None or abs(a.above_ground_m) > 3000.0:
        return _ABOVE.pack(NO_HEIGHT, 0)
    return _ABOVE.pack(round(a.above_ground_m / ABOVE_STEP_M), sigma_code(a.sigma_above_ground_m))


def _height_shares(a: Fix) -> tuple[int, int]:
    """Correlations of the height with both axes, towards zero: together at most 1."""
    vertical = a.ellipse.axes_en @ a.covariance_enu_m2[:2, 2]
    sigmas = np.array([a.ellipse.semi_major_m, a.ellipse.semi_minor_m]) / _SCALE * a.sigma_height_m
    shares = np.divide(vertical, sigmas, out=np.zeros(2), where=sigmas > 0.0)
    # The least more, so that what was decoded is written as the same again.
    major, minor = (int(share) for share in np.clip(shares, -1.0, 1.0) / SHARE_STEP * (1.0 + 1e-9))
    return major, minor


def _int(value: int, size: int, *, signed: bool = False) -> bytes:
    return value.to_bytes(size, "little", signed=signed)


def _whole(data: bytes, *, signed: bool = False) -> int:
    return int.from_bytes(data, "little", signed=signed)


def _read_question(payload: bytes) -> ClickQuestion:
    _, number, which, value, u_px, v_px = _QUESTION.unpack(payload)
    if which > BY_TIME or value < 0 or not (math.isfinite(u_px) and math.isfinite(v_px)):
        raise CorruptPayload(f"question {number} for {u_px!r}, {v_px!r} of kind {which}")
    frame, time_ns = (value if which == kind else None for kind in (BY_FRAME, BY_TIME))
    return ClickQuestion(number, u_px, v_px, frame, time_ns, value / 1000.0 if which == NEWEST else 0.0)


def _read_turned_away(payload: bytes) -> TurnedAway:
    _, number, low, high = _TURNED_AWAY.unpack(payload)
    return TurnedAway(number, low, high)


def _read_head(payload: bytes) -> tuple[int, int, int | None, int | None, float | None]:
    """Number, status or flags, frame, time (ns), age (s)."""
    _, number, code, frame, time, age = _HEAD.unpack_from(payload)
    frame, time = _whole(frame), _whole(time)
    return (
        number,
        code,
        None if frame == NO_FRAME else frame,
        None if time == 0 else time * TIME_STEP_NS,
        None if age == NO_AGE else age * AGE_STEP_S,
    )


def _read_refusal(payload: bytes) -> ClickAnswer:
    number, code, frame, time_ns, age_s = _read_head(payload)
    if len(payload) <= _HEAD.size:
        raise TruncatedPayload(f"a refusal of {len(payload)} bytes")
    if code >= len(_STATUSES):
        raise NewerPayload(f"status {code} is not known to this program")
    name, rest = payload[_HEAD.size + 1 :][: payload[_HEAD.size]], payload[_HEAD.size + 1 + payload[_HEAD.size] :]
    status = _STATUSES[code]
    if status is Status.OK:
        raise CorruptPayload("a refusal with status ok")
    return ClickAnswer(number, Refusal(status, frame, time_ns, _text(name) or None, _text(rest), age_s))


def _read_fix(payload: bytes) -> ClickAnswer:
    number, flags, frame, time_ns, age_s = _read_head(payload)
    lat, lon, height, undulation, major, minor, azimuth, up, r_major, r_minor, *offset = _FIX.unpack_from(
        payload, _HEAD.size
    )
    lat_deg, lon_deg = _whole(lat, signed=True) * DEGREE, _whole(lon, signed=True) * DEGREE
    is_on_earth = abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0
    method = flags >> 2
    heights = flags & (_HAS_ELLIPSOID | _HAS_AMSL)
    shares = np.array([r_major, r_minor]) * SHARE_STEP
    if not is_on_earth or frame is None or time_ns is None or method >= len(_METHODS) or not heights:
        raise CorruptPayload(f"an answer at {lat_deg}, {lon_deg} with flags {flags}")
    if shares @ shares > 1.0 + 2.0 * SHARE_STEP:
        raise CorruptPayload(f"correlations of {shares}")
    known_m, undulation_m = height * HEIGHT_STEP_M, _whole(undulation, signed=True) * HEIGHT_STEP_M
    is_amsl = bool(heights & _HAS_AMSL)
    ellipsoid_m = known_m + undulation_m if is_amsl else known_m
    ellipse = Ellipse(sigma_from_code(major), sigma_from_code(minor), azimuth * ANGLE_STEP_DEG)
    sigma_height_m = sigma_from_code(up)
    rest, above, sigma_above = payload[_HEAD.size + _FIX.size :], NO_HEIGHT, 0
    if _METHODS[method] == Measured.MEASURED.value:
        above, sigma_above = _ABOVE.unpack_from(rest)
        rest = rest[_ABOVE.size :]
    has_above = above != NO_HEIGHT
    fix = Fix(
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        height_ellipsoid_m=ellipsoid_m if heights & _HAS_ELLIPSOID else None,
        height_amsl_m=known_m if is_amsl else None,
        ellipse=ellipse,
        sigma_height_m=sigma_height_m,
        method=_METHODS[method],
        frame=frame,
        capture_unix_ns=time_ns,
        vehicle=_text(rest),
        offset_enu_m=np.array([_whole(c, signed=True) * OFFSET_STEP_M for c in offset]),
        covariance_enu_m2=_covariance(ellipse, sigma_height_m, shares),
        age_s=age_s,
        above_ground_m=above * ABOVE_STEP_M if has_above else None,
        sigma_above_ground_m=sigma_from_code(sigma_above) if has_above else None,
    )
    return ClickAnswer(number, fix)


def _covariance(ellipse: Ellipse, sigma_height_m: float, shares: np.ndarray) -> np.ndarray:
    """(3, 3), m^2, in east, north, up."""
    axes = ellipse.axes_en
    sigmas = np.array([ellipse.semi_major_m, ellipse.semi_minor_m]) / _SCALE
    out = np.zeros((3, 3))
    out[:2, :2] = axes.T @ np.diag(sigmas**2) @ axes
    out[:2, 2] = out[2, :2] = axes.T @ (shares * sigmas * sigma_height_m)
    out[2, 2] = sigma_height_m**2
    return out


def _text(data: bytes) -> str:
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        raise CorruptPayload(f"text is not UTF-8: {error}") from error
    return "".join(c for c in text if c.isprintable())


_READERS: dict[int, Callable[[bytes], ClickQuestion | ClickAnswer | TurnedAway]] = {
    QUESTION: _read_question,
    FIX: _read_fix,
    REFUSAL: _read_refusal,
    TURNED_AWAY: _read_turned_away,
}
