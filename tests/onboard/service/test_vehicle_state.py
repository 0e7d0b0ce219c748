"""The state in a word, by table; and when the watchdog may be fed."""

from dataclasses import replace

import pytest
from hypothesis import given

from contract.feature_set import Status
from contract.supervised_thread import ThreadReport, ThreadState
from contract.vehicle_status import MAX_STATE
from onboard.events.source import Severity, SourceStatus, State
from onboard.service.vehicle_state import (
    AT_REST,
    SILENT_S,
    STUCK_S,
    GpsReport,
    Inputs,
    Overall,
    Subject,
    VehicleState,
    is_alive,
    judge,
    overall,
    second_in_brief,
    severity,
)
from tests.onboard.service.reported import inputs, unhurried

OK = SourceStatus(State.OK)
GPS = GpsReport(3, 0.2, 14, 0.8)
WELL = Inputs(OK, OK, 0.03, 0.0, Status.OK, GPS)
REST = replace(WELL, outcome=Status.LOW_PARALLAX, is_at_rest=True)
LOST, FROZEN, STARTING = (
    SourceStatus(State.LOST, "unplugged"),
    SourceStatus(State.FROZEN, "same again"),
    SourceStatus(State.STARTING),
)
LATE = SourceStatus(State.DEGRADED, "10 of 30 Hz")

TABLE = [
    (WELL, VehicleState.OK, ""),
    (replace(WELL, camera=STARTING, picture_age_s=None, outcome=None), VehicleState.STARTING, "waiting for the camera"),
    (replace(WELL, telemetry=STARTING, outcome=None), VehicleState.STARTING, "waiting for the telemetry"),
    (replace(WELL, outcome=None), VehicleState.STARTING, "no picture has come through yet"),
    (replace(WELL, outcome=Status.STARTING), VehicleState.STARTING, "no position or too little seen yet"),
    (replace(WELL, camera=LOST), VehicleState.CAMERA_LOST, "unplugged"),
    (replace(WELL, camera=LOST, picture_age_s=100.0, outcome=None), VehicleState.CAMERA_LOST, "unplugged"),
    (replace(WELL, camera=FROZEN), VehicleState.CAMERA_FROZEN, "same again"),
    (replace(WELL, telemetry=LOST), VehicleState.TELEMETRY_LOST, "unplugged"),
    (replace(WELL, telemetry=LOST, outcome=Status.UNSYNCHRONISED), VehicleState.TELEMETRY_LOST, "unplugged"),
    (replace(WELL, telemetry=FROZEN), VehicleState.TELEMETRY_LOST, "same again"),
    (replace(WELL, camera=LOST, telemetry=LOST), VehicleState.CAMERA_LOST, "unplugged"),
    (replace(WELL, picture_age_s=5.0), VehicleState.CAMERA_SILENT, "no picture for 5 s"),
    (replace(WELL, busy_s=9.0), VehicleState.STUCK, "the pipeline has been at one event for 9 s"),
    (replace(WELL, busy_s=9.0, camera=LOST), VehicleState.STUCK, "the pipeline has been at one event for 9 s"),
    (replace(WELL, outcome=Status.NO_GPS), VehicleState.NO_GPS, "the position is not accepted"),
    (replace(WELL, outcome=Status.FEATURELESS), VehicleState.FEATURELESS, "too little to follow in the pictures"),
    (replace(WELL, outcome=Status.UNSYNCHRONISED), VehicleState.UNSYNCHRONISED,
     "no telemetry about the moment of exposure"),
    (replace(WELL, outcome=Status.LOW_PARALLAX), VehicleState.LOW_PARALLAX, "standing still: no depth without motion"),
    (replace(WELL, is_shedding=True), VehicleState.OVERLOADED, "pictures are dropped to keep up"),
    (replace(WELL, is_shedding=True, outcome=Status.NO_GPS), VehicleState.NO_GPS, "the position is not accepted"),
    (replace(WELL, recording_fault="disk full"), VehicleState.NOT_RECORDING, "disk full"),
    (replace(WELL, camera=LATE), VehicleState.DEGRADED, "camera: 10 of 30 Hz"),
    (replace(WELL, thermal_camera=OK), VehicleState.OK, ""),
    (replace(WELL, thermal_camera=LOST), VehicleState.DEGRADED, "thermal camera: lost, so no hot spots (unplugged)"),
    (replace(WELL, camera=LOST, thermal_camera=LOST), VehicleState.CAMERA_LOST, "unplugged"),
    (replace(WELL, telemetry=LATE), VehicleState.DEGRADED, "telemetry: 10 of 30 Hz"),
    (REST, VehicleState.AT_REST, AT_REST),
    (replace(REST, outcome=Status.STARTING), VehicleState.AT_REST, AT_REST),
    (replace(REST, outcome=Status.FEATURELESS), VehicleState.AT_REST, AT_REST),
    (replace(REST, outcome=Status.OK), VehicleState.OK, ""),
    (replace(REST, outcome=Status.POOR_FIT), VehicleState.POOR_FIT, "pictures and telemetry contradict each other"),
    (replace(REST, outcome=Status.BAD_PICTURE), VehicleState.BAD_PICTURE, "pictures cannot be used"),
    (replace(REST, outcome=None), VehicleState.STARTING, "no picture has come through yet"),
    (replace(REST, position_fault="far from it"), VehicleState.NO_GPS, "position: far from it"),
    (replace(REST, recording_fault="disk full"), VehicleState.NOT_RECORDING, "disk full"),
    (replace(REST, camera=LATE), VehicleState.DEGRADED, "camera: 10 of 30 Hz"),
    (replace(WELL, outcome=Status.POOR_FIT, position_fault="far from it"), VehicleState.NO_GPS,
     "position: far from it"),
    (replace(WELL, outcome=None, position_fault="no fix yet"), VehicleState.STARTING, "position: no fix yet"),
    (replace(WELL, position_fault="came back unexplained"), VehicleState.DEGRADED, "position: came back unexplained"),
    (replace(WELL, gps=None), VehicleState.DEGRADED, "gps: the receiver has sent nothing"),
    (replace(WELL, gps=replace(GPS, fix_type=1)), VehicleState.NO_GPS, "no position (no fix, 14 satellites, +-0.8 m)"),
    (replace(WELL, gps=replace(GPS, age_s=4.0)), VehicleState.NO_GPS, "the receiver has been silent for 4 s"),
    (replace(WELL, gps=replace(GPS, sigma_horizontal_m=12.0)), VehicleState.DEGRADED,
     "gps: 3D fix, 14 satellites, +-12.0 m"),
    (replace(WELL, threads=(ThreadReport("link", ThreadState.FAILED, None, 2, "OSError: gone"),)),
     VehicleState.DEGRADED, "link: failed (OSError: gone)"),
    (replace(WELL, threads=(ThreadReport("link", ThreadState.RUNNING, 0.1, 2, "OSError: gone"),)), VehicleState.OK, ""),
    (replace(WELL, telemetry=LATE, outcome=Status.TURNING), VehicleState.TURNING,
     "turning too fast to follow features"),
]  # fmt: skip


@pytest.mark.parametrize(("messages", "state", "reason"), TABLE)
def test_the_state_has_one_word_and_its_reason(messages: Inputs, state: VehicleState, reason: str) -> None:
    assert overall(messages) == Overall(state, reason)


@unhurried
@given(inputs())
def test_all_is_well_only_when_everything_is(messages: Inputs) -> None:
    state = overall(messages)
    flows = messages.outcome is Status.OK
    rests = messages.is_at_rest and messages.outcome in (Status.STARTING, Status.LOW_PARALLAX, Status.FEATURELESS)
    gps = messages.gps
    everything = (
        messages.camera.state is State.OK
        and messages.telemetry.state is State.OK
        and (flows or rests)
        and gps is not None
        and gps.fix_type >= 3
        and gps.age_s < 3.0
        and (gps.sigma_horizontal_m is None or gps.sigma_horizontal_m <= 5.0)
        and not messages.position_fault
        and not messages.is_shedding
        and not messages.recording_fault
        and all(thread.is_well for thread in messages.threads)
        and messages.busy_s <= STUCK_S
        and (messages.picture_age_s is None or messages.picture_age_s <= SILENT_S)
        and not messages.contradiction
        and (messages.thermal_camera is None or messages.thermal_camera.state is State.OK)
    )
    assert state.state.is_well == everything
    assert (state.state is VehicleState.OK) == (everything and flows)
    assert bool(state.reason) != (everything and flows)
    assert len(state.state.value) <= MAX_STATE


@unhurried
@given(inputs())
def test_the_state_is_the_first_of_what_is_found_and_degradations_come_last(messages: Inputs) -> None:
    found = judge(messages)
    assert overall(messages).state.is_well == (not found)
    if found:
        assert (overall(messages).state, overall(messages).reason) == (found[0].state, found[0].reason)
    degraded = [finding.state is VehicleState.DEGRADED for finding in found]
    assert degraded == sorted(degraded)
    assert all(finding.reason for finding in found)


def test_with_the_camera_lost_all_else_that_is_not_well_is_found_too() -> None:
    messages = replace(WELL, camera=LOST, outcome=None, gps=replace(GPS, fix_type=0), recording_fault="disk full")
    assert [finding.subject for finding in judge(messages)] == [
        Subject.CAMERA, Subject.GPS, Subject.ANSWERS, Subject.RECORDING,
    ]  # fmt: skip


@unhurried
@given(inputs())
def test_a_daemon_that_is_well_is_alive_and_one_that_is_stuck_is_not(messages: Inputs) -> None:
    if overall(messages).state.is_well:
        assert is_alive(messages)
    if overall(messages).state is VehicleState.STUCK:
        assert not is_alive(messages)
    if overall(messages).state is VehicleState.CAMERA_SILENT:
        assert not is_alive(messages)


@pytest.mark.parametrize(
    ("messages", "alive"),
    [
        (WELL, True),
        (replace(WELL, busy_s=STUCK_S + 0.1), False),
        (replace(WELL, picture_age_s=SILENT_S + 0.1), False),
        (replace(WELL, picture_age_s=60.0, camera=LOST), True),
        (replace(WELL, picture_age_s=60.0, camera=FROZEN), True),
        (replace(WELL, picture_age_s=60.0, camera=LOST, busy_s=STUCK_S + 0.1), False),
        (replace(WELL, picture_age_s=None, camera=STARTING, outcome=None), True),
        (replace(WELL, telemetry=LOST, outcome=Status.UNSYNCHRONISED), True),
    ],
)
def test_the_watchdog_is_fed_while_pictures_flow_or_the_camera_says_why_not(messages: Inputs, alive: bool) -> None:
    assert is_alive(messages) is alive


def test_people_are_warned_of_faults_louder_than_of_flying() -> None:
    assert severity(VehicleState.OK) is severity(VehicleState.STARTING) is Severity.NOTICE
    assert severity(VehicleState.CAMERA_LOST) is severity(VehicleState.NO_GPS) is Severity.WARNING
    assert severity(VehicleState.STUCK) is Severity.ERROR


@pytest.mark.parametrize(
    ("status", "text"),
    [
        (None, ""),
        (OK, ""),
        (LOST, "lost: unplugged"),
        (SourceStatus(State.LOST, "/dev/v4l/by-id/usb-x: no picture for 3.0 s"), "lost: no picture for 3.0 s"),
        (SourceStatus(State.DEGRADED, "pictures are 80x60, the camera file is for 160x120: none is used"),
         "degraded: pictures are 80x60, the camera file is for 160x120: none is used"),
    ],
)  # fmt: skip
def test_the_link_has_of_a_second_camera_its_state_and_why(status: SourceStatus | None, text: str) -> None:
    assert second_in_brief(status) == text
