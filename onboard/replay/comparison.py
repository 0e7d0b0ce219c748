"""A replay compared with what was recorded."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from contract.feature_set import FeatureSet
from contract.wire.codec import encode
from onboard.events.types import Event
from onboard.storage.mcap_reader import RecordedFlight


class Comparison:
    """A sink that compares the sets of a replay with those that were recorded, byte for byte."""

    def __init__(self, flight: RecordedFlight) -> None:
        self._recorded = flight.sets()
        self.same = self.different = self.further = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        return None

    def event(self, arrival_ns: int, event: Event) -> None:
        """Events are what is replayed."""

    def feature_set(self, output: FeatureSet) -> None:
        """Compare with the next one recorded."""
        recorded = next(self._recorded, None)
        if recorded is None:
            self.further += 1
        elif recorded == encode(output):
            self.same += 1
        else:
            self.different += 1

    def __str__(self) -> str:
        missing = sum(1 for _ in self._recorded)
        parts = [f"{self.same} of {self.same + self.different + missing} sets byte for byte"]
        if self.further:  # what a session that was killed had no time to finish
            parts.append(f"{self.further} more after its end")
        return ", ".join(parts)
