"""The pictures that the window can still place: which have no set yet, and which the window has seen past."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from contract.feature_set import Status
from onboard.pipeline.picture_record import Record


class RecordBook:
    """Records in the order of capture, and two queues of them: to be placed, and to be placed for the last time."""

    def __init__(self) -> None:
        self.records: list[Record] = []
        self.unplaced: deque[Record] = deque()  # the newest is placed first
        self.settling: deque[Record] = deque()  # the oldest is settled first

    def add(self, record: Record) -> None:
        """A picture that the window can place from now on."""
        self.records.append(record)

    def queue(self, frames: Sequence[int], behind: int) -> None:
        """After a solve of keyframes `frames`: what has no set yet, and what lies `behind` or more keyframes back.

        Settled pictures before the window are forgotten.
        """
        self.unplaced = deque(r for r in self.records if r.status is not Status.OK and not r.is_for_later)
        passed = len(frames) - 1 - behind
        if passed >= 0:
            queued = set(map(id, self.settling))
            found = [r for r in self.records if r.frame.index <= frames[passed] and not r.is_settled]
            self.settling.extend(r for r in found if id(r) not in queued)
        self.records = [r for r in self.records if r.frame.index > frames[0] or not r.is_settled]

    def take_all(self) -> list[Record]:
        """All records; the book is empty then."""
        records, self.records = self.records, []
        self.settling.clear()
        self.unplaced.clear()
        return records

    def take_before(self, record: Record) -> list[Record]:
        """The records before one, which begins the book again with those after it."""
        rest = [record, *(r for r in self.records if r.frame.index > record.frame.index)]
        before = [r for r in self.take_all() if r.frame.index < record.frame.index]
        self.records = rest
        return before
