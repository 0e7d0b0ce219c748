"""What is asked of autopilots that grant, deny, ignore and forget; time is a number here."""

from collections.abc import Callable

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.config.schema import parse_config
from onboard.telemetry.message_rates import COMMAND, NS_PER_S, RateRequests

ACCEPTED, DENIED, FAILED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_FAILED
UNSUPPORTED, BUSY = mavlink.MAV_RESULT_UNSUPPORTED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED
Answer = Callable[[str, float], int | None]
STEP_NS = NS_PER_S // 20


class Played:
    """An autopilot that answers by a rule and sends what it granted, at what it granted."""

    def __init__(
        self,
        answer: Answer,
        text: str = "",
        autopilot: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
        loop_hz: float | None = 400.0,
    ) -> None:
        self.requests = RateRequests(parse_config(text))
        self.answer, self.autopilot, self.loop_hz = answer, autopilot, loop_hz
        self.parameters = 0  # how often it was asked for its loop rate
        self.now_ns = 10**18
        self.asked: list[tuple[str, float]] = []
        self.streams: list[tuple[int, int]] = []
        self.sends_hz: dict[str, float] = {}
        self._owed: dict[str, float] = {}

    def fly(self, seconds: float, status: int = mavlink.MAV_STATE_ACTIVE) -> None:
        for _ in range(round(seconds * NS_PER_S / STEP_NS)):
            self.requests.heartbeat(status, self.autopilot)
            for name, hz in self.sends_hz.items():
                self._owed[name] = self._owed.get(name, 0.0) + hz * STEP_NS / NS_PER_S
                while self._owed[name] >= 1.0:
                    self._owed[name] -= 1.0
                    self.requests.seen(name)
            for message in self.requests.due(1, self.now_ns):
                self.receive(message)
            self.now_ns += STEP_NS

    def receive(self, message: object) -> None:
        if isinstance(message, mavlink.MAVLink_request_data_stream_message):
            self.streams.append((message.req_stream_id, message.req_message_rate))
            return
        if isinstance(message, mavlink.MAVLink_param_request_read_message):
            assert message.param_id == "SCHED_LOOP_RATE"
            self.parameters += 1
            if self.loop_hz is not None:
                self.requests.parameter("SCHED_LOOP_RATE", self.loop_hz)
            return
        assert isinstance(message, mavlink.MAVLink_command_long_message)
        assert (message.command, message.target_system, message.target_component) == (COMMAND, 1, 1)
        name, rate_hz = mavlink.mavlink_map[int(message.param1)].msgname, 1e6 / message.param2
        self.asked.append((name, rate_hz))
        result = self.answer(name, rate_hz)
        if result is not None:
            self.requests.acknowledged(COMMAND, result, self.now_ns)
        if result == ACCEPTED:
            self.sends_hz[name] = rate_hz


def grants(_name: str, _rate_hz: float) -> int | None:
    return ACCEPTED


def test_everything_is_asked_once_and_then_there_is_peace() -> None:
    played = Played(grants)
    played.fly(60.0)
    assert played.asked == [
        ("ATTITUDE", 50.0),
        ("GLOBAL_POSITION_INT", 10.0),
        ("GPS_RAW_INT", 5.0),
        ("EKF_STATUS_REPORT", 5.0),
        ("GIMBAL_DEVICE_ATTITUDE_STATUS", 20.0),
        ("SYS_STATUS", 0.2),
        ("HOME_POSITION", 0.1),
    ]
    assert played.requests.complaint() == ""
    assert played.requests.figures() == pytest.approx(
        {"attitude_hz": 50.0, "position_hz": 10.0, "gps_hz": 5.0}, abs=0.5
    )


def test_a_battery_is_asked_for_only_where_it_does_not_come_anyway() -> None:
    """For another on the line may have asked for it at a rate of its own."""
    played = Played(grants)
    played.sends_hz["SYS_STATUS"] = 0.5
    played.fly(60.0)
    assert "SYS_STATUS" not in {name for name, _ in played.asked}
    mute = Played(lambda name, _hz: FAILED if name == "SYS_STATUS" else ACCEPTED)
    mute.fly(120.0)
    assert [name for name, _ in mute.asked].count("SYS_STATUS") == 1 and mute.requests.complaint() == ""


def test_what_is_denied_is_asked_lower_by_steps() -> None:
    played = Played(lambda name, hz: DENIED if hz > 25.0 else ACCEPTED, "[telemetry]\nattitude_rate_hz = 100.0")
    played.fly(10.0)
    assert [hz for name, hz in played.asked if name == "ATTITUDE"] == [100.0, 50.0, 40.0, 25.0]


def test_nothing_is_asked_of_an_autopilot_that_is_still_starting() -> None:
    played = Played(grants)
    played.fly(10.0, status=mavlink.MAV_STATE_CALIBRATING)
    assert not played.asked
    played.fly(1.0, status=mavlink.MAV_STATE_STANDBY)
    assert played.asked


def test_px4_is_asked_for_its_own_filter_report() -> None:
    played = Played(grants, "[mount]\ngimbal = 'never'\n[range_finder]\nuse = true", mavlink.MAV_AUTOPILOT_PX4)
    played.fly(5.0)
    assert [name for name, _ in played.asked][-2:] == ["ESTIMATOR_STATUS", "DISTANCE_SENSOR"]
    assert not {"EKF_STATUS_REPORT", "GIMBAL_DEVICE_ATTITUDE_STATUS"} & {name for name, _ in played.asked}


def test_only_one_request_is_under_way() -> None:
    played = Played(lambda name, hz: None)
    played.fly(0.9)
    assert played.asked == [("ATTITUDE", 50.0)]


@pytest.mark.parametrize("answer", [lambda name, hz: UNSUPPORTED, lambda name, hz: None], ids=["unsupported", "mute"])
def test_old_autopilots_are_asked_for_streams(answer: Answer) -> None:
    played = Played(answer, loop_hz=None)
    played.fly(14.0)
    assert set(played.streams) == {
        (mavlink.MAV_DATA_STREAM_EXTRA1, 40),
        (mavlink.MAV_DATA_STREAM_POSITION, 10),
        (mavlink.MAV_DATA_STREAM_EXTENDED_STATUS, 5),
        (mavlink.MAV_DATA_STREAM_EXTRA3, 5),
    }
    assert len(played.asked) <= 3


@pytest.mark.parametrize("first", [BUSY, None], ids=["busy", "lost"])
def test_a_busy_autopilot_is_asked_again_and_a_lost_acknowledgement_is_got_over(first: int | None) -> None:
    answers = iter([first, first])
    played = Played(lambda name, hz: next(answers, ACCEPTED))
    played.fly(8.0)
    assert played.sends_hz["ATTITUDE"] == 50.0 and len(played.sends_hz) == 5
    assert not played.streams


def test_a_message_that_stops_coming_is_asked_for_again_but_ever_less_often() -> None:
    played = Played(grants)
    played.fly(10.0)
    before = len(played.asked)
    played.answer = lambda name, hz: ACCEPTED
    del played.sends_hz["GLOBAL_POSITION_INT"]
    played.fly(5.0)
    assert played.asked[before:][0] == ("GLOBAL_POSITION_INT", 10.0)
    played.receive = lambda message: played.requests.acknowledged(COMMAND, ACCEPTED, played.now_ns)
    del played.sends_hz["ATTITUDE"]
    played.fly(10.0)
    assert played.requests.complaint() == "no ATTITUDE"


def test_how_often_a_grant_that_is_not_kept_is_claimed() -> None:
    played = Played(grants)
    played.fly(10.0)
    asked: list[int] = []

    def accept(message: object) -> None:
        asked.append(played.now_ns)
        played.requests.acknowledged(COMMAND, ACCEPTED, played.now_ns)

    played.receive = accept
    played.sends_hz["ATTITUDE"] = 4.0
    played.sends_hz["SYS_STATUS"] = 1.0
    played.fly(300.0)
    assert 4 <= len(asked) <= 12
    assert "ATTITUDE at 4.0 Hz where 50 were granted" in played.requests.complaint()


def test_what_is_denied_altogether_is_reported() -> None:
    played = Played(lambda name, hz: FAILED if "POSITION" in name else ACCEPTED)
    played.fly(10.0)
    assert played.requests.complaint() == "no GLOBAL_POSITION_INT: the autopilot denies it"


def test_a_denied_attitude_is_asked_for_as_a_quaternion() -> None:
    played = Played(lambda name, hz: DENIED if name == "ATTITUDE" else ACCEPTED)
    played.fly(10.0)
    assert played.sends_hz["ATTITUDE_QUATERNION"] == 50.0


def test_after_a_restart_everything_is_asked_again() -> None:
    played = Played(grants)
    played.fly(5.0)
    before = len(played.asked)
    played.requests.restart()
    played.fly(5.0)
    assert played.asked[before:] == played.asked[:before]


def is_quiet(loop_hz: float, rate_hz: float) -> bool:
    """Whether ArduPilot grants a rate without a word to the pilot: `cap_message_interval` of its GCS_Common."""
    return int(1e6 / rate_hz + 1e-6) // 1000 * 800 >= 1e6 / loop_hz - 1e-6


@pytest.mark.parametrize("wanted_hz", [20.0, 50.0, 200.0, 400.0])
@pytest.mark.parametrize("loop_hz", [50.0, 100.0, 200.0, 300.0, 400.0])
def test_ardupilot_is_asked_for_what_its_loop_can_give_and_no_less(loop_hz: float, wanted_hz: float) -> None:
    played = Played(grants, f"[telemetry]\nattitude_rate_hz = {wanted_hz}\nposition_rate_hz = 50.0", loop_hz=loop_hz)
    played.fly(10.0)
    assert all(is_quiet(loop_hz, hz) for _, hz in played.asked)
    attitude_hz = played.sends_hz["ATTITUDE"]
    assert attitude_hz <= wanted_hz
    assert attitude_hz >= min(wanted_hz, 0.6 * loop_hz)  # whole milliseconds cost the rest of 0.8
    assert played.parameters == 1


def test_an_ardupilot_that_does_not_give_its_loop_rate_is_asked_for_forty() -> None:
    played = Played(grants, loop_hz=None)
    played.fly(10.0)
    assert played.asked[0] == ("ATTITUDE", 40.0)
    assert all(is_quiet(50.0, hz) for _, hz in played.asked)
    assert played.parameters == 2
    lower = Played(lambda name, hz: DENIED if hz > 30.0 else ACCEPTED, loop_hz=None)
    lower.fly(10.0)
    assert [hz for name, hz in lower.asked if name == "ATTITUDE"] == [40.0, 25.0]


def test_px4_is_not_asked_for_ardupilot_s_parameter() -> None:
    played = Played(grants, autopilot=mavlink.MAV_AUTOPILOT_PX4)
    played.fly(10.0)
    assert played.parameters == 0
    assert played.sends_hz["ATTITUDE"] == 50.0


def test_px4_without_a_fix_is_asked_at_once_and_again_when_it_is_ready() -> None:
    played = Played(grants, autopilot=mavlink.MAV_AUTOPILOT_PX4)
    played.fly(10.0, status=mavlink.MAV_STATE_UNINIT)
    first = list(played.asked)
    assert len(first) == 5
    played.fly(10.0, status=mavlink.MAV_STATE_STANDBY)
    assert played.asked == first * 2
    played.fly(10.0, status=mavlink.MAV_STATE_ACTIVE)
    assert played.asked == first * 2


def test_a_rate_below_what_was_granted_is_asked_for_again() -> None:
    played = Played(grants, autopilot=mavlink.MAV_AUTOPILOT_PX4)
    played.fly(10.0)
    before = len(played.asked)
    played.sends_hz["ATTITUDE"] = 25.0  # another on the line has set it lower
    played.fly(10.0)
    assert played.asked[before:] == [("ATTITUDE", 50.0)]
    assert played.requests.complaint() == ""


def test_a_loop_rate_that_comes_late_raises_what_was_asked_and_nonsense_does_not() -> None:
    played = Played(grants, loop_hz=None)
    played.fly(10.0)
    before = len(played.asked)
    for name, value in (
        ("SCHED_LOOP_RATE", float("nan")),
        ("SCHED_LOOP_RATE", 0.0),
        ("SCHED_DEBUG", 400.0),
        ("", 400.0),
    ):
        played.requests.parameter(name, value)
    played.fly(5.0)
    assert len(played.asked) == before
    played.requests.parameter("SCHED_LOOP_RATE", 1e30)  # no faster than a message a millisecond
    assert max(want.rates_hz[0] for want in played.requests.wants) <= 1000.0
    played.requests.parameter(b"SCHED_LOOP_RATE\0", 400.0)
    played.fly(5.0)
    assert played.asked[before:] == [("ATTITUDE", 50.0)]
