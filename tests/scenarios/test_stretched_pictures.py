"""Pictures that are stretched along one side against the camera file: 16:9 shown as 4:3, a sub-stream, analogue video.

Clicks were up to 15 ellipses (217 m) off in turns, half of them beyond two, without a word; a quarter on straight legs.
"""

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.autopilots import SENSORS
from benchmarks.sampled_flight import SampledFlight, SampledSpec, fly, replace_section
from contract.camera import UNKNOWN_SIGMA, Camera
from contract.feature_set import Status
from onboard.config.schema import parse_config
from onboard.pipeline.pipeline import Pipeline
from simulation.paths import PathSpec
from tests.sampled_clicks import chi2_of, located

CONFIG = parse_config("")
GPS = replace_section(CONFIG, "solve", **SENSORS["gps"])
FILE = replace(Camera.from_field_of_view(640, 480, 40.0), stated_sigma=(0.003, 0.003, 0.003, 0.01, 0.05))
LEVEL = SampledSpec(CONFIG, PathSpec("straight"), 8.0, 1.5, camera_file=FILE)
TURNS = replace(LEVEL, path=PathSpec("turns", leg_m=120.0), seconds=14.0)
LOW = replace(TURNS, path=PathSpec("turns", leg_m=120.0, height_m=100.0), seconds=12.0)
STEEP = replace(TURNS, path=PathSpec("turns", leg_m=200.0, height_m=150.0, bank_deg=40.0), seconds=12.0)
PIXELS = np.array([[120.0, 100.0], [330.0, 250.0], [560.0, 400.0]])
LONG = pytest.mark.long


def seen(wider: float) -> Camera:
    """The camera whose pictures are so many times wider, against their height, than the file has them."""
    return replace(FILE, fx_px=FILE.fx_px * wider**0.5, fy_px=FILE.fy_px / wider**0.5)


def off_by(share: float) -> Camera:
    """The file of a lens known by its type, whose focal length is off by this share."""
    longer = 1.0 + share
    return replace(FILE, fx_px=longer * FILE.fx_px, fy_px=longer * FILE.fy_px, stated_sigma=UNKNOWN_SIGMA)


def outcome_of(spec: SampledSpec, seed: int) -> tuple[Counter[Status], list[Any], Pipeline]:
    """The pictures' statuses by their last sets, and errors of all clicks in ellipses."""
    flight = SampledFlight(spec, seed)
    sets, pipeline = fly(flight)
    ratios = [
        chi2_of(*each) ** 0.5 / 4.6052**0.5 for s in sets.values() if s.is_ok for each in located(flight, s, PIXELS)
    ]
    return Counter(s.status for s in sets.values()), ratios, pipeline


@pytest.mark.parametrize(
    ("spec", "wider", "seed"),
    [
        (LEVEL, 0.75, 3),
        pytest.param(LEVEL, 4 / 3, 3, marks=LONG),
        pytest.param(TURNS, 0.75, 3, marks=LONG),
        pytest.param(TURNS, 4 / 3, 4, marks=LONG),
        pytest.param(TURNS, 1.1, 4, marks=LONG),
        pytest.param(replace(TURNS, config=GPS), 0.75, 4, marks=LONG),
        pytest.param(replace(LEVEL, has_terrain=True), 0.75, 4, marks=LONG),
    ],
    ids=["level", "level, wider", "turns", "turns, wider", "turns, a tenth", "camera + GPS", "over a terrain model"],
)
def test_stretched_pictures_are_called_that_and_answer_nothing(spec: SampledSpec, wider: float, seed: int) -> None:
    statuses, ratios, pipeline = outcome_of(replace(spec, camera=seen(wider)), seed)
    assert not ratios and not statuses[Status.OK]
    assert statuses[Status.STRETCHED] > 0.6 * statuses.total(), statuses
    assert pipeline.window.is_stretched
    shortfall = pipeline.summary.shortfall
    assert shortfall is not None and "calibrate at this picture size" in shortfall.remedy


@pytest.mark.parametrize(
    ("spec", "seed"),
    [
        (LEVEL, 3),
        pytest.param(replace(TURNS, readout_s=0.03), 5, marks=LONG),
        pytest.param(replace(LOW, readout_s=0.03, config=GPS), 5, marks=LONG),
        pytest.param(replace(STEEP, readout_s=-0.05), 5, marks=LONG),
        pytest.param(replace(TURNS, camera_file=off_by(0.03)), 5, marks=LONG),
        pytest.param(replace(TURNS, relief_sigma_m=20.0), 5, marks=LONG),
        pytest.param(replace(LEVEL, camera=seen(0.75), camera_file=replace(seen(0.75))), 3, marks=LONG),
    ],
    ids=[
        "true",
        "rolling rows, not declared",
        "rolling rows, low, camera + GPS",
        "rolling rows, steep",
        "another lens",
        "hills",
        "declared",
    ],
)
def test_pictures_of_the_files_shape_are_answered(spec: SampledSpec, seed: int) -> None:
    statuses, ratios, pipeline = outcome_of(spec, seed)
    assert not statuses[Status.STRETCHED] and statuses[Status.OK] > 0.9 * statuses.total(), statuses
    assert max(ratios) < 2.5
    assert not pipeline.window.is_stretched
