"""Styles of autopilots: which rates they send unasked, what they grant, what they refuse."""

from __future__ import annotations

from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

# REQUEST_DATA_STREAM's groups, as ArduPilot has them.
STREAMS = {
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: {"SYS_STATUS", "GPS_RAW_INT", "MEMINFO", "MISSION_CURRENT"},
    mavlink.MAV_DATA_STREAM_POSITION: {"GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"},
    mavlink.MAV_DATA_STREAM_EXTRA1: {"ATTITUDE", "AHRS2"},
    mavlink.MAV_DATA_STREAM_EXTRA2: {"VFR_HUD"},
    mavlink.MAV_DATA_STREAM_EXTRA3: {"SYSTEM_TIME", "EKF_STATUS_REPORT", "VIBRATION", "DISTANCE_SENSOR"},
}


@dataclass(frozen=True)
class Style:
    """One kind of autopilot."""

    autopilot: int
    unasked_hz: dict[str, float]
    others_hz: float  # of messages not named above
    max_hz: float  # above this SET_MESSAGE_INTERVAL is denied
    knows_intervals: bool = True
    knows_streams: bool = True
    mavlink1: bool = False
    timesync_s: float = 10.0  # how often it asks us
    starting_status: int = mavlink.MAV_STATE_CALIBRATING  # of its heartbeats until it is ready
    mode: int = 10  # in its heartbeats: AUTO of ArduPilot's aeroplanes
    parameters: dict[str, float] = field(default_factory=dict)  # that it reports; of others nothing
    unknown: tuple[int, ...] = ()  # numbers of messages it sends that pymavlink's dialect does not have
    # How long a component of the type "onboard controller" may be silent before the pilot is warned; None: for ever.
    mission_computer_s: float | None = None


STYLES = {
    "ardupilot": Style(
        mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
        {"ATTITUDE": 4.0, "GLOBAL_POSITION_INT": 2.0, "GPS_RAW_INT": 2.0, "ATTITUDE_QUATERNION": 0.0},
        1.0,
        40.0,
        parameters={"SCHED_LOOP_RATE": 50.0, "MAV_GCS_SYSID": 255.0, "MAV_GCS_SYSID_HI": 255.0},
    ),
    "px4": Style(
        mavlink.MAV_AUTOPILOT_PX4,
        {"ATTITUDE": 15.0, "GLOBAL_POSITION_INT": 5.0, "GPS_RAW_INT": 1.0, "ESTIMATOR_STATUS": 0.5},
        1.0,
        1000.0,
        knows_streams=False,
        mode=4 << 16 | 4 << 24,  # MISSION
        timesync_s=1.0,
        starting_status=mavlink.MAV_STATE_UNINIT,  # until it has a position
        unknown=(8, 380, 410, 411, 436),
        mission_computer_s=5.0,  # its COM_OBC_LOSS_T
    ),
    "old": Style(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, {}, 0.0, 50.0, knows_intervals=False, mavlink1=True),
}


@dataclass
class Rates:
    """The rates of messages on one link since one boot. `names`: messages this autopilot can send at all."""

    style: Style
    names: set[str]
    everything: bool = False
    asked_hz: dict[str, float] = field(default_factory=dict)
    _next_ns: dict[str, int] = field(default_factory=dict)

    def set_interval(self, message_id: int, interval_us: float) -> int:
        """SET_MESSAGE_INTERVAL; returns the MAV_RESULT of its acknowledgement."""
        if not self.style.knows_intervals:
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        known = mavlink.mavlink_map.get(message_id)
        name = known.msgname if known is not None else ""
        if name not in self.names:
            return int(mavlink.MAV_RESULT_FAILED)
        if interval_us == 0:
            self.asked_hz.pop(name, None)
        elif interval_us < 0:
            self.asked_hz[name] = 0.0
        elif 1e6 / interval_us > self.style.max_hz + 1e-6:
            return int(mavlink.MAV_RESULT_DENIED)
        else:
            self.asked_hz[name] = 1e6 / interval_us
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def set_stream(self, stream: int, rate_hz: float) -> None:
        """REQUEST_DATA_STREAM; never acknowledged."""
        if self.style.knows_streams:
            groups = STREAMS.values() if stream == mavlink.MAV_DATA_STREAM_ALL else [STREAMS.get(stream, set())]
            for name in set().union(*groups) & self.names:
                self.asked_hz[name] = min(rate_hz, self.style.max_hz)

    def rate_hz(self, name: str) -> float:
        """The rate at which a message is sent now."""
        return self.asked_hz.get(name, self.style.unasked_hz.get(name, self.style.others_hz))

    def is_due(self, name: str, now_ns: int) -> bool:
        """Return whether the next message of a recording goes out, to keep its rate on average."""
        if self.everything:
            return True
        rate_hz = self.rate_hz(name)
        if rate_hz <= 0.0:
            return False
        due_ns, interval_ns = self._next_ns.get(name, now_ns), round(1e9 / rate_hz)
        if now_ns < due_ns - 1_000_000:
            return False
        self._next_ns[name] = max(due_ns + interval_ns, now_ns + interval_ns // 2)
        return True
