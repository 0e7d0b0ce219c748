"""A picture is placed again where that changes what clicks are answered, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.locate import MAX_OUTSIDE
from onboard.estimation.rolling_shutter import Moving
from onboard.estimation.solved_window import Solved
from onboard.georeferencing.feature_sets import Origin, Picture, Placed, place
from onboard.georeferencing.revision import (
    IN_REACH,
    MOVED,
    RADIUS_90,
    RISEN,
    WIDENED,
    Revisions,
    are_same,
    is_all_in_reach,
)
from tests.onboard.georeferencing.test_feature_sets import solved as solved_window
from tests.onboard.scenes import FRAME, FULL, T0_NS, SceneSpec, draw

Array = NDArray[np.float64]
SIZE_PX = (640, 480)


@pytest.fixture(scope="module")
def placed() -> Placed:
    scene = draw(np.random.default_rng(3), FULL, SceneSpec())
    window = solved_window(scene)
    frame = int(scene.keys[len(scene.keys) // 2]) + 1
    seen, nav = scene.observations[frame], scene.navs[frame]
    guess = window.pose_guess(seen, nav)
    assert guess is not None and window.solved is not None
    picture = Picture(window.camera, Origin("uav-1", 7, frame, T0_NS + frame, 0, False), FRAME, 11.0)
    made = place(window, window.solved, seen, picture, guess, nav)
    assert isinstance(made, Placed)
    return made


def reaches_m(solved: Solved) -> Array:
    """Semi-major axes of the points' horizontal 90 % ellipses, and what 90 % of heights are off by, (2, N)."""
    s = solved.solution
    gain = s.point_gain[solved.good]
    covariance = gain @ solved.covariance_at(solved.keyframes[-1].nav.stamp_ns) @ gain.transpose(0, 2, 1)
    covariance += s.point_covariance[solved.good]
    major = RADIUS_90 * np.sqrt(np.linalg.eigvalsh(covariance[:, :2, :2])[:, 1])
    return np.sqrt(solved.variance_factor) * np.stack([major, 1.645 * np.sqrt(covariance[:, 2, 2])])


def radius_m(solved: Solved) -> float:
    return float(reaches_m(solved)[0].min())


def shifted(solved: Solved, by_m: Array) -> Solved:
    state = solved.solution.state
    moved = replace(state, points_enu_m=state.points_enu_m + by_m)
    return replace(solved, solution=replace(solved.solution, state=moved))


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0)])
def test_points_that_have_moved_by_more_than_a_tenth_of_the_radius_are_another_answer(
    placed: Placed, direction: tuple[float, float, float]
) -> None:
    step_m = radius_m(placed.solved) * np.array(direction)
    assert are_same(placed.solved, shifted(placed.solved, 0.8 * MOVED * step_m))
    assert not are_same(placed.solved, shifted(placed.solved, 1.5 * MOVED * step_m))


def test_one_point_that_has_moved_is_enough(placed: Placed) -> None:
    first = int(np.flatnonzero(placed.solved.good)[0])
    by_m = np.zeros_like(placed.solved.solution.state.points_enu_m)
    by_m[first, 0] = radius_m(placed.solved)
    assert not are_same(placed.solved, shifted(placed.solved, by_m))


def test_a_height_that_has_moved_by_more_than_a_fifth_of_its_error_is_another_answer(placed: Placed) -> None:
    least_m = float(reaches_m(placed.solved)[1].min())
    up = np.array([0.0, 0.0, 1.0])
    assert are_same(placed.solved, shifted(placed.solved, 0.8 * RISEN * least_m * up))
    assert not are_same(placed.solved, shifted(placed.solved, 1.5 * RISEN * least_m * up))


@pytest.mark.parametrize("change", [1.0 + WIDENED, 1.0 / (1.0 + WIDENED)])
def test_a_radius_that_has_changed_is_another_answer_either_way(placed: Placed, change: float) -> None:
    within = replace(placed.solved, variance_factor=placed.solved.variance_factor * change**1.6)
    beyond = replace(placed.solved, variance_factor=placed.solved.variance_factor * change**2.4)
    assert are_same(placed.solved, within)
    assert not are_same(placed.solved, beyond)


def test_without_a_point_in_common_nothing_is_known_to_be_the_same(placed: Placed) -> None:
    others = replace(placed.solved, point_ids=placed.solved.point_ids + 10_000)
    assert not are_same(placed.solved, others)


def test_what_was_placed_by_the_same_solution_is_never_placed_again(placed: Placed) -> None:
    nowhere = replace(placed, feature_set=replace(placed.feature_set, uv_px=np.zeros((0, 2))))
    assert Revisions().is_needless(nowhere, placed.solved)


def test_a_picture_with_a_corner_out_of_reach_is_placed_again(placed: Placed) -> None:
    now = replace(placed.solved)  # another solution, with the same points
    u, v = np.meshgrid(np.linspace(40.0, 600.0, 6), np.linspace(40.0, 440.0, 5))
    everywhere = np.stack([u.ravel(), v.ravel()], axis=1)
    half = everywhere[everywhere[:, 0] < 300.0]
    for uv_px, expected in ((everywhere, True), (half, False)):
        held = replace(placed, feature_set=replace(placed.feature_set, uv_px=uv_px))
        assert Revisions().is_needless(held, now) is expected


def test_what_counts_as_in_reach_the_ground_answers() -> None:
    """The ground's own limit, in undistorted coordinates, lies a little beyond ours, in pixels."""
    assert 0.85 * MAX_OUTSIDE < IN_REACH < MAX_OUTSIDE
    assert not is_all_in_reach(np.array([[320.0, 240.0], [330.0, 250.0]]), SIZE_PX)
    corners = np.array([[0.0, 0.0], [639.0, 0.0], [0.0, 479.0], [639.0, 479.0]])
    assert is_all_in_reach(corners, SIZE_PX)
    # A square of half the picture's height in its middle: its reach ends well before the corners.
    assert not is_all_in_reach(320.0 + 120.0 * (corners / [319.5, 239.5] - 1.0) * [1.0, 0.75], SIZE_PX)


def test_rows_that_take_another_time_are_another_answer_where_that_moves_a_corner(placed: Placed) -> None:
    """By a tenth of the radius, with the points where they were; of a global shutter nothing is to move."""
    u, v = np.meshgrid(np.linspace(0.0, 639.0, 6), np.linspace(0.0, 479.0, 5))
    rate, velocity = np.array([0.3, 0.0, 0.0]), np.array([0.0, 20.0, 0.0])
    moving = Moving(0.03, rate, velocity, velocity, np.zeros(3))
    one = replace(
        placed.feature_set,
        uv_px=np.stack([u.ravel(), v.ravel()], axis=1),
        shutter=moving.for_ground(np.eye(3), 0.03, 0.0),
    )
    held = replace(placed, feature_set=one)
    range_m = 1.0 / float(one.plane_per_m[0])
    step_s = MOVED * radius_m(placed.solved) / (0.5 * (0.3 * range_m + 20.0))  # in the middle of the outer rows
    for share, expected in ((0.3, True), (-0.3, True), (3.0, False), (-3.0, False)):
        now = replace(placed.solved, readout_s=placed.solved.readout_s + share * step_s)
        assert Revisions().is_needless(held, now) is expected
        at_once = replace(placed, feature_set=replace(one, shutter=None))
        assert Revisions().is_needless(at_once, now) is True
