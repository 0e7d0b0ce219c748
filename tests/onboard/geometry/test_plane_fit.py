"""The ground plane under the points, and the roll that makes it level."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.rotations import exp_so3
from onboard.geometry.plane_fit import fit_plane
from simulation.study_seed import level, roll_from_plane

slope = st.floats(-0.5, 0.5)


@given(slope, slope, st.floats(-500.0, 500.0), st.integers(0, 1000))
def test_a_tilted_plane_is_found(east: float, north: float, height: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-100.0, 100.0, (50, 2)) + rng.uniform(-1000.0, 1000.0, 2)
    z = height + xy @ [east, north]
    plane, spread = fit_plane(np.column_stack([xy, z]))
    assert plane[0] + xy @ plane[1:] == pytest.approx(z, abs=1e-2)
    assert plane[1:] == pytest.approx([east, north], abs=1e-4)
    assert 0.0 <= spread < 1e-2


def test_masts_and_wrong_points_at_one_side_do_not_tilt_it() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-100.0, 100.0, (200, 2))
    z = 0.1 * xy[:, 0] + 0.5 * rng.standard_normal(200)
    masts = np.argsort(xy[:, 1])[-12:]
    z[masts] += 30.0
    plane, spread = fit_plane(np.column_stack([xy, z]))
    assert plane[1:] == pytest.approx([0.1, 0.0], abs=0.01)
    assert 0.4 < spread < 1.0
    plain = np.linalg.lstsq(np.column_stack([np.ones(200), xy]), z, rcond=None)[0]
    assert abs(plain[2]) > 0.03


@pytest.mark.parametrize(
    "points", [np.array([[3.0, 4.0, 7.0]]), np.array([[0, 0, 5.0], [10.0, 0, 5.0], [20.0, 0, 5.0]])]
)
def test_too_few_points_give_a_level_plane_at_their_height(points: np.ndarray) -> None:
    plane, _ = fit_plane(points)
    assert plane[0] + points[:, :2] @ plane[1:] == pytest.approx(points[:, 2], abs=1e-3)
    assert plane[2] == pytest.approx(0.0, abs=1e-6)


def test_weights_choose_who_speaks() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-50.0, 50.0, (60, 2))
    z = np.where(np.arange(60) < 30, 0.2 * xy[:, 0], 30.0 - 0.2 * xy[:, 0])
    plane, _ = fit_plane(np.column_stack([xy, z]), np.where(np.arange(60) < 30, 1.0, 1e-9))
    assert plane[1:] == pytest.approx([0.2, 0.0], abs=1e-3)


def test_the_roll_is_the_slope_across_the_line_of_flight() -> None:
    """Flying north over ground that falls to the east: left is higher, the slope across (towards the left) positive."""
    assert roll_from_plane(np.array([0.0, -0.1, 0.3]), np.array([0.0, 9.0, 1.0])) == pytest.approx(np.arctan(0.1))
    assert roll_from_plane(np.array([0.0, 0.0, 0.3]), np.array([0.0, 9.0, 0.0])) == pytest.approx(0.0)


@given(st.floats(-3.14, 3.14), st.floats(-0.3, 0.3), st.integers(0, 100))
def test_levelling_takes_the_slope_across_away_and_leaves_the_one_along(course: float, roll: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    travel = 20.0 * np.array([np.sin(course), np.cos(course), 0.0])
    pivot = np.array([10.0, 20.0, 250.0])
    xy = rng.uniform(-100.0, 100.0, (60, 2))
    level_ground = np.column_stack([xy, np.zeros(60)])
    tilt = exp_so3(roll * travel / np.linalg.norm(travel))
    tilted = pivot + (level_ground - pivot) @ tilt.T
    R = exp_so3(rng.standard_normal((3, 3)))
    found = roll_from_plane(fit_plane(tilted)[0], travel)
    assert found == pytest.approx(roll, abs=1e-4)
    turned, back = level(R, pivot, travel, found)
    assert pivot + (tilted - pivot) @ back.T == pytest.approx(level_ground, abs=0.1)
    # A camera at the pivot sees the same pixels before and after.
    assert (pivot + (tilted - pivot) @ back.T - pivot) @ turned[0].T == pytest.approx(
        (tilted - pivot) @ R[0].T, abs=1e-9
    )
