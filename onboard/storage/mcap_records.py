"""The records of an MCAP file one after the other, past a stretch that cannot be read.

Source: the MCAP specification, version 0 (mcap.dev/spec): a record is an opcode, a length and its content, and nothing
marks its beginning. After a damaged length the next record is searched byte by byte; what is taken for one must be
whole in every way that is known: a record follows it, its channel is known and its time near, its content is readable.
"""

from __future__ import annotations

import io
import json
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO, TypeAlias

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata
from mcap.stream_reader import breakup_chunk

from contract import recording_format as names
from contract.errors import WireError
from contract.wire.codec import decode

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD_BYTES = 1 << 28  # a damaged length must not become memory asked for
MAX_STEP_NS = 86_400_000_000_000  # between the times of two records with nothing but damage between them
BLOCK_BYTES = 1 << 20

_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD_BYTES = 22
_OPCODES = {int(opcode) for opcode in Opcode}
# What may be begun again with: everything that stands between a recording's messages, and its end.
_BEGINNING = re.compile(b"[\x03\x04\x05\x0c\x0f]")
UNREADABLE = (McapError, struct.error, EOFError, UnicodeDecodeError, ValueError, OverflowError, MemoryError)


@dataclass(frozen=True)
class Damage:
    """Bytes `begin` to `end` of a file hold no record that can be read."""

    begin: int
    end: int


@dataclass(frozen=True)
class Lost:
    """Messages that a damaged stretch held, by the numbers of those around it; `topic` is empty if it is not known."""

    topic: str
    count: int


Found: TypeAlias = Metadata | Damage | Lost | tuple[Channel, Message]


@dataclass(frozen=True)
class _Record:
    opcode: int
    begin: int  # of its content
    end: int


def walk(stream: IO[bytes]) -> Iterator[Found]:
    """Metadata and messages of a file, up to its end or to where it was cut off, and what is damaged before that."""
    return _Walk(stream).found()


class _Walk:
    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._size = stream.seek(0, io.SEEK_END)
        self._channels: dict[int, Channel] = {}
        self._next_sequence: dict[int, int] = {}
        self._last_ns: int | None = None
        self._is_damaged = False

    def found(self) -> Iterator[Found]:
        at = len(MAGIC)
        record = self._record(at)
        while at < self._size:
            following = None if record is None else self._record(record.end)
            content = None
            if record is not None and (record.end == self._size or following is not None or self._is_whole(record)):
                content = self._content(record)
                if content and not self._has_channel(content[0], record):
                    content = None
            if record is None or content is None:
                again = self._resume(at + 1)
                if again is None:  # the last record of a killed process or a lost disk: what was before it counts
                    return
                yield Damage(at, again)
                self._know_of_damage()
                at, record = again, self._record(again)
                continue
            for part in content:
                yield from self._take(part)
            if record.opcode == Opcode.DATA_END:
                return
            at, record = record.end, following

    def _take(self, part: McapRecord) -> Iterator[Found]:
        if isinstance(part, Channel):
            self._channels[part.id] = part
        elif isinstance(part, Metadata):
            yield part
        elif isinstance(part, Message):
            channel = self._channels.get(part.channel_id)
            if self._is_damaged:
                # A recording numbers each channel's messages from 0 without a gap.
                missing = part.sequence - self._next_sequence.get(part.channel_id, 0) if channel is not None else 1
                if missing > 0:
                    yield Lost("" if channel is None else channel.topic, missing)
            self._next_sequence[part.channel_id] = part.sequence + 1
            self._last_ns = part.log_time
            if channel is not None:
                yield channel, part

    def _has_channel(self, part: McapRecord, record: _Record) -> bool:
        """False for a message of a channel that was never named: that record, or this one, is damaged."""
        if record.opcode != Opcode.MESSAGE or not isinstance(part, Message) or part.channel_id in self._channels:
            return True
        self._know_of_damage()
        return self._is_readable(part)

    def _know_of_damage(self) -> None:
        if not self._is_damaged:
            self._is_damaged = True
            self._channels = self._channels_of_summary() | self._channels

    def _read(self, begin: int, length: int) -> bytes:
        self._stream.seek(begin)
        return self._stream.read(length)

    def _record(self, at: int) -> _Record | None:
        """The record that begins there, if one can."""
        head = self._read(at, _HEAD.size)
        if len(head) < _HEAD.size:
            return None
        opcode, length = _HEAD.unpack(head)
        end = at + _HEAD.size + length
        is_one = opcode in _OPCODES and length <= MAX_RECORD_BYTES and end <= self._size
        return _Record(opcode, at + _HEAD.size, end) if is_one else None

    def _content(self, record: _Record) -> list[McapRecord] | None:
        """What a record holds of what is of use here; None if it cannot be read."""
        if record.opcode not in (Opcode.CHANNEL, Opcode.MESSAGE, Opcode.METADATA, Opcode.CHUNK):
            return []
        length = record.end - record.begin
        stream = ReadDataStream(io.BytesIO(self._read(record.begin, length)))
        try:
            if record.opcode == Opcode.MESSAGE:
                return [Message.read(stream, length)] if length >= _MESSAGE_HEAD_BYTES else None
            if record.opcode == Opcode.CHUNK:
                return list(breakup_chunk(Chunk.read(stream)))
            one = Channel.read(stream) if record.opcode == Opcode.CHANNEL else Metadata.read(stream)
        except UNREADABLE:
            return None
        return [one] if stream.count == length else None

    def _is_whole(self, record: _Record) -> bool:
        """Whether to believe a record that none follows: the next one may be damaged, or this one's own length."""
        content = self._content(record)
        if not content:
            return False
        message = content[0]
        return not isinstance(message, Message) or self._is_readable(message)

    def _is_readable(self, message: Message) -> bool:
        channel = self._channels.get(message.channel_id)
        try:
            if channel is not None and channel.message_encoding == "json":
                json.loads(message.data)
            elif channel is not None and channel.message_encoding == names.SET_ENCODING:
                decode(message.data)
        except (ValueError, RecursionError, WireError):
            return False
        return channel is not None

    def _resume(self, begin: int) -> int | None:
        """Where the next record begins that is whole beyond doubt."""
        while begin < self._size:
            block = self._read(begin, BLOCK_BYTES)
            for candidate in _BEGINNING.finditer(block):
                at = begin + candidate.start()
                record = self._record(at)
                if record is not None and self._is_beyond_doubt(record):
                    return at
            begin += len(block)
        return None

    def _is_beyond_doubt(self, record: _Record) -> bool:
        if record.end != self._size and self._record(record.end) is None:
            return False
        if record.opcode == Opcode.DATA_END:
            return record.end - record.begin == 4
        content = self._content(record)
        if content is None:
            return False
        if record.opcode == Opcode.SCHEMA:
            return record.end - record.begin >= 14 and _HEAD.size < self._size - record.end
        if not content or not isinstance(content[0], Message):
            return bool(content)
        message = content[0]
        is_near = self._last_ns is None or abs(message.log_time - self._last_ns) <= MAX_STEP_NS
        # 0: other writers number nothing.
        is_later = message.sequence == 0 or message.sequence >= self._next_sequence.get(message.channel_id, 0)
        return is_near and is_later and self._is_readable(message)

    def _channels_of_summary(self) -> dict[int, Channel]:
        """The channels as the end of a whole file repeats them: their own records may be what is damaged."""
        try:
            self._stream.seek(0)
            summary = make_reader(self._stream).get_summary()
        except UNREADABLE:
            return {}
        return {} if summary is None else dict(summary.channels)
