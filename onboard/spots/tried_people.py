"""People who are put at fixed places of the ground, and who of them would have been named by now. (25.24)

What hides a person in one picture hides him in the next as well, in part: so what several pictures find does not follow
from what each does. The same people are tried in all pictures that show their places, and reported as a spot is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.spot import PERSON_GRID, SURE_PICTURES
from onboard.spots.ground_view import GroundView

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

SEEN, OF = 2, 3  # a spot is reported that is in so many of so many pictures
USUAL, LEAST, MOST = 20.0, 10.0, 40.0  # people in a part of a picture; with fewer or more of them others are chosen
KEPT_NS = 60_000_000_000  # without a look, after which a place is as if it were new
_HALF = 2**30  # rows and columns of places, in one number


@dataclass(frozen=True)
class Tried:
    """The outcome for the people in a picture: the share that it finds, and by its parts, PERSON_GRID row by row, the
    share that has been named by now, None of a part that shows no ground. None and empty if none is in view.
    """

    found: float | None = None
    named: tuple[float | None, ...] = ()


class TriedPeople:
    """Fed with the pictures of a session in order, as they are searched."""

    def __init__(self) -> None:
        self._begin(0.0)

    def _begin(self, step_m: float) -> None:
        self._step_m = step_m
        self._key = np.zeros(0, np.int64)  # of the places, increasing
        self._last_ns = np.zeros(0, np.int64)
        self._looks, self._reports = np.zeros((2, 0), np.int64)
        self._before = np.zeros((OF - 1, 0), bool)  # found in the pictures before, the newest first

    def missed(self) -> None:
        """A picture that was looked at, and whose ground is not known."""
        self._before = np.vstack([np.zeros((1, len(self._key)), bool), self._before[:-1]])

    def look(self, view: GroundView, time_ns: int, found_at: Callable[[Array], tuple[Mask, Mask]]) -> Tried:
        """The next picture. `found_at` is asked for places in it (N, 2), in shares of its height and width: in which a
        person would be found, and which show ground.
        """
        rows, columns = PERSON_GRID
        if not LEAST <= view.area_m2 / (rows * columns) / max(self._step_m, 1e-6) ** 2 <= MOST:
            self._begin(float(np.sqrt(view.area_m2 / (rows * columns) / USUAL)))
        key, at = self._in_view(view)
        found, is_ground = found_at(at)
        key, at, found = key[is_ground], at[is_ground], found[is_ground]
        looks, named = self._count(key, found, time_ns)
        part = (at * PERSON_GRID).astype(np.int64) @ (columns, 1)
        by_part = tuple(_of_most_looks(looks[part == k], named[part == k]) for k in range(rows * columns))
        return Tried(float(found.mean()), by_part) if len(found) else Tried()

    def _in_view(self, view: GroundView) -> tuple[Index, Array]:
        """The keys (N,), increasing, of the places in a picture, and where in it they are (N, 2)."""
        low, high = np.floor(view.box_m / self._step_m).astype(np.int64)
        east, north = (axis.ravel() for axis in np.meshgrid(*map(np.arange, low, high + 1), indexing="ij"))
        at, shown = view.shares(np.column_stack([east + 0.5, north + 0.5]).astype(np.float64) * self._step_m)
        return ((east + _HALF) * 2 * _HALF + north + _HALF)[shown], at[shown]

    def _count(self, key: Index, found: Mask, time_ns: int) -> tuple[Index, Mask]:
        """Take in who is found (N,) at places with those keys (N,); return the looks at each, and who has been named by
        now (N,).
        """
        is_kept = time_ns - self._last_ns <= KEPT_NS
        every = np.union1d(self._key[is_kept], key)
        of_kept, of_key = np.searchsorted(every, self._key[is_kept]), np.searchsorted(every, key)
        last_ns, looks, reports = np.zeros((3, len(every)), np.int64)
        before, now = np.zeros((OF - 1, len(every)), bool), np.zeros(len(every), bool)
        last_ns[of_kept], reports[of_kept] = self._last_ns[is_kept], self._reports[is_kept]
        looks[of_kept] = self._looks[is_kept]
        before[:, of_kept] = self._before[:, is_kept]
        last_ns[of_key], now[of_key] = time_ns, found
        looks[of_key] += 1
        reports += now & (before.sum(axis=0) + 1 >= SEEN)
        self._key, self._last_ns, self._looks, self._reports = every, last_ns, looks, reports
        self._before = np.vstack([now[None], before[:-1]])
        return looks[of_key], np.asarray(reports[of_key] >= SURE_PICTURES)


def _of_most_looks(looks: Index, named: Mask) -> float | None:
    """The share named (N,) of those who were looked at as often as half of them or more (N,); None of no one.

    A part's statement counts when its ground leaves the picture: who came into view after the others has looks to come.
    """
    return float(named[looks >= np.median(looks)].mean()) if len(looks) else None
