"""Texts for the people at ground stations: STATUSTEXT, in pieces and one after the other. No link, no thread."""

from __future__ import annotations

from collections import deque
from typing import Any

TEXT_NS = 500_000_000  # between texts: the pilot must be able to read them
CHUNK_LENGTH = 50  # of STATUSTEXT
MAX_CHUNKS = 2
MAX_TEXTS = 8


class StatusTexts:
    """Keeps the newest few texts until they are due."""

    def __init__(self, dialect: Any) -> None:
        self._dialect = dialect
        self._texts: deque[tuple[int, str]] = deque(maxlen=MAX_TEXTS)
        self._next_ns = 0
        self._number = 0

    def add(self, severity: int, text: str) -> None:
        self._texts.append((severity, text[: MAX_CHUNKS * CHUNK_LENGTH]))

    def due(self, now_ns: int) -> list[Any]:
        """Return the messages of the next text, if one waits and may be shown now."""
        if not self._texts or now_ns < self._next_ns:
            return []
        self._next_ns = now_ns + TEXT_NS
        return self._messages(*self._texts.popleft())

    def _messages(self, severity: int, text: str) -> list[Any]:
        """One message, or several that ground stations put together by number; MAVLink 1 ones show them apart."""
        data = text.encode("ascii", "replace")
        if len(data) <= CHUNK_LENGTH:
            return [self._dialect.MAVLink_statustext_message(severity, data)]
        self._number = self._number % 65535 + 1
        return [
            self._dialect.MAVLink_statustext_message(
                severity, data[at : at + CHUNK_LENGTH], self._number, at // CHUNK_LENGTH
            )
            for at in range(0, len(data), CHUNK_LENGTH)
        ]
