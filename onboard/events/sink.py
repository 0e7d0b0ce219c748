"""The protocol of receivers of events and feature sets: the link, a recording, a comparison."""

from __future__ import annotations

from types import TracebackType
from typing import Protocol, Self

from contract.feature_set import FeatureSet
from onboard.events.types import Event


class Sink(Protocol):
    """A receiver of events and feature sets. Entered before the first event; left after the last, or with the error."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None: ...

    def event(self, arrival_ns: int, event: Event) -> None:
        """Take one event as it enters the pipeline."""

    def feature_set(self, output: FeatureSet) -> None:
        """Take one feature set as it leaves the pipeline."""
