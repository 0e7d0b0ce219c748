"""A recorded autopilot that banks, with all sensors or with camera and GPS alone: what a turn tilts stays tilted.

Before, the ground's weight fell as the ground was tilted, (5.9), so that in turns it was: above 30 degrees of bank 67
and 80 % of these flights' clicks were inside their 90 % ellipse.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.autopilots import SENSORS, Scene, judge
from benchmarks.sampled_flight import replace_section
from onboard.config.schema import parse_config

GPS_ALONE = replace_section(parse_config(""), "solve", **SENSORS["gps"])


@pytest.mark.long  # the short one, with all sensors, is in tests/test_benchmarks.py
@pytest.mark.parametrize(("name", "seed"), [("plane_gps_outage", 10), ("plane_wind_noise", 11)])
def test_banks_are_as_honest_as_level_flight(shared_data: Path, name: str, seed: int) -> None:
    score = judge(Scene(str(shared_data / "sitl" / name), GPS_ALONE, 0.0, 240.0), seed)
    inside, bank, error = np.array(score.ratio) < 1.0, np.array(score.bank_deg), np.array(score.error_m)
    assert np.count_nonzero(bank > 30.0) > 40
    assert np.mean(inside[bank > 30.0]) > 0.85
    assert np.mean(inside[bank <= 30.0]) > 0.85
    # Nor by ellipses that hold anything. Of six draws 13 to 18 m, the last digits the processor's; before, 36 m.
    assert np.quantile(error, 0.9) < 18.0 and np.median(score.semi_m) < 25.0
    assert score.answered["all"] > 0.65 * score.asked["all"]  # a minute of it is without positions


@pytest.mark.long  # the short one is in tests/onboard/estimation/test_bundle_adjustment.py
def test_no_other_orientation_is_accepted_after_a_steep_bank(shared_data: Path) -> None:
    """By camera and GPS: of four pictures at 60 degrees another was, 540 m off, with 70 m stated (8.5 ellipses).

    The right one was not found, though sought from 13 degrees beside it: its adjustment crept along a valley.
    """
    score = judge(Scene(str(shared_data / "sitl" / "plane_wind_noise"), GPS_ALONE, 60.0, 240.0), 759004)
    bank = np.array(score.bank_deg)
    assert np.count_nonzero(bank > 30.0) > 40
    assert max(score.ratio) < 3.0
    assert np.median(score.semi_m) < 25.0
    assert score.answered["all"] > 0.7 * score.asked["all"]


@pytest.mark.long  # the short one is in tests/onboard/estimation/test_sensor_factors.py
def test_a_heading_that_turns_late_is_allowed_for(shared_data: Path) -> None:
    """With all sensors: this autopilot's heading is 2 degrees behind in steep turns; before, 57 % were inside there.

    Four samples of the GPS's slow error: one alone has 68 to 98 % inside.
    """
    scene = Scene(str(shared_data / "sitl" / "plane_breeze"), parse_config(""), 45.0, 240.0)
    scores = [judge(scene, seed) for seed in (3, 4, 5, 6)]
    ratio, bank, error = (
        np.concatenate([getattr(s, name) for s in scores]) for name in ("ratio", "bank_deg", "error_m")
    )
    assert np.count_nonzero(bank > 30.0) > 400
    assert np.mean(ratio[bank > 30.0] < 1.0) > 0.85
    assert np.quantile(ratio[bank > 30.0], 0.9) > 0.6  # nor by ellipses that hold anything
    assert np.quantile(error, 0.9) < 9.0
    assert sum(s.answered["bank"] for s in scores) > 0.75 * sum(s.asked["bank"] for s in scores)
