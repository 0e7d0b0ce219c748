"""The doctor's lines, each turned red by its own fault and by no other's."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given

from contract.camera import Camera
from contract.feature_set import Status
from contract.supervised_thread import ThreadReport, ThreadState
from onboard.commands import doctor
from onboard.commands.line_meaning import MEANING
from onboard.commands.preflight import Surroundings, diagnose
from onboard.config.schema import Config, ThermalConfig
from onboard.config.second_camera import SecondCamera
from onboard.events.source import SourceStatus, State
from onboard.georeferencing.click_budget import Budget
from onboard.pipeline.estimates import (
    BORESIGHT,
    RELATIVE_VARIANCE,
    TIME_OFFSET,
    Contradiction,
    Estimate,
    SensorError,
    in_words,
)
from onboard.pipeline.statistics import LeftOut
from onboard.service.reports import Report
from onboard.service.vehicle_state import AT_REST, Inputs, Subject, overall
from tests.onboard.service.reported import WELL as WELL_INPUTS
from tests.onboard.service.reported import inputs, report_of, unhurried

CONFIG = Config.model_validate({"telemetry": {"url": "serial:/dev/ttyAMA0:921600"}, "camera": {"exposure_us": 2000.0}})
CAMERA = Camera.from_field_of_view(640, 480, 40.0)
WELL = report_of(WELL_INPUTS)
AROUND = Surroundings(CAMERA, "", 20000.0, 61.0)


NO_POSITION = Status.NO_GPS


def verdicts(report: Report, around: Surroundings = AROUND, config: Config = CONFIG) -> dict[str, bool]:
    return {line.name: line.is_good for line in diagnose(config, report, around)}


def text(report: Report, name: str) -> str:
    return next(line.text for line in diagnose(CONFIG, report, AROUND) if line.name == name)


def red(report: Report, around: Surroundings = AROUND) -> list[str]:
    return [name for name, is_good in verdicts(report, around).items() if not is_good]


def test_before_a_good_flight_all_is_green() -> None:
    assert verdicts(WELL) == dict.fromkeys(
        ["state", "camera", "rate", "stamps", "exposure", "telemetry", "rates", "time sync", "pipeline", "gps",
         "position", "answers", "load", "recording", "threads", "mount", "relative errors", "left out", "sensors",
         "radius", "calibration", "link", "disk", "processor"], True,
    )  # fmt: skip
    assert text(WELL, "exposure") == "fixed at 2000 us, mean grey 120 of 255"
    assert text(WELL, "time sync") == "+-0.9 ms, round trip 2.5 ms"
    assert text(WELL, "calibration") == "640 x 480, 40 deg wide"
    assert text(WELL, "gps") == "fix type 3, 14 satellites, +-0.8 m"


def test_how_well_pictures_are_timed_is_reported_and_amiss_where_it_is_poor() -> None:
    assert text(WELL, "stamps") == "0.000 +-0.100 s late by camera.latency_s, nothing learned yet: turns show it"
    messages = "each picture's time +-31.0 ms; 0.000 +-0.100 s late"
    assert text(figures("camera", stamp_sigma_ms=31.0), "stamps").startswith(messages)
    assert red(figures("camera", stamp_sigma_ms=31.0)) == []
    assert red(figures("camera", stamp_sigma_ms=140.0)) == ["stamps"]
    learned = replace(WELL, estimates=(Estimate(TIME_OFFSET, "seconds", (-0.213,), (0.008,)),))
    assert text(learned, "stamps") == "learned in flight: -0.213 +-0.008 s in addition to camera.latency_s"


def test_what_decodes_a_stream_is_reported_where_the_camera_is_one() -> None:
    around = replace(AROUND, decoders="H264 by v4l2h264dec (hardware), else avdec_h264")
    (line,) = (line for line in diagnose(CONFIG, WELL, around) if line.name == "decoder")
    assert line.is_good and line.text == around.decoders
    assert "decoder" not in verdicts(WELL)


def test_a_thermal_cameras_scale_is_reported_and_that_no_one_knows_it() -> None:
    assert "thermal" not in verdicts(WELL)
    messages = {}
    for scale in (None, 0.01):
        config = CONFIG.model_copy(update={"thermal": ThermalConfig(enabled=True, scale=scale)})
        (line,) = (line for line in diagnose(config, WELL, AROUND) if line.name == "thermal")
        assert line.is_good
        messages[scale] = line.text
    assert messages == {None: "uncalibrated; hot spots have no temperatures (thermal.scale)", 0.01: "0.01 K a count"}


def test_a_second_camera_has_a_line_that_is_red_while_nothing_comes_from_it() -> None:
    assert "thermal camera" not in verdicts(WELL)
    second = SecondCamera(device="/dev/video9", file="thermal.json", scale=0.04)
    config = CONFIG.model_copy(update={"camera": CONFIG.camera.model_copy(update={"thermal": second})})
    for state, detail, messages in (
        (State.OK, "", "ok"),
        (State.LOST, "unplugged", "lost, so no hot spots (unplugged)"),
    ):
        report = report_of(replace(WELL_INPUTS, thermal_camera=SourceStatus(state, detail)))
        lines = {line.name: line for line in diagnose(config, report, AROUND)}
        assert (lines["thermal camera"].text, lines["thermal camera"].is_good) == (messages, state is State.OK)
        assert lines["thermal"].text == "0.04 K a count" and lines["camera"].is_good


def test_what_is_left_out_of_the_picture_is_reported_with_who_found_it() -> None:
    assert text(WELL, "left out") == "nothing"
    found = replace(WELL, pictures=replace(WELL.pictures, left_out=LeftOut(0.02, 0.113)))
    messages = "2 % by camera.mask, 11 % found: stands still while the ground moves (a display, or the aircraft itself)"
    assert text(found, "left out") == messages and red(found) == []
    assert red(replace(WELL, pictures=replace(WELL.pictures, left_out=LeftOut(0.0, 0.5)))) == ["left out"]


def test_a_clock_known_by_arrival_alone_is_not_called_unknown() -> None:
    report = figures("telemetry", clock_sigma_ms=None, round_trip_ms=None, arrival_sigma_ms=3.0)
    assert red(report) == ["time sync"]
    assert text(report, "time sync").startswith("TIMESYNC is not answered: by arrival, +-3.0 ms")


def test_at_rest_with_a_good_fix_all_is_green() -> None:
    """PX4 on the ground: a good fix and nothing to be seen. It was `no gps` with a doctor that was green."""
    report = report_of(replace(WELL_INPUTS, outcome=Status.LOW_PARALLAX, is_at_rest=True))
    assert red(report) == []
    assert text(report, "state") == f"at rest: {AT_REST}"


@unhurried
@given(inputs())
def test_state_and_doctor_never_disagree(messages: Inputs) -> None:
    """Whatever makes the state not well is a red line of the doctor's next to the state's own, and the reverse."""
    is_well = overall(messages).state.is_well
    lines = verdicts(report_of(messages))
    judged = {name: lines[name] for name in (subject.value for subject in Subject) if name in lines}
    assert {s.value for s in Subject} - judged.keys() <= {"thermal camera"}
    assert lines["state"] is is_well
    assert all(judged.values()) is is_well
    assert all(lines[name] for name in lines.keys() - judged.keys() - {"state"})


@unhurried
@given(inputs())
def test_what_the_state_says_stands_in_a_red_line(messages: Inputs) -> None:
    state = overall(messages)
    if not state.state.is_well:
        lines = diagnose(CONFIG, report_of(messages), AROUND)
        reason = state.reason.split(": ")[-1]
        assert any(reason in line.text for line in lines if not line.is_good and line.name != "state")


@pytest.mark.parametrize(
    ("report", "lines"),
    [
        (report_of(replace(WELL_INPUTS, camera=SourceStatus(State.DEGRADED, "10 of 30 Hz"))), ["camera"]),
        (report_of(replace(WELL_INPUTS, camera=SourceStatus(State.FROZEN, "same again"))), ["camera"]),
        (report_of(replace(WELL_INPUTS, telemetry=SourceStatus(State.LOST, "silent"))), ["telemetry"]),
        (report_of(replace(WELL_INPUTS, busy_s=9.0)), ["pipeline"]),
        (report_of(replace(WELL_INPUTS, outcome=NO_POSITION, position_fault="far from it")), ["position", "answers"]),
        (report_of(replace(WELL_INPUTS, outcome=Status.POOR_FIT)), ["answers"]),
        (report_of(replace(WELL_INPUTS, is_shedding=True)), ["load"]),
        (report_of(replace(WELL_INPUTS, recording_fault="disk full")), ["recording"]),
        (report_of(replace(WELL_INPUTS, threads=(ThreadReport("link", ThreadState.FAILED, None, 0, "gone"),))),
         ["threads"]),
        (report_of(replace(WELL_INPUTS, gps=None)), ["gps"]),
        (report_of(replace(WELL_INPUTS, gps=replace(WELL.gps, fix_type=2))), ["gps"]),
        (report_of(replace(WELL_INPUTS, gps=replace(WELL.gps, age_s=9.0))), ["gps"]),
        (report_of(replace(WELL_INPUTS, gps=replace(WELL.gps, sigma_horizontal_m=12.0))), ["gps"]),
    ],
)  # fmt: skip
def test_what_the_daemon_judged_turns_the_state_and_its_own_line_red(report: Report, lines: list[str]) -> None:
    assert red(report) == ["state", *lines]


def figures(source: str, **changed: float | None) -> Report:
    """The report with figures of a source changed, or without them."""
    status: SourceStatus = getattr(WELL, source)
    kept = {name: value for name, value in (status.figures | changed).items() if value is not None}
    return replace(WELL, **{source: replace(status, figures=kept)})


@pytest.mark.parametrize(
    ("report", "line"),
    [
        (figures("camera", rate_hz=20.0), "rate"),
        (figures("camera", rate_hz=None), "rate"),
        (replace(WELL, brightness=None), "exposure"),
        (replace(WELL, brightness=replace(WELL.brightness, mean=12.0)), "exposure"),
        (replace(WELL, brightness=replace(WELL.brightness, white=0.5)), "exposure"),
        (replace(WELL, brightness=replace(WELL.brightness, black=0.5)), "exposure"),
        (figures("telemetry", position_hz=1.0), "rates"),
        (figures("telemetry", position_hz=None), "rates"),
        (figures("telemetry", attitude_hz=4.0), "rates"),
        (figures("telemetry", clock_sigma_ms=None), "time sync"),
        (figures("telemetry", clock_sigma_ms=float("nan")), "time sync"),
        (figures("telemetry", clock_sigma_ms=50.0), "time sync"),
        (figures("telemetry", round_trip_ms=300.0), "time sync"),
        (replace(WELL, estimates=(Estimate(BORESIGHT, "radians", (0.2, 0.0, 0.0), (0.002,) * 3),)), "mount"),
    ],
)
def test_each_limit_for_take_off_turns_its_own_line_red(report: Report, line: str) -> None:
    assert red(report) == [line]


@pytest.mark.parametrize(
    ("around", "line"),
    [
        (replace(AROUND, camera="camera.file is not set"), "calibration"),
        (replace(AROUND, link="the port is already in use"), "link"),
        (replace(AROUND, free_mb=900.0), "disk"),
        (replace(AROUND, free_mb=None), "disk"),
        (replace(AROUND, temperature_c=85.0), "processor"),
    ],
)
def test_what_surrounds_it_counts_too(around: Surroundings, line: str) -> None:
    assert red(WELL, around) == [line]


def test_what_is_not_needed_is_not_missed() -> None:
    gps = replace(WELL.gps, sigma_horizontal_m=None, satellites=None)
    report = replace(WELL, gps=gps, telemetry=SourceStatus(State.OK, "", {"position_hz": 10.0}))
    config = Config.model_validate({"telemetry": {"url": "nmea:/dev/ttyUSB0:9600"}, "recording": {"enabled": False}})
    assert all(verdicts(report, Surroundings(CAMERA, "", None, None), config).values())


def test_without_a_daemon_nothing_is_reported_of_what_only_it_can_know() -> None:
    lines = verdicts(WELL, replace(AROUND, is_running=False))
    assert not lines.keys() & {"state", "pipeline", "position", "answers", "load", "recording", "threads"}
    assert {"camera", "telemetry", "gps"} < lines.keys()


def test_what_would_make_a_radius_smaller_is_a_line_that_is_never_bad() -> None:
    report = replace(WELL, budget=Budget(6.2, {"mount": 0.6, "gps": 0.21, "pixels": 0.19}))
    assert verdicts(report)["radius"] and verdicts(WELL)["radius"]
    line = text(report, "radius")
    assert line.startswith(
        "90 % within 6.2 m in the picture's middle; mount 60 %, GPS, correlated 21 %: fly one circle"
    )
    assert line.endswith("(without it 3.9 m)")
    assert "no picture has been placed" in text(WELL, "radius")
    assert Report.from_json(report.to_json()).budget == report.budget
    assert "radius" not in verdicts(WELL, replace(AROUND, is_running=False))


def test_a_boresight_within_its_prior_is_well() -> None:
    report = replace(WELL, estimates=(Estimate(BORESIGHT, "radians", (0.01, 0.01, 0.0), (0.002,) * 3),))
    assert verdicts(report)["mount"]
    assert "learned in flight: 0.8 +-0.1 deg" in text(report, "mount")


def test_relative_errors_larger_than_stated_are_reported_and_far_larger_are_amiss() -> None:
    def found(factor: float) -> Report:
        return replace(WELL, estimates=(Estimate(RELATIVE_VARIANCE, "ratio", (factor,), (0.2,)),))

    assert text(WELL, "relative errors") == "no ground has been seen again yet"
    assert text(found(1.3), "relative errors") == "variance 1.30 +-0.20 of what was stated, by points seen again"
    assert verdicts(found(1.3))["relative errors"]
    assert not verdicts(found(6.0))["relative errors"]


def test_sensors_worse_than_declared_are_named_with_both_numbers() -> None:
    found = (
        SensorError("tilt", "deg", 0.52, 0.5),
        SensorError("heading", "deg", 3.8, 2.0),
        SensorError("velocity", "m/s", 0.3, 0.1),
    )
    assert (
        text(replace(WELL, sensor_errors=found), "sensors")
        == "heading 3.8 deg, declared 2; velocity 0.3 m/s, declared 0.1"
    )
    assert text(WELL, "sensors") == "no error found larger than configured"


def test_what_was_found_and_not_confirmed_is_named() -> None:
    doubted = (Estimate("camera_time_offset", "seconds", (0.81,), (0.12,)),)
    assert text(replace(WELL, unconfirmed=doubted), "sensors") == (
        "no error found larger than configured; found but not confirmed, and not used: "
        "time offset +0.810 +-0.120 s, camera to autopilot"
    )


def test_a_sensor_that_contradicts_the_others_is_not_well_while_it_does() -> None:
    """The state and the doctor's line say the same. It was `ok` with a red line and exit 1."""
    wrong, over = Contradiction("tilt", 12.0, 9.0, 8), Contradiction("velocity", 1.0, 3.0, 4)
    report = report_of(replace(WELL_INPUTS, contradiction=in_words((wrong, over))))
    messages = "tilt contradicts the other sensors for 9 s and counts with 12 times its sigma"
    assert red(report) == ["state", "sensors"]
    assert text(report, "sensors") == messages
    assert text(report, "state") == f"degraded: sensors: {messages}"
    assert red(report_of(replace(WELL_INPUTS, contradiction=in_words((over,))))) == []


def test_every_line_is_explained_and_no_name_runs_into_its_text() -> None:
    config = CONFIG.model_copy(update={"thermal": ThermalConfig(enabled=True)})
    report = report_of(replace(WELL_INPUTS, thermal_camera=SourceStatus(State.OK)))
    lines = diagnose(config, report, replace(AROUND, decoders="H264 by avdec_h264"))
    assert {line.name for line in lines} == set(MEANING)
    for explained in (False, True):
        messages = doctor.text(lines, False, explained).splitlines()
        assert len(messages) == len(lines) * (3 if explained else 1)
    for line, words in zip(lines, doctor.text(lines, False).splitlines(), strict=True):
        assert f" {line.name} " in words
    assert all("If bad" in meaning[1] for meaning in MEANING.values())
