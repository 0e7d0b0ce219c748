"""The conversation with one autopilot, with time as a number: how it is, what is said, and as what we are announced."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from contract.vehicle_status import MAX_MODE
from onboard.clocks.timesync import NS_PER_S
from onboard.config.schema import parse_config
from onboard.events.source import AircraftReport, Severity, SourceStatus, State
from onboard.events.types import NavEvent, PositionFix
from onboard.telemetry.flight_modes import mode_of
from onboard.telemetry.mavlink_session import Autopilot
from tests.onboard.clocks.test_clock_drift import EPOCH, MS, Clocks
from tests.rest_long import rest_long

STEP_NS = 50 * MS
PX4, ARDUPILOT = mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA


class Simulated:
    """An autopilot on a clock of its own that sends, grants and answers at once, and what is said to it."""

    def __init__(self, kind: int = PX4, rate: float = 0.0, changes: bool = False) -> None:
        self.autopilot, self.kind = Autopilot(parse_config("[telemetry]\nsystem = 1")), kind
        self.clocks = Clocks(rate, changes)
        self.tick = 0
        self.sent: list[Any] = []
        self.events: list[NavEvent] = []  # of what was received
        self.has_filter = True  # it sends the position of its filter, and not its receiver's alone
        self.other_clock_s: float | None = 0.0  # how far ahead the clock is that answers TIMESYNC; None: it does not

    @property
    def now_ns(self) -> int:
        return EPOCH + self.tick * STEP_NS

    def boot_ns(self, late_ns: int = 0) -> int:
        return self.clocks.boot_ns((self.now_ns - late_ns - EPOCH) / 1e9)

    def receive(self, message: Any, late_ns: int = 2 * MS) -> None:
        message._header = mavlink.MAVLink_header(message.id, srcSystem=1, srcComponent=1)
        self.events += self.autopilot.receive(message, self.now_ns + late_ns)

    def fly(self, seconds: float) -> SourceStatus:
        for _ in range(round(seconds * NS_PER_S / STEP_NS)):
            boot_ms = self.boot_ns() // MS
            if self.tick % 20 == 0:
                self.receive(mavlink.MAVLink_heartbeat_message(1, self.kind, 0, 0, mavlink.MAV_STATE_ACTIVE, 3))
            self.receive(mavlink.MAVLink_attitude_message(boot_ms, 0.1, 0.0, 0.0, 0.0, 0.0, 0.1))
            if self.has_filter:
                self.receive(mavlink.MAVLink_global_position_int_message(boot_ms, 4 * 10**8, 10**8, 0, 0, 500, 0, 0, 0))
            self.receive(mavlink.MAVLink_gps_raw_int_message(boot_ms * 1000, 3, 4 * 10**8, 10**8, 0, 100, 100, 0, 0, 9))
            for message in self.autopilot.due(self.now_ns):
                self.sent.append(message)
                self._answer(message)
            self.tick += 1
        return self.autopilot.health(self.now_ns)

    def _answer(self, message: Any) -> None:
        if message.get_type() == "TIMESYNC" and message.tc1 == 0 and self.other_clock_s is not None:
            answer_ns = self.clocks.boot_ns((self.now_ns + MS - EPOCH) / 1e9) + round(self.other_clock_s * 1e9)
            self.receive(mavlink.MAVLink_timesync_message(answer_ns, message.ts1))
        elif message.get_type() == "COMMAND_LONG":
            self.receive(mavlink.MAVLink_command_ack_message(message.command, mavlink.MAV_RESULT_ACCEPTED))

    def of(self, name: str) -> list[Any]:
        return [message for message in self.sent if message.get_type() == name]


def test_the_receiver_s_position_is_taken_where_the_filter_s_has_stopped_and_as_long_as_it_has() -> None:
    """A filter that had sent its position once was waited for all flight long."""
    link = Simulated()

    def positions(seconds: float) -> int:
        link.events.clear()
        link.fly(seconds)
        return sum(isinstance(event, PositionFix) for event in link.events)

    assert positions(10.0) > 150
    link.has_filter = False
    assert positions(4.0) <= 1 and positions(10.0) > 150
    link.has_filter = True
    assert positions(10.0) == pytest.approx(200, abs=3)  # one of each moment, not two
    link.tick += 20 * 8  # the whole link is cut for 8 s
    assert positions(1.0) == pytest.approx(20, abs=2)


def test_what_autopilots_pass_on_to_every_radio_is_next_to_nothing_once_the_clock_is_known() -> None:
    """Of 50 bytes a second that the thinnest radio carries. Questions of an autopilot's own come every ten seconds."""
    simulated = Simulated(ARDUPILOT, rate=50e-6)
    simulated.fly(60.0)
    begun = [len(packed(message)) for message in simulated.sent if not hasattr(message, "target_system")]
    simulated.sent.clear()
    for _ in range(54):
        simulated.receive(mavlink.MAVLink_timesync_message(0, simulated.boot_ns()))
        simulated.fly(10.0)
    passed_on = [packed(message) for message in simulated.sent if not hasattr(message, "target_system")]
    assert {message.get_type() for message in simulated.sent} >= {"HEARTBEAT", "TIMESYNC"}
    assert 0.5 < sum(map(len, passed_on)) / 540.0 <= 3.0
    assert sum(begun) <= 1000


def packed(message: Any) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, 1, 191)))


def lenient(status: SourceStatus) -> str:
    """The reason, but for rates: everything here comes 20 times a second, whatever was asked."""
    return "" if "were granted" in status.detail else status.detail


@pytest.mark.parametrize("rate", rest_long([27e-3, 0.0, 15e-3]))
def test_a_drifting_clock_that_answers_is_well(rate: float) -> None:
    simulated = Simulated(rate=rate, changes=True)
    status = simulated.fly(300.0)
    assert lenient(status) == ""
    assert 0.0 < status.figures["clock_sigma_ms"] < 10.0
    assert "round_trip_ms" in status.figures


@pytest.mark.parametrize(
    ("other_clock_s", "reason"),
    [(3.0, "TIMESYNC is answered from another clock: "), (None, "TIMESYNC is not answered any more: ")],
)
def test_health_says_so_where_the_clock_is_not_known_by_timesync(other_clock_s: float | None, reason: str) -> None:
    simulated = Simulated(rate=20e-3, changes=True)
    simulated.fly(60.0)
    simulated.other_clock_s = other_clock_s
    status = simulated.fly(60.0)
    assert status.state is State.DEGRADED
    assert status.detail.startswith(f"{reason}stamps by arrival, +-")
    assert "round_trip_ms" not in status.figures
    simulated.other_clock_s = 0.0
    assert lenient(simulated.fly(20.0)) == ""


def test_a_clock_known_badly_is_reported_to_be() -> None:
    simulated = Simulated()
    simulated.fly(5.0)
    for _ in range(100):  # half of 200 ms, evenly: 58 ms
        simulated.autopilot.clock.exchanged(simulated.now_ns - 200 * MS, simulated.boot_ns(100 * MS), simulated.now_ns)
        simulated.other_clock_s = None
        simulated.fly(1.0)
    status = simulated.autopilot.health(simulated.now_ns)
    assert status.state is State.DEGRADED
    assert status.detail.startswith("the autopilot's clock is known to +-5")


@pytest.mark.parametrize(
    ("kind", "announced"), [(PX4, mavlink.MAV_TYPE_GENERIC), (ARDUPILOT, mavlink.MAV_TYPE_ONBOARD_CONTROLLER)]
)
def test_px4_is_not_given_an_onboard_controller_to_miss(kind: int, announced: int) -> None:
    autopilot = Autopilot(parse_config(""))
    (first,) = autopilot.due(EPOCH, speaks_first=True)
    assert first.type == mavlink.MAV_TYPE_GENERIC  # PX4 may be the one that hears it
    simulated = Simulated(kind)
    simulated.fly(5.0)
    beats = simulated.of("HEARTBEAT")
    assert len(beats) == 1
    assert {(beat.type, beat.autopilot, beat.system_status) for beat in beats} == {(announced, 8, 4)}
    farewell = simulated.autopilot.farewell()
    assert (farewell.type, farewell.system_status) == (announced, mavlink.MAV_STATE_POWEROFF)


@pytest.mark.parametrize("text", ["ok", "x" * 50, "y" * 51, "word: reason " * 7, "z" * 300])
def test_a_text_for_the_pilot_is_whole_up_to_two_pieces(text: str) -> None:
    simulated = Simulated()
    simulated.fly(2.0)
    simulated.autopilot.send_text(Severity.WARNING, text)
    simulated.autopilot.send_text(Severity.INFO, text)
    simulated.fly(2.0)
    pieces = simulated.of("STATUSTEXT")
    count = 1 if len(text) <= 50 else 2
    assert len(pieces) == 2 * count
    assert b"".join(piece.text.encode() for piece in pieces[:count]).decode() == text[:100]
    assert [piece.chunk_seq for piece in pieces] == [*range(count)] * 2
    numbers = [piece.id for piece in pieces]
    assert numbers == ([0, 0] if count == 1 else [1, 1, 2, 2])
    assert [piece.severity for piece in pieces] == [4] * count + [6] * count


@pytest.mark.parametrize(
    ("autopilot", "vehicle", "number", "name"),
    [
        (ARDUPILOT, 1, 10, "AUTO"), (ARDUPILOT, 1, 5, "FLY BY WIRE A"), (ARDUPILOT, 20, 21, "QRTL"),
        (ARDUPILOT, 2, 10, ""), (ARDUPILOT, 2, 3, "AUTO"), (ARDUPILOT, 10, 4, "HOLD"), (ARDUPILOT, 1, 27, ""),
        (ARDUPILOT, 1, 2**32 - 1, ""), (ARDUPILOT, 200, 10, ""), (PX4, 2, 4 << 16 | 3 << 24, "HOLD"),
        (PX4, 13, 3 << 16, "POSITION"), (PX4, 13, 4 << 16, ""), (PX4, 1, 77 << 16, ""), (4, 1, 10, ""),
    ],
)  # fmt: skip
def test_a_mode_is_named_from_a_table_or_not_at_all(autopilot: int, vehicle: int, number: int, name: str) -> None:
    beat = mavlink.MAVLink_heartbeat_message(vehicle, autopilot, 1, number, mavlink.MAV_STATE_ACTIVE, 3)
    assert mode_of(beat) == name
    assert not name or len(name) <= MAX_MODE
    beat.base_mode = 0  # an ArduPilot whose number means nothing
    assert mode_of(beat) == (name if autopilot == PX4 else "")


@pytest.mark.parametrize(
    ("millivolts", "percent", "known"),
    [(22_140, 64, (64, 22.14)), (0, -1, (None, None)), (65535, 101, (None, None)), (65534, -128, (None, 65.534)),
     (12_000, 0, (0, 12.0))],
)  # fmt: skip
def test_a_battery_is_stated_as_far_as_it_is_known_and_no_longer_than_it_holds(
    millivolts: int, percent: int, known: tuple[int | None, float | None]
) -> None:
    simulated = Simulated(ARDUPILOT)
    message = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, millivolts, -1, percent, 0, 0, 0, 0, 0, 0)
    simulated.receive(message)
    simulated.receive(mavlink.MAVLink_heartbeat_message(1, ARDUPILOT, 1, 11, mavlink.MAV_STATE_ACTIVE, 3))
    for after_s, expected in (
        (4.0, AircraftReport("RTL", *known)),
        (14.0, AircraftReport("", *known)),
        (17.0, AircraftReport()),
    ):
        assert simulated.autopilot.health(simulated.now_ns + round(after_s * NS_PER_S)).aircraft == expected


def test_another_component_s_heartbeat_and_battery_are_not_the_aircraft_s() -> None:
    simulated = Simulated(ARDUPILOT)
    battery = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 5_000, -1, 3, 0, 0, 0, 0, 0, 0)
    beat = mavlink.MAVLink_heartbeat_message(1, ARDUPILOT, 1, 11, mavlink.MAV_STATE_ACTIVE, 3)
    for system, component in ((1, 100), (255, 190), (2, 1)):
        for message in (battery, beat):
            message._header = mavlink.MAVLink_header(message.id, srcSystem=system, srcComponent=component)
            simulated.autopilot.receive(message, simulated.now_ns)
    assert simulated.autopilot.health(simulated.now_ns).aircraft == AircraftReport()


def test_rates_are_asked_of_px4_before_it_has_a_fix() -> None:
    simulated = Simulated()
    simulated.receive(mavlink.MAVLink_heartbeat_message(1, PX4, 0, 0, mavlink.MAV_STATE_UNINIT, 3))
    out = simulated.autopilot.due(simulated.now_ns)
    assert [message.param1 for message in out if message.get_type() == "COMMAND_LONG"] == [30]
