"""The link as the daemon's sink: sets as they come, the status once a second."""

from __future__ import annotations

import json
from types import TracebackType
from typing import Self

from contract.feature_set import FeatureSet
from contract.vehicle_status import VehicleStatus, encode_status
from onboard.config import Config
from onboard.events import Event
from onboard.publisher import Publisher
from onboard.session import Detail


class LinkSink:
    """Opens the link at once. Raises LinkError where that cannot be done."""

    def __init__(self, config: Config) -> None:
        self._publisher = Publisher.open(config)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        return None

    def event(self, arrival_ns: int, event: Event) -> None:
        """Events stay on board."""

    def feature_set(self, output: FeatureSet) -> None:
        """Publish and keep for queries."""
        self._publisher.publish(output)

    def report(self, status: VehicleStatus, detail: Detail) -> None:
        """Publish the status; queries get the detail."""
        self._publisher.publish_status(encode_status(status), json.dumps(detail).encode())

    def close(self) -> None:
        """Leave the link."""
        self._publisher.close()
