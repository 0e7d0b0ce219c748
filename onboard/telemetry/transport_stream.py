"""MPEG transport streams (ISO 13818-1): the packets of a stream of metadata, and when each was shown.

Files of 188 bytes a packet, or of 192 with a time before each (.m2ts). Pictures are never read here: of the video only
the times of its first packets count.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

PACKET, SYNC = 188, 0x47
STRIDES = (188, 192)  # bytes from packet to packet
HEAD_BYTES = 4096
AT_ONCE = 200_000  # packets
MOST_BYTES = 512_000_000  # of metadata: hours of it
METADATA_PES, PRIVATE_PES = 0x15, 0x06  # kinds of streams: metadata by its standard, and anything a descriptor names
VIDEO_KINDS = frozenset({0x01, 0x02, 0x10, 0x1B, 0x24})
REGISTRATION, KLVA = 0x05, b"KLVA"
CLOCK_HZ, WRAP = 90_000, 1 << 33
REORDERED = 32  # pictures, which come in the order of decoding: the earliest of so many is the first


@dataclass(frozen=True)
class Packet:
    """One packet of metadata: its content, and when it counts on the video's own time (s), which begins with the
    first picture. `is_synchronous`: it states that time itself; else it is that of the pictures about it.
    """

    time_s: float
    content: bytes
    is_synchronous: bool


def begins_stream(head: bytes) -> bool:
    return _stride(head) is not None


def _stride(head: bytes) -> int | None:
    for stride in STRIDES:
        marks = head[stride - PACKET :: stride]
        if len(marks) > 2 and set(marks) == {SYNC}:
            return stride
    return None


def has_metadata(path: Path) -> bool:
    """Return whether a file is a transport stream that states a stream of KLV metadata. Raises OSError."""
    found = _Streams()
    with path.open("rb") as stream:
        stride = _stride(stream.read(HEAD_BYTES))
    if stride is not None:
        found.take(next(_packets(path, stride)))
    return found.has_metadata


def metadata_of(path: Path) -> list[Packet]:
    """Return the packets of the stream of KLV metadata in a file; none where it has no such stream, or no pictures.

    Raises OSError.
    """
    with path.open("rb") as stream:
        stride = _stride(stream.read(HEAD_BYTES))
    if stride is None:
        return []
    found = _Streams()
    for packets in _packets(path, stride):
        found.take(packets)
    return found.in_time()


def _packets(path: Path, stride: int) -> Iterator[NDArray[np.uint8]]:
    """Arrays (N, 188) of whole packets; one without its mark is left out."""
    with path.open("rb") as stream:
        while data := stream.read(AT_ONCE * stride):
            whole = len(data) // stride * stride
            rows = np.frombuffer(data[:whole], np.uint8).reshape(-1, stride)[:, stride - PACKET :]
            yield rows[rows[:, 0] == SYNC]


class _Streams:
    """Takes a file's packets; joins those of the metadata, and keeps the times of pictures."""

    def __init__(self) -> None:
        self._maps: set[int] = set()  # the packets that state a programme's streams
        self._metadata: int | None = None
        self._video: int | None = None
        self._parts: list[bytearray] = []  # of the metadata: one for each of its own packets
        self._shown: list[int | None] = []  # when each of these counts, in ticks, or that of the picture before it
        self._is_own: list[bool] = []
        self._newest: int | None = None  # of the pictures
        self._first: int | None = None
        self._pictures = 0
        self._bytes = 0

    @property
    def has_metadata(self) -> bool:
        return self._metadata is not None

    def take(self, packets: NDArray[np.uint8]) -> None:
        """Take packets (N, 188) in their order."""
        pids = (packets[:, 1].astype(np.int32) & 0x1F) << 8 | packets[:, 2]
        begins = packets[:, 1] & 0x40 != 0
        if self._metadata is None or self._video is None:
            self._look_for_streams(packets, pids, begins)
        wanted = (pids == self._metadata) | ((pids == self._video) & begins)
        for at in np.flatnonzero(wanted).tolist():
            payload = _payload(packets[at].tobytes())
            if pids[at] == self._metadata:
                self._take_metadata(payload, bool(begins[at]))
            elif (ticks := _shown_at(payload)) is not None:
                self._newest, self._pictures = ticks, self._pictures + 1
                if self._first is None or (self._pictures <= REORDERED and self._since_first(ticks) < 0):
                    self._first = ticks

    def _look_for_streams(self, packets: NDArray[np.uint8], pids: NDArray[np.int32], begins: NDArray[np.bool_]) -> None:
        for at in np.flatnonzero(begins & (pids == 0)).tolist():
            self._maps |= _programme_maps(_section(packets[at].tobytes()))
        for at in np.flatnonzero(begins & np.isin(pids, sorted(self._maps))).tolist():
            for kind, pid, described in _streams_of(_section(packets[at].tobytes())):
                if kind in VIDEO_KINDS and self._video is None:
                    self._video = pid
                elif kind == METADATA_PES or (kind == PRIVATE_PES and KLVA in described):
                    self._metadata = pid if self._metadata is None else self._metadata

    def _take_metadata(self, payload: bytes, is_begin: bool) -> None:
        if is_begin:
            own = _shown_at(payload)
            self._shown.append(self._newest if own is None else own)
            self._is_own.append(own is not None)
            self._parts.append(bytearray(_without_header(payload)))
        elif self._parts and self._bytes < MOST_BYTES:
            self._parts[-1] += payload
        self._bytes += len(payload)

    def _since_first(self, ticks: int) -> int:
        """Ticks since the first picture, of a clock that begins again every 26.5 hours; negative before it."""
        first = 0 if self._first is None else self._first
        return (ticks - first + WRAP // 2) % WRAP - WRAP // 2

    def in_time(self) -> list[Packet]:
        if self._first is None:
            return []
        rows = zip(self._shown, self._parts, self._is_own, strict=True)
        return [
            Packet(self._since_first(ticks) / CLOCK_HZ, bytes(part), is_own)
            for ticks, part, is_own in rows
            if ticks is not None
        ]


def _payload(packet: bytes) -> bytes:
    """The content of a packet behind its header and what adapts it; empty where it has none."""
    has_adaptation, has_payload = packet[3] & 0x20, packet[3] & 0x10
    if not has_payload:
        return b""
    return packet[5 + packet[4] :] if has_adaptation else packet[4:]


def _section(packet: bytes) -> bytes:
    """A table that begins in a packet, without its checksum; empty where it does not."""
    payload = _payload(packet)
    section = payload[1 + payload[0] :] if payload else b""
    length = (section[1] & 0x0F) << 8 | section[2] if len(section) > 3 else 0
    return section[: max(3 + length - 4, 0)]


def _programme_maps(section: bytes) -> set[int]:
    """The packets that state the streams of each programme, by the table of programmes."""
    if section[:1] != b"\x00":
        return set()
    rows = (struct.unpack_from(">HH", section, at) for at in range(8, len(section) - 3, 4))
    return {pid & 0x1FFF for programme, pid in rows if programme}


def _streams_of(section: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Each stream of a programme: its kind, its packets' number, and what describes it."""
    if section[:1] != b"\x02" or len(section) < 12:
        return
    at = 12 + ((section[10] & 0x0F) << 8 | section[11])
    while at + 5 <= len(section):
        kind, pid, length = struct.unpack_from(">BHH", section, at)
        described = section[at + 5 : at + 5 + (length & 0x0FFF)]
        yield kind, pid & 0x1FFF, described
        at += 5 + (length & 0x0FFF)


def _shown_at(payload: bytes) -> int | None:
    """When what begins here is to be shown, in ticks; None where that is not stated."""
    if payload[:3] != b"\x00\x00\x01" or len(payload) < 14 or not payload[7] & 0x80:
        return None
    a, b, c = payload[9], *struct.unpack_from(">HH", payload, 10)
    return int((a >> 1 & 7) << 30 | (b >> 1) << 15 | c >> 1)


def _without_header(payload: bytes) -> bytes:
    return payload[9 + payload[8] :] if payload[:3] == b"\x00\x00\x01" and len(payload) > 9 else payload
