"""A telemetry log in real time, as if it came over a wire now: `telemetry.url = "tlog:FILE"`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from contract.errors import InputError
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.source import Emit, Severity, SourceStatus, State, Stop
from onboard.telemetry.mavlink_session import Autopilot
from onboard.telemetry.tlog_reader import log_messages


class PlayedTelemetry:
    """Plays a log once, each packet as long after the first as it came then; then it is lost."""

    def __init__(self, config: Config, clock: SessionClock, path: Path) -> None:
        self._clock = clock
        self._path = path
        self._autopilot = Autopilot(config)
        self._chosen = config.telemetry.system
        self._is_over = False

    def run(self, emit: Emit, stop: Stop) -> None:
        """Raises InputError, one line, for a file that is no log, or of other vehicles."""
        messages, self._autopilot.choice.system = log_messages(self._path, self._chosen)
        if not messages:
            raise InputError(f"telemetry {self._path}: nothing of an autopilot in it")
        shift_ns = self._clock.now_ns() - messages[0][0]
        for logged_ns, message in messages:
            due_ns = logged_ns + shift_ns
            while not stop.is_set() and (early_ns := due_ns - self._clock.now_ns()) > 0:
                stop.wait(min(early_ns / 1e9, 0.5))
            if stop.is_set():
                break
            # Its own moment and not the one of waking up: how busy this computer is has no part in a log.
            for event in self._autopilot.receive(message, due_ns):
                emit(due_ns, event)
        self._is_over = True
        while not stop.is_set():
            stop.wait(0.5)

    def health(self) -> SourceStatus:
        """Return the status as of a live link; lost at the log's end."""
        health = self._autopilot.health(self._clock.now_ns())
        if self._is_over:
            return SourceStatus(State.LOST, f"the end of {self._path.name}", health.figures)
        if health.state is State.DEGRADED:  # a log answers no requests
            return replace(health, state=State.OK)
        return health

    def send_text(self, severity: Severity, text: str) -> None:
        """A log shows no texts: nothing happens."""
