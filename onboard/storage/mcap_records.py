"""The content of an MCAP file's records, one after the other, past stretches that cannot be read.

`contract.mcap_records` finds the records by opcode and length. Here they are read, those next to a damage with more
checks: there a length may be what is wrong, so that the last record before it and the first after it count only if
their content is readable and their channel is known. What a damage cost is counted by the messages' numbers.
"""

from __future__ import annotations

import io
import json
import mmap
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, NamedTuple, TypeAlias

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata
from mcap.stream_reader import breakup_chunk

from contract.errors import WireError
from contract.mcap_records import Damage, Data, Record, records
from contract.topics import FEATURES
from contract.wire.codec import decode

MAX_RECORD_BYTES = 1 << 28  # a damaged length must not become memory asked for
_HEAD_BYTES = 9
_OPCODES = {int(opcode) for opcode in Opcode}
_READ = {int(o) for o in (Opcode.CHANNEL, Opcode.MESSAGE, Opcode.METADATA, Opcode.CHUNK)}
UNREADABLE = (McapError, struct.error, EOFError, UnicodeDecodeError, ValueError, OverflowError, MemoryError)


@dataclass(frozen=True)
class Lost:
    """Messages that a damaged stretch held, by the numbers of those around it; `topic` is empty if it is not known."""

    topic: str
    count: int


Found: TypeAlias = Metadata | Damage | Lost | tuple[Channel, Message]


class _Content(NamedTuple):
    """A record that can be read, and where it stands in the file, its head included."""

    parts: list[McapRecord]
    start: int
    end: int


def walk(stream: IO[bytes]) -> Iterator[Found]:
    """Metadata and messages of a file, up to its end or to where it was cut off, and what is damaged before that."""
    with _mapped(stream) as data:
        yield from _Walk(stream, data).found()


@contextmanager
def _mapped(stream: IO[bytes]) -> Iterator[Data]:
    try:
        number = stream.fileno()
    except io.UnsupportedOperation:
        stream.seek(0)
        yield stream.read()
        return
    with mmap.mmap(number, 0, access=mmap.ACCESS_READ) as data:
        yield data


class _Walk:
    def __init__(self, stream: IO[bytes], data: Data) -> None:
        self._stream, self._data = stream, data
        self._channels: dict[int, Channel] = {}
        self._next_sequence: dict[int, int] = {}
        self._is_damaged = False

    def found(self) -> Iterator[Found]:
        held: _Content | None = None  # the last record: what follows decides whether it is doubted
        damage: Damage | None = None  # the stretch that goes on so far
        for item in self._items():
            if isinstance(item, Damage):
                self._know_of_damage()
                start = item.start
                if held is not None:
                    if self._is_readable(held):
                        yield from self._take(held)
                    else:
                        start = held.start
                    held = None
                damage = Damage(start if damage is None else damage.start, item.end)
                continue
            if damage is not None:
                if not self._is_readable(item):
                    damage = Damage(damage.start, item.end)
                    continue
                yield damage
                damage = None
            elif held is not None:
                yield from self._take(held)
            held = item
        if damage is not None:
            yield damage
        elif held is not None:
            yield from self._take(held)

    def _items(self) -> Iterator[_Content | Damage]:
        """Records and damages in the order of the file; a record that cannot be read is a damage too."""
        found: list[Damage] = []
        for record in records(self._data, found.append):
            yield from found
            found.clear()
            yield self._read(record)
        yield from found

    def _read(self, record: Record) -> _Content | Damage:
        opcode, start, length = record
        begin, end = start - _HEAD_BYTES, start + length
        if opcode not in _OPCODES or length > MAX_RECORD_BYTES:
            return Damage(begin, end)
        if opcode not in _READ:
            return _Content([], begin, end)
        stream = ReadDataStream(io.BytesIO(self._data[start:end]))
        try:
            if opcode == Opcode.MESSAGE:
                return _Content([Message.read(stream, length)], begin, end)
            if opcode == Opcode.CHUNK:
                return _Content(list(breakup_chunk(Chunk.read(stream))), begin, end)
            one = Channel.read(stream) if opcode == Opcode.CHANNEL else Metadata.read(stream)
        except UNREADABLE:
            return Damage(begin, end)
        return _Content([one], begin, end) if stream.count == length else Damage(begin, end)

    def _take(self, content: _Content) -> Iterator[Found]:
        for part in content.parts:
            if isinstance(part, Channel):
                self._channels[part.id] = part
            elif isinstance(part, Metadata):
                yield part
            elif isinstance(part, Message):
                if part.channel_id not in self._channels:  # never named: that record is damaged, or this one
                    self._know_of_damage()
                if not self._is_expected(part) and not self._is_readable_message(part):  # no message, by its opcode
                    self._know_of_damage()
                    yield Damage(content.start, content.end)
                    continue
                yield from self._message(part)

    def _message(self, message: Message) -> Iterator[Found]:
        channel = self._channels.get(message.channel_id)
        if self._is_damaged:
            # A recording numbers each channel's messages from 0 without a gap; other writers number nothing.
            missing = message.sequence - self._next_sequence.get(message.channel_id, 0) if channel is not None else 1
            if missing > 0:
                yield Lost("" if channel is None else channel.topic, missing)
        self._next_sequence[message.channel_id] = message.sequence + 1
        if channel is not None:
            yield channel, message

    def _know_of_damage(self) -> None:
        if not self._is_damaged:
            self._is_damaged = True
            self._channels = self._channels_of_summary() | self._channels

    def _is_expected(self, message: Message) -> bool:
        """Return whether it is the next of its channel; 0 is accepted, because other writers number nothing."""
        return message.sequence in (0, self._next_sequence.get(message.channel_id, 0))

    def _is_readable(self, content: _Content) -> bool:
        return all(self._is_readable_message(part) for part in content.parts if isinstance(part, Message))

    def _is_readable_message(self, message: Message) -> bool:
        channel = self._channels.get(message.channel_id)
        is_later = message.sequence == 0 or message.sequence >= self._next_sequence.get(message.channel_id, 0)
        try:
            if channel is not None and channel.message_encoding == "json":
                json.loads(message.data)
            elif channel is not None and channel.message_encoding == FEATURES.encoding:
                decode(message.data)
        except (ValueError, RecursionError, WireError):
            return False
        return channel is not None and is_later

    def _channels_of_summary(self) -> dict[int, Channel]:
        """The channels as the end of a whole file repeats them: their own records may be what is damaged."""
        try:
            self._stream.seek(0)
            summary = make_reader(self._stream).get_summary()
        except UNREADABLE:
            return {}
        return {} if summary is None else dict(summary.channels)
