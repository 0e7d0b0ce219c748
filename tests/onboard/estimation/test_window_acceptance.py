"""A wrong window is refused with its reason, a true one is published, and a memory that is wrong gives way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.drawn_flight import DrawnFlight, DrawnSpec, fly
from contract.feature_set import Status
from contract.rotations import exp_so3
from onboard.config.schema import parse_config
from onboard.estimation import initialisation, window_solver
from onboard.estimation.ground_memory import GroundMemory, GroundPatch, Home
from onboard.estimation.second_start import confirms, verdict
from onboard.estimation.sliding_window import Window
from onboard.estimation.solved_window import Solved
from onboard.estimation.window_acceptance import Memory, Refusal, by_itself, by_memory
from onboard.estimation.window_solver import Outcome, Request, adjust
from onboard.geometry.terrain_grid import Terrain
from simulation.paths import PathSpec
from tests.onboard.scenes import CAMERA, FULL, SEED_SENSORS, SceneSpec, draw

CALM = SceneSpec(error_scale=0.3)
LEVEL = 2.0, 10.0  # slope's sigma (deg), relief (m): the defaults


def patch(
    east_m: float,
    height_m: float,
    slope: tuple[float, float] = (0.0, 0.0),
    start_s: float = 0.0,
    seconds: float = 8.0,
    sigma_m: float = 4.0,
) -> GroundPatch:
    covariance = np.diag([sigma_m**2, 0.03**2, 0.03**2])
    return GroundPatch(np.array([east_m, 0.0]), height_m, np.array(slope), covariance, 80.0, start_s, start_s + seconds)


def believed(*patches: GroundPatch) -> GroundMemory:
    memory = GroundMemory()
    for one in patches:
        memory = memory.with_patch(one, *LEVEL)
    return memory


def test_ground_that_jumps_or_tilts_against_what_lies_beside_it_is_a_contradiction() -> None:
    memory = believed(*(patch(20.0 * k, 1.0 * (-1) ** k) for k in range(6)))
    assert memory.contradiction(patch(120.0, 3.0), *LEVEL) is None
    assert memory.contradiction(patch(140.0, 25.0), *LEVEL) is None  # a hill
    above = memory.contradiction(patch(120.0, 150.0), *LEVEL)
    assert above is not None and "+1" in above
    tilted = memory.contradiction(patch(110.0, 0.0, (0.9, 0.0)), *LEVEL)
    assert tilted is not None
    assert memory.contradiction(patch(900.0, 150.0), *LEVEL) is None  # nothing is known there


@pytest.mark.parametrize("slope", [0.1, 0.18, 0.5])
def test_a_mountain_side_is_no_contradiction(slope: float) -> None:
    """10 to 27 degrees of slope, seen by windows that find it: each patch leads to the next."""
    memory = GroundMemory()
    for k in range(30):
        one = patch(40.0 * k, 40.0 * slope * k, (slope, 0.0))
        assert memory.contradiction(one, *LEVEL) is None
        memory = memory.with_patch(one, *LEVEL)


def test_a_window_surer_than_its_neighbours_is_judged_by_both_covariances() -> None:
    vague = believed(*(patch(0.0, 0.0, sigma_m=40.0) for _ in range(3)))
    assert vague.contradiction(patch(10.0, 120.0, sigma_m=2.0), *LEVEL) is None
    sure = believed(*(patch(0.0, 0.0, sigma_m=2.0) for _ in range(3)))
    assert sure.contradiction(patch(10.0, 120.0, sigma_m=2.0), *LEVEL) is not None


def test_a_wrong_first_window_does_not_lock_the_flight_out() -> None:
    memory = believed(patch(0.0, 150.0, start_s=0.0))
    refused = 0
    for k in range(40):
        true = patch(10.0 * k, 0.0, start_s=1.0 + k)
        if memory.contradiction(true, *LEVEL) is None:
            memory = memory.with_patch(true, *LEVEL)
            break
        refused += 1
        memory = memory.contradicted(true)
    assert 8 <= refused <= 16  # longer than a window lasts, and no longer than two
    assert all(p.height_m == 0.0 for p in memory.patches)
    assert memory.contradiction(patch(10.0 * refused, 2.0, start_s=60.0), *LEVEL) is None


def test_wrong_windows_that_disagree_with_each_other_outvote_nobody() -> None:
    memory = believed(*(patch(10.0 * k, 0.0) for k in range(5)))
    rng = np.random.default_rng(0)
    for k in range(40):
        wrong = patch(60.0, float(rng.choice([-1.0, 1.0]) * rng.uniform(100.0, 900.0)), start_s=10.0 + 0.1 * k)
        assert memory.contradiction(wrong, *LEVEL) is not None
        memory = memory.contradicted(wrong)


def test_before_any_ground_is_known_homes_level_stands_for_it() -> None:
    home = Home(0.0, 10.0, 500.0)
    assert GroundMemory().contradiction(patch(0.0, 60.0), *LEVEL, home) is None
    against = GroundMemory().contradiction(patch(0.0, 170.0), *LEVEL, home)
    assert against is not None and "home" in against
    assert believed(patch(0.0, 170.0)).contradiction(patch(20.0, 170.0), *LEVEL, home) is None


def solved_scene(seed: int = 0) -> tuple[Request, Solved]:
    window = draw(np.random.default_rng(seed), FULL, CALM).window()
    request = window.prepare()
    outcome = adjust(request)
    assert outcome.status is Status.OK and outcome.solved is not None
    return request, outcome.solved


def judged(request: Request, solved: Solved, terrain: Terrain | None = None) -> Refusal | None:
    kept = np.isfinite(solved.solution.residual_sigmas).astype(float)
    return by_itself(
        request.config, CAMERA, solved.keyframes, terrain, solved.solution, solved.layout, kept, solved.good, []
    )


def flat_terrain(height_m: float) -> Terrain:
    return Terrain(-5000.0, -5000.0, 100.0, np.full((101, 101), height_m))


def test_points_off_the_terrain_model_are_refused() -> None:
    request, solved = solved_scene()
    ground = float(np.median(solved.solution.state.points_enu_m[solved.good, 2]))
    assert judged(request, solved) is None
    assert judged(request, solved, flat_terrain(ground + 4.0)) is None
    against = judged(request, solved, flat_terrain(ground + 75.0))
    assert against is not None and "terrain" in against.reason and against.status is Status.POOR_FIT


def test_a_scale_that_velocity_contradicts_is_refused() -> None:
    request, solved = solved_scene()
    for factor, is_refused in ((1.0, False), (1.15, False), (1.8, True), (0.4, True)):
        flown = tuple(
            replace(k, flown_enu_m=None if k.flown_enu_m is None else factor * k.flown_enu_m) for k in solved.keyframes
        )
        against = judged(request, replace(solved, keyframes=flown))
        assert (against is not None) is is_refused, factor
        assert against is None or "velocity" in against.reason


def test_points_behind_the_camera_or_at_it_are_refused() -> None:
    request, solved = solved_scene()
    state = solved.solution.state
    for pull, word in ((2.0, "above"), (0.99, "behind")):
        points = state.points_enu_m.copy()
        half = slice(0, len(points) // 2)
        points[half] += pull * (state.centres_enu_m.mean(axis=0) - points[half])
        wrong = replace(solved, solution=replace(solved.solution, state=replace(state, points_enu_m=points)))
        against = judged(request, wrong)
        assert against is not None and word in against.reason


def shifted(solved: Solved, shift_m: float) -> Solved:
    state = solved.solution.state
    solution = replace(solved.solution, state=replace(state, points_enu_m=state.points_enu_m + [shift_m, 0.0, 0.0]))
    for name in ("covariance", "point_gain", "point_covariance"):  # cached: of the solution as it was
        solution.__dict__[name] = getattr(solved.solution, name)
    return replace(solved, solution=solution)


def test_of_two_solutions_the_likelier_is_kept_and_none_where_they_fit_alike_and_differ() -> None:
    _, solved = solved_scene()
    far, near = shifted(solved, 200.0), shifted(solved, 0.5)
    assert verdict(solved, far, (100.0, 130.0))[0] is solved
    assert verdict(far, solved, (130.0, 100.0))[0] is solved
    same = verdict(solved, solved, (130.0, 100.0))[0]  # costs of two starts are no reason to change
    assert same is not None and same.solution is solved.solution and same.variance_factor == 1.0
    beside = verdict(solved, near, (100.0, 101.0))[0]
    assert beside is not None and beside.solution is solved.solution and 1.0 < beside.variance_factor < 3.0
    nobody, reason = verdict(solved, far, (100.0, 101.0))
    assert nobody is None and "alike" in reason
    assert confirms(solved, near)
    assert not confirms(solved, far)
    assert not confirms(None, solved)


def test_a_window_that_inherits_a_wrong_minimum_is_solved_again_from_attitude() -> None:
    """Before, it was refused for as long as its start was the window before's."""
    window = draw(np.random.default_rng(0), FULL, CALM).window()
    assert window.solve() is Status.OK and window.solved is not None
    true = window.solved
    request = window.prepare()
    state = true.solution.state
    over = 2.0 * state.centres_enu_m.mean(axis=0)[2]
    mirror = np.array([1.0, 1.0, -1.0])
    points = state.points_enu_m * mirror + [0.0, 0.0, over]
    half_turn = exp_so3(np.array([np.pi, 0.0, 0.0]))
    previous = replace(true, solution=replace(true.solution, state=replace(state, points_enu_m=points)))
    keyframes = tuple(replace(k, R_cam_enu=half_turn @ k.R_cam_enu) for k in request.keyframes)
    wrong = replace(request, previous=previous, keyframes=keyframes, memory=Memory())
    assert window_solver._adjusted(wrong).status is Status.POOR_FIT
    outcome = adjust(wrong)
    assert outcome.status is Status.OK and outcome.solved is not None
    miss = outcome.solved.solution.state.centres_enu_m - state.centres_enu_m
    assert np.linalg.norm(miss, axis=1).max() < 1.0


def test_without_attitude_a_solution_from_the_path_alone_needs_confirmation(monkeypatch: pytest.MonkeyPatch) -> None:
    window = draw(np.random.default_rng(1), SEED_SENSORS, CALM).window()
    request = window.prepare()
    true = adjust(request)
    assert true.status is Status.OK and true.solved is not None
    monkeypatch.setattr(initialisation, "orient", lambda *_: None)
    assert adjust(request).status is Status.POOR_FIT  # the rays support no start, and nothing says the path is right


def test_a_wrong_window_in_mid_flight_is_not_published_and_the_flight_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """One solve comes out 150 m too high: it is refused, counted with its reason, and the next is published."""
    made: list[Outcome] = []
    by = window_solver.by_memory

    def lifted(config: object, memory: Memory, solved: Solved, agreed: object) -> Refusal | None:
        if len(made) == 20:
            state = solved.solution.state
            solution = replace(
                solved.solution, state=replace(state, points_enu_m=state.points_enu_m + [0.0, 0.0, 150.0])
            )
            for name in ("covariance", "point_gain", "point_covariance"):
                solution.__dict__[name] = getattr(solved.solution, name)
            solved = replace(solved, solution=solution)
            agreed = memory.compared(solved)
        return by(config, memory, solved, agreed)  # type: ignore[arg-type]

    adopt = Window.adopt

    def watch(self: Window, outcome: Outcome) -> Status:
        made.append(outcome)
        return adopt(self, outcome)

    monkeypatch.setattr(window_solver, "by_memory", lifted)
    monkeypatch.setattr(Window, "adopt", watch)
    spec = DrawnSpec(parse_config('[solve]\nattitude = "none"\nvelocity = false'), PathSpec(), seconds=30.0)
    sets, pipeline = fly(DrawnFlight(spec, 4))
    assert made[20].status is Status.POOR_FIT and made[20].reason
    assert made[21].status is Status.OK
    assert sum(pipeline.summary.refused_windows.values()) == 1
    assert np.mean([s.is_ok for s in sets.values()]) > 0.85


def test_by_memory_is_silent_where_nothing_is_known() -> None:
    request, solved = solved_scene()
    assert by_memory(request.config, Memory(), solved, None) is None
