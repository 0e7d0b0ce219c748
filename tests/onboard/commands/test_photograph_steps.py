"""Photographs whose receiver began again in flight: their positions step, and both sides are answered for."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.camera import Camera
from onboard.config.files import load_config_files
from onboard.events.types import GpsQuality
from onboard.replay.runner import Flight
from onboard.telemetry.csv_reader import read_csv
from onboard.telemetry.two_logs import loosened
from simulation.flight import DescribedSpec
from simulation.session import SessionSpec
from tests.onboard.commands.test_import_photos import APART_S, CAMERA, PICTURES, SURVEY, imported, replayed
from tests.onboard.photographs import Style
from tests.scenarios.flights import CHI2_90, simulated

pytestmark = pytest.mark.xdist_group("import photos")

NO_ANGLES = Style(angles=False, focal="equivalent")


def of_survey() -> Path:
    spec = SessionSpec(
        DescribedSpec(SURVEY), seconds=PICTURES * APART_S, rate_hz=1 / APART_S, camera=CAMERA, clicks_per_frame=8
    )
    return simulated(spec)


def stepped(style: Style, size_m: float, pictures: range) -> Style:
    return replace(style, step_m=(0.8 * size_m, 0.6 * size_m, 0.0), stepped=pictures)


@pytest.mark.parametrize("style", [Style(), NO_ANGLES], ids=["angles", "no angles"])
def test_a_step_is_named_taken_out_and_doubted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], style: Style
) -> None:
    """The 90 % circle of every position holds both places, half of the step on either side."""
    flight = imported(of_survey(), tmp_path, stepped(style, 30.0, range(8, PICTURES)))
    printed = capsys.readouterr().out
    assert "in the positions from DJI_0008.JPG to DJI_0009.JPG" in printed
    claims = [e for e in read_csv(flight / "telemetry.csv").events if isinstance(e, GpsQuality)]
    circles_m = np.sqrt(CHI2_90) * np.array([claim.sigma_horizontal_m for claim in claims])
    assert circles_m.min() > 14.0 and circles_m.max() < 28.0
    assert load_config_files(flight / "config.toml").gps.correlation_time_s > 600.0


def test_photographs_that_are_replayed_as_they_are_have_their_steps_taken_out(tmp_path: Path) -> None:
    """With `--telemetry exif` nothing looked for them: 7.7 ellipses off."""
    flight = imported(of_survey(), tmp_path, stepped(Style(), 30.0, range(8, PICTURES)))
    config, camera = load_config_files(flight / "config.toml"), Camera.from_json(flight / "camera.json")
    config = config.model_copy(update={"gps": config.gps.model_copy(update={"correlation_time_s": 60.0})})
    opened = Flight.open(config, camera, tmp_path / "photos", "exif", flight / "stamps.csv")
    assert any("m in the positions from DJI_0008.JPG to DJI_0009.JPG" in note for note in opened.notes), opened.notes
    assert any("all may be off by 1" in note for note in opened.notes), opened.notes
    claims = [e for e in opened.telemetry.events if isinstance(e, GpsQuality)]
    assert min(claim.sigma_horizontal_m or 0.0 for claim in claims) > 8.0
    assert loosened(config, opened.telemetry).gps.correlation_time_s > 600.0


@pytest.mark.parametrize("style", [Style(), NO_ANGLES, Style(whole_seconds=True)], ids=["angles", "none", "seconds"])
def test_positions_without_a_step_count_as_before(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], style: Style
) -> None:
    flight = imported(of_survey(), tmp_path, style)
    assert "\nstep" not in capsys.readouterr().out
    claims = [e for e in read_csv(flight / "telemetry.csv").events if isinstance(e, GpsQuality)]
    assert all(claim.sigma_horizontal_m is None for claim in claims)
    assert load_config_files(flight / "config.toml").gps.correlation_time_s == 60.0


@pytest.mark.long
@pytest.mark.parametrize("first", [5, 8, 14])
@pytest.mark.parametrize("size_m", [10.0, 30.0])
def test_clicks_on_both_sides_of_a_step_lie_within_their_radius(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], size_m: float, first: int
) -> None:
    """A step of 30 m put half of them 31 m off, 8.4 ellipses."""
    flight = imported(of_survey(), tmp_path, stepped(Style(), size_m, range(first, PICTURES)))
    outcome = replayed(of_survey(), flight, capsys)
    assert outcome.solved >= 0.9, outcome.reported
    assert np.mean(outcome.chi2 < CHI2_90) >= 0.75 and np.sqrt(outcome.chi2.max() / CHI2_90) < 1.5, outcome.reported
    assert 0.5 * size_m < np.median(outcome.semi_m) < 0.5 * size_m + 5.0, outcome.reported


@pytest.mark.long
def test_a_step_there_and_back_costs_no_picture_and_no_radius(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A single position 60 m off made its picture featureless."""
    flight = imported(of_survey(), tmp_path, stepped(Style(), 60.0, range(8, 9)))
    outcome = replayed(of_survey(), flight, capsys)
    assert outcome.solved == 1.0 and outcome.inside_99 >= 0.97, outcome.reported
    assert outcome.errors_m.max() < 5.0 and np.median(outcome.semi_m) < 6.0, outcome.reported


@pytest.mark.long
def test_a_step_of_100_m_is_no_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An ellipse as long as half of it is too long to send people by."""
    flight = imported(of_survey(), tmp_path, stepped(Style(), 100.0, range(8, PICTURES)))
    outcome = replayed(of_survey(), flight, capsys)
    assert not len(outcome.errors_m), outcome.reported
