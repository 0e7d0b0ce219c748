"""Hot spots of a recorded flight, found in its pictures as in the air; without a thread, so that the same recording
gives the same spots.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

from contract.feature_set import FeatureSet
from contract.spot import SpotReport
from onboard.config.schema import Config
from onboard.events.types import Event
from onboard.spots.due_pictures import DuePictures
from onboard.spots.spot_book import SpotBook

MAX_HELD = 256  # pictures that wait for their set


class Spotted:
    """A sink: `outlets` are given the spots of each picture that was looked at; `looked` counts those pictures."""

    def __init__(self, config: Config, outlets: Sequence[Callable[[SpotReport], object]]) -> None:
        self._book = SpotBook(config.vehicle.id, config.spots, config.thermal)
        self._due, self._outlets = DuePictures(config.spots.rate_hz, MAX_HELD), outlets
        self.looked = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        return None

    def event(self, arrival_ns: int, event: Event) -> None:
        """Keep a picture until its set comes."""
        self._due.event(event)

    def feature_set(self, output: FeatureSet) -> None:
        """The next picture, if it is due."""
        frame = self._due.take(output)
        report = None if frame is None else self._book.picture(frame, output)
        if report is not None:
            self.looked += 1
            for outlet in self._outlets:
                outlet(report)
