"""Requests for messages and their rates: one at a time, at a lower rate where it is denied.

An acknowledgement names the command and not the message, so that two requests under way could not be distinguished.
What was granted is watched: a message that comes too rarely is requested again, and everything after a reboot, a lost
link, or when the autopilot becomes ready.

ArduPilot sends a message at most at 0.8 of its loop rate, and warns the pilot of each request above that. So its loop
rate is asked for first, and nothing beyond it; where it does not report it, no more than every ArduPilot can.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.config.schema import Config
from onboard.telemetry.mavlink_events import AUTOPILOT_COMPONENT

NS_PER_S = 1_000_000_000
ANSWER_NS = NS_PER_S  # to wait for an acknowledgement
MAX_TRIES = 3
LOOP_TRIES = 2
LOOP_NS = NS_PER_S // 4  # to wait for the loop rate before anything is asked; later it may still come
WATCH_NS = 3 * NS_PER_S
FIRST_AGAIN_NS = 3 * NS_PER_S
MAX_AGAIN_NS = 60 * NS_PER_S
TOO_FEW = 0.35  # of the rate granted: a complaint
FEWER = 0.7  # of the rate granted: asked for again
FALLBACKS_HZ = (50.0, 40.0, 25.0, 10.0, 5.0, 2.0)
LOOP_RATE = "SCHED_LOOP_RATE"  # ArduPilot's parameter, Hz
LOOP_SHARE = 0.8  # of it, the most a message is sent at
LEAST_LOOP_HZ = 50.0  # the least ArduPilot can be set to, and ArduPlane's own
COMMAND = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
FILTER_HZ = 5.0  # reports of the navigation filter: they show a loss
GPS_HZ = 5.0
GIMBAL_HZ = 20.0
RANGE_HZ = 10.0
BATTERY_HZ = 0.2  # 43 bytes each time, for people only
HOME_HZ = 0.1  # it changes seldom; a terrain model is held against it
SEVERAL = 4  # of a message are watched for before its rate is stated

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
    is_spare: bool = False  # asked for only where it does not come anyway: another on the line may have its rate
    step: int = 0  # which rate is asked for; past the end: denied altogether
    granted_hz: float = 0.0
    tries: int = 0
    due_ns: int = 0  # when to ask next
    again_ns: int = FIRST_AGAIN_NS
    since_ns: int | None = None  # when the watch began
    count: int = 0  # since then
    measured_hz: float | None = None
    watches: int = 0  # since the grant

    @property
    def is_short(self) -> bool:
        """Granted, and it hardly comes."""
        return self._comes_below(TOO_FEW)

    @property
    def is_to_be_asked_again(self) -> bool:
        """Granted, and it comes less often than that."""
        return self._comes_below(FEWER)

    def _comes_below(self, share: float) -> bool:
        return self.watches >= 2 and self.measured_hz is not None and self.measured_hz < share * self.granted_hz

    @property
    def may_come_anyway(self) -> bool:
        """Spare, and nothing shows yet that it does not come without being asked for."""
        return self.is_spare and not self.granted_hz and (self.watches == 0 or self.measured_hz != 0.0)

    def is_due(self, now_ns: int) -> bool:
        """Return whether it is to be asked for now."""
        if self.is_denied or self.may_come_anyway or now_ns < self.due_ns:
            return False
        return not self.granted_hz or self.is_to_be_asked_again

    def watch(self, now_ns: int) -> None:
        """Measure its rate whenever it was watched for long enough."""
        if self.since_ns is None:
            self.since_ns = now_ns
        seconds = (now_ns - self.since_ns) / 1e9
        if seconds * NS_PER_S < max(WATCH_NS, SEVERAL / self.rates_hz[-1] * NS_PER_S):
            return
        self.measured_hz, self.count, self.since_ns = self.count / seconds, 0, now_ns
        self.watches += 1
        if self.granted_hz and self.watches >= 2 and not self.is_to_be_asked_again:
            self.again_ns = FIRST_AGAIN_NS

    @property
    def is_denied(self) -> bool:
        return self.step >= len(self.rates_hz)


def most_hz(loop_hz: float) -> float:
    """The highest rate ArduPilot grants with this loop rate: its intervals are whole milliseconds."""
    return 1000.0 / max(math.ceil(round(1000.0 / (LOOP_SHARE * loop_hz), 6)), 1)


def _falling(rate_hz: float, lowest_hz: float) -> tuple[float, ...]:
    return rate_hz, *(f for f in FALLBACKS_HZ if lowest_hz <= f < rate_hz)


@dataclass
class RateRequests:
    """Requests of rates to one autopilot, and its answers. Owns no link and no clock; `due` is what to send now."""

    config: Config
    wants: list[_Want] = field(init=False)
    can_be_asked: bool = False  # a heartbeat has come, and not of one that is booting
    is_ready: bool = False  # the autopilot's system_status was 3 or more
    by_streams: bool = False  # it does not know SET_MESSAGE_INTERVAL
    _asking: _Want | None = None
    _asked_ns: int = 0
    _unanswered: int = 0
    _is_ardupilot: bool = True
    _loop_hz: float | None = None  # ArduPilot's, once it has reported it
    _loop_tries: int = 0
    _loop_asked_ns: int = 0

    def __post_init__(self) -> None:
        self.wants = self._all_wants()

    @property
    def _cap_hz(self) -> float:
        """The highest rate that may be requested without a warning to the pilot that it is too much, Hz."""
        return most_hz(self._loop_hz or LEAST_LOOP_HZ) if self._is_ardupilot else math.inf

    def _all_wants(self) -> list[_Want]:
        telemetry = self.config.telemetry
        position_hz = telemetry.position_rate_hz
        report = "EKF_STATUS_REPORT" if self._is_ardupilot else "ESTIMATOR_STATUS"
        cap_hz = self._cap_hz
        wants = [
            _Want("ATTITUDE", _falling(min(telemetry.attitude_rate_hz, cap_hz), 10.0)),
            _Want("GLOBAL_POSITION_INT", _falling(min(position_hz, cap_hz), 2.0)),
            _Want("GPS_RAW_INT", _falling(min(position_hz, GPS_HZ), 2.0)),
            _Want(report, _falling(FILTER_HZ, 2.0), is_needed=False),
        ]
        if self.config.mount.gimbal != "never":
            wants.append(_Want("GIMBAL_DEVICE_ATTITUDE_STATUS", _falling(GIMBAL_HZ, 10.0), is_needed=False))
        if self.config.range_finder.use:
            wants.append(_Want("DISTANCE_SENSOR", _falling(RANGE_HZ, 5.0)))
        wants.append(_Want("HOME_POSITION", (HOME_HZ,), is_needed=False, is_spare=True))
        wants.append(_Want("SYS_STATUS", (BATTERY_HZ,), is_needed=False, is_spare=True))
        return wants

    def heartbeat(self, status: int, autopilot: int) -> None:
        """Take the autopilot's own heartbeat: whether it can be asked, whether it is ready, and what it is.

        PX4 reports "uninitialised" until it has a position, and grants rates all the same; one that is booting or
        calibrating may forget what it granted. What was asked before it was ready is asked again when it is.
        """
        is_ready = status >= mavlink.MAV_STATE_STANDBY
        is_ardupilot = autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
        if is_ardupilot != self._is_ardupilot or (is_ready and not self.is_ready and self.can_be_asked):
            self._is_ardupilot = is_ardupilot
            self._begin()
        self.is_ready = is_ready
        self.can_be_asked = status not in (mavlink.MAV_STATE_BOOT, mavlink.MAV_STATE_CALIBRATING)

    def parameter(self, name: str | bytes, value: float) -> None:
        """Take a PARAM_VALUE of the autopilot's; all but the loop rate are passed over."""
        text = name.decode("ascii", "replace") if isinstance(name, bytes) else name
        if text.rstrip("\0") != LOOP_RATE or not self._is_ardupilot or not math.isfinite(value) or value < 1.0:
            return
        if self._loop_hz == value:
            return
        self._loop_hz = value
        better = {want.name: want for want in self._all_wants()}
        for i, want in enumerate(self.wants):  # what is asked for at the right rate already stays as it is
            new = better.get(want.name)
            if new is not None and new.rates_hz != want.rates_hz:
                self.wants[i] = new
                self._asking = None if self._asking is want else self._asking

    def restart(self) -> None:
        """Ask for everything again: the autopilot has rebooted, or the link was lost and with it what it granted."""
        self.is_ready = self.can_be_asked = False
        self._loop_hz = None
        self._loop_tries = 0
        self._begin()

    def _begin(self) -> None:
        self.wants = self._all_wants()
        self._asking = None
        self._unanswered = 0
        self.by_streams = False

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
        for want in self.wants:
            if want.name == name:
                want.count += 1

    def due(self, system: int, now_ns: int) -> list[Any]:
        """Return the messages to send now: at most one request."""
        for want in self.wants:
            want.watch(now_ns)
        if not self.can_be_asked:
            return []
        if self._is_ardupilot and self._loop_hz is None:
            since_ns = now_ns - self._loop_asked_ns
            if self._loop_tries == 0 or (self._loop_tries < LOOP_TRIES and since_ns >= ANSWER_NS):
                self._loop_tries, self._loop_asked_ns = self._loop_tries + 1, now_ns
                return [mavlink.MAVLink_param_request_read_message(system, AUTOPILOT_COMPONENT, LOOP_RATE.encode(), -1)]
            if self._loop_tries == 1 and since_ns < LOOP_NS:
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
            if want.is_due(now_ns):
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

    def figures(self) -> dict[str, float]:
        """Rates as they come, by what they carry."""
        names = {"ATTITUDE": "attitude_hz", "GLOBAL_POSITION_INT": "position_hz", "GPS_RAW_INT": "gps_hz"}
        return {
            names[want.name]: round(want.measured_hz, 1)
            for want in self.wants
            if want.name in names and want.measured_hz is not None
        }

    def complaint(self) -> str:
        """The needed message that does not come as requested, in words; empty if all do."""
        for want in self.wants:
            if not want.is_needed or want.measured_hz is None:
                continue
            if want.measured_hz == 0.0 and not want.count:
                return f"no {want.name}" + (": the autopilot denies it" if want.is_denied else "")
            if want.is_short:
                return f"{want.name} at {want.measured_hz:.1f} Hz where {want.granted_hz:.0f} were granted"
        return ""
