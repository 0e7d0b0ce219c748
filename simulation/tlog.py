"""Telemetry logs as bytes: 8-byte big-endian microseconds, then a MAVLink packet. Cut without re-encoding."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from contract.errors import InputError

# Message numbers, as common.xml and ardupilotmega.xml give them.
HEARTBEAT, SYSTEM_TIME, GPS_RAW_INT, ATTITUDE, GLOBAL_POSITION_INT = 0, 2, 24, 30, 33
EKF_STATUS_REPORT, HOME_POSITION = 193, 242


class Packet(NamedTuple):
    """One logged packet: when it arrived, which message it is, its bytes with the eight of its stamp."""

    arrival_unix_s: float
    message: int
    record: bytes


def packets(log: bytes) -> Iterator[Packet]:
    """Packets of a log in order; bytes that begin no packet are passed over as a damaged log's reader would."""
    at = 0
    while at + 16 <= len(log):
        stamp_us: int = struct.unpack_from(">Q", log, at)[0]
        magic, length = log[at + 8], log[at + 9]
        if magic == 0xFD:
            size = 12 + length + (13 if log[at + 10] & 1 else 0)
            message = int.from_bytes(log[at + 15 : at + 18], "little")
        elif magic == 0xFE:
            size, message = 8 + length, log[at + 13]
        else:
            at += 1
            continue
        if at + 8 + size > len(log):
            return
        yield Packet(stamp_us * 1e-6, message, log[at : at + 8 + size])
        at += 8 + size


def read(path: Path) -> bytes:
    """A log's bytes; raises InputError naming the file."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"telemetry log {path}: {error.strerror}") from error


def cut(log: bytes, start_unix_s: float, end_unix_s: float, keep_every: Mapping[int, int] | None = None) -> bytes:
    """The packets that arrived within a span, unchanged; with `keep_every`, only those messages, each n-th of them."""
    seen: dict[int, int] = {}
    kept = []
    for packet in packets(log):
        if not start_unix_s <= packet.arrival_unix_s <= end_unix_s:
            continue
        if keep_every is not None:
            if packet.message not in keep_every:
                continue
            count = seen.get(packet.message, 0)
            seen[packet.message] = count + 1
            if count % keep_every[packet.message]:
                continue
        kept.append(packet.record)
    return b"".join(kept)
