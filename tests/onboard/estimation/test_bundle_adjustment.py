"""The bundle adjustment finds the truth, knows how well, and is the same as the dense problem it never builds."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rotations import exp_so3
from onboard.estimation.bundle_adjustment import Problem, evaluate, parallax_of, solve
from onboard.estimation.factors import Layout, State, ground_plane, reprojection
from onboard.estimation.noise_shape import rounded
from onboard.geometry.camera_errors import by_states
from onboard.geometry.plane_fit import fit_plane
from onboard.geometry.robust import robust_cost
from simulation.study_seed import level, roll_from_plane
from tests.onboard.scenes import Drawn, bundle_problem, error_of, first_guess

Array = NDArray[np.float64]


def residuals(problem: Problem, state: State) -> Array:
    xy = problem.xy.transpose(0, 2, 1)
    r, predicted, _ = reprojection(state.R_cam_enu, state.centres_enu_m, state.points_enu_m, xy)
    if problem.camera is not None:
        by_camera = by_states(problem.camera, predicted[:, 0], predicted[:, 1])
        r = r - np.einsum("kcip,c->kip", by_camera, state.camera - problem.camera_taken)
    r = rounded(problem.shape, r) * problem.weight[:, None]
    relief = ground_plane(state.points_enu_m, problem.reference_enu_m, state.plane)[0] * problem.ground_weight
    if problem.parallax is not None:
        seen_larger = parallax_of(state.centres_enu_m, problem.reference_enu_m, state.plane) / problem.parallax
        relief = relief * seen_larger * np.exp(state.camera[0] if len(state.camera) else 0.0)
    return np.concatenate([r.ravel(), relief, *(prior.evaluate(state)[0] for prior in problem.priors)])


def dense_jacobian(problem: Problem, state: State) -> Array:
    """Central differences by camera side, then points."""
    D, P = problem.layout.size, len(state.points_enu_m)
    columns = []
    for c in range(D + 3 * P):
        step = np.zeros(D + 3 * P)
        step[c] = h = 1e-6 if c < D else 1e-4
        sides = [residuals(problem, state.retract(s[:D], s[D:].reshape(P, 3))) for s in (step, -step)]
        columns.append((sides[0] - sides[1]) / (2.0 * h))
    return np.stack(columns, axis=1)


def turned_start(drawn: Drawn, turn_rad: Array) -> State:
    """All cameras turned by the same rotation (ENU axes), centres as GPS says, points where the turned rays meet."""
    R = drawn.truth.R_cam_enu @ exp_so3(turn_rad).T
    return first_guess(drawn, R, drawn.truth.centres_enu_m)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", ["roll", "pitch", "heading", "all"])
def test_fifteen_degrees_of_wrong_orientation_are_removed_without_an_attitude_sensor(axis: str, sign: float) -> None:
    """GPS, pictures and level ground alone: the seed's sensors."""
    drawn = bundle_problem(np.random.default_rng(5), 8, 70, noise=0.0, attitude=False)
    along = np.diff(drawn.truth.centres_enu_m[[0, -1]], axis=0)[0]
    along[2] = 0.0
    along /= np.linalg.norm(along)
    axes = {"roll": along, "pitch": np.array([-along[1], along[0], 0.0]), "heading": np.array([0.0, 0.0, 1.0])}
    turn = axes[axis] if axis != "all" else sum(axes.values()) / np.sqrt(3.0)
    start = turned_start(drawn, sign * np.radians(15.0) * turn)
    assert np.median(np.linalg.norm(start.points_enu_m - drawn.truth.points_enu_m, axis=1)) > 5.0
    solution = solve(drawn.problem, start, scale=None, max_iterations=60, tolerance=1e-12)
    assert solution.converged
    assert np.abs(solution.state.centres_enu_m - drawn.truth.centres_enu_m).max() < 0.01
    assert np.abs(solution.state.points_enu_m - drawn.truth.points_enu_m).max() < 0.01
    assert 0.0 <= solution.cost < 1e-6


def test_with_the_robust_loss_a_window_as_the_daemon_solves_it_also_gets_there() -> None:
    drawn = bundle_problem(np.random.default_rng(6), 8, 70, noise=0.0, attitude=False)
    start = turned_start(drawn, np.radians([6.0, -6.0, 8.0]))
    first = solve(drawn.problem, start, scale=3.0, tolerance=3e-4)
    second = solve(drawn.problem, first.state, scale=6.0, max_iterations=40, tolerance=1e-12)
    assert np.abs(second.state.centres_enu_m - drawn.truth.centres_enu_m).max() < 0.01


@pytest.mark.parametrize("views", [3, 4, 6])
def test_a_first_window_turned_by_twenty_degrees_about_any_axis_reaches_its_minimum(views: int) -> None:
    """Depth and tilt change together along a bent valley; steps that are linear in places creep along it."""
    steps = []
    for seed in range(900, 912):
        rng = np.random.default_rng(seed)
        sampled = bundle_problem(rng, views, 70, attitude=False)
        axis = rng.standard_normal(3)
        start = turned_start(sampled, np.radians(20.0) * axis / np.linalg.norm(axis))
        found = solve(sampled.problem, start, scale=3.0, tolerance=3e-4)
        lowest = solve(sampled.problem, sampled.truth, scale=3.0, tolerance=3e-4)
        assert found.converged and found.cost < 1.01 * lowest.cost + 0.5, seed
        steps.append(found.iterations)
    assert max(steps) <= 12


@pytest.mark.parametrize("attitude", [True, False])
def test_a_window_that_is_nearly_solved_needs_four_steps_also_where_something_is_hardly_known(attitude: bool) -> None:
    """Of GPS alone the roll is known to degrees: damped by its large diagonal it would creep along for dozens."""
    firsts, away = [], []
    for seed in range(300, 312):
        drawn = bundle_problem(np.random.default_rng(seed), 8, 70, attitude=attitude)
        start = first_guess(drawn, drawn.truth.R_cam_enu, drawn.truth.centres_enu_m)
        first = solve(drawn.problem, start, scale=3.0, tolerance=3e-4)
        second = solve(drawn.problem, first.state, scale=6.0, tolerance=1e-5)
        ended = solve(drawn.problem, first.state, scale=6.0, max_iterations=200, tolerance=1e-13)
        assert second.converged and ended.converged
        assert 2 <= second.iterations <= 5
        e = error_of(second.state, ended.state)
        firsts.append(first.iterations)
        away.append(float(np.sqrt(e @ np.linalg.solve(ended.covariance, e))))
    assert np.mean(firsts) < 7.0
    assert max(away) < 0.005


def test_a_lens_that_trades_with_height_and_tilt_is_found_in_few_steps() -> None:
    """Without attitude. By coordinates that do not stretch with the lens some creep, and one ends nowhere."""
    steps = []
    for seed in range(12):
        sampled = bundle_problem(np.random.default_rng(seed), 4, 70, attitude=False, lens=UNKNOWN_LENS)
        start = first_guess(sampled, sampled.truth.R_cam_enu, sampled.truth.centres_enu_m)
        start = replace(start, platform=np.zeros_like(start.platform))
        found = solve(sampled.problem, start, scale=6.0, tolerance=1e-5)
        assert found.converged, seed
        steps.append(found.iterations)
    assert max(steps) <= 12 and np.mean(steps) < 8.0


def test_covariance_is_the_scatter_of_the_errors() -> None:
    """Normalised squared errors of the poses, of what they share and of the points, and the cost, are chi-square."""
    runs, layout = 120, Layout(6)
    poses, shared, points, cost, freedom = [], [], [], [], 0
    for seed in range(runs):
        drawn = bundle_problem(np.random.default_rng(100 + seed))
        s = solve(drawn.problem, first_guess(drawn, drawn.truth.R_cam_enu, drawn.truth.centres_enu_m), scale=None)
        e = error_of(s.state, drawn.truth)
        pose, rest = slice(0, 36), slice(36, layout.size)
        poses.append(e[pose] @ np.linalg.solve(s.covariance[pose, pose], e[pose]) / 36)
        shared.append(e[rest] @ np.linalg.solve(s.covariance[rest, rest], e[rest]) / 11)
        cov = np.einsum("pid,de,pje->pij", s.point_gain, s.covariance, s.point_gain) + s.point_covariance
        ep = s.state.points_enu_m - drawn.truth.points_enu_m
        points.append(np.mean(np.einsum("pi,pij,pj->p", ep, np.linalg.inv(cov), ep)) / 3)
        cost.append(2.0 * s.cost)
        measured = 2 * np.count_nonzero(drawn.problem.weight) + drawn.problem.weight.shape[1]
        priors = sum(len(prior.evaluate(s.state)[0]) for prior in drawn.problem.priors)
        freedom += measured + priors - layout.size - 3 * drawn.truth.points_enu_m.shape[0]
    # One sigma of the means: sqrt(2 / (36 * 120)) = 0.022 and sqrt(2 / (11 * 120)) = 0.039; points of one run share
    # most of their error, so theirs is taken as of three free numbers a run: sqrt(2 / (3 * 120)) = 0.075.
    assert 1.0 - 4 * 0.022 < np.mean(poses) < 1.0 + 4 * 0.022
    assert 1.0 - 4 * 0.039 < np.mean(shared) < 1.0 + 4 * 0.039
    assert 1.0 - 4 * 0.075 < np.mean(points) < 1.0 + 4 * 0.075
    assert 0.97 < np.sum(cost) / freedom < 1.03


def test_errors_drawn_larger_than_believed_show_as_larger() -> None:
    """The test above can fail: twice the noise is four times the normalised error."""
    values = []
    for seed in range(15):
        drawn = bundle_problem(np.random.default_rng(500 + seed), noise=2.0)
        s = solve(drawn.problem, first_guess(drawn, drawn.truth.R_cam_enu, drawn.truth.centres_enu_m), scale=None)
        e = error_of(s.state, drawn.truth)[:36]
        values.append(e @ np.linalg.solve(s.covariance[:36, :36], e) / 36)
    assert 3.2 < np.mean(values) < 4.8


# Nearly right, for the derivatives are those at the camera that measurements were made with.
UNKNOWN_LENS = replace(Camera.from_field_of_view(640, 480, 65.0), stated_sigma=(0.05, 0.02, 0.02, 0.1, 0.1))
LENS = replace(Camera.from_field_of_view(640, 480, 40.0), stated_sigma=(2e-5, 1e-5, 1e-5, 5e-5, 5e-5))

FISHEYE = Camera(640, 480, 330.0, 333.0, 322.0, 236.0, (-0.031, 0.012, -0.006, 0.0011), "fisheye", LENS.sigma)


def with_ground_by_parallax(drawn: Drawn) -> Problem:
    """The window with the ground's weight relative to what a metre of height moves in the pictures, (5.9)."""
    problem = drawn.problem
    there = parallax_of(drawn.truth.centres_enu_m, problem.reference_enu_m, drawn.truth.plane)
    return replace(problem, parallax=1.1 * there)


@pytest.mark.parametrize("by_parallax", [False, True])
@pytest.mark.parametrize(("lens", "grown"), [(None, 0.0), (LENS, 0.0), (LENS, 0.05), (FISHEYE, 0.0), (FISHEYE, 0.05)])
def test_schur_complement_is_the_dense_problem(lens: Camera | None, grown: float, by_parallax: bool) -> None:
    """Covariance, gain of the points and their own covariance are blocks of the dense normal matrix's inverse.

    Also where the lens is `grown` from what the coordinates were made with, so that these stretch.
    """
    drawn = bundle_problem(np.random.default_rng(2), 4, 14, lens=lens)
    problem = with_ground_by_parallax(drawn) if by_parallax else drawn.problem
    problem = replace(problem, camera_taken=problem.camera_taken - grown, seen_by=lens)
    s = solve(
        problem, first_guess(drawn, drawn.truth.R_cam_enu, drawn.truth.centres_enu_m), scale=None, tolerance=1e-12
    )
    D, P = problem.layout.size, len(drawn.truth.points_enu_m)
    J = dense_jacobian(problem, s.state)
    H = J.T @ J
    scale = 1.0 / np.sqrt(np.diag(H))
    inverse = np.linalg.inv(H * scale[:, None] * scale) * scale[:, None] * scale
    sigma = np.sqrt(np.diag(inverse))
    assert s.covariance / np.outer(sigma[:D], sigma[:D]) == pytest.approx(
        inverse[:D, :D] / np.outer(sigma[:D], sigma[:D]), abs=2e-4
    )
    for p in range(P):
        at = slice(D + 3 * p, D + 3 * p + 3)
        # E[d point | d camera side] = -V^-1 W' d, so the joint covariance's block is -Y S.
        cross = -s.point_gain[p] @ s.covariance
        assert cross / np.outer(sigma[at], sigma[:D]) == pytest.approx(
            inverse[at, :D] / np.outer(sigma[at], sigma[:D]), abs=2e-4
        )
        own = s.point_gain[p] @ s.covariance @ s.point_gain[p].T + s.point_covariance[p]
        assert own / np.outer(sigma[at], sigma[at]) == pytest.approx(
            inverse[at, at] / np.outer(sigma[at], sigma[at]), abs=2e-4
        )


def test_nothing_is_gained_by_tilting_views_and_ground_together() -> None:
    """Seen from the side, as in a bank: the pictures stay the same, and the ground's weight must, too.

    Counted over the plane's reference point instead of below the views, the clearance grows with the tilt: 5 degrees
    then took a third off the ground's cost, and in turns the ground came out tilted. Counted vertically, the cost falls
    with the tilt's square, and over hills windows in a row tilted by 40 degrees.
    """
    rng = np.random.default_rng(8)
    beside = np.array([300.0, 40.0, 0.0])
    points = beside + rng.normal(0.0, [80.0, 80.0, 5.0], (60, 3))
    centres = np.array([0.0, 0.0, 250.0]) + np.linspace(-80.0, 80.0, 6)[:, None] * [0.0, 1.0, 0.0]
    flat = 1.0 / parallax_of(centres, beside, np.zeros(3))
    for degrees in (-40.0, -5.0, 5.0, 60.0):
        angle = np.radians(degrees)
        R = exp_so3(angle * np.array([0.0, 1.0, 0.0]))
        about = centres.mean(axis=0)
        ground = about + (points - about) @ R.T
        # The plane that was level, in the same coordinates: its height at the reference point and its slopes.
        slope = np.array([R[2, 0] / R[0, 0], 0.0])
        foot = about + R @ (np.array([*about[:2], 0.0]) - about)
        plane = np.array([foot[2] + slope @ (beside - foot)[:2], *slope])
        relief = ground_plane(ground, beside, plane)[0]
        turned = relief * parallax_of(about + (centres - about) @ R.T, beside, plane) * flat
        assert turned == pytest.approx(points[:, 2], rel=1e-9)


def test_the_solution_is_a_minimum_of_the_cost_it_reports() -> None:
    drawn = bundle_problem(np.random.default_rng(3), 4, 14)
    start = first_guess(drawn, drawn.truth.R_cam_enu, drawn.truth.centres_enu_m)
    for scale in (None, 3.0):
        s = solve(drawn.problem, start, scale=scale, tolerance=1e-13, max_iterations=60)
        assert s.cost == pytest.approx(evaluate(drawn.problem, s.state, scale), rel=1e-12)
        assert s.cost < evaluate(drawn.problem, start, scale)
        rng = np.random.default_rng(0)
        for _ in range(20):
            dc = np.sqrt(np.diag(s.covariance)) * 0.05 * rng.standard_normal(drawn.problem.layout.size)
            dp = -np.einsum("pid,d->pi", s.point_gain, dc)
            assert evaluate(drawn.problem, s.state.retract(dc, dp), scale) > s.cost


def test_gross_errors_are_told_apart_and_do_no_harm() -> None:
    rng = np.random.default_rng(8)
    drawn = bundle_problem(rng, 8, 80)
    clean = solve(drawn.problem, first_guess(drawn, drawn.truth.R_cam_enu, drawn.truth.centres_enu_m))
    seen = drawn.problem.weight > 0
    wrong = seen & (rng.random(seen.shape) < 0.10)
    xy = drawn.problem.xy + np.where(wrong, 1.0, 0.0)[..., None] * rng.uniform(-60.0, 60.0, (*seen.shape, 2)) / 900.0
    dirty = Drawn(replace(drawn.problem, xy=xy), drawn.truth)
    s = solve(dirty.problem, first_guess(dirty, drawn.truth.R_cam_enu, drawn.truth.centres_enu_m), max_iterations=40)
    large = wrong & (np.linalg.norm(xy - drawn.problem.xy, axis=-1) > 12.0 / 900.0)
    often = np.count_nonzero(seen & ~wrong, axis=0) >= 3
    assert np.mean(s.robust_weight[large & often] < 0.3) > 0.95
    assert np.mean(s.robust_weight[seen & ~wrong & often] > 0.3) > 0.95
    sigma = np.sqrt(np.diag(clean.covariance))
    shift = error_of(s.state, clean.state) / sigma
    assert np.abs(shift).max() < 1.0
    plain = solve(
        dirty.problem,
        first_guess(dirty, drawn.truth.R_cam_enu, drawn.truth.centres_enu_m),
        scale=None,
        max_iterations=40,
    )
    assert np.abs(error_of(plain.state, clean.state) / sigma).max() > 3.0


@pytest.mark.parametrize("scale", [None, 1.0, 3.0])
def test_the_losss_weight_is_its_slope(scale: float | None) -> None:
    squared = np.array([0.0, 0.5, 4.0, 100.0, 1e6])
    value, weight = robust_cost(squared, scale)
    h = 1e-4 * (1.0 + squared)
    slope = (robust_cost(squared + h, scale)[0] - robust_cost(squared - h, scale)[0]) / (2.0 * h)
    assert weight == pytest.approx(slope, rel=1e-5)
    assert weight[0] == 1.0
    assert np.all(value <= squared + 1e-12)


def test_a_point_behind_a_camera_that_saw_it_costs_dearly() -> None:
    drawn = bundle_problem(np.random.default_rng(4), 4, 14)
    points = drawn.truth.points_enu_m.copy()
    points[0, 2] += 600.0
    behind = replace(drawn.truth, points_enu_m=points)
    views = np.count_nonzero(drawn.problem.weight[:, 0])
    at_truth, at_behind = (evaluate(drawn.problem, s, None) for s in (drawn.truth, behind))
    assert views >= 2
    assert 0.5 * views * 99.0**2 < at_behind - at_truth < 1e6


def test_levelling_before_or_level_ground_in_the_bundle_agree() -> None:
    """Seed 2.3: fit a plane, turn the scene about the line of flight. The bundle's soft plane says the same roll."""
    drawn = bundle_problem(np.random.default_rng(9), 8, 90, noise=0.0, attitude=False)
    truth = drawn.truth
    travel = truth.centres_enu_m[-1] - truth.centres_enu_m[0]
    R_wrong, R = level(truth.R_cam_enu, truth.centres_enu_m[0], travel, np.radians(4.0))
    points = truth.centres_enu_m[0] + (truth.points_enu_m - truth.centres_enu_m[0]) @ R.T
    roll = roll_from_plane(fit_plane(points)[0], travel)
    assert np.degrees(roll) == pytest.approx(-4.0, abs=0.05)
    s = solve(drawn.problem, first_guess(drawn, R_wrong, truth.centres_enu_m), scale=None, max_iterations=60)
    levelled, _ = level(R_wrong, truth.centres_enu_m[0], travel, roll)
    assert levelled == pytest.approx(s.state.R_cam_enu, abs=2e-3)
