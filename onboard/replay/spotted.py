"""Hot spots of a recorded flight, found in its pictures as in the air; without a thread, so that the same recording
gives the same spots.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from types import TracebackType
from typing import Self

from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.spot import SpotReport
from onboard.config.schema import Config
from onboard.events.types import Event, Frame
from onboard.spots.looking import Look, looking

MAX_HELD = 256  # pictures that wait for their set


class Spotted:
    """A sink: `outlets` are given the spots of each picture that was looked at.

    `second`: a second camera's optics and pictures, which come in by their stamps; `keepers` are given those of
    them that were looked at.
    """

    def __init__(
        self,
        config: Config,
        outlets: Sequence[Callable[[SpotReport], object]],
        second: tuple[Camera, Iterable[Frame]] | None = None,
    ) -> None:
        self._looking = looking(config, None if second is None else second[0], MAX_HELD)
        self.keepers = self._looking.keepers
        self._outlets = outlets
        self._pictures: Iterator[Frame] = iter(()) if second is None else iter(second[1])
        self._next = next(self._pictures, None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        while error is None and self._next is not None:
            self._second_picture(self._next)

    def event(self, arrival_ns: int, event: Event) -> None:
        """Keep a picture until its set comes; take those of the second camera that were taken before it."""
        while self._next is not None and isinstance(event, Frame) and self._next.stamp_ns <= event.stamp_ns:
            self._second_picture(self._next)
        self._looking.event(event)

    def feature_set(self, output: FeatureSet) -> None:
        self._look(self._looking.feature_set(output))

    def _second_picture(self, frame: Frame) -> None:
        self._look(self._looking.second_picture(frame))
        self._next = next(self._pictures, None)

    def _look(self, looks: list[Look]) -> None:
        for look in looks:
            report = look()
            if report is not None:
                for outlet in self._outlets:
                    outlet(report)
