"""The autopilot itself: one thread that plays a flight over a wire, on a boot clock of its own, and answers."""

from __future__ import annotations

import heapq
import itertools
import random
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any, Self

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from simulation.autopilot.clock import Clock, HostClock
from simulation.autopilot.flight import Flight, as_px4, moved
from simulation.autopilot.styles import STYLES, Rates
from simulation.autopilot.transports import open_wire

IDLE_S = 0.02
FRESH_BOOT_NS = 1_500_000_000  # how long after its boot a rebooted autopilot first sends
FIRST_QUESTION_NS = 2_000_000_000  # after a boot: its own first TIMESYNC
KEEP = 50_000  # messages kept for later queries


@dataclass(frozen=True)
class Faults:
    """The faults of the link, both ways. Jitter lets packets overtake each other."""

    loss: float = 0.0  # share of packets
    corrupt: float = 0.0  # share of packets whose bytes are changed, cut, or preceded by garbage
    delay_s: float = 0.0
    jitter_s: float = 0.0  # mean of an exponential delay on top


@dataclass(frozen=True)
class _Boot:
    """One run of the boot clock: at `monotonic_ns` it read `boot_ns`; `shift_ns` is that less the recording's."""

    monotonic_ns: int
    boot_ns: int
    shift_ns: int


class FakeAutopilot:
    """Plays `flight` over `url` (see `transports.open_wire`) while entered; `url` is then what the other end opens.

    `drift` is how much faster its clock runs than the host's, `speed` how much faster everything runs (its clock
    with it). `system` is its system number, the recording's if None. `everything`: send every recorded message unasked.
    `chatter`: others send on the same line, another vehicle among them. `key`: 32 bytes, sign and accept only signed.
    `clock` takes the place of the host's: all that is called monotonic here is then its time. `spoil` sees each
    recorded message (a copy) before it is sent, with that time, and returns what is sent instead; None for nothing.
    `mission_computer_s` takes the place of the style's, so that tests need not wait as long.
    """

    def __init__(
        self,
        flight: Flight,
        url: str,
        *,
        style: str = "ardupilot",
        faults: Faults | None = None,
        drift: float = 0.0,
        speed: float = 1.0,
        begin_s: float = 0.0,
        at_monotonic_ns: int | None = None,
        loop: bool = False,
        system: int | None = None,
        everything: bool = False,
        answers_timesync: bool = True,
        chatter: bool = False,
        getting_ready_s: float = 0.5,
        key: bytes | None = None,
        seed: int = 0,
        clock: Clock | None = None,
        spoil: Callable[[int, Any], Any | None] | None = None,
        mission_computer_s: float | None = None,
    ) -> None:
        self.flight = flight
        self.style = STYLES[style]
        if mission_computer_s is not None:
            self.style = replace(self.style, mission_computer_s=mission_computer_s)
        self.faults = faults or Faults()
        self.rate = speed * (1.0 + drift)
        self.loop = loop
        self.answers_timesync = answers_timesync
        self.chatter = chatter
        self.getting_ready_s = getting_ready_s
        self.system = flight.system if system is None else system
        self.sent: deque[tuple[int, Any]] = deque(maxlen=KEEP)  # (index of the boot, message as sent)
        self.received: deque[Any] = deque(maxlen=KEEP)  # what the other end has sent
        self.counts: Counter[str] = Counter()
        self.roi: tuple[float, float, float] | None = None  # what it looks at: degrees, and metres above sea level
        self.circle: tuple[float, float, float, float] | None = None  # likewise what it circles, and its radius, m
        # MAV_VTOL_STATE and MAV_LANDED_STATE, which it reports when asked; None: never.
        self.extended_state: tuple[int, int] | None = (
            int(mavlink.MAV_VTOL_STATE_UNDEFINED), int(mavlink.MAV_LANDED_STATE_IN_AIR),
        )  # fmt: skip
        self.roi_results: deque[int | None] = (
            deque()
        )  # of the next commands to look, instead of its own; None: no answer
        self._messages = [as_px4(m) for m in flight.messages] if style == "px4" else flight.messages
        self._everything = everything
        self._begin_ns = flight.due_ns[0] + round(begin_s * 1e9)
        self._at_ns = at_monotonic_ns
        self._random = random.Random(seed)
        self._clock = clock or HostClock()
        self._spoil = spoil
        self._wire = open_wire(url)
        self.url = self._wire.url
        self._packer = mavlink.MAVLink(None, srcSystem=self.system, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        for end in (self._packer, self._parser) if key is not None else ():
            end.signing.secret_key = key
            end.signing.timestamp = round((time.time() - 1420070400) * 1e5)  # 10 us since 2015
        self._packer.signing.sign_outgoing = key is not None
        self._boots: list[_Boot] = []
        self._rates = self._fresh_rates()
        self._late: list[tuple[int, int, bytes | None, bytes | None]] = []  # (due, order, to send, to take in)
        self._order = itertools.count()
        self._silent_until_ns = 0
        self._mission_computer_ns: int | None = None  # when it was last received
        self._next = 0
        self._next_beat_ns = self._next_question_ns = 0
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._orders: deque[tuple[str, float]] = deque()
        self._thread = threading.Thread(target=self._run, name="autopilot", daemon=True)

    def __enter__(self) -> Self:
        start_ns = self._clock.now_ns() if self._at_ns is None else self._at_ns
        self._boots.append(_Boot(start_ns, self._begin_ns, 0))
        self._next_question_ns = start_ns + FIRST_QUESTION_NS
        self._pass_until(self._begin_ns)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._stop.set()
        self._thread.join(5.0)
        self._wire.close()

    def monotonic_ns(self, boot_ns: int, boot: int = -1) -> int:
        """The truth: when (CLOCK_MONOTONIC) the boot clock of its n-th boot read this."""
        run = self._boots[boot]
        return run.monotonic_ns + round((boot_ns - run.boot_ns) / self.rate)

    @property
    def log_ns(self) -> tuple[int, int]:
        """A moment of CLOCK_MONOTONIC and of the log's own clock (Unix ns) that belong together."""
        first = self._boots[0]
        return first.monotonic_ns, first.boot_ns + self.flight.log_offset_ns

    @property
    def is_over(self) -> bool:
        """True once the recording has been played to its end; never for one played in a loop."""
        return self._next >= len(self._messages) and not self.loop

    @property
    def boots(self) -> int:
        """The number of boots so far."""
        return len(self._boots)

    def received_of(self, name: str) -> list[Any]:
        """Messages of this name that the other end has sent."""
        return [message for message in list(self.received) if message.get_type() == name]

    def mute(self, seconds: float) -> None:
        """Send nothing and receive nothing for a while; the flight continues."""
        self._orders.append(("mute", seconds))

    def reboot(self, seconds: float = 1.0) -> None:
        """Silence for a while, then a boot clock that starts again, and no memory of rates asked for."""
        self._orders.append(("reboot", seconds))

    def unplug(self) -> None:
        """Break the wire."""
        self._orders.append(("unplug", 0.0))

    def plug(self) -> None:
        """Mend it. A serial line comes back under another name, behind the same link if it has one."""
        self._orders.append(("plug", 0.0))

    def send_bytes(self, data: bytes) -> None:
        """Put anything on the line."""
        with self._lock:
            heapq.heappush(self._late, (self._clock.now_ns(), next(self._order), data, None))

    def _fresh_rates(self) -> Rates:
        return Rates(self.style, {m.get_type() for m in self._messages}, self._everything)

    def _boot_ns(self, monotonic_ns: int) -> int:
        run = self._boots[-1]
        return run.boot_ns + round((monotonic_ns - run.monotonic_ns) * self.rate)

    def _run(self) -> None:
        while not self._stop.is_set():
            self._take_orders()
            now = self._clock.now_ns()
            if now >= max(self._silent_until_ns, self._boots[0].monotonic_ns):
                self._play(now)
            else:
                self._skip(now)
            self._deliver()
            chunk = self._wire.receive(self._wait_s())
            if chunk and self._clock.now_ns() >= self._silent_until_ns:
                if self.faults.delay_s > 0.0:
                    with self._lock:
                        heapq.heappush(self._late, (self._arrival_ns(), next(self._order), None, chunk))
                else:
                    self._receive(chunk)

    def _wait_s(self) -> float:
        now = self._clock.now_ns()
        due = []
        if self._next < len(self._messages):
            next_ns = self.monotonic_ns(self.flight.due_ns[self._next] + self._boots[-1].shift_ns)
            due.append(max(next_ns, self._silent_until_ns))
        with self._lock:
            if self._late:
                due.append(self._late[0][0])
        return max(min([IDLE_S, *(self._clock.wall_s(at - now) for at in due)]), 0.0)

    def _take_orders(self) -> None:
        while self._orders:
            order, seconds = self._orders.popleft()
            now = self._clock.now_ns()
            if order == "unplug":
                self._wire.unplug()
            elif order == "plug":
                self._wire.plug()
            else:
                self._silent_until_ns = now + round(seconds * 1e9)
            if order == "reboot":
                was, back = self._boots[-1], self._silent_until_ns
                shift = FRESH_BOOT_NS - (self._boot_ns(back) - was.shift_ns)
                self._boots.append(_Boot(back, FRESH_BOOT_NS, shift))
                self._rates = self._fresh_rates()
                self._next_beat_ns, self._next_question_ns = back, back + FIRST_QUESTION_NS
                self._pass_until(FRESH_BOOT_NS - shift)

    def _skip(self, now: int) -> None:
        """Drop the messages that were due while it was silent: they are never sent."""
        if now >= self._boots[-1].monotonic_ns:
            self._pass_until(self._boot_ns(now) - self._boots[-1].shift_ns)
            while self._begins_again():
                self._pass_until(self._boot_ns(now) - self._boots[-1].shift_ns)

    def _pass_until(self, recorded_ns: int) -> None:
        while self._next < len(self._messages) and self.flight.due_ns[self._next] < recorded_ns:
            self._next += 1

    def _play(self, now: int) -> None:
        run = self._boots[-1]
        boot_ns = self._boot_ns(now)
        if now >= self._next_beat_ns:
            self._next_beat_ns = now + 1_000_000_000
            self._beat(now)
        self._watch_mission_computer(now)
        if now >= self._next_question_ns:
            self._next_question_ns = now + round(self.style.timesync_s * 1e9)
            self._send(mavlink.MAVLink_timesync_message(0, boot_ns))
        recorded_ns = boot_ns - run.shift_ns
        while self._next < len(self._messages) and self.flight.due_ns[self._next] <= recorded_ns:
            due_ns, message = self.flight.due_ns[self._next], self._messages[self._next]
            self._next += 1
            if self._rates.is_due(message.get_type(), due_ns + run.shift_ns):
                sent = moved(message, run.shift_ns)
                if self._spoil is not None:
                    sent = self._spoil(now, sent)
                if sent is not None:
                    self._send(sent)
        self._begins_again()

    def _begins_again(self) -> bool:
        """Start a looped recording again at its end, boot clock running on; return whether it did."""
        if self._next < len(self._messages) or not self.loop:
            return False
        run, self._next = self._boots[-1], 0
        length_ns = self.flight.due_ns[-1] - self.flight.due_ns[0] + 20_000_000
        self._boots[-1] = _Boot(run.monotonic_ns, run.boot_ns, run.shift_ns + length_ns)
        return True

    def _beat(self, now: int) -> None:
        ready = now - self._boots[-1].monotonic_ns >= self.getting_ready_s * 1e9
        status = mavlink.MAV_STATE_ACTIVE if ready else self.style.starting_status
        style, kind = self.style, self.flight.vehicle_type
        self._send(mavlink.MAVLink_heartbeat_message(kind, style.autopilot, 0x81, style.mode, status, 3))
        for number in self.style.unknown:
            self._post(mavlink.MAVLink_message(number, "")._pack(self._packer, 0, b"\x01" * 20))
            self._packer.seq = (self._packer.seq + 1) % 256
        if self.chatter:
            others = (
                (self.system + 6, 1, mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)),
                (self.system + 6, 1, mavlink.MAVLink_global_position_int_message(1000, 1, 2, 3, 4, 5, 6, 7, 8)),
                (self.system, 100, mavlink.MAVLink_heartbeat_message(30, 8, 0, 0, 4, 3)),
                (self.system, 100, mavlink.MAVLink_attitude_message(77, 3.0, 1.0, 2.0, 0.0, 0.0, 0.0)),
                (255, 190, mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)),
                (255, 190, mavlink.MAVLink_timesync_message(12345, 67890)),
            )
            for system, component, message in others:
                self._post(message.pack(mavlink.MAVLink(None, system, component)))

    def _watch_mission_computer(self, now: int) -> None:
        """PX4's warning; it looks at the type of a component's heartbeats, never at the state they claim."""
        limit_s, received_ns = self.style.mission_computer_s, self._mission_computer_ns
        if limit_s is not None and received_ns is not None and now - received_ns > limit_s * 1e9:
            self._mission_computer_ns = None
            self._show(mavlink.MAV_SEVERITY_CRITICAL, "Connection to mission computer lost")

    def _show(self, severity: int, text: str) -> None:
        """Send the pilot a text."""
        self._send(mavlink.MAVLink_statustext_message(severity, text.encode()))

    @property
    def shown(self) -> list[str]:
        """Texts the autopilot itself has sent to its pilot."""
        return [message.text for _, message in list(self.sent) if message.get_type() == "STATUSTEXT"]

    def _send(self, message: Any) -> None:
        packet = message.pack(self._packer, force_mavlink1=self.style.mavlink1)
        self._packer.seq = (self._packer.seq + 1) % 256
        self.counts[message.get_type()] += 1
        self.sent.append((len(self._boots) - 1, message))
        self._post(packet)

    def _arrival_ns(self) -> int:
        late = self.faults.delay_s
        if self.faults.jitter_s > 0.0:
            late += self._random.expovariate(1.0 / self.faults.jitter_s)
        return self._clock.now_ns() + round(late * 1e9)

    def _post(self, packet: bytes) -> None:
        faults = self.faults
        if faults.loss and self._random.random() < faults.loss:
            return
        if faults.corrupt and self._random.random() < faults.corrupt:
            packet = self._spoiled(packet)
        if faults.delay_s > 0.0 or faults.jitter_s > 0.0:
            with self._lock:
                heapq.heappush(self._late, (self._arrival_ns(), next(self._order), packet, None))
        else:
            self._wire.send(packet)

    def _spoiled(self, packet: bytes) -> bytes:
        kind, where = self._random.randrange(3), self._random.randrange(len(packet))
        if kind == 0:
            return packet[:where] + bytes([packet[where] ^ (1 << self._random.randrange(8))]) + packet[where + 1 :]
        if kind == 1:
            return packet[:where]
        return self._random.randbytes(where) + packet

    def _deliver(self) -> None:
        while True:
            with self._lock:
                if not self._late or self._late[0][0] > self._clock.now_ns():
                    return
                _, _, outgoing, incoming = heapq.heappop(self._late)
            if outgoing is not None:
                self._wire.send(outgoing)
            if incoming is not None:
                self._receive(incoming)

    def _receive(self, chunk: bytes) -> None:
        if self.faults.loss and self._random.random() < self.faults.loss:
            return
        for message in self._parser.parse_buffer(chunk) or ():
            name = message.get_type()
            if name == "BAD_DATA" or name.startswith("UNKNOWN"):
                continue
            self.received.append(message)
            if name == "TIMESYNC" and message.tc1 == 0 and self.answers_timesync:
                self._send(mavlink.MAVLink_timesync_message(self._boot_ns(self._clock.now_ns()), message.ts1))
            elif name == "COMMAND_LONG" and message.target_system == self.system:
                self._answer(message)
            elif name == "COMMAND_INT" and message.target_system == self.system:
                self._obey(message)
            elif name == "HEARTBEAT" and message.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER:
                if message.get_srcSystem() == self.system:
                    self._mission_computer_ns = self._clock.now_ns()
            elif name == "PARAM_REQUEST_READ" and message.target_system == self.system:
                value = self.style.parameters.get(message.param_id)
                if value is not None:
                    kind, asked = mavlink.MAV_PARAM_TYPE_INT16, message.param_id.encode()
                    self._send(mavlink.MAVLink_param_value_message(asked, value, kind, 1000, 500))
            elif name == "REQUEST_DATA_STREAM" and message.target_system == self.system:
                self._rates.set_stream(message.req_stream_id, message.req_message_rate * message.start_stop)

    def _obey(self, command: Any) -> None:
        """Look at or circle about a place in global coordinates, as both do; a height of another frame is not taken.

        A plane circles where it is sent to; of multicopters PX4's alone orbit.
        """
        obeyed = {mavlink.MAV_CMD_DO_SET_ROI_LOCATION, mavlink.MAV_CMD_DO_SET_ROI_NONE}
        if self.flight.vehicle_type == mavlink.MAV_TYPE_FIXED_WING:
            obeyed.add(mavlink.MAV_CMD_DO_REPOSITION)
        elif self.style.autopilot == mavlink.MAV_AUTOPILOT_PX4:
            obeyed.add(mavlink.MAV_CMD_DO_ORBIT)
        result: int | None = int(mavlink.MAV_RESULT_UNSUPPORTED)
        is_global = command.frame in (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)
        if command.command in obeyed and is_global and not self.style.mavlink1:
            result = int(mavlink.MAV_RESULT_ACCEPTED)
        if self.roi_results:
            result = self.roi_results.popleft()
        if result == mavlink.MAV_RESULT_ACCEPTED:
            place = command.x / 1e7, command.y / 1e7, command.z
            if command.command in (mavlink.MAV_CMD_DO_REPOSITION, mavlink.MAV_CMD_DO_ORBIT):
                is_orbit = command.command == mavlink.MAV_CMD_DO_ORBIT
                self.circle = (*place, command.param1 if is_orbit else command.param3)
            else:
                self.roi = None if command.command == mavlink.MAV_CMD_DO_SET_ROI_NONE else place
        if result is not None:
            self._acknowledge(command, result)

    def _answer(self, command: Any) -> None:
        if command.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            result = self._rates.set_interval(int(command.param1), command.param2)
            if result == mavlink.MAV_RESULT_DENIED and "SCHED_LOOP_RATE" in self.style.parameters:
                self._show(mavlink.MAV_SEVERITY_WARNING, f"Requested rate {1e6 / command.param2:.0f}Hz too fast")
        elif command.command == mavlink.MAV_CMD_REQUEST_MESSAGE and command.param1 == 148:
            result = int(mavlink.MAV_RESULT_ACCEPTED)
            none = [0] * 8
            self._send(
                mavlink.MAVLink_autopilot_version_message(
                    mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2, 0x04070000, 0, 0, 0, none, none, none, 0, 0, 1
                )
            )
        elif self._is_asked_what_it_is(command) and self.extended_state is not None:
            result = int(mavlink.MAV_RESULT_ACCEPTED)
            self._send(mavlink.MAVLink_extended_sys_state_message(*self.extended_state))
        else:
            result = int(mavlink.MAV_RESULT_UNSUPPORTED)
        self._acknowledge(command, result)

    @staticmethod
    def _is_asked_what_it_is(command: Any) -> bool:
        asked = command.command, command.param1
        return asked == (mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)

    def _acknowledge(self, command: Any, result: int) -> None:
        self._send(
            mavlink.MAVLink_command_ack_message(
                command.command, result, 0, 0, command.get_srcSystem(), command.get_srcComponent()
            )
        )
