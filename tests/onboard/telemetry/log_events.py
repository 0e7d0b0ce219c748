"""A log as it was read."""

from typing import Any

from onboard.events.types import NavEvent
from onboard.telemetry.telemetry_log import TelemetryLog


def of(log: TelemetryLog, kind: type[NavEvent]) -> list[Any]:
    return [event for event in log.events if isinstance(event, kind)]
