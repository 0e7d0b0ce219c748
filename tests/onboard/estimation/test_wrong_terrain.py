"""A terrain model of another datum, unit or place answers nothing once pictures show the ground elsewhere. (16.16)"""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.sampled_flight import PLACE, SampledFlight, SampledSpec, fly
from contract.answer import Fix
from contract.feature_set import Status
from contract.locate import Locator
from onboard.config.schema import parse_config
from onboard.estimation.window_problem import Outcome
from onboard.estimation.window_request import Request
from onboard.estimation.window_solver import adjust
from onboard.geometry.terrain_grid import Terrain
from simulation.paths import PathSpec
from tests.onboard.scenes import FULL, SceneSpec, draw

CLICKS = np.array([[60.0, 60.0], [320.0, 240.0], [480.0, 360.0]])


@pytest.fixture(scope="module")
def request_and_ground() -> tuple[Request, float]:
    """A window without a terrain model, and how high its ground is (ENU, m)."""
    request = draw(np.random.default_rng(2), FULL, SceneSpec()).window().prepare()
    solved = adjust(request).solved
    assert solved is not None
    return request, float(np.median(solved.solution.state.points_enu_m[:, 2]))


def over(request: Request, height_m: float) -> Outcome:
    return adjust(replace(request, terrain=Terrain(-5000.0, -5000.0, 100.0, np.full((101, 101), height_m))))


@pytest.mark.parametrize("off_m", [48.0, -60.0])
def test_a_window_over_a_wrong_model_is_refused_and_leaves_it_in_doubt(
    request_and_ground: tuple[Request, float], off_m: float
) -> None:
    """Before, a model 48 m too high was accepted, and all ground with it 45 m too high."""
    request, ground_m = request_and_ground
    outcome = over(request, ground_m + off_m)
    assert outcome.status is Status.POOR_FIT
    assert outcome.terrain_doubt.startswith(f"ground off the terrain model: {-off_m:+.0f} m"), outcome.terrain_doubt


@pytest.mark.parametrize("off_m", [1.0, -5.0])
def test_a_model_that_is_right_is_used(request_and_ground: tuple[Request, float], off_m: float) -> None:
    request, ground_m = request_and_ground
    outcome = over(request, ground_m + off_m)
    assert outcome.status is Status.OK
    assert outcome.terrain_doubt == ""


@pytest.mark.long  # short, a window of it: above
@pytest.mark.parametrize("off_m", [48.0, -48.0, 0.0])
def test_a_model_that_the_pictures_contradict_answers_nothing(off_m: float) -> None:
    """Before, 90 of 90 clicks were answered by it, 12.6 m off (median), 17 beyond 3 ellipses."""
    path = PathSpec("straight", height_m=120.0, speed_m_s=12.0)
    flight = SampledFlight(SampledSpec(parse_config(""), path, seconds=9.0, rate_hz=2.0, has_terrain=True), 3)
    flight.terrain_error_m = off_m
    sets, pipeline = fly(flight)
    ellipses = []
    for frame, found in sets.items():
        if frame < 6:  # before any window has depth, the model answers
            continue
        for at, place in zip(CLICKS, flight.ground_points(frame, CLICKS), strict=True):
            answer = Locator(found).locate(at)
            if isinstance(answer, Fix):
                assert answer.height_amsl_m is not None
                error = (PLACE.to_enu(answer.lat_deg, answer.lon_deg, answer.height_amsl_m) - place)[:2]
                ellipses.append(
                    float(np.sqrt(error @ np.linalg.solve(answer.covariance_enu_m2[:2, :2], error) / 4.605))
                )
    assert bool(pipeline.window.terrain_doubt) == (off_m != 0.0)
    if off_m == 0.0:
        assert len(ellipses) == len(CLICKS) * (len(sets) - 6)
        assert max(ellipses) < 1.5
    else:
        assert not ellipses
