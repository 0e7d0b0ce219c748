"""The protocol of everything that yields events to the daemon: cameras, autopilots, receivers.

A source is run in a thread of its own until it is stopped. Whatever the field does to it (unplugged, silent,
garbage, back under another name) is its own business: it reopens for good, reports its state, and raises only for what
a configuration can never make work (`ConfigError`, `InputError`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

from contract.secrets import without_secrets
from contract.supervised_thread import Stop
from onboard.events.types import Event

__all__ = ["AircraftReport", "Emit", "Severity", "Source", "SourceStatus", "State", "Stop", "TelemetrySource"]

Emit = Callable[[int, Event], None]
"""Takes the arrival time (Unix ns of the session's clock) and the event. Never blocks for long."""


class State(Enum):
    """The state of a source. Values are the words users see."""

    STARTING = "starting"
    OK = "ok"
    DEGRADED = "degraded"  # it works, but not as asked: `detail` states what is missing
    LOST = "lost"
    FROZEN = "frozen"  # it comes, but repeats itself


class Severity(Enum):
    """The severity of a message to the people around the aircraft, as in MAVLink's MAV_SEVERITY and syslog."""

    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


@dataclass(frozen=True)
class AircraftReport:
    """An autopilot's report of its aircraft for people to read, as of now; nothing is computed from it."""

    mode: str = ""  # by its name; empty where it is not known
    battery_percent: int | None = None  # left, by the autopilot's own count
    battery_v: float | None = None


@dataclass(frozen=True)
class SourceStatus:
    """The status of a source now. `figures` are named with their unit: `rate_hz`, `dropped`, `round_trip_ms`, ..."""

    state: State
    detail: str = ""
    figures: dict[str, float] = field(default_factory=dict)
    aircraft: AircraftReport = AircraftReport()

    def __post_init__(self) -> None:
        """Addresses, and the last words of a helper that opens them, may hold passwords: nothing passes them on."""
        object.__setattr__(self, "detail", without_secrets(self.detail))


class Source(Protocol):
    """A camera or a telemetry link."""

    def run(self, emit: Emit, stop: Stop) -> None:
        """Hand out events until `stop` is set; returns within a second of it."""

    def health(self) -> SourceStatus:
        """Asked from another thread, at any time, before and after `run` too."""


class TelemetrySource(Source, Protocol):
    """A source that can also speak."""

    def send_text(self, severity: Severity, text: str) -> None:
        """Show a short text (100 characters) to the pilot, where the link can; otherwise nothing happens."""
