"""One autopilot: messages in, events out, and messages to be sent. No link, no thread, no clock.

The vehicle is the one that `vehicle_choice` gives: what others send on the same line is never taken for it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.mavlink_camera.status_texts import StatusTexts
from onboard.clocks.timesync import SELDOM_NS, LinkClock
from onboard.config.schema import Config
from onboard.events.source import Severity, SourceStatus, State
from onboard.events.types import GimbalAttitude, NavEvent, PositionFix
from onboard.telemetry.aircraft_reports import AircraftReports
from onboard.telemetry.gimbal_senders import Gimbals, is_of_payload
from onboard.telemetry.mavlink_events import AUTOPILOT_COMPONENT, MessageToEvent, Sources, boot_ns_of
from onboard.telemetry.message_rates import RateRequests
from onboard.telemetry.vehicle_choice import VehicleChoice, is_autopilot

NS_PER_S = 1_000_000_000
# Between heartbeats: until the autopilot is received, which may first have to be sent to; and then, for it passes them
# on to every radio, 21 bytes each.
CALL_NS, BEAT_NS = NS_PER_S, SELDOM_NS
MAX_PENDING = 32
RETURN_NS = 3 * NS_PER_S  # of silence after which what was granted is taken for lost
SUBSTITUTE_NS = 5 * NS_PER_S  # to wait for the better of two messages
MAX_CLOCK_SIGMA_MS = 20.0  # as the doctor's: 0.4 m at 20 m/s


class Autopilot:
    """The state of an autopilot by its messages. `receive` and `due` are called by one thread; `health` by any."""

    def __init__(self, config: Config) -> None:
        self.config = config.telemetry
        self.choice = VehicleChoice(config.telemetry.system)
        self.clock = LinkClock(config.telemetry.clock)
        self.rates = RateRequests(config)
        self.gimbals = Gimbals(config.telemetry.clock, config.mount.gimbal_component)
        self.aircraft = AircraftReports()
        self.reboots = 0
        self._converter = MessageToEvent(Sources())
        self._seen_ns: dict[str, int] = {}  # the last arrival of each message since the autopilot's boot
        self._first_ns: int | None = None
        self._received_ns: int | None = None
        self._position_ns: int | None = None
        self._newest_boot_ns = 0
        self._boot_moved_ns = 0
        self._next_beat_ns = self._next_answer_ns = 0
        self._pending: deque[int] = deque(maxlen=MAX_PENDING)
        self._answers: deque[Any] = deque(maxlen=MAX_PENDING)
        self._texts = StatusTexts(mavlink)
        self._kind = int(mavlink.MAV_AUTOPILOT_INVALID)  # of autopilot; not known yet

    @property
    def system(self) -> int | None:
        """The vehicle's system number; None while it is open which vehicle is ours."""
        return self.choice.system

    @property
    def is_known(self) -> bool:
        """Return whether a heartbeat of the vehicle's autopilot has been received, and so what it is."""
        return self._kind != int(mavlink.MAV_AUTOPILOT_INVALID)

    # --- in ---

    def receive(self, message: Any, arrival_ns: int) -> list[NavEvent]:
        """One message from the line, of any sender -> the events it holds."""
        name, system, component = message.get_type(), message.get_srcSystem(), message.get_srcComponent()
        if is_of_payload(message, self.gimbals.wanted):
            return [*self.gimbals.receive(message, arrival_ns)] if system == self.system else []
        if component != AUTOPILOT_COMPONENT:
            return []
        if is_autopilot(message):
            self.choice.heartbeat(message, arrival_ns)
        self.choice.look(arrival_ns)
        if system != self.system:
            return []
        self._note(message, arrival_ns)
        self.aircraft.receive(message, arrival_ns)
        if name == "HEARTBEAT":
            self._kind = int(message.autopilot)
            self.rates.heartbeat(message.system_status, message.autopilot)
        elif name == "TIMESYNC":
            self._timesync(message, arrival_ns)
        elif name == "COMMAND_ACK" and self._is_for_us(message):
            self.rates.acknowledged(message.command, message.result, arrival_ns)
        elif name == "PARAM_VALUE":
            self.rates.parameter(message.param_id, message.param_value)
        return self._events(message, arrival_ns)

    def _note(self, message: Any, arrival_ns: int) -> None:
        """Note that the autopilot has sent this message; after a long silence all rates are requested again."""
        if self._received_ns is not None and arrival_ns - self._received_ns > RETURN_NS:
            self.rates.restart()
            self._first_ns = None  # the better of two messages may come again a moment later than the other
            self._seen_ns.clear()
        self._received_ns = arrival_ns
        self._first_ns = self._first_ns or arrival_ns
        self._seen_ns[message.get_type()] = arrival_ns
        self.rates.seen(message.get_type())

    def _is_for_us(self, message: Any) -> bool:
        """MAVLink 1 acknowledgements name no receiver: 0."""
        return message.target_system in (0, self.system) and message.target_component in (0, self.config.component)

    def _timesync(self, message: Any, arrival_ns: int) -> None:
        if message.tc1 == 0:  # it keeps time without us, and our answers too go to every radio
            if arrival_ns < self._next_answer_ns and self.clock.sync.is_settled:
                return
            self._next_answer_ns = arrival_ns + SELDOM_NS
            self._answers.append(mavlink.MAVLink_timesync_message(arrival_ns, message.ts1))
        elif message.ts1 in self._pending:
            self._pending.remove(message.ts1)
            self.clock.exchanged(message.ts1, message.tc1, arrival_ns)

    def _events(self, message: Any, arrival_ns: int) -> list[NavEvent]:
        boot_ns = boot_ns_of(message)
        if boot_ns is not None:
            if self.clock.arrived(boot_ns, arrival_ns):
                self._rebooted(arrival_ns)
            if boot_ns > self._newest_boot_ns:
                self._newest_boot_ns, self._boot_moved_ns = boot_ns, arrival_ns
        if not self.clock.is_known(arrival_ns):
            return []
        self._converter.sources = self._best_sources(arrival_ns)
        events = self._converter.convert(message, arrival_ns, self.clock.to_host_ns)
        if any(isinstance(event, GimbalAttitude) for event in events):
            return events if self.gimbals.choice.takes(message, arrival_ns) else []
        for event in events:
            if isinstance(event, PositionFix):
                self._position_ns = arrival_ns
        return events

    def _rebooted(self, arrival_ns: int) -> None:
        self.reboots += 1
        self.rates.restart()
        self._converter = MessageToEvent(self._converter.sources)
        self._seen_ns.clear()
        self._pending.clear()
        self._first_ns, self._newest_boot_ns = arrival_ns, 0

    def _best_sources(self, now_ns: int) -> Sources:
        """The filter's position and Euler angles, unless only the other kind has come for a while."""
        sources = self._converter.sources
        position = self._better("GLOBAL_POSITION_INT", "GPS_RAW_INT", sources.position, now_ns)
        attitude = self._better("ATTITUDE", "ATTITUDE_QUATERNION", sources.attitude, now_ns)
        unchanged = (position, attitude) == (sources.position, sources.attitude)
        return sources if unchanged else Sources(position, attitude)

    def _better(self, best: str, other: str, taken: str, now_ns: int) -> str:
        """The message to take of two: the best one while it comes, and what is `taken` until it is clear that it does
        not.
        """
        first_ns = now_ns if self._first_ns is None else self._first_ns
        if now_ns - self._seen_ns.get(best, first_ns) > SUBSTITUTE_NS:
            return other if other in self._seen_ns else taken
        return best if best in self._seen_ns else taken

    def is_received(self, now_ns: int) -> bool:
        """Return whether the vehicle's autopilot has been received recently."""
        return self._received_ns is not None and now_ns - self._received_ns <= self.config.lost_after_s * 1e9

    # --- out ---

    def due(self, now_ns: int, speaks_first: bool = False) -> list[Any]:
        """Return the messages to send now. `speaks_first`: the other end answers only senders it has received from."""
        self.choice.look(now_ns)
        if self.system is None and not speaks_first:
            return []
        out: list[Any] = []
        if now_ns >= self._next_beat_ns:
            self._next_beat_ns = now_ns + (BEAT_NS if self.is_known else CALL_NS)
            out.append(self._heartbeat(mavlink.MAV_STATE_ACTIVE))
        if self.system is None or self._received_ns is None:
            return out
        while self._answers:
            out.append(self._answers.popleft())
        if self.clock.is_due(now_ns):
            self.clock.asked(now_ns)
            self._pending.append(now_ns)
            self.gimbals.asked(now_ns)
            out.append(mavlink.MAVLink_timesync_message(0, now_ns))
        return out + self._texts.due(now_ns) + self.rates.due(self.system, now_ns)

    def _heartbeat(self, state: int) -> Any:
        # PX4 takes any component of the type "onboard controller" for its mission computer, and sends the pilot a
        # critical warning when its heartbeats cease, whatever the last one reported. The vehicle does not depend on
        # us: to PX4, and before the autopilot is known, we are a generic component, whose silence it does not report.
        is_other = self._kind in (mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_INVALID)
        kind = mavlink.MAV_TYPE_GENERIC if is_other else mavlink.MAV_TYPE_ONBOARD_CONTROLLER
        return mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, state, 3)

    def farewell(self) -> Any:
        """The last message of a session: a HEARTBEAT that reports that we power off."""
        return self._heartbeat(mavlink.MAV_STATE_POWEROFF)

    def send_text(self, severity: Severity, text: str) -> None:
        """Have a text shown to the pilot: 100 characters at most. The newest few wait for the link."""
        self._texts.add(severity.value, text)

    # --- how it is ---

    def health(self, now_ns: int) -> SourceStatus:
        """State, reason, figures and what it reports of its aircraft. Silence counts from the autopilot's last
        message.
        """
        return replace(self._link_health(now_ns), aircraft=self.aircraft.at(now_ns))

    def _link_health(self, now_ns: int) -> SourceStatus:
        figures = {
            **self.rates.figures(),
            **self.clock.figures(),
            **self.gimbals.figures(),
            "reboots": float(self.reboots),
        }
        received_ns, position_ns = self._received_ns, self._position_ns
        limit_ns = self.config.lost_after_s * 1e9
        if received_ns is None:
            state = State.LOST if self.choice.is_refused else State.STARTING
            return SourceStatus(state, self.choice.refusal(now_ns), figures)
        silent_ns = now_ns - received_ns
        if silent_ns > limit_ns:
            silent = f"the autopilot is silent for {silent_ns / 1e9:.0f} s{self.choice.instead(now_ns)}"
            return SourceStatus(State.LOST, silent, figures)
        if now_ns - self._boot_moved_ns > limit_ns and self._boot_moved_ns:
            return SourceStatus(State.FROZEN, "the autopilot's clock stands still", figures)
        if position_ns is None:
            return SourceStatus(State.STARTING, "the autopilot gives no position yet", figures)
        if now_ns - position_ns > limit_ns:
            return SourceStatus(State.LOST, f"no position for {(now_ns - position_ns) / 1e9:.0f} s", figures)
        complaint = (
            self.choice.doubt(now_ns) or self._complaint() or self.gimbals.complaint(now_ns, self.config.lost_after_s)
        )
        return SourceStatus(State.DEGRADED if complaint else State.OK, complaint, figures)

    def _complaint(self) -> str:
        sigma_ms = self.clock.figures().get("clock_sigma_ms")
        sigma = "" if sigma_ms is None else f", +-{sigma_ms:.0f} ms"
        if self.clock.disagrees:
            return f"TIMESYNC is answered from another clock: stamps by arrival{sigma}"
        if self.clock.is_by_arrival:
            return f"TIMESYNC is not answered any more: stamps by arrival{sigma}"
        if sigma_ms is not None and sigma_ms > MAX_CLOCK_SIGMA_MS:
            return f"the autopilot's clock is known to +-{sigma_ms:.0f} ms only"
        return self.rates.complaint()
