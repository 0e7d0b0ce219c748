"""A wide lens over rows read in turn whose file is off is learned in flight, and its answers hold what they state."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.click_score import clicks, scored
from benchmarks.fisheye import FILE_SIGMA, READOUT_S, Result, judge, lens, spec_of
from benchmarks.sampled_flight import SampledFlight, SampledSpec, fly, replace_section
from contract.answer import CHI2_2
from onboard.config.schema import parse_config
from onboard.estimation.platform_states import STATES
from simulation.paths import PathSpec

SMALL = (320, 240)


def test_a_file_that_is_three_per_cent_off_is_learned_and_clicks_all_over_the_picture_hold() -> None:
    """Tracks are sampled; 150 degrees wide, so that clicks reach 79 degrees off the axis."""
    camera, height_m = lens(150.0, SMALL)
    filed = replace(camera, fx_px=1.03 * camera.fx_px, fy_px=1.03 * camera.fy_px, stated_sigma=FILE_SIGMA)
    config = replace_section(parse_config(""), "camera", readout_s=READOUT_S)
    path = PathSpec("turns", height_m=height_m, speed_m_s=12.0)
    spec = SampledSpec(config, path, 10.0, 2.0, camera=camera, camera_file=filed, readout_s=READOUT_S)
    flight = SampledFlight(spec, 2)
    sets, pipeline = fly(flight)
    score, platform = scored(flight, clicks(flight, sets, SMALL, 6, 6.0, 1)), pipeline.window.alignment.platform
    assert score.answered["all"] >= 0.85 * score.asked["all"] > 40
    assert np.mean(np.array(score.ratio) < 1.0) > 0.85 and np.median(score.error_m) < 3.0
    assert np.quantile(score.ratio, 0.9) > 0.2  # no ellipse that would hold anything
    assert platform.sigma[STATES] < 0.8 * FILE_SIGMA[0]
    assert abs(platform.mean[STATES] + np.log(1.03)) < 2.5 * platform.sigma[STATES]


@pytest.mark.long
@pytest.mark.parametrize("wide_deg", [110.0, 150.0])
def test_rendered_pictures_through_a_fisheye_are_tracked_and_answer_as_a_pinhole_s(wide_deg: float) -> None:
    """At the pinhole's ground sample distance in the middle; the file is 3 % off, its rows are read in turn."""
    wide, pinhole = Result(), Result()
    for seed in range(3):
        judge(*spec_of(wide_deg, 0.03, seed, 14.0), wide)
        judge(*spec_of(60.0, 0.03, seed, 14.0), pinhole)
    assert len(wide.error_m) > 0.85 * wide.asked > 500
    assert np.mean([np.mean(np.array(chi2) < CHI2_2) for chi2 in wide.chi2]) > 0.8
    assert np.median(wide.error_m) < 1.2 * np.median(pinhole.error_m)
    assert np.sqrt(np.mean(np.square(wide.focal_sigmas))) < 2.0
