"""Views of the reports of one kind, filled from the link, a journal or a recording by the codec of the table."""

from __future__ import annotations

import time
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

    def received(self, reports: Iterable[tuple[int, T]]) -> None:
        """Take reports with the times (Unix ns, the ground's clock) at which they came, in that order."""
        self.add(report for _, report in reports)

    def take(self, key: str, payload: bytes, received_unix_ns: int | None = None) -> None:
        """Take a message of the link that came now, or then; one that is none of the kind is passed over."""
        came_ns = time.time_ns() if received_unix_ns is None else received_unix_ns
        self.received([(came_ns, report) for report in self.payload.found(key, payload)])

    def read(self, recording: Recording, vehicles: Iterable[str]) -> None:
        self.received(recording.received(self.payload, vehicles))


def subscriptions(vehicle: str, *views: ReportView[Any]) -> dict[str, Callable[[str, bytes], object]]:
    """The subscriptions that fill the views, for `SetCache`: of one vehicle, or of all with ANY_VEHICLE."""
    return {view.payload.topic.key(vehicle): view.take for view in views}
