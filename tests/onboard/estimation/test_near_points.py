"""What shows where the aircraft was ties no camera to a place: a speck on the lens in a climb fits a point right there.

A point at a camera's centre fits whatever that camera saw, and holds the camera to itself. (6.16)
"""

from dataclasses import replace

import numpy as np
import pytest

from contract.feature_set import Status
from onboard.estimation import second_solve, weighing
from onboard.estimation.bundle_adjustment import Problem, solve
from onboard.estimation.factors import State
from onboard.estimation.keyframe import observation
from onboard.estimation.second_solve import lie_near
from onboard.estimation.sliding_window import Window
from tests.onboard.scenes import CAMERA, FULL, Scene, SceneSpec, bundle_problem, draw
from tests.rest_long import rest_long

SPECKS = np.arange(100_000, 100_004)
ANYWHERE_PX = np.array([[250.0, 200.0], [400.0, 280.0], [300.0, 240.0], [340.0, 250.0]])
CLIMB = SceneSpec(speed_m_s=0.3, climb_m_s=4.0, height_m=40.0, wobble_deg=0.5)


def with_specks(scene: Scene) -> None:
    """In every picture after the first something is seen where the first was taken from; in that one, anything."""
    first, *later = (int(k) for k in scene.keys)
    where = scene.centres_enu_m[first] + [[0.3, 0.2, -0.1], [-0.2, 0.3, 0.1], [0.1, 0.1, 0.0], [0.0, -0.1, 0.3]]
    for k in (first, *later):
        uv, _ = CAMERA.project((where - scene.centres_enu_m[k]) @ scene.R_cam_enu[k].T)
        uv = ANYWHERE_PX if k == first else uv
        seen = scene.observations[k]
        scene.observations[k] = observation(CAMERA, np.append(seen.ids, SPECKS), np.concatenate([seen.uv_px, uv]))


def nearest_speck_m(window: Window) -> float:
    rows, kept = window.solved.rows(SPECKS)
    state = window.solved.solution.state
    return float(np.linalg.norm(state.points_enu_m[rows[kept]] - state.centres_enu_m[0], axis=1).min(initial=np.inf))


def share_of_gps(problem: Problem, state: State) -> float:
    """What is known of the place of everything as a whole, as a share of what the sensors know of it."""
    layout = problem.layout
    eastward = np.zeros(layout.size)
    eastward[layout.centres()[:, 0]] = 1.0
    eastward[np.arange(layout.size)[layout.plane][0]] = -state.plane[1]
    known = eastward @ solve(problem, state, max_iterations=0).reduced.S @ eastward
    by_sensors = sum(float(np.sum((prior.evaluate(state)[1] @ eastward) ** 2)) for prior in problem.priors)
    return float(known / by_sensors)


@pytest.mark.parametrize("seed", rest_long(range(6)))
def test_a_window_with_specks_claims_no_place_that_its_gps_does_not_give(seed: int) -> None:
    scene = draw(np.random.default_rng(seed), FULL, CLIMB)
    with_specks(scene)
    window = scene.window()
    assert window.solve() is Status.OK
    assert nearest_speck_m(window) > 0.1
    variances = np.diag(window.solved.solution.covariance)[window.solved.layout.centres()]
    by_gps_m = FULL.gps.sigma_correlated_horizontal_m
    assert 0.9 * by_gps_m < np.sqrt(variances[:, :2].min()) < 1.25 * by_gps_m
    error_m = (window.solved.solution.state.centres_enu_m - scene.centres_enu_m[scene.keys])[:, :2]
    assert np.abs(error_m).max() < 4.0 * by_gps_m


def test_specks_do_reach_the_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the test above shows nothing: without the check one of them stays, next to the camera."""
    for module in (second_solve, weighing):
        monkeypatch.setattr(module, "lie_near", lambda state, weight: np.zeros(len(state.points_enu_m), bool))
    nearest_m = []
    for seed in range(6):
        scene = draw(np.random.default_rng(seed), FULL, CLIMB)
        with_specks(scene)
        window = scene.window()
        assert window.solve() is Status.OK
        nearest_m.append(nearest_speck_m(window))
    assert min(nearest_m) < 0.05


def test_a_point_at_a_camera_ties_that_to_no_place() -> None:
    """Nothing but GPS knows where all of it is as a whole; a ridge that keeps points finite must not either."""
    sampled = bundle_problem(np.random.default_rng(0))
    assert share_of_gps(sampled.problem, sampled.truth) == pytest.approx(1.0, abs=1e-3)
    points = sampled.truth.points_enu_m.copy()
    (view, *_), j = np.flatnonzero(sampled.problem.weight[:, 0] > 0), 0
    camera_m = sampled.truth.centres_enu_m[view]
    points[j] = camera_m + 0.03 * (points[j] - camera_m) / np.linalg.norm(points[j] - camera_m)
    moved = replace(sampled.truth, points_enu_m=points)
    assert share_of_gps(sampled.problem, moved) == pytest.approx(1.0, abs=1e-3)


def test_only_points_next_to_a_camera_that_saw_them_are_near() -> None:
    window = draw(np.random.default_rng(0), FULL, CLIMB).window()
    assert window.solve() is Status.OK
    state = window.solved.solution.state
    seen = np.ones((len(state.centres_enu_m), len(state.points_enu_m)))
    assert not lie_near(state, seen).any()
    points = state.points_enu_m.copy()
    points[7] = state.centres_enu_m[2] + 0.02 * (points[7] - state.centres_enu_m[2])
    moved = replace(state, points_enu_m=points)
    assert np.flatnonzero(lie_near(moved, seen)).tolist() == [7]
    seen[:3, 7] = 0.0  # by cameras below and at the point: it did not see these, nor they it
    assert not lie_near(moved, seen).any()
