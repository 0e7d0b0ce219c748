"""A SIYI gimbal next to the autopilot: asked for its attitude and zoom over UDP, by `mount.gimbal_url`.

Its answers have no stamps, so each counts for the middle between its request and itself: it is off by half the round
trip at most, but for what the gimbal itself takes.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from functools import partial

from contract.errors import ConfigError
from contract.supervised_thread import Policy, SupervisedThread
from onboard.events.session_clock import SessionClock
from onboard.events.source import Emit, Severity, SourceStatus, State, Stop, TelemetrySource
from onboard.events.types import GimbalAttitude, Zoom
from onboard.telemetry.siyi_protocol import (
    ATTITUDE,
    ZOOM,
    ZOOM_STEP,
    Packet,
    PacketReader,
    attitude_deg,
    encode,
    zoom_times,
)
from onboard.telemetry.telemetry_log import quaternion
from onboard.telemetry.transports import Address

NS_PER_S = 1_000_000_000
READ_S = 0.02
REOPEN_S = 0.5
EVERY_NS = {ATTITUDE: NS_PER_S // 25, ZOOM: NS_PER_S // 10}
ANSWER_NS = NS_PER_S // 4  # to wait for an answer before asking again
LATE_AFTER_S = 10.0


def siyi_address(url: str) -> Address:
    """Return the address that `mount.gimbal_url` names. Raises ConfigError, one line, for what can never be opened."""
    scheme, _, rest = url.partition(":")
    if scheme != "siyi":
        raise ConfigError(f"mount.gimbal_url {url!r}: unknown kind {scheme!r}; write siyi:HOST:PORT")
    place, _, number = rest.rpartition(":")
    if not place or not number.isdecimal() or not 0 < int(number) < 65536:
        raise ConfigError(f"mount.gimbal_url {url!r}: write siyi:HOST:PORT, such as siyi:192.168.144.25:37260")
    return Address("udpout", place.strip("[]"), int(number))


class SiyiAnswers:
    """Requests out, events in. No socket, no thread, no clock of its own."""

    def __init__(self) -> None:
        self.reader = PacketReader()
        self.received_ns: int | None = None  # of the newest attitude
        self.round_trip_ns = 0
        self._asked: dict[int, int] = {}  # command -> when its open request left
        self._due = dict.fromkeys(EVERY_NS, 0)
        self._sequence = 0

    def due(self, now_ns: int) -> list[bytes]:
        """Return the packets to send now. One request of a kind is open at a time: an answer is known to be its."""
        out = []
        for command, due_ns in self._due.items():
            asked_ns = self._asked.get(command)
            if now_ns < due_ns or (asked_ns is not None and now_ns - asked_ns < ANSWER_NS):
                continue
            self._asked[command], self._due[command] = now_ns, now_ns + EVERY_NS[command]
            out.append(encode(Packet(command, sequence=self._sequence)))
            self._sequence += 1
        return out

    def take(self, data: bytes, now_ns: int) -> list[GimbalAttitude | Zoom]:
        """Return the events of data that came in, maybe none. An answer to no open request is passed over."""
        out: list[GimbalAttitude | Zoom] = []
        for packet in self.reader.feed(data):
            asked_ns = self._asked.pop(packet.command, None)
            if asked_ns is None or now_ns - asked_ns > ANSWER_NS:
                continue
            stamp_ns = (asked_ns + now_ns) // 2
            angles, times = attitude_deg(packet), zoom_times(packet)
            if angles is not None:
                self.received_ns, self.round_trip_ns = now_ns, now_ns - asked_ns
                out.append(GimbalAttitude(stamp_ns, quaternion(angles), "vehicle"))
            elif times is not None:
                out.append(Zoom(stamp_ns, times, "times", ZOOM_STEP))
        return out


class SiyiGimbal:
    """A `Source` of `GimbalAttitude` and `Zoom`."""

    def __init__(self, clock: SessionClock, address: Address, lost_after_s: float) -> None:
        self._clock, self._address, self._lost_after_s = clock, address, lost_after_s
        self._answers = SiyiAnswers()
        self._fault = ""

    def run(self, emit: Emit, stop: Stop) -> None:
        """Until `stop`: open, ask, and open again."""
        while not stop.is_set():
            try:
                with closing(self._address.open()) as wire:
                    self._fault = ""
                    while not stop.is_set():
                        for request in self._answers.due(self._clock.now_ns()):
                            wire.write(request)
                        data = wire.read(READ_S)
                        now_ns = self._clock.now_ns()
                        for event in self._answers.take(data, now_ns):
                            emit(now_ns, event)
            except OSError as error:
                self._fault = f"cannot reach {self._address.place}: {error.strerror or error}"
                stop.wait(REOPEN_S)

    def health(self) -> SourceStatus:
        """Return the gimbal's status; from any thread."""
        answers, now_ns = self._answers, self._clock.now_ns()
        figures = {"gimbal_damaged": float(answers.reader.damaged), "gimbal_garbage": float(answers.reader.garbage)}
        if answers.received_ns is None:
            return SourceStatus(State.STARTING, self._fault or "the gimbal has not answered yet", figures)
        figures["gimbal_round_trip_ms"] = answers.round_trip_ns / 1e6
        silent_s = (now_ns - answers.received_ns) / 1e9
        if silent_s > self._lost_after_s:
            return SourceStatus(State.LOST, self._fault or f"the gimbal is silent for {silent_s:.0f} s", figures)
        return SourceStatus(State.OK, "", figures)


class WithGimbal:
    """A telemetry source and a gimbal's own with it, as one. Telemetry that does not come is the worse fault."""

    def __init__(self, telemetry: TelemetrySource, gimbal: SiyiGimbal) -> None:
        self._telemetry, self._gimbal = telemetry, gimbal

    def run(self, emit: Emit, stop: Stop) -> None:
        """Both, until `stop`; raises what telemetry raises."""
        thread = SupervisedThread("gimbal", partial(self._gimbal.run, emit), Policy.RESTART, late_after_s=LATE_AFTER_S)
        thread.start()
        try:
            self._telemetry.run(emit, stop)
        finally:
            thread.end()
            thread.join(1.0)

    def health(self) -> SourceStatus:
        """Telemetry's, degraded by a gimbal that is silent."""
        health, gimbal = self._telemetry.health(), self._gimbal.health()
        figures = {**health.figures, **gimbal.figures}
        if health.state is State.OK and gimbal.state is not State.OK:
            return SourceStatus(State.DEGRADED, gimbal.detail, figures)
        return replace(health, figures=figures)

    def send_text(self, severity: Severity, text: str) -> None:
        self._telemetry.send_text(severity, text)
