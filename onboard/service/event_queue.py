"""Between the sources and the pipeline: events in order of arrival. Telemetry is never dropped, pictures are.

A computer that cannot keep up must show a picture of now, not of a minute ago: pictures that have waited too long, or
that are too many, are dropped, oldest first, before anything has been recorded of them. A burst of work has all of the
time that is allowed; where the queue stands, pictures wait a fifth of it. Otherwise each would wait as long as is
allowed for as long as the load lasts, and no more of them would be handled.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from onboard.events.types import Event, Frame

MAX_PICTURES = 64  # grey 640x480: 20 MB
STANDING = 0.2
"""A queue stands if, for as long as a picture may wait, each one that left it had waited for more than this share."""


@dataclass
class _Entry:
    put_ns: int
    arrival_ns: int
    event: Event | None  # None: a picture that has been dropped


class EventQueue:
    """Filled by the sources' threads, emptied by the pipeline's."""

    def __init__(self, now_ns: Callable[[], int], max_delay_s: float, max_pictures: int = MAX_PICTURES) -> None:
        self.max_delay_s = max_delay_s
        self._now_ns, self._max_pictures = now_ns, max_pictures
        self._entries: deque[_Entry] = deque()
        self._pictures: deque[_Entry] = deque()  # those of the entries that hold one
        self._long_since_ns: int | None = None  # each picture that left since then had waited long
        self._stands = False
        self._changed = threading.Condition()
        self._is_closed = False
        self._dropped = 0
        self._dropped_at_ns: int | None = None

    def put(self, arrival_ns: int, event: Event) -> None:
        """Take an event; after `close`, nothing."""
        with self._changed:
            if self._is_closed:
                return
            now_ns = self._now_ns()
            entry = _Entry(now_ns, arrival_ns, event)
            if isinstance(event, Frame):
                self._shed(now_ns, self._max_pictures - 1)
                self._pictures.append(entry)
            self._entries.append(entry)
            self._changed.notify()

    def get(self, timeout_s: float) -> tuple[int, Event] | None:
        """The next event and its arrival; None if none came in time, or none will."""
        with self._changed:
            while True:
                self._shed(self._now_ns(), self._max_pictures)
                while self._entries:
                    entry = self._entries.popleft()
                    if entry.event is not None:
                        if self._pictures and self._pictures[0] is entry:
                            self._pictures.popleft()
                            self._note_wait(entry)
                        return entry.arrival_ns, entry.event
                if self._is_closed or not self._changed.wait(timeout_s):
                    return None

    def close(self) -> None:
        """Nothing more comes; what waits can still be had."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    @property
    def is_over(self) -> bool:
        with self._changed:
            return self._is_closed and not self._entries

    @property
    def dropped(self) -> int:
        return self._dropped

    def dropped_within(self, seconds: float) -> bool:
        """Return whether a picture was dropped in the last `seconds`."""
        at_ns = self._dropped_at_ns
        return at_ns is not None and self._now_ns() - at_ns < seconds * 1e9

    def _shed(self, now_ns: int, keep: int) -> None:
        allowed_ns = round(self.max_delay_s * 1e9)
        if self._long_since_ns is not None and now_ns - self._long_since_ns > allowed_ns:
            self._stands = True
        elif not self.dropped_within(self.max_delay_s):
            self._stands = False
        while self._pictures:
            waited_ns = now_ns - self._pictures[0].put_ns
            stale = waited_ns > allowed_ns or (self._stands and len(self._pictures) > 1 and self._is_long(waited_ns))
            if not stale and len(self._pictures) <= keep:
                return
            self._pictures.popleft().event = None
            self._dropped += 1
            self._dropped_at_ns = now_ns

    def _note_wait(self, picture: _Entry) -> None:
        now_ns = self._now_ns()
        if not self._is_long(now_ns - picture.put_ns):
            self._long_since_ns = None
        elif self._long_since_ns is None:
            self._long_since_ns = now_ns

    def _is_long(self, waited_ns: int) -> bool:
        return waited_ns > STANDING * self.max_delay_s * 1e9
