"""SIYI's own gimbal protocol: packets <-> bytes, and what their answers hold. No socket, no clock.

    55 66 | control | length (2) | sequence (2) | command | data | CRC16 (2)      all little-endian

The CRC is CCITT's with polynomial 0x1021 from 0, over everything before it. Requests have bit 0 of `control` set.
"""

from __future__ import annotations

import binascii
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass

START = b"\x55\x66"
ATTITUDE, ZOOM = 0x0D, 0x18  # commands: how the gimbal is turned, and how often the camera enlarges
ZOOM_STEP = 0.1
MAX_DATA = 256  # the longest documented message has less
NEEDS_ANSWER = 1

_HEAD = struct.Struct("<2sBHHB")
_CRC = struct.Struct("<H")
_ATTITUDE = struct.Struct("<6h")
_MAX_PITCH_DEG, _MAX_ANGLE_DEG, _MAX_ZOOM = 180.0, 360.0, 255.9


@dataclass(frozen=True)
class Packet:
    """One message: what it asks or answers, and its data."""

    command: int
    data: bytes = b""
    sequence: int = 0
    control: int = NEEDS_ANSWER


def encode(packet: Packet) -> bytes:
    """The packet as it is sent."""
    head = _HEAD.pack(START, packet.control, len(packet.data), packet.sequence & 0xFFFF, packet.command)
    body = head + packet.data
    return body + _CRC.pack(binascii.crc_hqx(body, 0))


class PacketReader:
    """Bytes as they come -> packets; what is none is skipped and counted. It holds one packet at most."""

    def __init__(self) -> None:
        self.garbage = 0  # bytes that were part of no packet
        self.damaged = 0  # packets whose checksum is another
        self._held = b""

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Take some bytes; hands out each packet that is whole by now."""
        self._held += data
        while (packet := self._next()) is not None:
            yield packet

    def _next(self) -> Packet | None:
        while True:
            at = self._held.find(START)
            # The last byte may be the first of the next packet.
            self._skip(at if at >= 0 else max(len(self._held) - 1, 0))
            if at < 0 or len(self._held) < _HEAD.size:
                return None
            _, control, length, sequence, command = _HEAD.unpack_from(self._held)
            end = _HEAD.size + length
            if length > MAX_DATA:
                self._skip(len(START))
                continue
            if len(self._held) < end + _CRC.size:
                return None
            if binascii.crc_hqx(self._held[:end], 0) != _CRC.unpack_from(self._held, end)[0]:
                self.damaged += 1
                self._skip(len(START))  # the next packet may begin within what was taken for this one
                continue
            packet = Packet(command, self._held[_HEAD.size : end], sequence, control)
            self._held = self._held[end + _CRC.size :]
            return packet

    def _skip(self, count: int) -> None:
        self.garbage += count
        self._held = self._held[count:]


def attitude_deg(packet: Packet) -> tuple[float, float, float] | None:
    """Roll and pitch against the horizon and yaw from the nose, clockwise seen from above; None where it holds none.

    SIYI counts yaw the other way round.
    """
    if packet.command != ATTITUDE or len(packet.data) != _ATTITUDE.size:
        return None
    yaw, pitch, roll = (value / 10.0 for value in _ATTITUDE.unpack(packet.data)[:3])
    if max(abs(yaw), abs(roll)) > _MAX_ANGLE_DEG or abs(pitch) > _MAX_PITCH_DEG:
        return None
    return roll, pitch, -yaw


def zoom_times(packet: Packet) -> float | None:
    """Return how many times the widest view is enlarged; None where the packet holds no zoom."""
    if packet.command != ZOOM or len(packet.data) != 2:
        return None
    whole, tenths = packet.data
    zoom = whole + tenths / 10.0
    return zoom if tenths <= 9 and 1.0 <= zoom <= _MAX_ZOOM and math.isfinite(zoom) else None
