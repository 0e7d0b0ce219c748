"""A camera file without sigmas whose distortion is far off is found out in flight and costs no answer."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.click_score import clicks, scored
from benchmarks.sampled_flight import SampledFlight, SampledSpec, fly, replace_section
from contract.camera import UNKNOWN_SIGMA, Camera
from onboard.config.schema import parse_config
from onboard.estimation.camera_states import COUNT
from onboard.estimation.platform_states import STATES
from simulation.paths import PathSpec

K2 = STATES + COUNT - 1
LENS = replace(Camera.from_field_of_view(640, 480, 65.0), distortion=(0.1, -0.3, 0.0, 0.0, 0.0))
FILE = replace(LENS, distortion=(0.1, 0.05, 0.0, 0.0, 0.0), stated_sigma=UNKNOWN_SIGMA)
TURNS = PathSpec("turns", height_m=80.0, speed_m_s=15.0)


@pytest.mark.long
@pytest.mark.parametrize("sensors", ["all", "camera and GPS"])
def test_a_second_coefficient_seven_sigmas_off_refuses_nothing(sensors: str) -> None:
    """The real flight's file is 5.6 sigmas off in it. Held to what is assumed of lenses, 0 and 10 % were answered."""
    solve = {} if sensors == "all" else {"attitude": "none", "velocity": False}
    config = replace_section(parse_config(""), "solve", **solve)
    flight = SampledFlight(SampledSpec(config, TURNS, 40.0, 2.0, camera=LENS, camera_file=FILE), 2)
    sets, pipeline = fly(flight)
    score = scored(flight, clicks(flight, sets, LENS.size_px, 4, 10.0, 2))
    ratio = np.array(score.ratio)
    assert score.answered["all"] > 0.9 * score.asked["all"]
    assert np.mean(ratio < 1.0) > 0.85
    assert 0.3 < np.quantile(ratio, 0.9) < 1.2
    assert np.median(score.error_m) < 6.0
    if sensors == "all":
        platform = pipeline.window.alignment.platform
        assert abs(platform.mean[K2] + 0.35) < 3.0 * platform.sigma[K2]
        assert platform.sigma[K2] < 0.02
