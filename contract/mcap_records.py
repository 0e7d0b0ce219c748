"""A walk over the records of an MCAP file without chunks, by opcode and length, past what is damaged.

Source: the MCAP specification, version 0 (mcap.dev/spec). A file may be cut off anywhere (a killed process, a lost
disk): that is its end and no damage. A record whose length or opcode cannot be is followed by a search for the next
place from which records follow one another; what is between is reported.
"""

from __future__ import annotations

import mmap
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from contract.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGE, CHUNK, METADATA, DATA_END = 0x03, 0x04, 0x05, 0x06, 0x0C, 0x0F
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_RECORD = struct.Struct("<BQ")
_CHANNEL_HEAD = struct.Struct("<HH")
_STRING = struct.Struct("<I")
_MAX_LENGTH = 1 << 32
_CANNOT_BE = 1 << 62
# The least length of each opcode's records. No others exist but those from 0x80 on, for private use: a recording has
# none, and in damaged bytes half of all would be one.
_LEAST = [_CANNOT_BE, 8, 20, 16, 14, 22, 40, 6, 70, 49, 62, 46, 12, 24, 17, 4]
_LEAST += [_CANNOT_BE] * (0x100 - len(_LEAST))
_IN_A_ROW = 3  # records that follow one another, for a place to be where one begins
_NEAR_NS = 86_400_000_000_000  # and their messages are of the same day as the last one read
# Records that may come first after a damage, with a length below 2^32.
_CANDIDATE = re.compile(rb"[\x03\x04\x05\x0c\x0f].{4}\x00{4}", re.DOTALL)

Data = bytes | mmap.mmap
Record = tuple[int, int, int]  # opcode, and where the content starts and how long it is


@dataclass(frozen=True)
class Damage:
    """Bytes in which no record can be found, from `start` up to `end`."""

    start: int
    end: int


def records(data: Data, damaged: Callable[[Damage], None]) -> Iterator[Record]:
    """Every record up to the end of the data section, or to where the file was cut off; calls `damaged` on the way."""
    head, unpack, least = _RECORD.size, _RECORD.unpack_from, _LEAST
    is_closed = _is_closed(data)
    end = len(data) - len(MAGIC) if is_closed else len(data)
    position, log_ns = len(MAGIC), None
    opcode, length = _header(data, position)
    while position + head <= end:
        start, after = position + head, position + head + length
        is_whole = after <= end and least[opcode] <= length < _MAX_LENGTH
        has_next = is_whole and after + head <= end
        next_opcode, next_length = unpack(data, after) if has_next else (0, 0)
        # A reader that takes a damaged record for the end of the data loses all that comes after it.
        if is_whole and (
            (opcode == DATA_END and length != least[DATA_END]) or (is_closed and end - head < after < end)
        ):
            is_whole = False
        most = end - after - head if is_closed else _MAX_LENGTH - 1  # what was cut off may be longer than what is left
        if is_whole and (not has_next or least[next_opcode] <= next_length <= most or opcode == DATA_END):
            if opcode == DATA_END:
                return
            yield opcode, start, length
            if opcode == MESSAGE:
                log_ns = start + 6
            position, opcode, length = after, next_opcode, next_length
            continue
        # The damage is this record's length, or the head of the one after it.
        resumed = _next_place(data, position + 1, None if log_ns is None else _u64(data, log_ns))
        if is_whole and (resumed is None or after <= resumed):
            yield opcode, start, length
            position = after
        if resumed is None:
            if position < end and (is_whole or is_closed):
                damaged(Damage(position, end))
            return
        damaged(Damage(position, resumed))
        position = resumed
        opcode, length = _header(data, position)


def _header(data: Data, position: int) -> tuple[int, int]:
    """Opcode and length; an opcode that cannot be where no header is left."""
    if position + _RECORD.size > len(data):
        return 0, 0
    opcode, length = _RECORD.unpack_from(data, position)
    return opcode, length


def _is_closed(data: Data) -> bool:
    """Return whether the file was finished: then no record of it was cut off."""
    return len(data) >= 2 * len(MAGIC) and bytes(data[len(data) - len(MAGIC) :]) == MAGIC


def _next_place(data: Data, position: int, log_ns: int | None) -> int | None:
    """Find the next position from which records follow one another again; None if there is none."""
    while (found := _CANDIDATE.search(data, position)) is not None:
        if _follow_one_another(data, found.start(), log_ns):
            return found.start()
        position = found.start() + 1
    return None


def _follow_one_another(data: Data, position: int, log_ns: int | None) -> bool:
    end = len(data)
    for count in range(_IN_A_ROW):
        if position + _RECORD.size > end:
            return count > 0
        opcode, length = _header(data, position)
        start = position + _RECORD.size
        if not _LEAST[opcode] <= length < _MAX_LENGTH:
            return False
        if start + length > end:
            return count > 0 and not _is_closed(data)  # cut off
        if opcode == DATA_END:
            return length == _LEAST[DATA_END]
        if opcode == MESSAGE and log_ns is not None and abs(_u64(data, start + 6) - log_ns) > _NEAR_NS:
            return False
        position = start + length
    return True


def _u64(data: Data, position: int) -> int:
    return int.from_bytes(data[position : position + 8], "little")


def mapped(path: Path) -> Data:
    """A file as `records` walks it; empty for what is no MCAP file. Raises InputError for one that cannot be read."""
    try:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                return b""
            return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as error:
        raise InputError(f"recording {path}: {error.strerror}") from error


def read_channel(record: bytes) -> tuple[int, str, str]:
    """Id, topic and message encoding of a channel record; empty texts if it is damaged."""
    try:
        channel, _ = _CHANNEL_HEAD.unpack_from(record)
        position, texts = _CHANNEL_HEAD.size, []
        for _ in range(2):
            (length,) = _STRING.unpack_from(record, position)
            position += _STRING.size
            texts.append(record[position : position + length].decode())
            position += length
    except (struct.error, UnicodeDecodeError):
        return -1, "", ""
    return channel, texts[0], texts[1]
