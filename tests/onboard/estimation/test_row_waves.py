"""Pictures that vibrate while their rows are read: found in residuals, estimated with the poses, and not imagined."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.estimation import row_waves
from onboard.estimation.bundle_adjustment import Problem, Solution, image_residuals, solve
from onboard.estimation.factors import WAVES
from onboard.estimation.rolling_shutter import Sweep
from tests.onboard.estimation.test_rolling_shutter import CAMERA, scene
from tests.onboard.scenes import first_guess
from tests.rest_long import rest_long

Array = NDArray[np.float64]

NOISE_RAD = 0.3 / CAMERA.focal_px
CYCLES = np.array([5.75, 6.0, 6.25, 6.5, 6.125, 5.875, 6.0, 6.25])  # about 200 Hz, an engine that changes its speed


def vibrating(seed: int, swing_px: float) -> tuple[Problem, Sweep, Array]:
    """A problem whose pictures swing by so much (one sigma along each axis, as does each phase), its rows, and how."""
    drawn, sweep, xy = scene(seed)
    rng = np.random.default_rng(seed + 100)
    sweep = replace(sweep, cycles=CYCLES, sigma_wave_rad=max(swing_px, 0.1) / CAMERA.focal_px)
    waves = swing_px / CAMERA.focal_px * rng.standard_normal((8, 6))
    predicted = drawn.problem.xy.transpose(0, 2, 1)
    moved = np.einsum("kcip,kc->kpi", sweep.by_wave(np.ascontiguousarray(predicted)), waves)
    xy = xy + moved + NOISE_RAD * rng.standard_normal(xy.shape)
    weight = np.where(drawn.problem.weight > 0, 1.0 / NOISE_RAD, 0.0)
    return replace(drawn.problem, xy=xy, weight=weight, sweep=sweep), sweep, waves


def with_waves(problem: Problem) -> Problem:
    layout = problem.layout.with_block(WAVES)
    return replace(problem, layout=layout, priors=[replace(p, layout=layout) for p in problem.priors])


def solved(seed: int, problem: Problem) -> Solution:
    drawn, _, _ = scene(seed)
    start = first_guess(drawn, drawn.truth.R_cam_enu, drawn.truth.centres_enu_m)
    start = replace(start, own=np.zeros(problem.layout.by_picture.shape))
    return solve(problem, start, scale=None, max_iterations=60, tolerance=1e-9)


@pytest.mark.parametrize("seed", rest_long([1, 2, 3]))
def test_how_often_each_picture_swings_is_found_in_what_poses_leave(seed: int) -> None:
    problem, _, waves = vibrating(seed, 1.5)
    found = row_waves.seen(problem, solved(seed, problem))
    strong = np.hypot(waves[:, 0], waves[:, 3]) + np.hypot(waves[:, 1], waves[:, 4]) > 2.0 / CAMERA.focal_px
    assert np.count_nonzero(strong) >= 5
    np.testing.assert_allclose(found.cycles[strong], CYCLES[strong], atol=0.4)
    assert 0.3 < found.sigma_rad * CAMERA.focal_px / 1.5 < 1.5, "poses and points take some of it"


def test_cycles_are_found_between_those_that_are_compared() -> None:
    """Half of what lies between two moves the outer rows by a fifth of the wave: eight pictures, one at an end."""
    right = np.append(np.linspace(5.9, 6.2, 7), row_waves.CYCLES[0])
    gain = 40.0 - np.square(row_waves.CYCLES[:, None] - right)
    found = row_waves._between(gain, np.argmax(gain, axis=0))
    np.testing.assert_allclose(found[:-1], right[:-1], atol=1e-9)
    assert abs(found[-1] - right[-1]) <= row_waves.CYCLES[1] - row_waves.CYCLES[0]


@pytest.mark.parametrize("seed", rest_long(range(12), 2))
def test_none_is_imagined_in_noise(seed: int) -> None:
    problem, _, _ = vibrating(seed, 0.0)
    assert row_waves.seen(problem, solved(seed, problem)) is None


@pytest.mark.parametrize("seed", rest_long(range(6), 2))
def test_wrong_rates_are_no_vibration(seed: int) -> None:
    """The log says that no picture turned; all turned by up to 20 degrees a second."""
    problem, sweep, _ = vibrating(seed, 0.0)
    wrong = replace(problem, sweep=replace(sweep, rate_cam_rad_s=np.zeros((8, 3))))
    solution = solved(seed, wrong)
    left_px = np.median(np.abs(image_residuals(wrong, solution.state)[:, 0][wrong.weight > 0])) * CAMERA.focal_px
    assert left_px > 0.4, "these rates would not matter"
    assert row_waves.seen(wrong, solution) is None


def test_waves_of_the_row_are_found_with_the_poses_and_what_is_left_is_the_noise() -> None:
    left_px, off, missed_m = [], [], []
    for seed in (1, 2, 3):
        given, _, waves = vibrating(seed, 1.5)
        drawn, _, _ = scene(seed)
        for problem in (given, with_waves(given)):
            solution, layout = solved(seed, problem), problem.layout
            residual = image_residuals(problem, solution.state)
            seen = np.broadcast_to((problem.weight > 0)[:, None], residual.shape)
            left_px.append(float(np.sqrt(np.mean(residual[seen] ** 2))) * CAMERA.focal_px)
            missed_m.append(float(np.abs(solution.state.points_enu_m - drawn.truth.points_enu_m).mean()))
            if WAVES in layout.blocks:
                sigma = np.sqrt(np.diag(solution.covariance)[layout.by_picture])
                across = [0, 1, 3, 4]
                off.append(((solution.state.own - waves) / sigma)[:, across])
                assert sigma[:, across].max() < 0.7 * 1.5 / CAMERA.focal_px, "the pictures tell them"
    without, found = left_px[::2], left_px[1::2]
    assert max(found) < 0.31
    assert min(without) > 2.0 * max(found), "this vibration would not matter"
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.3
    assert np.mean(missed_m[1::2]) < 0.8 * np.mean(missed_m[::2])


def test_the_residual_changes_with_the_waves_as_its_derivative_says() -> None:
    problem, sweep, _ = vibrating(4, 1.5)
    drawn, _, _ = scene(4)
    problem = with_waves(problem)
    start = replace(drawn.truth, own=np.zeros((8, 6)))
    R, C, X = start.R_cam_enu, start.centres_enu_m, start.points_enu_m
    p = np.einsum("kij,kpj->kpi", R, X[None] - C[:, None])
    by_wave = sweep.by_wave((p[..., :2] / p[..., 2:]).transpose(0, 2, 1))
    step = 1e-5
    for i in range(6):
        waves = np.zeros((8, 6))
        waves[:, i] = step
        change = image_residuals(problem, replace(start, own=waves)) - image_residuals(problem, start)
        np.testing.assert_allclose(change / step, by_wave[:, i], atol=1e-6)


def test_pictures_whose_waves_nobody_knows_hold_them_as_noise() -> None:
    waves = np.tile([0.003, -0.001, 0.5, 0.001, 0.003, 0.5], (8, 1))
    assert row_waves.swing_rad(waves) == pytest.approx(np.sqrt((0.003**2 + 0.001**2) / 2.0))
    assert row_waves.swing_rad(np.zeros((0, 6))) == 0.0
