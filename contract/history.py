"""One vehicle's sets, bounded by age and number, each frame at its latest revision."""

from __future__ import annotations

from bisect import bisect_left, insort
from dataclasses import dataclass
from typing import Generic, TypeVar

from contract.feature_set import FeatureSet, Status
from contract.topics import TIME_TOLERANCE_S

T = TypeVar("T")

# Sets in a row of a session that is not plainly a new one, before it is taken for the one that runs. A session's number
# is the clock's second at its beginning, so a lower one is nearly always a late packet; after so many it is an aircraft
# whose clock was set back before it restarted.
IN_A_ROW = 5
MAX_SESSIONS = 2  # whose sets are kept: of the one that runs and of the last other one received


@dataclass(frozen=True)
class Entry(Generic[T]):
    """One frame's set as it is kept, and what belongs to it."""

    frame: int
    revision: int
    capture_unix_ns: int
    status: Status
    item: T

    @property
    def is_ok(self) -> bool:
        """Whether the set answers clicks."""
        return self.status is Status.OK


class History(Generic[T]):
    """Items (payloads, sets) by frame and by capture time. Ages are counted between captures: it has no clock.

    All that is returned is of one session, the one that runs. It is the highest ever received, so that packets of an
    earlier one that come late change nothing; but IN_A_ROW sets of another make that the one that runs, with all of its
    sets that were received.
    """

    def __init__(self, max_age_s: float = 600.0, max_sets: int = 5000) -> None:
        self.max_age_s = max_age_s
        self.max_sets = max_sets
        self._sessions: dict[int, _Session[T]] = {}
        self._current: _Session[T] = _Session(-1)
        self._highest = -1
        self._last, self._in_a_row = -1, 0

    def __len__(self) -> int:
        return len(self._current.entries)

    @property
    def session(self) -> int | None:
        """Number of the session that runs; None before the first set."""
        return None if self._current.number < 0 else self._current.number

    def add(self, feature_set: FeatureSet, item: T, *, is_running: bool = True) -> None:
        """Keep a set; a revision older than the one held is dropped.

        `is_running` False: it did not come by itself just now, so it does not show which session runs, except by being
        of a higher one.
        """
        s = feature_set
        if is_running:
            self._in_a_row = self._in_a_row + 1 if s.session == self._last else 1
            self._last = s.session
        session = self._sessions.get(s.session)
        if session is None:
            session = self._sessions[s.session] = _Session(s.session)
        session.add(Entry(s.frame, s.revision, s.capture_unix_ns, s.status, item), self.max_age_s, self.max_sets)
        if s.session > self._highest or (is_running and self._in_a_row >= IN_A_ROW):
            self._current = session
        self._highest = max(self._highest, s.session)
        if len(self._sessions) > MAX_SESSIONS:
            kept = {self._current.number, s.session}
            for number in [n for n in self._sessions if n not in kept][: len(self._sessions) - MAX_SESSIONS]:
                del self._sessions[number]

    def newest_answer(self) -> Entry[T] | None:
        """The newest set that answers clicks; None if none does."""
        return self._current.newest_answer()

    def newest_picture(self) -> Entry[T] | None:
        """The newest set whether it answers or refuses; None if there is nothing."""
        return self._current.newest_picture()

    def newest_entry(self) -> Entry[T] | None:
        """The newest set that answers clicks; the newest refusal if none does; None if there is nothing."""
        return self.newest_answer() or self.newest_picture()

    def ordered(self) -> list[Entry[T]]:
        """All entries, in capture order."""
        return self._current.ordered()

    def entry(self, frame: int) -> Entry[T] | None:
        """The set of a frame with what belongs to it."""
        return self._current.entries.get(frame)

    def nearest_entry(self, unix_s: float) -> Entry[T] | None:
        """The set captured nearest to a time, within TIME_TOLERANCE_S, with what belongs to it."""
        return self._current.nearest(round(unix_s * 1e9))

    def newest(self) -> T | None:
        """The item of `newest_entry`."""
        return _item(self.newest_entry())

    def frame(self, frame: int) -> T | None:
        """The item of a frame."""
        return _item(self.entry(frame))

    def nearest(self, unix_s: float) -> T | None:
        """The item of `nearest_entry`."""
        return _item(self.nearest_entry(unix_s))


class _Session(Generic[T]):
    """The sets of one session."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.entries: dict[int, Entry[T]] = {}  # by frame
        self._order: list[tuple[int, int]] = []  # (capture_unix_ns, frame), sorted
        self._newest_ok: tuple[int, int] | None = None  # the same, of the newest set that answers

    def add(self, entry: Entry[T], max_age_s: float, max_sets: int) -> None:
        held = self.entries.get(entry.frame)
        if held is not None:
            if held.revision > entry.revision:
                return
            self._forget(held.capture_unix_ns, entry.frame)
        key = entry.capture_unix_ns, entry.frame
        self.entries[entry.frame] = entry
        insort(self._order, key)
        if entry.is_ok and (self._newest_ok is None or key > self._newest_ok):
            self._newest_ok = key
        oldest = self._order[-1][0] - round(max_age_s * 1e9)
        while len(self._order) > max_sets or self._order[0][0] < oldest:
            self._forget(*self._order[0])

    def newest_answer(self) -> Entry[T] | None:
        return None if self._newest_ok is None else self.entries[self._newest_ok[1]]

    def newest_picture(self) -> Entry[T] | None:
        return self.entries[self._order[-1][1]] if self._order else None

    def ordered(self) -> list[Entry[T]]:
        return [self.entries[frame] for _, frame in self._order]

    def nearest(self, asked_ns: int) -> Entry[T] | None:
        after = bisect_left(self._order, (asked_ns, -1))
        near = min(self._order[max(after - 1, 0) : after + 1], key=lambda e: abs(e[0] - asked_ns), default=None)
        if near is None or abs(near[0] - asked_ns) > TIME_TOLERANCE_S * 1e9:
            return None
        return self.entries[near[1]]

    def _forget(self, capture_unix_ns: int, frame: int) -> None:
        self._order.remove((capture_unix_ns, frame))
        del self.entries[frame]
        if self._newest_ok == (capture_unix_ns, frame):
            self._newest_ok = max((e for e in self._order if self.entries[e[1]].is_ok), default=None)


def _item(entry: Entry[T] | None) -> T | None:
    return None if entry is None else entry.item
