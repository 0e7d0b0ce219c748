"""Messages of the link that are not accepted: counted by reason, for people to read. Thread-safe."""

from __future__ import annotations

import threading
from collections import Counter

from contract.errors import ForeignMessage, WireError

MOST_REASONS = 20  # a peer may invent names
OTHERS = "other messages that are not accepted"


class DroppedMessages:
    """`unreadable` counts what is no message of ours; `last_error` is the last one's. The rest goes by its reason."""

    def __init__(self, what: str = "no sets") -> None:
        self._what = what
        self._lock = threading.Lock()
        self._reasons: Counter[str] = Counter()
        self.unreadable = 0
        self.last_error: WireError | ValueError | None = None

    def failed(self, error: WireError | ValueError) -> None:
        """A message that could not be read, or that names another vehicle than its key."""
        if isinstance(error, ForeignMessage):
            self.not_accepted(str(error))
            return
        with self._lock:
            self.unreadable += 1
            self.last_error = error

    def not_accepted(self, reason: str) -> None:
        with self._lock:
            is_room = reason in self._reasons or len(self._reasons) < MOST_REASONS
            self._reasons[reason if is_room else OTHERS] += 1

    @property
    def count(self) -> int:
        with self._lock:
            return self._reasons.total()

    def lines(self) -> list[str]:
        """A line for each reason with its number, the most frequent first; empty while nothing was dropped."""
        with self._lock:
            lines = [f"dropped, {reason}: {count} messages" for reason, count in self._reasons.most_common()]
            if self.unreadable:
                lines.append(f"{self.unreadable} messages were {self._what} ({self.last_error})")
        return lines
