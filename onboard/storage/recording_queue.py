"""Records that wait for the disk, and counts of those dropped: a bounded queue that never blocks its writers.

A disk that stalls must cost records and nothing else. When the queue is full, new records are dropped at once and
counted; the count stands in the queue where the records would have stood, and is written in their place.
"""

from __future__ import annotations

import json
import threading
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from contract.topics import TOPICS, Counted, Topic
from onboard.storage.mcap_writer import SessionRecorder

Write = Callable[[SessionRecorder], None]
EVENTS, PICTURES = Counted("event", "events"), Counted("picture", "pictures")
COUNTED = (EVENTS, PICTURES, *(topic.recorded for topic in TOPICS if topic.recorded is not None))


def counted(topic: Topic) -> Counted:
    """The words for a topic's messages; it must be one that is recorded."""
    assert topic.recorded is not None, topic.name
    return topic.recorded


@dataclass(frozen=True)
class Gap:
    """Records that are missing between their neighbours in a recording; times are the session's, Unix ns.

    `counts`: how many of each of COUNTED; events are those without pictures, reports are counted by messages.
    """

    begin_ns: int  # of the first and of the last that is missing
    end_ns: int
    reason: str
    counts: Mapping[str, int] = field(default_factory=dict)

    def and_then(self, later: Gap) -> Gap:
        """One gap of two with nothing between them; the first reason counts."""
        counts = Counter(self.counts) + Counter(later.counts)
        return Gap(min(self.begin_ns, later.begin_ns), max(self.end_ns, later.end_ns), self.reason, counts)

    def __str__(self) -> str:
        numbers = [(self.counts.get(words.many, 0), words) for words in COUNTED]
        named = [f"{n} {words.one if n == 1 else words.many}" for n, words in numbers if n]
        return " and ".join([", ".join(named[:-1]), named[-1]] if len(named) > 1 else named)

    def to_json(self) -> bytes:
        """Return the gap as a recording keeps it."""
        counts = {words.many: self.counts.get(words.many, 0) for words in COUNTED}
        content = {"begin_ns": self.begin_ns, "end_ns": self.end_ns, "reason": self.reason, **counts}
        return json.dumps(content, separators=(",", ":")).encode()

    @classmethod
    def from_json(cls, data: bytes) -> Gap:
        """The gap as it was recorded; without times and counts if its record cannot be read."""
        try:
            content = json.loads(data)
            times, reason = (content.pop("begin_ns"), content.pop("end_ns")), content.pop("reason")
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            return cls(0, 0, "its gap record cannot be read")
        is_known = content.keys() <= {words.many for words in COUNTED}
        if not is_known or not all(isinstance(n, int) for n in (*times, *content.values())):
            return cls(0, 0, "its gap record cannot be read")
        return cls(*times, reason, content)


@dataclass(frozen=True, eq=False)
class Entry:
    """One thing to write."""

    kind: str  # how it is counted, one of COUNTED
    stamp_ns: int
    size: int  # bytes that it keeps in memory, where these are many
    write: Write

    def missing(self, reason: str) -> Gap:
        return Gap(self.stamp_ns, self.stamp_ns, reason, {self.kind: 1})


class RecordingQueue:
    """Filled by any thread, emptied by one."""

    def __init__(self, max_entries: int, max_bytes: int) -> None:
        self._max_entries, self._max_bytes = max_entries, max_bytes
        self._waiting: deque[Entry | Gap] = deque()
        self._bytes = 0
        self._gap: Gap | None = None  # dropped after the last that waits
        self._is_closed = False
        self._changed = threading.Condition()
        self.dropped = 0

    def put(self, entry: Entry) -> bool:
        """Take it, or drop it and return False; at once."""
        with self._changed:
            if len(self._waiting) >= self._max_entries or self._bytes + entry.size > self._max_bytes:
                gap = entry.missing("the disk did not keep up")
                self._gap = gap if self._gap is None else self._gap.and_then(gap)
                self.dropped += 1
                return False
            if self._gap is not None:
                self._waiting.append(self._gap)
                self._gap = None
            self._waiting.append(entry)
            self._bytes += entry.size
            self._changed.notify_all()
            return True

    def get(self, timeout_s: float) -> Entry | Gap | None:
        """The next, or the gap in its place; None if none came in time, or none will."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._is_closed, timeout_s)
            if self._waiting:
                found = self._waiting.popleft()
                if isinstance(found, Entry):
                    self._bytes -= found.size
                return found
            gap = None
            if self._is_closed:
                gap, self._gap = self._gap, None
            return gap

    def close(self) -> None:
        """Mark the end: no more entries come; those that wait can still be had."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    @property
    def is_over(self) -> bool:
        with self._changed:
            return self._is_closed and not self._waiting and self._gap is None
