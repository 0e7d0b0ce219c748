"""Recorded flights over hills, draws in which clicks were once 7.4 and 4.7 ellipses off, two others, and steep ground.

The quad climbs from 15 m; a wrong track ended at its first camera and held that in place, (6.16). The quadplane banks
by 56 degrees with camera and GPS alone; a window's newest picture fell into a wrong minimum, which bent the path by 9 m
and which the windows after it inherited, (16.11). Ground that is steeper than declared shows that along the track, and
camera and GPS claim less across it, (14.3).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.autopilots import SENSORS, STARTS, Scene, judge, seed_of
from benchmarks.click_score import Score
from benchmarks.platform_faults import FAULTS
from benchmarks.sampled_flight import replace_section
from onboard.config.schema import parse_config


def score_of(name: str, sensors: str, draw: int, ground: str = "hills", seconds: float = 240.0) -> Score:
    """As `benchmarks.autopilots --faults hills --seconds 240 --seed 3` has that draw."""
    config = replace_section(parse_config(""), "solve", **SENSORS[sensors])
    return judge(replace(Scene(name, config, STARTS[name], seconds), **FAULTS[ground]), seed_of(name, 3) + draw)


@pytest.mark.long
@pytest.mark.usefixtures("shared_data")
@pytest.mark.parametrize(
    ("name", "sensors", "draw", "answered"),
    [
        ("quad", "full", 3, 0.9),
        ("quad", "full", 0, 0.9),
        ("qp_transition", "gps", 2, 0.7),
        ("qp_transition", "gps", 1, 0.7),
    ],
)
def test_climbs_and_steep_banks_over_hills_stay_within_two_ellipses(
    name: str, sensors: str, draw: int, answered: float
) -> None:
    score = score_of(name, sensors, draw)
    assert score.answered["all"] > answered * score.asked["all"]
    assert max(score.ratio) < 2.0 and np.quantile(score.ratio, 0.9) > 0.4


@pytest.mark.long
@pytest.mark.usefixtures("shared_data")
def test_camera_and_gps_claim_as_much_as_they_know_over_ground_steeper_than_declared() -> None:
    """Short hills of 6 m; before (14.3) was by the variogram 77 and 63 % were inside, sharpness 1.13 and 1.30."""
    scores = [score_of(name, "gps", draw, "rough", 120.0) for name in ("copter_survey", "quad") for draw in (0, 1)]
    ratio = np.concatenate([s.ratio for s in scores])
    assert len(ratio) > 0.55 * sum(s.asked["all"] for s in scores)
    assert 0.85 < np.mean(ratio < 1.0) < 0.97
    assert 0.75 < np.quantile(ratio, 0.9) < 1.1
    assert ratio.max() < 2.0
