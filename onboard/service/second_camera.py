"""The second camera's thread: its pictures go to what looks for hot spots, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Self

from contract.feature_set import FeatureSet
from contract.supervised_thread import END_S, Policy, SupervisedThread
from onboard.events.source import Source
from onboard.events.types import Event, Frame

LATE_S = 10.0  # a source asks each second whether to end; opening a device may take it some seconds


class SecondCameraThread:
    """Runs `source` as long as the session lasts, as one of its sinks; begun again whatever becomes of it: the flight
    does without.
    """

    def __init__(self, source: Source, take: Callable[[Frame], object]) -> None:
        self.source, self._take = source, take
        self.thread = SupervisedThread("thermal camera", self._run, Policy.RESTART, late_after_s=LATE_S)

    def __enter__(self) -> Self:
        self.thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.thread.end()
        self.thread.join(END_S)

    def event(self, arrival_ns: int, event: Event) -> None:
        """The first camera's and the autopilot's, which are no concern of this one."""

    def feature_set(self, output: FeatureSet) -> None:
        """Ignore it, as `event` does."""

    def _run(self, thread: SupervisedThread) -> None:
        self.source.run(self._emit, thread)

    def _emit(self, arrival_ns: int, event: Event) -> None:
        if isinstance(event, Frame):
            self._take(event)
