"""One vehicle's sets, bounded by age and number, each frame at its latest revision."""

from __future__ import annotations

from bisect import bisect_left, insort
from dataclasses import dataclass
from typing import Generic, TypeVar

from contract.feature_set import FeatureSet
from contract.topics import TIME_TOLERANCE_S

T = TypeVar("T")


@dataclass(frozen=True)
class _Entry(Generic[T]):
    capture_unix_ns: int
    revision: int
    is_ok: bool
    item: T


class History(Generic[T]):
    """Items (payloads, sets) by frame and by capture time. Ages are counted between captures: it has no clock."""

    def __init__(self, max_age_s: float = 600.0, max_sets: int = 5000) -> None:
        self.max_age_s = max_age_s
        self.max_sets = max_sets
        self._session = -1
        self._entries: dict[int, _Entry[T]] = {}  # by frame
        self._order: list[tuple[int, int]] = []  # (capture_unix_ns, frame), sorted
        self._newest_ok: tuple[int, int] | None = None  # the same, of the newest set that answers

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, feature_set: FeatureSet, item: T) -> None:
        """Keep a set; a revision older than the one held is dropped, and so is everything of an earlier session."""
        s = feature_set
        if s.session != self._session:
            self._entries.clear()
            self._order.clear()
            self._newest_ok = None
            self._session = s.session
        held = self._entries.get(s.frame)
        if held is not None:
            if held.revision > s.revision:
                return
            self._forget(held.capture_unix_ns, s.frame)
        self._entries[s.frame] = _Entry(s.capture_unix_ns, s.revision, s.is_ok, item)
        insort(self._order, (s.capture_unix_ns, s.frame))
        if s.is_ok and (self._newest_ok is None or (s.capture_unix_ns, s.frame) > self._newest_ok):
            self._newest_ok = (s.capture_unix_ns, s.frame)
        oldest = self._order[-1][0] - round(self.max_age_s * 1e9)
        while len(self._order) > self.max_sets or self._order[0][0] < oldest:
            self._forget(*self._order[0])

    def newest(self) -> T | None:
        """The newest set that answers clicks; the newest refusal if none does; None if there is nothing."""
        if self._newest_ok is not None:
            return self._entries[self._newest_ok[1]].item
        return self._entries[self._order[-1][1]].item if self._order else None

    def frame(self, frame: int) -> T | None:
        """The set of a frame."""
        entry = self._entries.get(frame)
        return entry.item if entry else None

    def nearest(self, unix_s: float) -> T | None:
        """The set captured nearest to a time, within TIME_TOLERANCE_S."""
        asked = round(unix_s * 1e9)
        after = bisect_left(self._order, (asked, -1))
        near = min(self._order[max(after - 1, 0) : after + 1], key=lambda e: abs(e[0] - asked), default=None)
        if near is None or abs(near[0] - asked) > TIME_TOLERANCE_S * 1e9:
            return None
        return self._entries[near[1]].item

    def _forget(self, capture_unix_ns: int, frame: int) -> None:
        self._order.remove((capture_unix_ns, frame))
        del self._entries[frame]
        if self._newest_ok == (capture_unix_ns, frame):
            self._newest_ok = max((e for e in self._order if self._entries[e[1]].is_ok), default=None)
