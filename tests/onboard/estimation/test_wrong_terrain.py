"""A terrain model of another datum, unit or place is left out once pictures or the take-off show it. (16.16)"""

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.sampled_flight import PLACE, SampledFlight, SampledSpec, _stamp, fly
from contract.answer import Fix
from contract.feature_set import FeatureSet, Status
from contract.locate import Locator
from onboard.config.schema import parse_config
from onboard.estimation.window_problem import Outcome
from onboard.estimation.window_request import Request
from onboard.estimation.window_solver import adjust
from onboard.events.types import Event, Home, PositionFix
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
def test_a_window_over_a_wrong_model_is_solved_without_it(
    request_and_ground: tuple[Request, float], off_m: float
) -> None:
    """Before, a model 48 m too high was accepted, and all ground with it 45 m too high; then nothing was answered."""
    request, ground_m = request_and_ground
    outcome = over(request, ground_m + off_m)
    assert outcome.solved is not None
    assert np.median(outcome.solved.solution.state.points_enu_m[:, 2]) == pytest.approx(ground_m, abs=1.0)
    assert outcome.terrain_doubt.startswith(f"ground off the terrain model: {-off_m:+.0f} m"), outcome.terrain_doubt


@pytest.mark.parametrize(
    ("known", "off_m", "status", "is_doubted"),
    [
        pytest.param({}, 1.0, Status.OK, False, id="one that is right is used"),
        pytest.param({}, -5.0, Status.OK, False, id="and one that is nearly right"),
        pytest.param({"is_terrain_left_out": True}, 0.0, Status.OK, False, id="left out, it comes back when it agrees"),
        pytest.param({"is_terrain_left_out": True}, 48.0, Status.OK, True, id="and not before"),
        pytest.param(
            {"has_terrain_agreed": True}, 48.0, Status.POOR_FIT, True, id="agreed, it is as sure as lens and ground"
        ),
    ],
)
def test_a_model_is_in_doubt_by_what_is_known_of_it(
    request_and_ground: tuple[Request, float], known: dict[str, bool], off_m: float, status: Status, is_doubted: bool
) -> None:
    request, ground_m = request_and_ground
    outcome = over(replace(request, **known), ground_m + off_m)
    assert (outcome.status, bool(outcome.terrain_doubt)) == (status, is_doubted)


def answered(sets: dict[int, FeatureSet], flight: SampledFlight) -> list[float]:
    """The error of each answer, in radii of its 90 % ellipse."""
    ellipses = []
    for frame, found in sets.items():
        for at, place in zip(CLICKS, flight.ground_points(frame, CLICKS), strict=True):
            answer = Locator(found).locate(at)
            if isinstance(answer, Fix):
                assert answer.height_amsl_m is not None
                error = (PLACE.to_enu(answer.lat_deg, answer.lon_deg, answer.height_amsl_m) - place)[:2]
                ellipses.append(
                    float(np.sqrt(error @ np.linalg.solve(answer.covariance_enu_m2[:2, :2], error) / 4.605))
                )
    return ellipses


@pytest.mark.long  # short, a window of it: above
@pytest.mark.parametrize("off_m", [48.0, -48.0, 0.0])
def test_a_model_that_the_pictures_contradict_costs_no_answer(off_m: float) -> None:
    """Before, 90 of 90 clicks were answered by it, 12.6 m off (median), 17 beyond 3 ellipses; then none."""
    path = PathSpec("straight", height_m=120.0, speed_m_s=12.0)
    spec = SampledSpec(parse_config(""), path, seconds=9.0, rate_hz=2.0, has_terrain=True)
    flight = SampledFlight(spec, 3)
    flight.terrain_error_m = off_m
    sets, pipeline = fly(flight)
    without, _ = fly(SampledFlight(replace(spec, has_terrain=False), 3))
    # Before any window has depth, the model answers.
    ellipses = answered({frame: found for frame, found in sets.items() if frame >= 6}, flight)
    assert bool(pipeline.window.terrain_doubt) == bool(pipeline.summary.terrain_doubt) == (off_m != 0.0)
    assert len(ellipses) >= len(answered({f: found for f, found in without.items() if f >= 6}, flight)) > 30
    assert max(ellipses) < 1.5


class StoodFirst(SampledFlight):
    """A flight that stands below where it hovers later, for its first second."""

    def _positions(self) -> list[PositionFix]:
        return [stood(fix) if fix.stamp_ns < _stamp(1.0) else fix for fix in super()._positions()]


class HomeStated(SampledFlight):
    """A flight that begins in the air, whose autopilot states where it was armed: below where it hovers."""

    def events(self) -> Iterator[Event]:
        first = self._positions()[0]
        home_m = first.height_amsl_m - (first.height_above_home_m or 0.0)
        yield Home(first.stamp_ns, first.lat_deg, first.lon_deg, home_m)
        yield from super().events()


def stood(fix: PositionFix) -> PositionFix:
    above_m = fix.height_above_home_m or 0.0
    return replace(
        fix, height_amsl_m=fix.height_amsl_m - above_m, height_above_home_m=0.0, velocity_ned_m_s=(0.0, 0.0, 0.0)
    )


@pytest.mark.parametrize("off_m", [48.0, -48.0, 0.0])
@pytest.mark.parametrize("kind", [StoodFirst, HomeStated, SampledFlight])
def test_a_hover_over_a_wrong_model_is_not_answered_by_it(kind: type[SampledFlight], off_m: float) -> None:
    """It was: without parallax no window shows the ground. Those that show no ground they stood on are the control."""
    path = PathSpec("hover", height_m=100.0)
    spec = SampledSpec(parse_config("[tracking]\nfeatures = 100\n"), path, seconds=12.0, rate_hz=1.0, has_terrain=True)
    flight = kind(spec, 3)
    flight.terrain_error_m = off_m
    sets, pipeline = fly(flight)
    ellipses = answered({frame: found for frame, found in sets.items() if frame >= 7}, flight)
    if off_m and kind is not SampledFlight:
        assert not ellipses
        sign = "-+"[off_m < 0.0]
        words = rf"ground off the terrain model: \{sign}[45]\d m at the take-off"
        assert re.match(words, pipeline.window.terrain_doubt)
    else:
        assert pipeline.window.terrain_doubt == ""
        assert len(ellipses) == 5 * len(CLICKS) or kind is StoodFirst  # which is 100 m below within a second
        assert max(ellipses) < 1.5 or off_m
