"""The doctor's lines agree with the state; what each prints, case by case: tests/transcripts/pc-onboard-doctor.txt."""

from dataclasses import replace

import pytest
from hypothesis import given

from onboard.commands import doctor
from onboard.commands.checks import CHECKS
from onboard.commands.preflight import Surroundings, diagnose
from onboard.config.schema import Config, SpotsConfig, ThermalConfig
from onboard.events.source import SourceStatus, State
from onboard.service.reports import Report
from onboard.service.vehicle_state import Inputs, Subject, overall
from tests.onboard.commands.doctor_page import AROUND, BUDGET, CASES, CONFIG, RADIO, judged
from tests.onboard.service.reported import inputs, report_of, unhurried


def verdicts(report: Report, around: Surroundings = AROUND, config: Config = CONFIG) -> dict[str, bool]:
    return {line.name: line.is_good for line in diagnose(config, report, around)}


@unhurried
@given(inputs())
def test_state_and_doctor_never_disagree(messages: Inputs) -> None:
    """Whatever makes the state not well is a red line of the doctor's next to the state's own, and the reverse."""
    is_well = overall(messages).state.is_well
    lines = verdicts(report_of(messages))
    of_subjects = {name: lines[name] for name in (subject.value for subject in Subject) if name in lines}
    assert {s.value for s in Subject} - of_subjects.keys() <= {"thermal camera"}
    assert lines["state"] is is_well
    assert all(of_subjects.values()) is is_well
    assert all(lines[name] for name in lines.keys() - of_subjects.keys() - {"state"})


@unhurried
@given(inputs())
def test_what_the_state_says_stands_in_a_red_line(messages: Inputs) -> None:
    state = overall(messages)
    if not state.state.is_well:
        lines = diagnose(CONFIG, report_of(messages), AROUND)
        reason = state.reason.split(": ")[-1]
        assert any(reason in line.text for line in lines if not line.is_good and line.name != "state")


def test_every_line_is_explained_and_no_name_runs_into_its_text() -> None:
    config = RADIO.model_copy(update={"thermal": ThermalConfig(enabled=True)})
    report = judged(thermal_camera=SourceStatus(State.OK))
    lines = diagnose(config, report, replace(AROUND, decoders="H264 by avdec_h264"))
    assert {line.name for line in lines} == set(CHECKS) - {"permission"}
    for explained in (False, True):
        messages = doctor.text(lines, False, explained).splitlines()
        assert len(messages) == len(lines) * (3 if explained else 1)
    for line, words in zip(lines, doctor.text(lines, False).splitlines(), strict=True):
        assert f" {line.name} " in words
    assert all(check.sentences[1] == f"If bad: {check.cure}" for check in CHECKS.values())
    assert all(check.looks_at.endswith(".") and check.cure.endswith(".") for check in CHECKS.values())


@pytest.mark.parametrize(
    ("enabled", "spots", "red"), [(False, True, "no thermal"), (True, False, "spots.enabled"), (True, True, "")]
)
def test_a_net_that_has_nothing_to_look_at_is_a_red_line(enabled: bool, spots: bool, red: str) -> None:
    config = CONFIG.model_copy(
        update={"thermal": ThermalConfig(enabled=enabled), "spots": SpotsConfig(enabled=spots, things=True)}
    )
    (line,) = (line for line in diagnose(config, judged(), AROUND) if line.name == "thermal")
    assert line.is_good is not bool(red) and red in line.text


def test_a_budget_is_passed_on_as_it_is() -> None:
    assert Report.from_json(BUDGET.to_json()).budget == BUDGET.budget


def test_what_is_red_in_a_case_is_one_line_or_the_state_with_those_of_its_reason() -> None:
    """So that each fault turns its own line red and no other's, whatever the transcript has: others wait for it."""
    red = {
        case.what: [
            line.name
            for line in diagnose(case.config, case.report, case.around)
            if not line.is_good and not line.waits_for
        ]
        for case in CASES
    }
    assert all(len(lines) <= 1 or (lines[0] == "state" and len(lines) <= 3) for lines in red.values()), red
    assert sum(map(bool, red.values())) > 35
