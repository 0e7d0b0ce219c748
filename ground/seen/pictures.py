"""The pictures that have seen a cell: of each the runs of cells in its rows, all in a few long arrays."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.seen.picture_cells import PictureCells, PictureView

Key = tuple[str, int, int]  # vehicle, session, frame

MOST_PICTURES = 20_000  # an hour at five a second; in 2 m cells some 35 MB
RUN = np.dtype([("row", "i4"), ("first", "i4"), ("last", "i4"), ("gsd_m", "f4"), ("picture", "i4")])
FIRST_SIZE = 4096


class Shown(NamedTuple):
    """A picture that has seen a place, and how finely: metres of ground from pixel to pixel."""

    vehicle: str
    session: int
    frame: int
    capture_unix_ns: int
    gsd_m: float


class Look(NamedTuple):
    """A picture and, when they are asked for, its cells."""

    key: Key
    capture_unix_ns: int
    cells: Callable[[], PictureCells]


class Pictures:
    """The last MOST_PICTURES that were added; older ones are still counted."""

    def __init__(self) -> None:
        self.counted = 0  # that have seen something
        self._number: dict[Key, int] = {}  # in the order of adding
        self._about: dict[int, tuple[Key, int, PictureView | None]] = {}
        self._next = 0
        self._runs = np.zeros(FIRST_SIZE, RUN)
        self._from = self._to = 0  # of the runs that are held
        # By vehicle and session: the newest capture among the pictures that were dropped.
        self._dropped_ns: dict[tuple[str, int], int] = {}

    def __len__(self) -> int:
        return len(self._number)

    @property
    def forgotten(self) -> int:
        return self._next - len(self._number)

    def knows(self, key: Key, capture_unix_ns: int) -> bool:
        """Return whether a picture was added, or is no newer than one that was dropped."""
        return key in self._number or capture_unix_ns <= self._dropped_ns.get(key[:2], -1)

    def add(self, key: Key, capture_unix_ns: int, cells: PictureCells) -> None:
        """A picture with its cells, in the order of rows and columns."""
        self.counted += len(cells) > 0
        number = self._next
        self._next += 1
        self._number[key], self._about[number] = number, (key, capture_unix_ns, cells.view)
        runs = _runs(cells, number)
        if self._to + len(runs) > len(self._runs):
            held = self._runs[self._from : self._to]
            self._runs = np.zeros(max(2 * (len(held) + len(runs)), FIRST_SIZE), RUN)
            self._runs[: len(held)] = held
            self._from, self._to = 0, len(held)
        self._runs[self._to : self._to + len(runs)] = runs
        self._to += len(runs)
        if len(self._number) > MOST_PICTURES:
            self._drop()

    def showing(self, row: int, column: int, most: int) -> list[Shown]:
        """The pictures that have seen a cell, in the order of adding; of more than `most`, as many chosen evenly."""
        runs = self._runs[self._from : self._to]
        there = runs[np.flatnonzero(runs["row"] == row)]
        there = there[(there["first"] <= column) & (column <= there["last"])]
        if len(there) > most:
            there = there[np.linspace(0, len(there) - 1, most).round().astype(np.int64)]
        out = []
        for number, gsd_m in zip(there["picture"].tolist(), there["gsd_m"].tolist(), strict=True):
            key, capture_unix_ns, _ = self._about[number]
            out.append(Shown(*key, capture_unix_ns, gsd_m))
        return out

    def looks(self) -> list[Look]:
        """All that are held, in the order of adding."""
        runs = self._runs[self._from : self._to]
        ends = np.searchsorted(runs["picture"], [*self._about, self._next])
        return [
            Look(key, capture_unix_ns, partial(_cells, runs[low:high], view))
            for (key, capture_unix_ns, view), low, high in zip(self._about.values(), ends, ends[1:], strict=False)
        ]

    def capture_unix_ns(self, key: Key) -> int | None:
        """The moment when a picture was taken; None if it is not among the last."""
        number = self._number.get(key)
        return None if number is None else self._about[number][1]

    def _drop(self) -> None:
        """The oldest by the order of adding."""
        key = next(iter(self._number))
        number = self._number.pop(key)
        capture_unix_ns = self._about.pop(number)[1]
        self._dropped_ns[key[:2]] = max(capture_unix_ns, self._dropped_ns.get(key[:2], -1))
        held = self._runs["picture"][self._from : self._to]
        self._from += int(np.searchsorted(held, number, side="right"))


def _cells(runs: NDArray[np.void], view: PictureView | None) -> PictureCells:
    """The cells of a picture's runs."""
    counts = runs["last"] - runs["first"] + 1
    within = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
    column = np.repeat(runs["first"], counts) + within
    return PictureCells(np.repeat(runs["row"], counts).astype(np.int64), column, np.repeat(runs["gsd_m"], counts), view)


def _runs(cells: PictureCells, number: int) -> NDArray[np.void]:
    """Neighbours in a row as one, with their mean ground sample distance."""
    if not len(cells):
        return np.zeros(0, RUN)
    starts = np.flatnonzero(np.r_[True, (np.diff(cells.row) != 0) | (np.diff(cells.column) != 1)])
    ends = np.r_[starts[1:], len(cells)]
    out = np.zeros(len(starts), RUN)
    out["row"], out["first"], out["last"] = cells.row[starts], cells.column[starts], cells.column[ends - 1]
    out["gsd_m"] = np.add.reduceat(cells.gsd_m, starts) / (ends - starts)
    out["picture"] = number
    return out
