"""Where a covariance cannot say how well an orientation is known, the cost's own profile does. Equation (16.10)."""

from dataclasses import replace

import numpy as np
import pytest

from contract.feature_set import Status
from contract.rotations import exp_so3
from onboard.estimation.bundle_adjustment import image_residuals
from onboard.estimation.stages import from_one_start
from onboard.estimation.turn_profile import TurnPrior, by_profile, turned_as_one, weakest_turn
from onboard.estimation.window_problem import Outcome
from onboard.estimation.window_request import Request
from onboard.estimation.window_solver import adjust
from tests.onboard.scenes import FULL, SEED_SENSORS, SceneSpec, bundle_problem, draw

CLIMB = SceneSpec(climb_m_s=2.5, speed_m_s=2.0, height_m=60.0, wobble_deg=5.0, relief_sigma_m=3.0)


def first_solve(spec: SceneSpec, seed: int = 0) -> tuple[Request, Outcome]:
    request = draw(np.random.default_rng(seed), SEED_SENSORS, spec).window().prepare()
    return request, from_one_start(request)


def test_the_held_turns_derivative_is_that_of_its_residual() -> None:
    rng = np.random.default_rng(5)
    drawn = bundle_problem(rng)
    layout, state = drawn.problem.layout, drawn.truth
    axis = np.array([0.2, -0.3, 0.9]) / np.linalg.norm([0.2, -0.3, 0.9])
    before = state.R_cam_enu @ exp_so3(-0.4 * axis) @ exp_so3(0.05 * rng.standard_normal((layout.keyframes, 3)))
    held = TurnPrior(layout, before, axis, 0.5)
    r, J = held.evaluate(state)
    for column in rng.choice(6 * layout.keyframes, 12, replace=False):
        step = np.zeros(layout.size)
        step[column] = 1e-6
        moved = held.evaluate(state.retract(step, np.zeros_like(state.points_enu_m)))[0]
        assert (moved - r)[0] / 1e-6 == pytest.approx(J[0, column], abs=1e-3)
    assert not J[:, 6 * layout.keyframes :].any()


def test_level_flight_and_flight_with_attitude_are_left_as_they_are() -> None:
    request, outcome = first_solve(SceneSpec())
    assert outcome.status is Status.OK
    assert by_profile(request.keyframes, outcome) == (outcome, None)
    with_attitude = draw(np.random.default_rng(0), FULL, CLIMB).window().prepare()
    outcome = from_one_start(with_attitude)
    assert outcome.status is Status.OK
    assert by_profile(with_attitude.keyframes, outcome) == (outcome, None)


def test_in_a_climb_the_heading_about_the_path_is_what_is_known_least() -> None:
    _, outcome = first_solve(replace(CLIMB, speed_m_s=0.7), seed=1)
    assert outcome.solved is not None
    axis, sigma_rad = weakest_turn(outcome.solved)
    assert abs(axis[2]) > 0.8 and np.degrees(sigma_rad) > 5.0


@pytest.mark.parametrize("seed", [2, 4])
def test_variances_that_are_too_small_are_given_back_what_they_lack(seed: int) -> None:
    """A quarter of the variance: three of its sigmas cost a quarter of what they should."""
    request, outcome = first_solve(replace(CLIMB, speed_m_s=0.7), seed)
    assert outcome.solved is not None
    assert 13.4 < np.degrees(weakest_turn(outcome.solved)[1]) < 20.0
    true = by_profile(request.keyframes, outcome)[0].solved
    narrowed = replace(outcome.solved.solution)
    narrowed.__dict__["covariance"] = 0.25 * outcome.solved.solution.covariance
    again = by_profile(request.keyframes, replace(outcome, solved=replace(outcome.solved, solution=narrowed)))[0].solved
    assert 1.0 <= true.variance_factor < 1.7
    assert 0.75 < again.variance_factor / (4.0 * true.variance_factor) < 1.33


def test_a_valley_with_another_bottom_is_refused_however_narrow_this_one_is() -> None:
    request, outcome = first_solve(replace(CLIMB, speed_m_s=1.0), seed=0)
    assert outcome.solved is not None and np.degrees(weakest_turn(outcome.solved)[1]) < 17.0
    refused, _ = by_profile(request.keyframes, outcome)
    assert refused.status is Status.LOW_PARALLAX and refused.solved is None and "heading" in refused.reason


def test_views_points_and_plane_turned_as_one_leave_the_pictures_as_they_are() -> None:
    sample = bundle_problem(np.random.default_rng(6))
    turned = turned_as_one(sample.truth, np.array([0.1, -0.2, 2.0]), sample.problem)
    before, after = (image_residuals(sample.problem, state) for state in (sample.truth, turned))
    seen = sample.problem.weight > 0
    np.testing.assert_allclose(after.transpose(0, 2, 1)[seen], before.transpose(0, 2, 1)[seen], atol=1e-9)
    np.testing.assert_allclose(turned.R_cam_enu, sample.truth.R_cam_enu @ exp_so3(np.array([0.1, -0.2, 2.0])))


@pytest.mark.parametrize("seed", range(3))
def test_a_climb_with_travel_is_answered_and_hardly_widened(seed: int) -> None:
    request = draw(np.random.default_rng(seed), SEED_SENSORS, replace(CLIMB, speed_m_s=4.0)).window().prepare()
    outcome = adjust(request)
    assert 1.0 <= outcome.solved.variance_factor < 4.0
