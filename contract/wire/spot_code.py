"""All spots of a picture as one small packet, at most 200 bytes whatever is in it. docs/wire-format.md, section 15."""

from __future__ import annotations

import math
import struct
from dataclasses import replace

from contract.answer import Ellipse, Place
from contract.errors import CorruptPayload, NewerPayload, TruncatedPayload
from contract.feature_set import Status
from contract.spot import MOST_SPOTS, PERSON_GRID, Spot, SpotReport, ThingKind
from contract.wire.byte_cursor import ByteCursor
from contract.wire.outlines import fitted
from contract.wire.small_packet import HEIGHT_STEP_M, first_byte, heights_of

MAJOR, OLDEST, MAX_SPOT_BYTES = 2, 1, 200  # of version 2 are packets that state who would have been named
KIND = 1
IS_CALIBRATED, HAS_PLACES, HAS_ELLIPSOID, HAS_AMSL, HAS_KINDS, HAS_PERSON, HAS_PARTS = 1, 2, 4, 8, 16, 32, 64
IS_COLD, IS_CUT, STATUS_MASK = 0x40, 0x80, 0x3F
DEGREE, TIME_STEP_NS, PIXEL_STEP, SHARE_STEP = 1e-9, 10_000, 1.0 / 8.0, 1.0 / 255.0
TEMPERATURE_STEP_C, ANGLE_STEP_DEG = 0.05, 180.0 / 256.0
OFFSET_STEP_DEG, SPOT_HEIGHT_STEP_M, OUTLINE_STEP_M = 1e-7, 0.1, 0.01
LOG_ODDS_STEP = 1.0 / 8.0
PARTS = PERSON_GRID[0] * PERSON_GRID[1]  # an even number: two to a byte
NO_GROUND = 15
PART_STEP = 1.0 / (NO_GROUND - 1)
AREA_SHARE_STEP = 1.0 / 64.0  # of an area's sigma, as a share of the area
# Lengths, contrasts, differences of temperature and areas in one byte: natural logarithm of a step, and what code 1 is.
LENGTH, CONTRAST, KELVIN, AREA = (0.055, 0.01), (0.03, 0.5), (0.04, 0.05), (0.08, 0.01)
MOST_EXPONENT = 31
_STATUSES, _KINDS = tuple(Status), tuple(ThingKind)

# kind, flags, session, frame, time, spots, more, shares of picture and session
_HEAD = struct.Struct("<BBII6sBBBB")
_REFERENCE = struct.Struct("<5s5si3sB")  # latitude, longitude, height, undulation, exponent of the offsets' step
_SPOT = struct.Struct("<BHHB")  # status and flags, u, v, contrast
_TEMPERATURE = struct.Struct("<hB")  # and how far from its ground's
_KIND = struct.Struct("<Bb")  # 0: only hot, else 1 more than its place in ThingKind; log odds
# latitude, longitude and height from the reference; axes, azimuth, sigma of the height, area, its sigma; points
_PLACE = struct.Struct("<hhhBBBBBBB")


def encode_spots(report: SpotReport) -> bytes:
    """20 to 200 bytes: at most MOST_SPOTS spots, whose outlines share what is left. Raises ValueError."""
    r, kept = report, report.spots[:MOST_SPOTS]
    placed = [spot.place for spot in kept if spot.place is not None]
    has_kinds = any(spot.kind is not None for spot in kept)
    flags = r.is_calibrated * IS_CALIBRATED | bool(placed) * HAS_PLACES | has_kinds * HAS_KINDS
    has_person = r.person_found is not None
    flags |= has_person * HAS_PARTS
    try:
        body = _person(r.person_found, r.person_named)
        if placed:
            first = placed[0]
            flags |= (first.height_ellipsoid_m is not None) * HAS_ELLIPSOID
            flags |= (first.height_amsl_m is not None) * HAS_AMSL
            exponent = _exponent(placed)
            body += _reference(first, exponent)
            step = OFFSET_STEP_DEG * 2.0**exponent
        more = min(max(r.more + len(r.spots) - len(kept), 0), 255)
        kind = (MAJOR if has_person else OLDEST) << 4 | KIND
        head = _HEAD.pack(
            kind, flags, r.session, r.frame, round(r.capture_unix_ns / TIME_STEP_NS).to_bytes(6, "little"), len(kept),
            more, _share(r.picture_share), _share(r.session_share),
        )  # fmt: skip
        parts = [_spot(spot, r.is_calibrated) + (_kind(spot) if has_kinds else b"") for spot in kept]
        size = len(head) + len(body) + sum(map(len, parts)) + _PLACE.size * len(placed)
        outlines = fitted([spot.outline_en_m if spot.place else () for spot in kept], MAX_SPOT_BYTES - size)
        for spot, part, outline in zip(kept, parts, outlines, strict=True):
            body += part
            if spot.place is not None:
                body += _place(spot, spot.place, placed[0], step, len(outline)) + _outline(outline)
        return head + body
    except (struct.error, OverflowError, ValueError) as error:
        raise ValueError(f"spots of frame {r.frame} have no encoding: {error}") from error


def decode_spots(payload: bytes, vehicle: str = "") -> SpotReport:
    """Raises TruncatedPayload, CorruptPayload or NewerPayload, and nothing else."""
    if (kind := first_byte(payload, "spots", MAJOR, OLDEST)) != KIND:
        raise CorruptPayload(f"spots of kind {kind}")
    if len(payload) < _HEAD.size:
        raise TruncatedPayload(f"{len(payload)} bytes")
    _, flags, session, frame, time, count, more, *shares = _HEAD.unpack_from(payload)
    if flags > 127 or count > MOST_SPOTS or len(payload) > MAX_SPOT_BYTES:
        raise CorruptPayload(f"{count} spots with flags {flags:#x} in {len(payload)} bytes")
    cursor = ByteCursor(payload, _HEAD.size, len(payload))
    found, named = _read_person(cursor, flags, payload[0] >> 4)
    reference, step = _read_reference(cursor, flags) if flags & HAS_PLACES else (None, 0.0)
    spots = tuple(_read_spot(cursor, flags, reference, step) for _ in range(count))
    if cursor.position != len(payload):
        raise CorruptPayload(f"{len(payload) - cursor.position} bytes too many")
    return SpotReport(
        session, frame, int.from_bytes(time, "little") * TIME_STEP_NS, bool(flags & IS_CALIBRATED), spots, more,
        shares[0] * SHARE_STEP, shares[1] * SHARE_STEP, vehicle, found, named,
    )  # fmt: skip


def _share(share: float) -> int:
    """0 to 255."""
    return round(min(max(share, 0.0), 1.0) / SHARE_STEP)


def _person(found: float | None, named: tuple[float | None, ...]) -> bytes:
    """A byte for the picture, and half a byte for each part of it, the first in the low half. Raises ValueError."""
    if len(named) != (0 if found is None else PARTS):
        raise ValueError(f"{len(named)} parts of a picture, not {PARTS}, or none where nothing is known of a person")
    if found is None:
        return b""
    codes = [NO_GROUND if p is None else round(min(max(p, 0.0), 1.0) / PART_STEP) for p in named]
    return bytes([_share(found), *(low | high << 4 for low, high in zip(codes[::2], codes[1::2], strict=True))])


def _read_person(cursor: ByteCursor, flags: int, version: int) -> tuple[float | None, tuple[float | None, ...]]:
    """Read on which share of the picture a person is found, and of its parts who has been named: `person_found` and
    `person_named`. Packets of version 1 state the first alone, in one byte or by parts.
    """
    one = cursor.take(1)[0] * SHARE_STEP if flags & HAS_PERSON or (version > 1 and flags & HAS_PARTS) else None
    if not flags & HAS_PARTS:
        return one, ()
    codes = [code for byte in cursor.take(PARTS // 2) for code in (byte & 15, byte >> 4)]
    parts = tuple(None if code == NO_GROUND else code * PART_STEP for code in codes)
    if version > 1:
        return one, parts
    known = [share for share in parts if share is not None]
    return (sum(known) / len(known) if known else None), ()


def _code(value: float, scale: tuple[float, float]) -> int:
    """1 to 255; 0 for 0."""
    if not (math.isfinite(value) and value >= 0.0):
        raise ValueError(f"{value!r} where a figure of 0 or more is expected")
    unit, first = scale
    return min(max(1 + round(math.log(value / first) / unit), 1), 255) if value > 0.0 else 0


def _from_code(code: int, scale: tuple[float, float]) -> float:
    unit, first = scale
    return first * math.exp(unit * (code - 1)) if code else 0.0


def _exponent(placed: list[Place]) -> int:
    """The least power of two of the step with which all places reach the first."""
    far = max(max(abs(p.lat_deg - placed[0].lat_deg), abs(_wrapped(p.lon_deg - placed[0].lon_deg))) for p in placed)
    if not math.isfinite(far):
        raise ValueError("a place that is not a number")
    return max(math.ceil(math.log2(max(far / OFFSET_STEP_DEG, 1.0) / 32767.0)), 0)


def _known(p: Place) -> float:
    """Height above mean sea level, else above the ellipsoid."""
    return (p.height_ellipsoid_m if p.height_amsl_m is None else p.height_amsl_m) or 0.0


def _reference(p: Place, exponent: int) -> bytes:
    undulation = 0.0
    if p.height_ellipsoid_m is not None and p.height_amsl_m is not None:
        undulation = p.height_ellipsoid_m - p.height_amsl_m
    return _REFERENCE.pack(
        round(p.lat_deg / DEGREE).to_bytes(5, "little", signed=True),
        round(p.lon_deg / DEGREE).to_bytes(5, "little", signed=True),
        round(_known(p) / HEIGHT_STEP_M),
        round(undulation / HEIGHT_STEP_M).to_bytes(3, "little", signed=True),
        exponent,
    )


def _read_reference(cursor: ByteCursor, flags: int) -> tuple[Place, float]:
    """Read the place that the spots' offsets count from, and the offsets' step, degrees. Raises CorruptPayload."""
    lat, lon, height, undulation, exponent = cursor.unpack(_REFERENCE)
    lat_deg, lon_deg = (int.from_bytes(part, "little", signed=True) * DEGREE for part in (lat, lon))
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0 and exponent <= MOST_EXPONENT):
        raise CorruptPayload(f"places from {lat_deg} {lon_deg} in steps of 2^{exponent}")
    amsl, ellipsoid = heights_of(height, undulation, (flags & HAS_AMSL) > 0, (flags & HAS_ELLIPSOID) > 0)
    return Place(lat_deg, lon_deg, amsl, ellipsoid, Ellipse(0.0, 0.0, 0.0), 0.0), OFFSET_STEP_DEG * 2.0**exponent


def _spot(spot: Spot, is_calibrated: bool) -> bytes:
    status = Status.OK if spot.place is not None else spot.status
    if spot.place is None and status is Status.OK:
        raise ValueError("a spot with status ok and without a place")
    flags = (spot.contrast < 0.0) * IS_COLD | spot.is_cut * IS_CUT
    pixels = [min(max(round((c + 0.5) / PIXEL_STEP), 0), 0xFFFF) for c in (spot.u_px, spot.v_px)]
    out = _SPOT.pack(status.code | flags, *pixels, _code(abs(spot.contrast), CONTRAST))
    if not is_calibrated:
        return out
    if spot.temperature_c is None or spot.above_ground_k is None:
        raise ValueError("a spot of a calibrated camera without a temperature")
    temperature = min(max(round(spot.temperature_c / TEMPERATURE_STEP_C), -32768), 32767)
    return out + _TEMPERATURE.pack(temperature, _code(abs(spot.above_ground_k), KELVIN))


def _kind(spot: Spot) -> bytes:
    if spot.kind is None:
        return _KIND.pack(0, 0)
    most = 127 * LOG_ODDS_STEP
    return _KIND.pack(1 + _KINDS.index(spot.kind), round(min(max(spot.log_odds, -most), most) / LOG_ODDS_STEP))


def _read_kind(cursor: ByteCursor) -> tuple[ThingKind | None, float]:
    """Read what a net takes a spot for, and its log odds. Raises CorruptPayload and NewerPayload."""
    number, steps = cursor.unpack(_KIND)
    if number > len(_KINDS):
        raise NewerPayload(f"a thing of kind {number}")
    if (number == 0 and steps != 0) or steps == -128:
        raise CorruptPayload(f"odds {steps} of a thing of kind {number}")
    return (None if number == 0 else _KINDS[number - 1]), steps * LOG_ODDS_STEP


def _place(spot: Spot, p: Place, reference: Place, step: float, points: int) -> bytes:
    e, height = p.ellipse, round((_known(p) - _known(reference)) / SPOT_HEIGHT_STEP_M)
    share = spot.sigma_area_m2 / spot.area_m2 / AREA_SHARE_STEP if spot.area_m2 > 0.0 else 0.0
    return _PLACE.pack(
        round((p.lat_deg - reference.lat_deg) / step), round(_wrapped(p.lon_deg - reference.lon_deg) / step),
        min(max(height, -32768), 32767), _code(e.semi_major_m, LENGTH), _code(e.semi_minor_m, LENGTH),
        round(e.azimuth_deg / ANGLE_STEP_DEG) % 256, _code(p.sigma_height_m, LENGTH), _code(spot.area_m2, AREA),
        min(round(share), 255), points,
    )  # fmt: skip


def _outline(points: tuple[tuple[float, float], ...]) -> bytes:
    if not points:
        return b""
    far = max(max(abs(east), abs(north)) for east, north in points)
    # Powers of the root of two, so that what was decoded is written as the same again.
    exponent = max(math.ceil(2.0 * math.log2(max(far, OUTLINE_STEP_M) / (127.0 * OUTLINE_STEP_M))), 0)
    step = OUTLINE_STEP_M * math.sqrt(2.0**exponent)
    return bytes([exponent]) + b"".join(struct.pack("<bb", round(e / step), round(n / step)) for e, n in points)


def _read_spot(cursor: ByteCursor, flags: int, reference: Place | None, step: float) -> Spot:
    status, u, v, contrast = cursor.unpack(_SPOT)
    if status & STATUS_MASK >= len(_STATUSES):
        raise NewerPayload(f"status {status & STATUS_MASK}")
    sign, temperature_c, above_k = -1.0 if status & IS_COLD else 1.0, None, None
    if flags & IS_CALIBRATED:
        temperature, above = cursor.unpack(_TEMPERATURE)
        temperature_c, above_k = temperature * TEMPERATURE_STEP_C, sign * _from_code(above, KELVIN)
    kind, log_odds = _read_kind(cursor) if flags & HAS_KINDS else (None, 0.0)
    spot = Spot(
        u * PIXEL_STEP - 0.5, v * PIXEL_STEP - 0.5, sign * _from_code(contrast, CONTRAST),
        temperature_c, above_k, _STATUSES[status & STATUS_MASK], is_cut=bool(status & IS_CUT),
        kind=kind, log_odds=log_odds,
    )  # fmt: skip
    if spot.status is not Status.OK:
        return spot
    if reference is None:
        raise CorruptPayload("a spot with a place, and no place that it counts from")
    lat, lon, height, major, minor, azimuth, sigma, area, share, points = cursor.unpack(_PLACE)
    amsl, ellipsoid = (
        None if of is None else of + height * SPOT_HEIGHT_STEP_M
        for of in (reference.height_amsl_m, reference.height_ellipsoid_m)
    )
    ellipse = Ellipse(_from_code(major, LENGTH), _from_code(minor, LENGTH), azimuth * ANGLE_STEP_DEG)
    place = Place(
        min(max(reference.lat_deg + lat * step, -90.0), 90.0), _wrapped(reference.lon_deg + lon * step), amsl,
        ellipsoid, ellipse, _from_code(sigma, LENGTH),
    )  # fmt: skip
    area_m2 = _from_code(area, AREA)
    return replace(
        spot, place=place, area_m2=area_m2, sigma_area_m2=area_m2 * share * AREA_SHARE_STEP,
        outline_en_m=_read_outline(cursor, points),
    )  # fmt: skip


def _read_outline(cursor: ByteCursor, points: int) -> tuple[tuple[float, float], ...]:
    if not points:
        return ()
    exponent = cursor.take(1)[0]
    if points < 3 or exponent > 2 * MOST_EXPONENT:
        raise CorruptPayload(f"an outline of {points} points in steps of 2^({exponent}/2)")
    step = OUTLINE_STEP_M * math.sqrt(2.0**exponent)
    return tuple((east * step, north * step) for east, north in struct.iter_unpack("<bb", cursor.take(2 * points)))


def _wrapped(degrees: float) -> float:
    """An angle in [-180, 180]."""
    return degrees if abs(degrees) <= 180.0 else (degrees + 180.0) % 360.0 - 180.0
