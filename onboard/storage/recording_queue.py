"""Records that wait for the disk, and counts of those dropped: a bounded queue that never blocks its writers.

A disk that stalls must cost records and nothing else. When the queue is full, new records are dropped at once and
counted; the count stands in the queue where the records would have stood, and is written in their place.
"""

from __future__ import annotations

import json
import threading
import typing
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Literal

from onboard.storage.mcap_writer import SessionRecorder

Kind = Literal["events", "pictures", "sets", "statuses", "tracks", "spots"]
Write = Callable[[SessionRecorder], None]


@dataclass(frozen=True)
class Gap:
    """Records that are missing between their neighbours in a recording; times are the session's, Unix ns."""

    begin_ns: int  # of the first and of the last that is missing
    end_ns: int
    reason: str
    events: int = 0  # without pictures
    pictures: int = 0
    sets: int = 0
    statuses: int = 0
    tracks: int = 0  # messages of all tracks' reports
    spots: int = 0  # messages of a picture's spots

    def and_then(self, later: Gap) -> Gap:
        """One gap of two with nothing between them; the first reason counts."""
        return Gap(
            min(self.begin_ns, later.begin_ns),
            max(self.end_ns, later.end_ns),
            self.reason,
            self.events + later.events,
            self.pictures + later.pictures,
            self.sets + later.sets,
            self.statuses + later.statuses,
            self.tracks + later.tracks,
            self.spots + later.spots,
        )

    def __str__(self) -> str:
        one, more = ("event", "picture", "set", "status", "report of tracks", "report of spots"), typing.get_args(Kind)
        named = [f"{n} {one[i] if n == 1 else more[i]}" for i, n in enumerate(self.counts) if n]
        return " and ".join([", ".join(named[:-1]), named[-1]] if len(named) > 1 else named)

    def to_json(self) -> bytes:
        return json.dumps(asdict(self), separators=(",", ":")).encode()

    @classmethod
    def from_json(cls, data: bytes) -> Gap:
        """The gap as it was recorded; without times and counts if its record cannot be read."""
        try:
            found = cls(**json.loads(data))
        except (ValueError, TypeError, RecursionError):
            return cls(0, 0, "its gap record cannot be read")
        return (
            found
            if all(isinstance(n, int) for n in (found.begin_ns, found.end_ns, *found.counts))
            else cls(0, 0, "unreadable")
        )

    @property
    def counts(self) -> tuple[int, ...]:
        """Events, pictures, sets, statuses, reports of tracks and of spots."""
        return self.events, self.pictures, self.sets, self.statuses, self.tracks, self.spots


@dataclass(frozen=True, eq=False)
class Entry:
    """One thing to write."""

    kind: Kind
    stamp_ns: int
    size: int  # bytes that it keeps in memory, where these are many
    write: Write

    def missing(self, reason: str) -> Gap:
        """The gap that it leaves."""
        counts = {kind: int(kind == self.kind) for kind in typing.get_args(Kind)}
        return Gap(self.stamp_ns, self.stamp_ns, reason, **counts)


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
