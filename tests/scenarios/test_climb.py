"""Camera and GPS alone while a quadplane climbs nearly straight up, banks, and changes to cruise: recorded telemetry.

Before, three of four rendered grounds and GPS errors gave orientations that were turned by up to 170 degrees, and
clicks 10.6 ellipses off.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.autopilots import SENSORS, Scene, judge
from benchmarks.sampled_flight import replace_section
from onboard.config.schema import parse_config
from tests.rest_long import rest_long

GPS_ALONE = replace_section(parse_config(""), "solve", **SENSORS["gps"])


@pytest.mark.parametrize("seed", rest_long([3, 2]))
def test_a_climb_on_camera_and_gps_is_answered_and_its_ellipses_hold(seed: int) -> None:
    score = judge(Scene("qp_climb", GPS_ALONE, 0.0, 30.0), seed, warm_s=2.5)
    ratio = np.array(score.ratio)
    # Over 30 % of the height above ground a radius is no answer (`uncertain`): early in the climb some are.
    assert score.answered["all"] > 0.7 * score.asked["all"]
    assert ratio.max() < 2.0
    assert np.mean(ratio < 1.0) > 0.85
    assert np.median(score.error_m) < 12.0 and np.median(score.semi_m) < 25.0  # nor by ellipses that hold anything
