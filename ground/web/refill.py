"""The sets that an aircraft still has of the minutes before this server listened: asked for, the newest first.

The aircraft keeps ten minutes. Its replies share the link with what it sends by itself, so one is asked for at a time,
and after each there is a pause of some times what it took.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from contract.feature_set import FeatureSet
from ground.watched_thread import WatchedThread

BACK_S = 600.0  # what an aircraft keeps, by default
STEP_S = 2.0  # of flight, between the sets that are asked for
LEAST_PAUSE_S, PAUSE = 0.2, 4.0  # of what a reply took
MOST_MISSES = 15  # in a row: before that it has nothing, or it does not answer


@dataclass(eq=False)
class _Task:
    session: int
    next_s: float  # capture time, Unix
    until_s: float
    misses: int = 0


class Refill:
    """Goes back in time, vehicle by vehicle, in a thread of its own.

    `newest(vehicle)`: session and capture time (Unix s) of the newest set; None before the first. `has(vehicle, unix_s,
    within_s)`: whether there is a set near that time. `ask(vehicle, unix_s)`: the aircraft's set nearest to that time,
    kept; None if it has none or does not answer.
    """

    def __init__(
        self,
        vehicles: Callable[[], list[str]],
        newest: Callable[[str], tuple[int, float] | None],
        has: Callable[[str, float, float], bool],
        ask: Callable[[str, float], FeatureSet | None],
        back_s: float = BACK_S,
    ) -> None:
        self._vehicles, self._newest, self._has, self._ask, self._back_s = vehicles, newest, has, ask, back_s
        self._tasks: dict[str, _Task] = {}
        self._not_before_s = 0.0
        self._thread = WatchedThread("refill from the aircraft", self.step, 0.1)

    def step(self) -> None:
        """Ask one aircraft for one set, if it is time and one is missing."""
        if time.monotonic() < self._not_before_s:
            return
        for vehicle in self._vehicles():
            task = self._task(vehicle)
            while task is not None and task.next_s > task.until_s and self._has(vehicle, task.next_s, 0.5 * STEP_S):
                task.next_s -= STEP_S
            if task is None or task.next_s <= task.until_s or task.misses >= MOST_MISSES:
                continue
            began_s = time.monotonic()
            found = self._ask(vehicle, task.next_s)
            took_s = time.monotonic() - began_s
            task.misses = 0 if found is not None else task.misses + 1
            task.next_s -= STEP_S
            self._not_before_s = time.monotonic() + max(LEAST_PAUSE_S, PAUSE * took_s)
            return

    def close(self) -> None:
        self._thread.close()

    def _task(self, vehicle: str) -> _Task | None:
        """The sets still to ask of a vehicle; of a session that begins while this listens, everything again."""
        newest = self._newest(vehicle)
        if newest is None:
            return None
        session, unix_s = newest
        task = self._tasks.get(vehicle)
        if task is None or task.session != session:
            task = self._tasks[vehicle] = _Task(session, unix_s - STEP_S, unix_s - self._back_s)
        return task
