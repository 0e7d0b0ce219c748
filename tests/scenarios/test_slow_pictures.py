"""Pictures that come slowly, 0.1 to 10 s apart, with and without gaps of telemetry in between; why some cannot do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.camera import Camera
from contract.feature_set import Status
from onboard.__main__ import main
from onboard.events.types import Event, GpsQuality
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from tests.rest_long import rest_long
from tests.scenarios.flights import Outcome, play, retouched, simulated

WIDE = Camera.from_field_of_view(320, 240, 70.0)


def survey(apart_s: float, pictures: int = 12, speed_m_s: float = 12.0, height_m: float = 300.0) -> SessionSpec:
    """A straight leg; ten seconds apart at 12 m/s and 300 m, pictures have 62 % in common."""
    path = PathSpec("straight", speed_m_s=speed_m_s, height_m=height_m)
    return SessionSpec(
        DescribedSpec(path), seconds=pictures * apart_s, rate_hz=1.0 / apart_s, camera=WIDE, clicks_per_frame=8
    )


def answers(outcome: Outcome, share: float = 0.6) -> None:
    """Most clicks are answered, inside of what is claimed, and the claim is worth something."""
    asked = len(outcome.errors_m) + outcome.refusals.total()
    assert len(outcome.errors_m) >= share * asked, outcome.reported
    assert outcome.inside_99 >= 0.97, outcome.reported
    assert np.median(outcome.errors_m) < 8.0 and np.median(outcome.semi_m) < 25.0, outcome.reported


def why(outcome: Outcome) -> str:
    """Reason and remedy where nothing was solved."""
    assert outcome.pipeline is not None
    summary = outcome.pipeline.summary
    assert summary.solved == 0 and summary.shortfall is not None, outcome.reported
    return f"{summary.shortfall.reason}; {summary.shortfall.remedy}"


def between(apart_s: float, share: tuple[float, float]) -> Callable[[Event, float], Event | None]:
    """Lose telemetry within this share of the time between two pictures."""
    return lambda event, t: None if share[0] < (t % apart_s) / apart_s < share[1] else event


@pytest.mark.parametrize(
    ("apart_s", "pictures"),
    rest_long([(10.0, 12), (3.04, 12), (1.0, 14), (0.1, 120), (3.0, 12), (5.0, 12)]),
)
def test_pictures_however_slow_are_solved_while_they_overlap(apart_s: float, pictures: int) -> None:
    answers(play(simulated(survey(apart_s, pictures))))


@pytest.mark.long  # short, with still less: what is said to be enough without overlap, below
def test_little_overlap_is_enough() -> None:
    """20 m/s, ten seconds apart: 36 % of a picture in common."""
    answers(play(simulated(survey(10.0, speed_m_s=20.0))))


@pytest.mark.parametrize("apart_s", rest_long([4.0, 10.0]))
def test_telemetry_that_pauses_between_pictures_is_no_outage(apart_s: float) -> None:
    """Nothing is received for half of the time between two pictures: no velocity between them, but two positions."""
    answers(play(simulated(survey(apart_s)), spoil=between(apart_s, (0.2, 0.7))))


def test_pictures_slow_by_being_refused_go_on_when_they_are_back() -> None:
    """Telemetry pauses over every third picture: that one is refused, the others 10 s apart are not."""
    outcome = play(simulated(survey(5.0, 15)), spoil=lambda event, t: None if 8.0 < t % 15.0 < 12.0 else event)
    assert outcome.statuses[Status.UNSYNCHRONISED] == 5, outcome.reported
    assert outcome.statuses[Status.OK] == 10, outcome.reported
    assert outcome.inside_99 >= 0.97, outcome.reported


def test_a_fix_lost_between_pictures_is_an_outage() -> None:
    """The receiver has no fix for a second and a half between any two pictures: no window may hold both of them."""

    def lost(event: Event, t: float) -> Event:
        return replace(event, fix_type=1) if isinstance(event, GpsQuality) and 2.0 < t % 10.0 < 3.5 else event

    assert "GPS was lost or doubted between 11 of 11 pairs" in why(play(simulated(survey(10.0)), spoil=lost))


def test_pictures_without_overlap_are_refused_and_the_summary_says_how_often_is_enough() -> None:
    """30 m/s, ten seconds apart, 315 m of ground on a picture: 5 % in common. Every 7.9 s a quarter would be."""
    printed = why(play(simulated(survey(10.0, 8, speed_m_s=30.0))))
    assert "no overlap: pictures 10.0 s apart, at most " in printed
    most_s = float(printed.split("at most ")[1].split()[0])
    assert 7.2 < most_s < 8.4, printed
    answers(play(simulated(survey(most_s, 8, speed_m_s=30.0))))


@pytest.mark.long  # short: pictures without overlap, above
def test_pictures_too_far_apart_for_any_overlap_are_refused() -> None:
    """13 s apart, though the aircraft is slow enough to see the same ground."""
    assert "pictures 13.0 s apart, at most 12.0; take" in why(play(simulated(survey(13.0, speed_m_s=6.0))))


@pytest.mark.long  # short, where pictures overlap more: blind ones of test_degenerate_ground.py
def test_one_missed_picture_costs_no_more_than_itself() -> None:
    """20 m/s, ten seconds apart: a picture that shows nothing leaves the next without overlap; it begins again."""

    folder = retouched(simulated(survey(10.0, 16, speed_m_s=20.0)), np.zeros_like, range(7, 8))
    outcome = play(folder)
    assert outcome.statuses[Status.OK] >= 14, outcome.reported
    assert outcome.inside_99 >= 0.97, outcome.reported


def test_other_reasons_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    hover = replace(survey(1.0), flight=DescribedSpec(PathSpec("hover", height_m=100.0)))
    assert "no parallax: " in why(play(simulated(hover)))
    assert "telemetry gap: " in why(play(simulated(survey(1.0)), spoil=lambda e, t: None if t > -3.0 else e))

    def unfixed(event: Event, t: float) -> Event:
        return replace(event, fix_type=1) if isinstance(event, GpsQuality) else event

    assert "no accepted position" in why(play(simulated(survey(1.0)), spoil=unfixed))
    assert "too short: " in why(play(simulated(survey(0.1, 20))))
    assert main(_arguments(simulated(survey(0.1, 20)))) == 3
    out = capsys.readouterr().out
    assert "nothing solved" in out and "too short" in out and "what to do" in out


def _arguments(folder: Path) -> list[str]:
    named = {"frames": "frames", "telemetry": "telemetry.tlog", "stamps": "stamps.csv", "camera": "camera.json"}
    return ["replay", *(p for k, v in {**named, "config": "config.toml"}.items() for p in (f"--{k}", str(folder / v)))]


def test_a_replay_that_solves_exits_with_0(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(_arguments(simulated(survey(10.0, 6)))) == 0
    assert "nothing solved" not in capsys.readouterr().out
