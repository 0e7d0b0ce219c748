"""Feature sets in pieces small enough for a telemetry radio, and a receiver's reports. docs/wire-format.md, section 13.

A radio with error correction splits what is longer than 118 bytes on the wire, and then loses all of it with any part.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

from contract.errors import CorruptPayload, TruncatedPayload
from contract.wire.click_code import MAJOR
from contract.wire.parity import groups_of, joined, length_of, parities, pieces_of

MAX_WIRE_BYTES = 118
PIECE, REPORT = 5, 6
MAX_BYTES = 2000  # of a set and its age
AGE_STEP_S, NO_AGE = 0.01, 0xFFFF
LATEST = 8  # packets, of which a report states when they came
CAME_STEP_S, NOT_CAME = 0.02, 0xFF
_AGE = struct.Struct("<H")
_PIECE = struct.Struct("<BHBBBH")  # kind, packet, set, piece, pieces, bytes
_REPORT = struct.Struct("<BHH")
PIECE_HEAD = _PIECE.size


@dataclass(frozen=True)
class SetPiece:
    """Piece `number` of `pieces` (from there on parities) of set `of` modulo 256. `packet` counts all that are sent."""

    packet: int
    of: int
    number: int
    pieces: int
    size: int  # bytes of the whole
    content: bytes


@dataclass(frozen=True)
class ReceiverReport:
    """A ground that wants sets: the highest packet it has, and how many it has received, both modulo 65536.

    `came_s`: how long ago the latest packets came, by number; those of which it is known, and within 5 s.
    """

    highest: int
    received: int
    came_s: dict[int, float] = field(default_factory=dict)


def cut_set(payload: bytes, age_s: float | None, max_bytes: int) -> list[tuple[int, int, int, bytes]]:
    """A set's pieces, parities last: number, pieces, bytes of the whole, content. Raises ValueError if it is too long.

    `max_bytes` is what a packet may hold, its head included.
    """
    age = NO_AGE if age_s is None else max(min(round(age_s / AGE_STEP_S), NO_AGE - 1), 0)
    whole = _AGE.pack(age) + payload
    room = max_bytes - _PIECE.size
    if len(whole) > MAX_BYTES:
        raise ValueError(f"a set of {len(payload)} bytes")
    pieces = -(-len(whole) // room)
    contents = pieces_of(whole, pieces)
    contents += parities(contents)
    return [(number, pieces, len(whole), content) for number, content in enumerate(contents)]


def encode_piece(piece: SetPiece) -> bytes:
    """One packet."""
    p = piece
    return _PIECE.pack(MAJOR << 4 | PIECE, p.packet, p.of, p.number, p.pieces, p.size) + p.content


def encode_report(report: ReceiverReport) -> bytes:
    """Thirteen bytes."""
    numbers = ((report.highest - back) % 65536 for back in range(LATEST))
    steps = (report.came_s.get(number, NOT_CAME * CAME_STEP_S) / CAME_STEP_S for number in numbers)
    head = _REPORT.pack(MAJOR << 4 | REPORT, report.highest, report.received)
    return head + bytes(min(round(step), NOT_CAME) for step in steps)


def read_piece(payload: bytes) -> SetPiece | None:
    """A packet; None if it is of another kind. Raises TruncatedPayload or CorruptPayload, and nothing else."""
    if not payload or payload[0] != MAJOR << 4 | PIECE:
        return None
    if len(payload) < _PIECE.size:
        raise TruncatedPayload(f"a piece of a set of {len(payload)} bytes")
    _, packet, of, number, pieces, size = _PIECE.unpack_from(payload)
    content = payload[_PIECE.size :]
    if not _AGE.size < size <= MAX_BYTES or not 1 <= pieces <= size or number >= pieces + groups_of(pieces):
        raise CorruptPayload(f"piece {number} of {pieces} of a set of {size} bytes")
    if len(content) != length_of(size, pieces, number):
        raise CorruptPayload(f"piece {number} of {pieces} has {len(content)} bytes")
    return SetPiece(packet, of, number, pieces, size, content)


def read_report(payload: bytes) -> ReceiverReport | None:
    """A report; None if it is none."""
    if len(payload) < _REPORT.size or payload[0] != MAJOR << 4 | REPORT:
        return None
    _, highest, received = _REPORT.unpack_from(payload)
    steps = enumerate(payload[_REPORT.size :][:LATEST])
    came_s = {(highest - back) % 65536: step * CAME_STEP_S for back, step in steps if step != NOT_CAME}
    return ReceiverReport(highest, received, came_s)


class SetAssembly:
    """Pieces in any order, of the last few sets -> sets with their ages; and what the receiver reports of them.

    Not for use by several threads.
    """

    MAX_PARTIAL = 4  # sets: one that was lost on the way is given up when later ones have come

    def __init__(self) -> None:
        self._partial: dict[tuple[int, int, int], dict[int, bytes]] = {}
        self._done: list[tuple[int, int, int]] = []
        self._highest: int | None = None
        self._received = 0
        self._came_s: dict[int, float] = {}  # of the latest packets

    def take(self, piece: SetPiece, now_s: float) -> tuple[bytes, float | None] | None:
        """The set that this piece completes and the age its picture had when it was sent, if it does."""
        self._received += 1
        self._came_s.setdefault(piece.packet, now_s)
        if len(self._came_s) > 2 * LATEST:  # in the order in which they came, not in that of their numbers
            del self._came_s[next(iter(self._came_s))]
        if self._highest is None or (piece.packet - self._highest) % 65536 < 32768:
            self._highest = piece.packet
        identity = piece.of, piece.pieces, piece.size
        if identity in self._done:
            return None
        came = self._partial.setdefault(identity, {})
        came[piece.number] = piece.content
        if len(self._partial) > self.MAX_PARTIAL:
            del self._partial[next(iter(self._partial))]
        whole = joined(piece.size, piece.pieces, came)
        if whole is None:
            return None
        self._partial.pop(identity, None)
        self._done = [*self._done, identity][-self.MAX_PARTIAL :]
        (age,) = _AGE.unpack_from(whole)
        return whole[_AGE.size :], None if age == NO_AGE else age * AGE_STEP_S

    def report(self, now_s: float) -> ReceiverReport:
        """Summarise what was received so far: highest packet number, count, ages (s) of the latest packets."""
        came_s = {number: now_s - at_s for number, at_s in self._came_s.items()}
        return ReceiverReport(self._highest or 0, self._received % 65536, came_s)
