"""Which messages are asked of the autopilot, and how often: one request at a time, lower where it is denied.

An acknowledgement names the command and not the message, so that two requests under way could not be told apart. What
was granted is watched: a message that stops coming is asked for again, and everything after a reboot or a lost link.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.config.schema import Config
from onboard.telemetry.mavlink_events import AUTOPILOT_COMPONENT

NS_PER_S = 1_000_000_000
ANSWER_NS = NS_PER_S  # to wait for an acknowledgement
MAX_TRIES = 3
WATCH_NS = 3 * NS_PER_S
FIRST_AGAIN_NS = 3 * NS_PER_S
MAX_AGAIN_NS = 60 * NS_PER_S
TOO_FEW = 0.35  # of the rate granted: asked for again
FALLBACKS_HZ = (50.0, 40.0, 25.0, 10.0, 5.0, 2.0)
COMMAND = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
FILTER_HZ = 5.0  # reports of the navigation filter: they tell of a loss
GPS_HZ = 5.0
GIMBAL_HZ = 20.0
RANGE_HZ = 10.0

# Groups of REQUEST_DATA_STREAM that hold the messages, for autopilots that know nothing else.
STREAMS = {
    "ATTITUDE": mavlink.MAV_DATA_STREAM_EXTRA1,
    "GLOBAL_POSITION_INT": mavlink.MAV_DATA_STREAM_POSITION,
    "GPS_RAW_INT": mavlink.MAV_DATA_STREAM_EXTENDED_STATUS,
    "EKF_STATUS_REPORT": mavlink.MAV_DATA_STREAM_EXTRA3,
}


@dataclass
class _Want:
    """One message we want, and how far the asking has got."""

    name: str
    rates_hz: tuple[float, ...]  # falling
    is_needed: bool = True
    step: int = 0  # which rate is asked for; past the end: denied altogether
    granted_hz: float = 0.0
    tries: int = 0
    due_ns: int = 0  # when to ask next
    again_ns: int = FIRST_AGAIN_NS
    count: int = 0  # since the watch began
    measured_hz: float | None = None
    watches: int = 0  # since the grant

    @property
    def is_short(self) -> bool:
        """Granted, and it does not come. The first watch began before the grant."""
        return self.watches >= 2 and self.measured_hz is not None and self.measured_hz < TOO_FEW * self.granted_hz

    @property
    def is_denied(self) -> bool:
        return self.step >= len(self.rates_hz)


def _falling(rate_hz: float, lowest_hz: float) -> tuple[float, ...]:
    return rate_hz, *(f for f in FALLBACKS_HZ if lowest_hz <= f < rate_hz)


@dataclass
class RateRequests:
    """The conversation about rates with one autopilot. Owns no link and no clock: `due` says what to send now."""

    config: Config
    wants: list[_Want] = field(init=False)
    is_ready: bool = False  # the autopilot's system_status was 3 or more
    by_streams: bool = False  # it does not know SET_MESSAGE_INTERVAL
    _asking: _Want | None = None
    _asked_ns: int = 0
    _unanswered: int = 0
    _watch_ns: int | None = None
    _is_ardupilot: bool = True

    def __post_init__(self) -> None:
        self.wants = self._all_wants()

    def _all_wants(self) -> list[_Want]:
        telemetry = self.config.telemetry
        position_hz = telemetry.position_rate_hz
        report = "EKF_STATUS_REPORT" if self._is_ardupilot else "ESTIMATOR_STATUS"
        wants = [
            _Want("ATTITUDE", _falling(telemetry.attitude_rate_hz, 10.0)),
            _Want("GLOBAL_POSITION_INT", _falling(position_hz, 2.0)),
            _Want("GPS_RAW_INT", _falling(min(position_hz, GPS_HZ), 2.0)),
            _Want(report, _falling(FILTER_HZ, 2.0), is_needed=False),
        ]
        if self.config.mount.gimbal != "never":
            wants.append(_Want("GIMBAL_DEVICE_ATTITUDE_STATUS", _falling(GIMBAL_HZ, 10.0), is_needed=False))
        if self.config.range_finder.use:
            wants.append(_Want("DISTANCE_SENSOR", _falling(RANGE_HZ, 5.0)))
        return wants

    def heartbeat(self, status: int, autopilot: int) -> None:
        """Take the autopilot's own heartbeat: whether it is ready to be asked, and what it is."""
        self.is_ready = status >= mavlink.MAV_STATE_STANDBY
        is_ardupilot = autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
        if is_ardupilot != self._is_ardupilot:
            self._is_ardupilot = is_ardupilot
            self.restart()

    def restart(self) -> None:
        """Ask for everything anew: the autopilot has rebooted, or the link was lost and with it what it granted."""
        self.wants = self._all_wants()
        self._asking, self._watch_ns = None, None
        self._unanswered = 0
        self.is_ready = self.by_streams = False

    def acknowledged(self, command: int, result: int, now_ns: int) -> None:
        """Take a COMMAND_ACK that is meant for us."""
        want = self._asking
        if command != COMMAND or want is None or result == mavlink.MAV_RESULT_IN_PROGRESS:
            return
        self._asking = None
        self._unanswered = 0
        if result == mavlink.MAV_RESULT_ACCEPTED:
            want.granted_hz = want.rates_hz[want.step]
            want.tries = 0
            want.watches = 0
            want.due_ns = now_ns + want.again_ns
        elif result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED:
            want.due_ns = now_ns + ANSWER_NS
        elif result == mavlink.MAV_RESULT_UNSUPPORTED:
            self._use_streams(now_ns)
        else:
            want.step += 1
            want.tries = 0
            if want.is_denied and want.name == "ATTITUDE":
                self.wants.append(_Want("ATTITUDE_QUATERNION", want.rates_hz))

    def _use_streams(self, now_ns: int) -> None:
        self.by_streams = True
        for want in self.wants:
            want.due_ns = now_ns

    def seen(self, name: str) -> None:
        """Count a message of the autopilot."""
        for want in self.wants:
            if want.name == name:
                want.count += 1

    def due(self, system: int, now_ns: int) -> list[Any]:
        """What to send now: at most one request."""
        self._watch(now_ns)
        if not self.is_ready:
            return []
        if self._asking is not None and not self.by_streams:
            if now_ns - self._asked_ns < ANSWER_NS:
                return []
            self._asking.due_ns = now_ns
            self._unanswered += 1
            if self._asking.tries >= MAX_TRIES:
                self._asking.tries = 0
                self._asking.due_ns = now_ns + self._longer(self._asking)
            self._asking = None
            if self._unanswered >= MAX_TRIES and not any(want.granted_hz or want.step for want in self.wants):
                self._use_streams(now_ns)
        for want in self.wants:
            if want.is_denied or now_ns < want.due_ns:
                continue
            if want.granted_hz and not want.is_short:
                continue
            return self._ask(want, system, now_ns)
        return []

    def _longer(self, want: _Want) -> int:
        want.again_ns = min(2 * want.again_ns, MAX_AGAIN_NS)
        return want.again_ns

    def _ask(self, want: _Want, system: int, now_ns: int) -> list[Any]:
        rate_hz = want.rates_hz[want.step]
        if self.by_streams:
            stream = STREAMS.get(want.name)
            want.granted_hz = rate_hz if stream is not None else 0.0
            want.watches = 0
            want.due_ns = now_ns + self._longer(want)
            if stream is None:
                return []
            return [mavlink.MAVLink_request_data_stream_message(system, AUTOPILOT_COMPONENT, stream, round(rate_hz), 1)]
        if want.granted_hz:  # it was granted, and does not come
            want.granted_hz = 0.0
            self._longer(want)
        self._asking, self._asked_ns = want, now_ns
        want.tries += 1
        number = getattr(mavlink, f"MAVLINK_MSG_ID_{want.name}")
        return [
            mavlink.MAVLink_command_long_message(
                system, AUTOPILOT_COMPONENT, COMMAND, 0, number, 1e6 / rate_hz, 0, 0, 0, 0, 0
            )
        ]

    def _watch(self, now_ns: int) -> None:
        if self._watch_ns is None:
            self._watch_ns = now_ns
        seconds = (now_ns - self._watch_ns) / 1e9
        if seconds * NS_PER_S >= WATCH_NS:
            for want in self.wants:
                want.measured_hz, want.count = want.count / seconds, 0
                want.watches += 1
                if want.granted_hz and want.watches >= 2 and not want.is_short:
                    want.again_ns = FIRST_AGAIN_NS
            self._watch_ns = now_ns

    def figures(self) -> dict[str, float]:
        """Rates as they come, by what they carry."""
        names = {"ATTITUDE": "attitude_hz", "GLOBAL_POSITION_INT": "position_hz", "GPS_RAW_INT": "gps_hz"}
        return {
            names[want.name]: round(want.measured_hz, 1)
            for want in self.wants
            if want.name in names and want.measured_hz is not None
        }

    def complaint(self) -> str:
        """What is needed and does not come as asked; empty if all does."""
        for want in self.wants:
            if not want.is_needed or want.measured_hz is None:
                continue
            if want.measured_hz == 0.0 and not want.count:
                return f"no {want.name}" + (": the autopilot denies it" if want.is_denied else "")
            if want.is_short:
                return f"{want.name} at {want.measured_hz:.1f} Hz where {want.granted_hz:.0f} were granted"
        return ""
