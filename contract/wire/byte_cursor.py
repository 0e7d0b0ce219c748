"""A cursor over a payload that cannot run past its end."""

from __future__ import annotations

import struct
from typing import Any

from contract.errors import CorruptPayload


class ByteCursor:
    """Reads `payload` from `position` up to `end`; raises CorruptPayload where content is missing."""

    def __init__(self, payload: bytes, position: int, end: int) -> None:
        self.payload, self.position, self.end = payload, position, end

    def take(self, count: int) -> bytes:
        """The next `count` bytes."""
        if self.position + count > self.end:
            raise CorruptPayload(f"content ends at byte {self.end}, {count} more were expected at {self.position}")
        self.position += count
        return self.payload[self.position - count : self.position]

    def unpack(self, layout: struct.Struct) -> tuple[Any, ...]:
        return layout.unpack(self.take(layout.size))

    def signed(self, count: int) -> int:
        return int.from_bytes(self.take(count), "little", signed=True)
