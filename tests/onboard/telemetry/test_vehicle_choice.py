"""Which vehicle on a line is ours, with time as a number: what is refused and stated, and whose positions count."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.config.schema import parse_config
from onboard.events.source import SourceStatus, State
from onboard.events.types import PositionFix
from onboard.telemetry.mavlink_session import Autopilot
from tests.onboard.clocks.test_clock_drift import EPOCH, MS

STEP_NS = 100 * MS
OURS, OTHER = 1, 7
LAT = {OURS: 47.0, OTHER: 46.0}
BOTH = "1 ArduPilot fixed wing, 7 PX4 quadrotor"


class OnOneLine:
    """Vehicles that send on one line, each a heartbeat a second and ten positions; and whose positions came of it."""

    def __init__(self, configured: int = 0) -> None:
        self.autopilot = Autopilot(parse_config(f"[telemetry]\nsystem = {configured}"))
        self.now_ns = EPOCH
        self.fixes: list[PositionFix] = []

    def fly(self, seconds: float, *systems: int) -> SourceStatus:
        for tick in range(round(seconds * 1e9 / STEP_NS)):
            for system in systems:
                self._send(system, is_beat=tick % 10 == 0)
            self.now_ns += STEP_NS
            self.autopilot.due(self.now_ns)
        return self.autopilot.health(self.now_ns)

    def _send(self, system: int, *, is_beat: bool) -> None:
        boot_ms = (self.now_ns - EPOCH) // MS + 1000 * system
        kind, flies = (3, mavlink.MAV_TYPE_FIXED_WING) if system == OURS else (12, mavlink.MAV_TYPE_QUADROTOR)
        beat = mavlink.MAVLink_heartbeat_message(flies, kind, 0, 0, mavlink.MAV_STATE_ACTIVE, 3)
        fix = mavlink.MAVLink_global_position_int_message(boot_ms, round(LAT[system] * 1e7), 10**8, 0, 0, 0, 0, 0, 0)
        for message in [beat, fix] if is_beat else [fix]:
            message._header = mavlink.MAVLink_header(message.id, srcSystem=system, srcComponent=1)
            events = self.autopilot.receive(message, self.now_ns + 2 * MS)
            self.fixes += [event for event in events if isinstance(event, PositionFix)]

    @property
    def lats(self) -> set[float]:
        return {fix.lat_deg for fix in self.fixes}


def test_the_only_one_is_ours_as_soon_as_others_had_time_to_be_received() -> None:
    line = OnOneLine()
    assert line.fly(1.0, OURS).state is State.STARTING and not line.fixes
    assert (
        line.autopilot.health(line.now_ns).detail == "1 ArduPilot fixed wing found: listening for others on this line"
    )
    line.fly(4.0, OURS)
    assert line.autopilot.system == OURS and line.lats == {47.0}


@pytest.mark.parametrize("order", [(OTHER, OURS), (OURS, OTHER)])
def test_of_two_none_is_ours_until_one_is_chosen(order: tuple[int, int]) -> None:
    line = OnOneLine()
    status = line.fly(300.0, *order)
    assert not line.fixes and line.autopilot.system is None
    assert (status.state, status.detail) == (
        State.LOST, f"several vehicles on this line ({BOTH}): set telemetry.system"
    )  # fmt: skip
    chosen = OnOneLine(OURS)
    assert "telemetry.system" not in chosen.fly(10.0, *order).detail
    assert chosen.lats == {47.0}


def test_once_the_other_has_left_for_longer_than_a_reboot_takes_we_follow_our_own_and_state_it() -> None:
    line = OnOneLine()
    line.fly(10.0, OTHER, OURS)
    assert line.fly(25.0, OURS).state is State.LOST and not line.fixes
    status = line.fly(15.0, OURS)
    assert line.lats == {47.0}
    assert status.state is State.DEGRADED
    assert status.detail == f"{BOTH} were on this line, 1 is left and followed: set telemetry.system"


def test_what_is_ours_stays_ours_when_a_second_comes_seconds_later_and_that_is_stated() -> None:
    line = OnOneLine()
    line.fly(10.0, OURS)
    status = line.fly(10.0, OTHER, OURS)
    assert (status.state, line.lats) == (State.DEGRADED, {47.0})
    assert status.detail == f"several vehicles on this line ({BOTH}), 1 is followed: set telemetry.system"
    line.fly(31.0, OURS)
    assert "several" not in line.autopilot.health(line.now_ns).detail


def test_ours_falling_silent_next_to_another_never_makes_that_one_ours() -> None:
    line = OnOneLine()
    line.fly(10.0, OURS)
    line.fly(10.0, OURS, OTHER)
    status = line.fly(300.0, OTHER)
    assert line.lats == {47.0} and status.state is State.LOST
    assert status.detail.endswith("; received instead: 7 PX4 quadrotor. If that is this aircraft, set telemetry.system")
    line.fly(5.0, OURS, OTHER)
    assert line.autopilot.health(line.now_ns).state is State.DEGRADED and line.lats == {47.0}


def test_a_configured_vehicle_that_is_not_there_is_named_with_those_that_are() -> None:
    line = OnOneLine(3)
    status = line.fly(5.0, OURS)
    assert (status.state, line.fixes) == (State.STARTING, [])
    assert status.detail == (
        "no autopilot with system number 3 found yet, but 1 ArduPilot fixed wing: is telemetry.system right?"
    )
