"""The state in a word, by table; and when the watchdog may be fed."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.feature_set import Status
from contract.vehicle_status import MAX_WORD
from onboard.events.source import Severity, SourceStatus, State
from onboard.service.vehicle_state import SILENT_S, STUCK_S, Inputs, Overall, Word, is_alive, overall, severity

OK = SourceStatus(State.OK)
WELL = Inputs(OK, OK, 0.03, 0.0, Status.OK)
LOST, FROZEN, STARTING = (
    SourceStatus(State.LOST, "unplugged"),
    SourceStatus(State.FROZEN, "same again"),
    SourceStatus(State.STARTING),
)
LATE = SourceStatus(State.DEGRADED, "10 of 30 Hz")

TABLE = [
    (WELL, Word.OK, ""),
    (replace(WELL, camera=STARTING, picture_age_s=None, outcome=None), Word.STARTING, "waiting for the camera"),
    (replace(WELL, telemetry=STARTING, outcome=None), Word.STARTING, "waiting for the telemetry"),
    (replace(WELL, outcome=None), Word.STARTING, "no picture has come through yet"),
    (replace(WELL, outcome=Status.STARTING), Word.STARTING, "no position or too little seen yet"),
    (replace(WELL, camera=LOST), Word.CAMERA_LOST, "unplugged"),
    (replace(WELL, camera=LOST, picture_age_s=100.0, outcome=None), Word.CAMERA_LOST, "unplugged"),
    (replace(WELL, camera=FROZEN), Word.CAMERA_FROZEN, "same again"),
    (replace(WELL, telemetry=LOST), Word.TELEMETRY_LOST, "unplugged"),
    (replace(WELL, telemetry=LOST, outcome=Status.UNSYNCHRONISED), Word.TELEMETRY_LOST, "unplugged"),
    (replace(WELL, telemetry=FROZEN), Word.TELEMETRY_LOST, "same again"),
    (replace(WELL, camera=LOST, telemetry=LOST), Word.CAMERA_LOST, "unplugged"),
    (replace(WELL, picture_age_s=5.0), Word.CAMERA_SILENT, "no picture for 5 s"),
    (replace(WELL, busy_s=9.0), Word.STUCK, "the pipeline has been at one event for 9 s"),
    (replace(WELL, busy_s=9.0, camera=LOST), Word.STUCK, "the pipeline has been at one event for 9 s"),
    (replace(WELL, outcome=Status.NO_GPS), Word.NO_GPS, "the position is not believed"),
    (replace(WELL, outcome=Status.FEATURELESS), Word.FEATURELESS, "too little to follow in the pictures"),
    (replace(WELL, outcome=Status.UNSYNCHRONISED), Word.UNSYNCHRONISED, "no telemetry about the moment of exposure"),
    (replace(WELL, outcome=Status.LOW_PARALLAX), Word.LOW_PARALLAX, "standing still: no depth without motion"),
    (replace(WELL, is_shedding=True), Word.OVERLOADED, "pictures are dropped to keep up"),
    (replace(WELL, is_shedding=True, outcome=Status.NO_GPS), Word.NO_GPS, "the position is not believed"),
    (replace(WELL, recording_fault="disk full"), Word.NOT_RECORDING, "disk full"),
    (replace(WELL, camera=LATE), Word.DEGRADED, "camera: 10 of 30 Hz"),
    (replace(WELL, telemetry=LATE), Word.DEGRADED, "telemetry: 10 of 30 Hz"),
    (replace(WELL, telemetry=LATE, outcome=Status.TURNING), Word.TURNING, "turning too fast to follow features"),
]  # fmt: skip


@pytest.mark.parametrize(("inputs", "word", "reason"), TABLE)
def test_the_state_has_one_word_and_its_reason(inputs: Inputs, word: Word, reason: str) -> None:
    assert overall(inputs) == Overall(word, reason)


HEALTHS = st.builds(SourceStatus, st.sampled_from(State), st.just("because"))
INPUTS = st.builds(
    Inputs, HEALTHS, HEALTHS, st.none() | st.floats(0, 10), st.floats(0, 10), st.none() | st.sampled_from(Status),
    st.booleans(), st.sampled_from(["", "disk full"]),
)  # fmt: skip


@given(INPUTS)
def test_all_is_well_only_when_everything_is(inputs: Inputs) -> None:
    state = overall(inputs)
    everything = (
        inputs.camera.state is State.OK
        and inputs.telemetry.state is State.OK
        and inputs.outcome is Status.OK
        and not inputs.is_shedding
        and not inputs.recording_fault
        and inputs.busy_s <= STUCK_S
        and (inputs.picture_age_s is None or inputs.picture_age_s <= SILENT_S)
    )
    assert (state.word is Word.OK) == everything
    assert bool(state.reason) != everything
    assert len(state.word.value) <= MAX_WORD


@given(INPUTS)
def test_a_daemon_that_is_well_is_alive_and_one_that_is_stuck_is_not(inputs: Inputs) -> None:
    if overall(inputs).word is Word.OK:
        assert is_alive(inputs)
    if overall(inputs).word in (Word.STUCK, Word.CAMERA_SILENT):
        assert not is_alive(inputs) or overall(inputs).word is Word.CAMERA_SILENT


@pytest.mark.parametrize(
    ("inputs", "alive"),
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
def test_the_watchdog_is_fed_while_pictures_flow_or_the_camera_says_why_not(inputs: Inputs, alive: bool) -> None:
    assert is_alive(inputs) is alive


def test_people_are_told_of_faults_louder_than_of_flying() -> None:
    assert severity(Word.OK) is severity(Word.STARTING) is Severity.NOTICE
    assert severity(Word.CAMERA_LOST) is severity(Word.NO_GPS) is Severity.WARNING
    assert severity(Word.STUCK) is Severity.ERROR
