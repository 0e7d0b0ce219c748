"""Camera and GPS alone next to a recorded autopilot that banks: what a turn tilts, later pictures inherit.

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
from tests.rest_long import rest_long

GPS_ALONE = replace_section(parse_config(""), "solve", **SENSORS["gps"])


@pytest.mark.parametrize(("name", "seed"), rest_long([("plane_gps_outage", 10), ("plane_wind_noise", 11)]))
def test_banks_are_as_honest_as_level_flight(shared_data: Path, name: str, seed: int) -> None:
    score = judge(Scene(str(shared_data / "sitl" / name), GPS_ALONE, 0.0, 240.0), seed)
    inside, bank, error = np.array(score.ratio) < 1.0, np.array(score.bank_deg), np.array(score.error_m)
    assert np.count_nonzero(bank > 30.0) > 40
    assert np.mean(inside[bank > 30.0]) > 0.85
    assert np.mean(inside[bank <= 30.0]) > 0.85
    assert np.quantile(error, 0.9) < 16.0 and np.median(score.semi_m) < 25.0  # nor by ellipses that hold anything
    assert score.answered["all"] > 0.65 * score.asked["all"]  # a minute of it is without positions
