"""One vehicle's sets, bounded by age and number, each frame at its latest revision."""

from __future__ import annotations

from bisect import bisect_left, insort
from dataclasses import dataclass
from typing import Generic, TypeVar

from contract.feature_set import FeatureSet, Status
from contract.topics import TIME_TOLERANCE_S
from contract.wire.codec import Identity

T = TypeVar("T")

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
        return self.status is Status.OK


class History(Generic[T]):
    """Items (payloads, sets) by frame and by capture time. Ages are counted between captures: it has no clock.

    All that is returned is of one session, the one that runs. A session's number is the clock's second at its
    beginning, or higher: of two the higher one is the later, and an earlier one never replaces a later one by itself.
    `run` does, for who knows that an aircraft began again with its clock set back.
    """

    def __init__(self, max_age_s: float = 600.0, max_sets: int = 5000) -> None:
        self.max_age_s = max_age_s
        self.max_sets = max_sets
        self._sessions: dict[int, _Session[T]] = {}
        self._current: _Session[T] = _Session(-1)
        self._highest = -1  # of those that ran

    def __len__(self) -> int:
        return len(self._current.entries)

    @property
    def session(self) -> int | None:
        """Number of the session that runs; None before the first set."""
        return None if self._current.number < 0 else self._current.number

    @property
    def highest(self) -> int:
        """The highest number of a session that ran; -1 before the first."""
        return self._highest

    def add(self, feature_set: FeatureSet | Identity, item: T, *, runs: bool | None = None) -> None:
        """Keep a set; a revision older than the one held is dropped.

        `runs`: whether its session is the one that runs from now on, if it is not already; without it, if its number
        is higher than that of any that ran.
        """
        s = feature_set
        session = self._of(s.session)
        session.add(Entry(s.frame, s.revision, s.capture_unix_ns, s.status, item), self.max_age_s, self.max_sets)
        if s.session > self._highest if runs is None else runs:
            self.run(s.session)
        if len(self._sessions) > MAX_SESSIONS:
            kept = {self._current.number, s.session}
            for number in [n for n in self._sessions if n not in kept][: len(self._sessions) - MAX_SESSIONS]:
                del self._sessions[number]

    def run(self, session: int) -> None:
        """Make this session the one that runs, with those of its sets that are kept."""
        self._current = self._of(session)
        self._highest = max(self._highest, session)

    def forget_after(self, session: int, unix_ns: int) -> None:
        """Drop the sets of a session that are stamped later than this."""
        if session in self._sessions:
            self._sessions[session].forget_after(unix_ns)

    def forget(self, session: int, frame: int) -> None:
        """Drop the set of a frame; nothing happens where there is none."""
        if session in self._sessions:
            self._sessions[session].forget(frame)

    @property
    def sessions(self) -> list[int]:
        return list(self._sessions)

    def span_ns(self, session: int) -> tuple[int, int] | None:
        """The capture times of the first and the newest picture that are kept of a session, which runs or not; None of
        one without any.
        """
        held = self._sessions.get(session)
        entries = [] if held is None else held.ordered()
        return (entries[0].capture_unix_ns, entries[-1].capture_unix_ns) if entries else None

    def _of(self, session: int) -> _Session[T]:
        return self._sessions.setdefault(session, _Session(session))

    def newest_answer(self) -> Entry[T] | None:
        return self._current.newest_answer()

    def newest_picture(self) -> Entry[T] | None:
        return self._current.newest_picture()

    def newest_entry(self) -> Entry[T] | None:
        """The newest set that answers clicks; the newest refusal if none does; None if there is nothing."""
        return self.newest_answer() or self.newest_picture()

    def ordered(self) -> list[Entry[T]]:
        return self._current.ordered()

    def entry(self, frame: int) -> Entry[T] | None:
        return self._current.entries.get(frame)

    def nearest_entry(self, unix_s: float) -> Entry[T] | None:
        """The set captured nearest to a time, within TIME_TOLERANCE_S, with what belongs to it."""
        return self._current.nearest(round(unix_s * 1e9))

    def newest(self) -> T | None:
        return _item(self.newest_entry())

    def frame(self, frame: int) -> T | None:
        return _item(self.entry(frame))

    def nearest(self, unix_s: float) -> T | None:
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

    def forget_after(self, unix_ns: int) -> None:
        while self._order and self._order[-1][0] > unix_ns:
            self._forget(*self._order[-1])

    def forget(self, frame: int) -> None:
        if frame in self.entries:
            self._forget(self.entries[frame].capture_unix_ns, frame)

    def _forget(self, capture_unix_ns: int, frame: int) -> None:
        self._order.remove((capture_unix_ns, frame))
        del self.entries[frame]
        if self._newest_ok == (capture_unix_ns, frame):
            self._newest_ok = max((e for e in self._order if self.entries[e[1]].is_ok), default=None)


def _item(entry: Entry[T] | None) -> T | None:
    return None if entry is None else entry.item
