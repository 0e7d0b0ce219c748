"""A live MAVLink link: one thread that reads, answers, and opens the wire again until it succeeds."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.mavlink_camera.component import MavlinkCamera
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.source import Emit, Severity, SourceStatus, State, Stop
from onboard.events.tunnel import TunnelEnd
from onboard.telemetry.mavlink_events import AUTOPILOT_COMPONENT
from onboard.telemetry.mavlink_framing import Framer, SequenceGaps
from onboard.telemetry.mavlink_passage import Passage
from onboard.telemetry.mavlink_session import Autopilot
from onboard.telemetry.pointing import Pointing
from onboard.telemetry.signing import keep_time, sign
from onboard.telemetry.tlog_writer import TlogWriter
from onboard.telemetry.transports import Address, Wire

READ_S = 0.02
REOPEN_S = 0.5
HUNG_NS = 10_000_000_000  # of silence on a wire that may be dead without an error
USUAL_SYSTEM = 1  # of a vehicle, where we must speak before one is received
GARBAGE = 2000  # bytes without a packet among them before that is reported


class End(Protocol):
    """Our end of a wire, as a MAVLink library makes it."""

    system: int | None  # the vehicle's, which we send as; None while none is ours

    def attach(self, wire: Wire) -> None:
        """Send over this wire from now on."""

    def take(self, data: bytes, now_ns: int) -> list[tuple[int, Any]]:
        """Take data, maybe none; return messages that are ready, each with its arrival, as pymavlink has them."""

    def send(self, message: Any, component: int | None = None) -> None:
        """Send one of pymavlink's messages, as `component` of the vehicle's where it is given. Raises OSError where the
        wire is broken.
        """

    def lost(self, system: int) -> int | None:
        """Packets lost on the way from this system's autopilot since the start; None where that is not known."""

    def complaint(self) -> str:
        """The reason why nothing may be understood; empty if there is no reason to think so."""

    def close(self) -> None:
        """The end of it."""


class PymavlinkEnd:
    """Packs, checks and decodes with pymavlink; signs if there is a key."""

    def __init__(self, config: Config, key: bytes | None = None) -> None:
        self.system = config.telemetry.system or None
        self._component = config.telemetry.component
        self._mav = mavlink.MAVLink(None, srcComponent=self._component)
        self._numbers: dict[int, int] = {}  # of the next packet, by component: each counts its own
        self._is_signing = key is not None
        if key is not None:
            sign(self._mav, key)
        self._gaps = SequenceGaps()
        self._framer = Framer(self._mav, self._gaps)
        self._wire: Wire | None = None
        self._taken = 0

    def attach(self, wire: Wire) -> None:
        """A new wire begins with no half packet from the old."""
        self._wire = wire
        self._framer = Framer(self._mav, self._gaps)
        self._gaps.restart()
        self._taken = 0

    def take(self, data: bytes, now_ns: int) -> list[tuple[int, Any]]:
        """Everything that arrived in one piece has one arrival."""
        messages = self._framer.feed(data) if data else []
        self._taken += len(messages)
        return [(now_ns, message) for message in messages]

    def send(self, message: Any, component: int | None = None) -> None:
        """Pack and write at once."""
        if self._is_signing:
            keep_time(self._mav)
        sender = self._component if component is None else component
        self._mav.srcSystem, self._mav.srcComponent = self.system or USUAL_SYSTEM, sender
        self._mav.seq = self._numbers.get(sender, 0)
        packet = message.pack(self._mav)
        self._numbers[sender] = (self._mav.seq + 1) % 256
        if self._wire is not None:
            self._wire.write(bytes(packet))

    def lost(self, system: int) -> int | None:
        """Return how many packets of a system's autopilot were lost, by the numbers in all headers, of any kind."""
        return self._gaps.lost[system, AUTOPILOT_COMPONENT]

    def complaint(self) -> str:
        """Wrong keys and wrong baud rates both mean that no message comes: report which it is."""
        signing = self._mav.signing
        refused = signing.badsig_count if self._is_signing else 0
        if refused and not signing.goodsig_count:
            return f"{refused} packets with a wrong signature: another key?"
        if not self._taken and self._framer.garbage > GARBAGE:
            return f"{self._framer.garbage} bytes and no packet among them: another baud rate?"
        return ""

    def close(self) -> None:
        """Nothing of its own to close."""


class LiveTelemetry:
    """A telemetry source over a wire. See `onboard.events.source.TelemetrySource`."""

    def __init__(
        self,
        config: Config,
        clock: SessionClock,
        address: Address,
        make_end: Callable[[], End],
        tunnel: TunnelEnd | None = None,
        camera: MavlinkCamera | None = None,
        pointing: Pointing | None = None,
    ) -> None:
        self._config = config
        self._clock = clock
        self._address = address
        self._make_end = make_end
        self._autopilot = Autopilot(config)
        self._passage = None if tunnel is None else Passage(config, tunnel)
        self._camera, self._pointing = camera, pointing
        self._log = (
            TlogWriter(config.telemetry.log, config.recording.keep_free_mb)
            if config.telemetry.log is not None
            else None
        )
        self._fault = ""  # why there is no wire
        self._complaint = ""
        self._lost: int | None = None
        self._opened = 0
        self._is_over = False

    def run(self, emit: Emit, stop: Stop) -> None:
        """Until `stop`: open, exchange messages, and open again."""
        end = self._make_end()
        try:
            while not stop.is_set():
                try:
                    wire = self._address.open()
                except OSError as error:
                    self._fault = f"cannot open {self._address.place}: {error.strerror or error}"
                    stop.wait(REOPEN_S)
                    continue
                self._opened += 1
                self._fault = ""
                self._autopilot.rates.restart()
                with closing(wire):
                    try:
                        end.attach(wire)
                        self._exchange(wire, end, emit, stop)
                        if stop.is_set():
                            end.send(self._autopilot.farewell())
                    except OSError as error:
                        self._fault = f"{self._address.place}: {error.strerror or error}"
                if not stop.is_set():
                    stop.wait(REOPEN_S)
        finally:
            end.close()
            if self._log is not None:
                self._log.close()
            self._is_over = True

    def _exchange(self, wire: Wire, end: End, emit: Emit, stop: Stop) -> None:
        autopilot, clock = self._autopilot, self._clock
        received_ns = clock.now_ns()
        while not stop.is_set():
            data = wire.read(READ_S)
            now_ns = clock.now_ns()
            for arrival_ns, message in end.take(data, now_ns):
                if message.get_srcSystem() == autopilot.system:
                    wire.confirm()
                if autopilot.system in (None, message.get_srcSystem()):
                    received_ns = now_ns
                if self._log is not None:
                    self._log.write(arrival_ns, bytes(message.get_msgbuf()))
                for event in autopilot.receive(message, arrival_ns):
                    emit(arrival_ns, event)
                if self._passage is not None and autopilot.is_known:
                    self._passage.receive(message, autopilot.system)
                if self._pointing is not None:
                    self._pointing.receive(message, autopilot.system)
                if self._camera is not None:
                    self._camera.receive(message, autopilot.system, arrival_ns)
            end.system = autopilot.system
            self._send_due(end, clock.now_ns(), speaks_first=wire.speaks_first or self._is_signed)
            self._complaint = end.complaint()
            self._lost = end.lost(autopilot.system) if autopilot.system is not None else None
            if wire.may_die_silently and now_ns - received_ns > HUNG_NS:
                self._fault = f"{self._address.place}: silent; opening it again"
                return

    def _send_due(self, end: End, now_ns: int, *, speaks_first: bool) -> None:
        for message in self._autopilot.due(now_ns, speaks_first):
            end.send(message)
            if self._passage is not None:
                self._passage.note_sent(message)
        if self._passage is not None and self._autopilot.system is not None:
            for message in self._passage.due(now_ns, self._autopilot.system):
                end.send(message)
        if self._pointing is not None and self._autopilot.system is not None and self._autopilot.is_received(now_ns):
            for message in self._pointing.due(now_ns, self._autopilot.system):
                end.send(message)
        if self._camera is not None and self._autopilot.system is not None:
            for message in self._camera.due(now_ns):
                end.send(message, self._camera.component)

    @property
    def _is_signed(self) -> bool:
        # An autopilot that does not know the time yet takes it from our signature, and its packets pass only then.
        return self._config.telemetry.signing_key is not None

    def health(self) -> SourceStatus:
        """Return the autopilot's status with the faults of wire and log; from any thread."""
        health = self._autopilot.health(self._clock.now_ns())
        figures = {**health.figures, "reopened": float(max(self._opened - 1, 0))}
        if self._lost is not None:
            figures["lost_packets"] = float(self._lost)
        if self._is_over:
            return SourceStatus(State.LOST, "stopped", figures)
        if self._fault and health.state in (State.STARTING, State.LOST):
            return SourceStatus(State.LOST, self._fault, figures)
        if self._complaint and health.state in (State.STARTING, State.LOST):
            return SourceStatus(health.state, self._complaint, figures)
        if self._log is not None and self._log.fault and health.state is State.OK:
            return replace(health, state=State.DEGRADED, detail=f"telemetry log: {self._log.fault}", figures=figures)
        contested = "" if self._camera is None else self._camera.complaint(self._clock.now_ns())
        if contested and health.state is State.OK:
            return replace(health, state=State.DEGRADED, detail=contested, figures=figures)
        return replace(health, figures=figures)

    def send_text(self, severity: Severity, text: str) -> None:
        """Send it as STATUSTEXT, which ground stations show and read aloud."""
        self._autopilot.send_text(severity, text)
