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
    """Plays a log once, each packet as long after the first as it came then; then it is lost.

    Where pictures are played too, `pictures_ns`, it is in step with them: what lies before the first of them comes at
    once, with its own time.
    """

    def __init__(self, config: Config, clock: SessionClock, path: Path) -> None:
        self._clock = clock
        self._path = path
        self._autopilot = Autopilot(config)
        self._chosen = config.telemetry.system
        self._is_over = False
        self.pictures_ns: tuple[int, int] | None = None
        """Capture times of the first and the last picture that are played with it, by their own clock, ns."""
        self.shift_ns: int | None = None
        """The session's clock less the log's, ns, once it plays."""

    def run(self, emit: Emit, stop: Stop) -> None:
        """Raises InputError, one line, for a file that is no log, or of other vehicles or of another time."""
        messages, self._autopilot.choice.system = log_messages(self._path, self._chosen)
        if not messages:
            raise InputError(f"telemetry {self._path}: nothing of an autopilot in it")
        shift_ns = self.shift_ns = self._clock.now_ns() - self._begin_ns(messages[0][0], messages[-1][0])
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

    def _begin_ns(self, first_ns: int, last_ns: int) -> int:
        """Return the moment of the log that is now."""
        if self.pictures_ns is None:
            return first_ns
        begin_ns, end_ns = self.pictures_ns
        if begin_ns > last_ns or end_ns < first_ns:
            apart_s = max(begin_ns - last_ns, first_ns - end_ns) / 1e9
            raise InputError(
                f"telemetry {self._path}: it {'ends' if begin_ns > last_ns else 'begins'} {apart_s:.1f} s "
                f"{'before the first' if begin_ns > last_ns else 'after the last'} of the pictures that are played "
                "with it, by the stamps of both: they are not of one flight, or not by one clock"
            )
        return begin_ns

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
