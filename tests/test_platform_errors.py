"""Lever arm, delays and a compass that errs by its heading are modelled, so that answers hold with them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.sampled_flight import PLACE, SampledFlight, SampledSpec, fly, replace_section
from contract.answer import CHI2_2
from contract.camera import UNKNOWN_SIGMA, Camera
from contract.feature_set import FeatureSet
from onboard.config.schema import Config, parse_config
from onboard.estimation.boresight import PlatformEstimate
from onboard.estimation.platform_states import HEADING, OFFSET, STATES
from simulation.paths import PathSpec
from tests.sampled_clicks import chi2_of, located

Array = NDArray[np.float64]

CONFIG = parse_config("")
TURNS = PathSpec("turns", leg_m=160.0)
SURVEY = PathSpec("survey", leg_m=200.0, spacing_m=120.0)
LEVER_M = (0.5, 0.2, 0.1)


def with_latency(sigma_s: float) -> Config:
    return replace_section(CONFIG, "gps", sigma_latency_s=sigma_s)


def errors_of(flight: SampledFlight, sets: dict[int, FeatureSet], after_s: float) -> list[float]:
    """Horizontal errors (m) of clicks at the pictures' middles and near their corners, from `after_s` on."""
    out = []
    for k, s in sets.items():
        if flight.times_s[k] < after_s or not s.is_ok:
            continue
        uv = np.array([[320.0, 240.0], [80.0, 60.0], [560.0, 420.0]])
        out += [float(np.hypot(*error)) for error, _ in located(flight, s, uv)]
    return out


def clicks(flight: SampledFlight, sets: dict[int, FeatureSet], after_s: float, every: int = 4) -> tuple[Array, Array]:
    """Squared errors in units of the stated covariance, and semi-major axes, of clicks from `after_s` on."""
    rng = np.random.default_rng(7)
    chi2, semi_m = [], []
    for k in range(0, len(flight.times_s), every):
        if flight.times_s[k] < after_s or k not in sets or not sets[k].is_ok:
            continue
        for error, answer in located(flight, sets[k], rng.uniform(40.0, 440.0, (2, 2))):
            chi2.append(chi2_of(error, answer))
            semi_m.append(answer.ellipse.semi_major_m)
    return np.array(chi2), np.array(semi_m)


def body_bias_m(lever_known: bool) -> Array:
    """Mean error (3,) of the cameras' centres, body axes, over turns; sensors err by a 250th of what is declared."""
    config = with_latency(0.001)  # at one speed a lever arm ahead looks like a delay: here there is none to be found
    config = replace_section(config, "solve", level_ground_sigma_deg=2.0)  # ground is sampled by it, and is to be level
    if lever_known:
        config = replace_section(config, "mount", lever_arm_m=LEVER_M)
    spec = SampledSpec(config, TURNS, seconds=37.0, rate_hz=2.0, errors=0.004, lever_arm_m=LEVER_M)
    flight = SampledFlight(spec, 3)
    sets, _ = fly(flight)
    R_enu_body = flight.trajectory.R_enu_body(flight.times_s)
    errors = []
    for k, s in sets.items():
        if s.is_ok and flight.times_s[k] > 10.0:
            centre = PLACE.to_enu(s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m)
            errors.append(R_enu_body[k].T @ (centre - flight.centres_enu_m[k]))
    assert len(errors) > 50
    out: Array = np.mean(errors, axis=0)
    return out


@pytest.mark.long
def test_a_lever_arm_that_is_known_leaves_no_bias() -> None:
    assert np.abs(body_bias_m(True)).max() < 0.06


@pytest.mark.long
def test_a_lever_arm_that_is_not_known_leaves_itself() -> None:
    """So the test above can fail."""
    assert body_bias_m(True) - body_bias_m(False) == pytest.approx(np.array(LEVER_M), abs=0.05)


@pytest.mark.long  # short: stamps that are far off, tests/onboard/foreign_clock
@pytest.mark.parametrize(
    ("path", "seconds", "after_s", "delay_s"),
    [
        pytest.param(PathSpec(), 24.0, 4.0, 0.15, id="late-straight"),
        pytest.param(PathSpec(), 24.0, 4.0, -0.15, id="early-straight"),
        pytest.param(TURNS, 60.0, 38.0, 0.15, id="late-after turns"),
        pytest.param(TURNS, 60.0, 38.0, -0.15, id="early-after turns"),
    ],
)
def test_a_delay_is_covered_by_the_ellipse(path: PathSpec, seconds: float, after_s: float, delay_s: float) -> None:
    """Three metres along the track that no straight leg shows: held by the ellipse, and not by one without end."""
    inside, wide = [], []
    for seed in range(2):
        flight = SampledFlight(SampledSpec(CONFIG, path, seconds, 2.0, errors=0.5, delay_s=delay_s, offset_s=0.0), seed)
        sets, _ = fly(flight)
        chi2, semi_m = clicks(flight, sets, after_s)
        assert len(chi2) > 10
        inside += list(chi2 < CHI2_2)
        wide += list(semi_m)
    assert np.mean(inside) > 0.85
    assert np.median(wide) < 12.0


@pytest.mark.long
def test_who_takes_the_delay_for_certain_is_wrong_by_it() -> None:
    """The flights above need their ellipses: with the delay declared certain, most clicks lie outside."""
    inside = []
    for seed in range(3):
        spec = SampledSpec(with_latency(0.001), seconds=24.0, rate_hz=2.0, errors=0.5, delay_s=0.15, offset_s=0.0)
        flight = SampledFlight(spec, seed)
        sets, _ = fly(flight)
        inside += list(clicks(flight, sets, 4.0)[0] < CHI2_2)
    assert np.mean(inside) < 0.8


@pytest.mark.long  # the short one: posteriors of heading errors, tests/onboard/estimation/test_boresight.py
@pytest.mark.parametrize("seconds", [80.0, 120.0])
def test_a_compass_that_errs_by_its_heading_is_recovered_after_turns(seconds: float) -> None:
    """Over opposite legs and turns: found within three of its sigmas, which have become smaller."""
    heading_error_deg = (4.0, -4.0)  # by cosine and sine of the heading: from 5.7 to -5.7 within a circle
    spec = SampledSpec(CONFIG, SURVEY, seconds, 2.0, errors=0.4, heading_error_deg=heading_error_deg, offset_s=0.0)
    flight = SampledFlight(spec, 4)
    sets, pipeline = fly(flight)
    platform = pipeline.window.alignment.platform
    found_deg, sigma_deg = np.degrees(platform.mean[HEADING]), np.degrees(platform.sigma[HEADING])
    assert np.all(np.abs(found_deg - heading_error_deg) < 3.0 * sigma_deg)
    assert sigma_deg.max() < 0.75 * CONFIG.solve.heading_sigma_deg
    assert np.abs(found_deg - heading_error_deg).max() < 2.0, "nothing was learned"
    chi2, _ = clicks(flight, sets, 0.5 * seconds)
    assert np.mean(chi2 < CHI2_2) > 0.8


@pytest.mark.long
def test_without_such_an_error_none_is_found() -> None:
    flight = SampledFlight(SampledSpec(CONFIG, SURVEY, 75.0, 2.0, errors=0.4, offset_s=0.0), 4)
    _, pipeline = fly(flight)
    platform = pipeline.window.alignment.platform
    assert np.all(np.abs(platform.mean[HEADING]) < 3.0 * platform.sigma[HEADING])
    assert np.abs(np.degrees(platform.mean[HEADING])).max() < 1.5


@pytest.mark.long  # the short ones are in tests/onboard/estimation/test_rotation_timing.py
def test_late_stamps_are_known_after_a_few_turns_from_beyond_their_prior() -> None:
    """0.45 s where 0.1 is declared, a mount 2 and 1.5 degrees off: rotations say so twice before it is accepted."""
    truth_deg, offset_s = np.array([2.0, 1.5, 0.0]), -0.45
    config = replace_section(CONFIG, "solve", level_ground_sigma_deg=2.0)  # the ground, too, is sampled by it
    spec = SampledSpec(config, TURNS, 42.0, 2.0, errors=0.5, boresight_deg=(2.0, 1.5, 0.0), offset_s=offset_s)
    flight = SampledFlight(spec, 1)
    sets, pipeline = fly(flight)
    platform = pipeline.window.alignment.platform
    assert abs(platform.mean[OFFSET] - offset_s) < 0.03
    assert platform.sigma[OFFSET] < 0.045
    assert abs(platform.mean[OFFSET] - offset_s) < 3.0 * platform.sigma[OFFSET]
    assert np.all(np.abs(np.degrees(platform.mean[:3]) - truth_deg) < 3.0 * np.degrees(platform.sigma[:3]))
    assert np.all(np.degrees(platform.sigma[:3]) < 0.8)
    chi2, semi_m = clicks(flight, sets, 25.0, every=2)
    assert np.mean(chi2 < CHI2_2) > 0.85
    assert np.median(semi_m) < 12.0
    assert np.mean([s.is_ok for s in sets.values()]) > 0.85


def with_camera_file(
    filed: Camera | None, seconds: float, after_s: float
) -> tuple[list[float], Array, PlatformEstimate]:
    """Errors (m) and squared errors in units of the stated covariance after some time of turns, and what was found."""
    spec = SampledSpec(CONFIG, TURNS, seconds, rate_hz=2.0, offset_s=0.0, camera_file=filed)
    flight = SampledFlight(spec, 0)
    sets, pipeline = fly(flight)
    chi2, _ = clicks(flight, sets, after_s)
    assert len(chi2) > 20
    return errors_of(flight, sets, after_s), chi2, pipeline.window.alignment.platform


LENS = SampledSpec(CONFIG).camera
# Focal length 3 % and k1 0.1 off, in a file that says nothing of its errors.
WRONG = replace(
    LENS,
    fx_px=1.03 * LENS.fx_px,
    fy_px=1.03 * LENS.fy_px,
    distortion=(0.1, 0.0, 0.0, 0.0, 0.0),
    stated_sigma=UNKNOWN_SIGMA,
)


@pytest.mark.long  # short: tests/onboard/commands/test_calibrate_in_flight.py
@pytest.mark.parametrize(("seconds", "after_s"), [(54.0, 30.0), (80.0, 40.0)])
def test_a_wrong_camera_file_is_found_out(seconds: float, after_s: float) -> None:
    """After a minute with turns, and the ellipses hold."""
    errors_m, chi2, platform = with_camera_file(WRONG, seconds, after_s)
    found, sigma = platform.mean[STATES:], platform.sigma[STATES:]
    assert np.abs(found[0] + np.log(1.03)) < 3.0 * sigma[0] and sigma[0] < 0.5 * UNKNOWN_SIGMA[0]
    assert np.abs(found[3] + 0.1) < 3.0 * sigma[3] and sigma[3] < 0.5 * UNKNOWN_SIGMA[3]
    assert np.mean(chi2 < CHI2_2) > 0.85
    assert np.median(errors_m) < 8.0


@pytest.mark.long
def test_a_wrong_camera_file_hardly_costs_accuracy() -> None:
    wrong_m, right_m = (float(np.median(with_camera_file(filed, 80.0, 40.0)[0])) for filed in (WRONG, None))
    assert wrong_m < 1.3 * right_m
