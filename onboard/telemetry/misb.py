"""MISB ST 0601, the metadata of a sensor in a video (KLV) -> rows of positions and angles.

A set has a key of 16 bytes, a length, and items: a number, a length, a value, which an integer maps onto a range. The
last is a checksum; a set that fails it is left out. What a set does not repeat, its sender need not: a lens and the
sensor's roll hold until they are stated otherwise.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from contract.rotations import euler_from_matrix, matrix_from_euler
from onboard.telemetry.row_events import ABOVE_ELLIPSOID, ATTITUDE, GIMBAL, VELOCITY, Row

KEY = bytes.fromhex("060e2b34020b01010e01030101000000")
CHECKSUM, TIME, LEAP_SECONDS = 1, 2, 136
CHECKSUM_BYTES = 4  # its number, its length and itself
US = 1000  # ns


@dataclass(frozen=True)
class Scale:
    """An item of so many bytes: what its least and its largest number stand for.

    Signed ones map symmetrically, and their most negative number states that the value is out of range or unknown.
    """

    size: int
    low: float
    high: float

    def of(self, value: bytes) -> float | None:
        """Return what a value stands for; None where that is not known."""
        if len(value) != self.size:
            return None
        if self.low == -self.high:
            number = int.from_bytes(value, "big", signed=True)
            half = 1 << (8 * self.size - 1)
            return None if number == -half else number * self.high / (half - 1)
        return self.low + int.from_bytes(value, "big") * (self.high - self.low) / ((1 << 8 * self.size) - 1)


HEADING, PITCH, ROLL, LATITUDE, LONGITUDE, ALTITUDE, WIDTH = 5, 6, 7, 13, 14, 15, 16
AZIMUTH, ELEVATION, TURN, ELLIPSOID, NORTH, EAST, FULL_PITCH, FULL_ROLL = 18, 19, 20, 75, 79, 80, 90, 91
ITEMS = {
    HEADING: Scale(2, 0.0, 360.0),
    PITCH: Scale(2, -20.0, 20.0),
    ROLL: Scale(2, -50.0, 50.0),
    LATITUDE: Scale(4, -90.0, 90.0),
    LONGITUDE: Scale(4, -180.0, 180.0),
    ALTITUDE: Scale(2, -900.0, 19000.0),
    WIDTH: Scale(2, 0.0, 180.0),
    AZIMUTH: Scale(4, 0.0, 360.0),
    ELEVATION: Scale(4, -180.0, 180.0),
    TURN: Scale(4, 0.0, 360.0),
    ELLIPSOID: Scale(2, -900.0, 19000.0),
    NORTH: Scale(2, -327.0, 327.0),
    EAST: Scale(2, -327.0, 327.0),
    FULL_PITCH: Scale(4, -90.0, 90.0),
    FULL_ROLL: Scale(4, -90.0, 90.0),
}
PERSISTENT = (TURN, WIDTH)  # hold until they are stated otherwise
HEIGHTS = {ALTITUDE: "height_amsl_m", ELLIPSOID: ABOVE_ELLIPSOID}


@dataclass(frozen=True)
class Sample:
    """One set: when it counts (ns, UTC), whether its sender states how it counts leap seconds, and its values."""

    stamp_ns: int
    is_utc: bool
    values: Mapping[int, float]

    @property
    def width_deg(self) -> float | None:
        return self.values.get(WIDTH)

    def row(self) -> Row:
        """The row of it, with what `row_events` reads."""
        v = self.values
        row: Row = {}
        if LATITUDE in v and LONGITUDE in v:
            row = {"lat_deg": v[LATITUDE], "lon_deg": v[LONGITUDE]}
            row |= {name: v[item] for item, name in HEIGHTS.items() if item in v}
        if NORTH in v and EAST in v:
            row |= {VELOCITY[0]: v[NORTH], VELOCITY[1]: v[EAST]}
        vehicle = _vehicle_deg(v)
        if vehicle is not None:
            row |= dict(zip(ATTITUDE, vehicle, strict=True))
            if AZIMUTH in v and ELEVATION in v:
                R = _turn(*vehicle) @ _turn(v.get(TURN, 0.0), v[ELEVATION], v[AZIMUTH])
                row |= dict(zip(GIMBAL, np.degrees(euler_from_matrix(R)).tolist(), strict=True))
        return row


def _vehicle_deg(v: Mapping[int, float]) -> tuple[float, float, float] | None:
    """Roll, pitch, heading: those of the full range where they are stated."""
    roll, pitch, heading = v.get(FULL_ROLL, v.get(ROLL)), v.get(FULL_PITCH, v.get(PITCH)), v.get(HEADING)
    return None if roll is None or pitch is None or heading is None else (roll, pitch, heading)


def _turn(roll_deg: float, pitch_deg: float, yaw_deg: float) -> np.ndarray:
    return matrix_from_euler(*(math.radians(angle) for angle in (roll_deg, pitch_deg, yaw_deg)))


class Reader:
    """Takes the metadata of a video piece by piece; keeps what persists."""

    def __init__(self) -> None:
        self.damaged = 0  # sets
        self._persistent: dict[int, float] = {}

    def samples(self, content: bytes) -> Iterator[Sample]:
        """Yield the samples of all whole sets in a packet's content."""
        at = content.find(KEY)
        while at >= 0:
            begin = at + len(KEY)
            length, begin = _length(content, begin)
            whole = content[at : begin + length]
            if length and len(whole) == begin + length - at and _is_intact(whole):
                sample = self._sample(dict(_items(content[begin : begin + length])))
                if sample is not None:
                    yield sample
                at = content.find(KEY, begin + length)
            else:
                self.damaged += 1
                at = content.find(KEY, begin)

    def _sample(self, items: Mapping[int, bytes]) -> Sample | None:
        time = items.get(TIME, b"")
        if len(time) != 8:  # without a time it belongs to no picture
            return None
        leap = items.get(LEAP_SECONDS)
        leap_s = 0 if leap is None else int.from_bytes(leap, "big", signed=True)
        stamp_ns = int.from_bytes(time, "big") * US + leap_s * 1_000_000_000
        read = {item: ITEMS[item].of(value) for item, value in items.items() if item in ITEMS}
        values = {item: value for item, value in read.items() if value is not None}
        self._persistent |= {item: values[item] for item in PERSISTENT if item in values}
        return Sample(stamp_ns, leap is not None, self._persistent | values)


def _is_intact(whole: bytes) -> bool:
    """Return whether a set's checksum is right: the sum of all before it, taken two bytes at a time."""
    if len(whole) < CHECKSUM_BYTES or whole[-CHECKSUM_BYTES:-2] != bytes((CHECKSUM, 2)):
        return False
    summed = whole[:-2] + b"\0" * (len(whole) % 2)
    words = struct.unpack(f">{len(summed) // 2}H", summed)
    return bool(sum(words) % 0x10000 == int.from_bytes(whole[-2:], "big"))


def _items(content: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at < len(content):
        item = 0
        while at < len(content):
            item = item << 7 | content[at] & 0x7F
            at += 1
            if content[at - 1] < 0x80:  # the last byte of its number
                break
        length, at = _length(content, at)
        if at + length > len(content):
            return
        yield item, content[at : at + length]
        at += length


def _length(content: bytes, at: int) -> tuple[int, int]:
    """A length that stands at `at`, and where what it counts begins; 0 for one that is cut or absurd."""
    if at >= len(content):
        return 0, at
    first, at = content[at], at + 1
    if first < 0x80:
        return first, at
    size = first & 0x7F
    return (int.from_bytes(content[at : at + size], "big") if size <= 4 else 0), at + size
