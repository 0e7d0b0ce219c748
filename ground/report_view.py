"""Views of the reports of one kind, filled from the link, a journal or a recording by the codec of the table."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from typing import Any, Generic, TypeVar

from contract.wire.message import Payload
from ground.recording import Recording

T = TypeVar("T")


class ReportView(ABC, Generic[T]):
    """Keeps reports of the kind `payload`. Thread-safe."""

    payload: Payload[T]

    @abstractmethod
    def add(self, reports: Iterable[T]) -> None:
        """Take reports, of messages in the order in which they came."""

    def take(self, key: str, payload: bytes) -> None:
        """Take a message of the link; one that is none of the kind is passed over."""
        self.add(self.payload.found(key, payload))

    def read(self, recording: Recording, vehicles: Iterable[str]) -> None:
        """Take what a recording holds of these vehicles."""
        self.add(recording.reports(self.payload, vehicles))


def subscriptions(vehicle: str, *views: ReportView[Any]) -> dict[str, Callable[[str, bytes], object]]:
    """The subscriptions that fill the views, for `SetCache`: of one vehicle, or of all with ANY_VEHICLE."""
    return {view.payload.topic.key(vehicle): view.take for view in views}
