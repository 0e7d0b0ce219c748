"""Bytes of a line -> MAVLink messages, whatever else is on it. pymavlink checks and decodes; the framing is ours.

pymavlink's own parser drops a whole supposed packet where a checksum fails, and real packets with it that follow a
false start byte; here only that byte is dropped. Nor do complete packets wait for the length that false start bytes
announce: where nothing shows that those begin a packet (no packet of their sender was received), complete packets
count. Where a known sender seems to continue, the rest is awaited: a packet may hold others, which do not belong to
this line.
"""

from __future__ import annotations

import re
from collections import Counter
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

V1, V2 = mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2
START = re.compile(bytes([ord("["), V1, V2, ord("]")]))
SIGNATURE = mavlink.MAVLINK_SIGNATURE_BLOCK_LEN
SIGNED = mavlink.MAVLINK_IFLAG_SIGNED
HEADER_V1, HEADER_V2 = 6, 10


class SequenceGaps:
    """Packets lost, by the gaps in their numbers, for each sender (system, component)."""

    def __init__(self) -> None:
        self.lost: Counter[tuple[int, int]] = Counter()
        self._newest: dict[tuple[int, int], int] = {}

    def note(self, system: int, component: int, sequence: int) -> None:
        """Take one packet's header."""
        sender = system, component
        gap = (sequence - self._newest.get(sender, sequence - 1) - 1) % 256
        if gap < 128:
            self.lost[sender] += gap
            self._newest[sender] = sequence
        elif self.lost[sender]:  # overtaken by others, it had been counted as lost
            self.lost[sender] -= 1

    def goes_on(self, system: int, component: int, sequence: int) -> bool:
        """Return whether this may be the next packet of a known sender."""
        newest = self._newest.get((system, component))
        return newest is not None and (sequence - newest - 1) % 256 < 128

    def has_received(self, system: int, component: int) -> bool:
        return (system, component) in self._newest

    def restart(self) -> None:
        """The link was interrupted: what passed meanwhile is not counted as lost."""
        self._newest.clear()


class _Packet(NamedTuple):
    """A packet in the buffer."""

    start: int
    length: int
    message: Any


class Framer:
    """Fed with chunks as they come; `decoder` holds the keys if packets must be signed."""

    def __init__(self, decoder: Any, gaps: SequenceGaps | None = None) -> None:
        self._decoder = decoder
        self._gaps = gaps if gaps is not None else SequenceGaps()
        self._buffer = bytearray()
        self.garbage = 0  # bytes that belonged to no packet

    def feed(self, data: bytes) -> list[Any]:
        """Take what has come in; returns the messages that are complete and sound."""
        self._buffer += data
        out, at = [], 0
        while True:
            start = START.search(self._buffer, at)
            if start is None:
                self.garbage += len(self._buffer) - at
                at = len(self._buffer)
                break
            self.garbage += start.start() - at
            at = start.start()
            length = self._length(at)
            if length is None:
                break
            message = self._decoded(at, length) if length else None
            if message is None and at + length > len(self._buffer):
                inside = None if self._gaps.goes_on(*self._sender(at)) else self._complete_within(at + 1)
                if inside is None:
                    break
                self.garbage += inside.start - at
                at, length, message = inside
            if message is None:
                self.garbage += 1
                at += 1
                continue
            self._gaps.note(*self._sender(at))
            out.append(message)
            at += length
        del self._buffer[:at]
        return [message for message in out if not message.get_type().startswith("UNKNOWN")]

    def _sender(self, at: int) -> tuple[int, int, int]:
        """System, component and number of the packet that seems to start here.

        Off the header, for pymavlink does not decode that of unknown kinds, and their numbers count like all.
        """
        first = at + (2 if self._buffer[at] == V1 else 4)
        sequence, system, component = self._buffer[first : first + 3]
        return system, component, sequence

    def _complete_within(self, at: int) -> _Packet | None:
        """The first packet from here on that is complete, sound and of a known kind."""
        for start in START.finditer(self._buffer, at):
            length = self._length(start.start())
            if length is None:
                return None
            message = self._decoded(start.start(), length) if length else None
            if message is not None and not message.get_type().startswith("UNKNOWN"):
                return _Packet(start.start(), length, message)
        return None

    def _length(self, at: int) -> int | None:
        """Whole length of the packet that seems to start here; 0: none does; None: too little of it has come."""
        buffer, left = self._buffer, len(self._buffer) - at
        if buffer[at] == V1:
            if left < HEADER_V1:
                return None
            payload, number, length = buffer[at + 1], buffer[at + 5], HEADER_V1 + 2
        else:
            if left < HEADER_V2:
                return None
            flags = buffer[at + 2]
            if flags & ~SIGNED:
                return 0
            payload, number = buffer[at + 1], int.from_bytes(buffer[at + 7 : at + 10], "little")
            length = HEADER_V2 + 2 + (SIGNATURE if flags & SIGNED else 0)
        known = mavlink.mavlink_map.get(number)
        # Newer dialects may append fields to a message, but not make it several times as long.
        if known is not None and payload > 2 * known.unpacker.size + 8:
            return 0
        return length + payload

    def _decoded(self, at: int, length: int) -> Any | None:
        end = at + length
        if end > len(self._buffer):
            return None
        packet = self._buffer[at:end]
        try:
            message = self._decoder.decode(packet)
        except mavlink.MAVError:
            return None
        if message.get_type().startswith("UNKNOWN"):
            # Nothing checks its bytes: accepted only of a sender who is known, and where another packet follows.
            system, component, _ = self._sender(at)
            is_followed = end == len(self._buffer) or self._buffer[end] in (V1, V2)
            return message if is_followed and self._gaps.has_received(system, component) else None
        return message
