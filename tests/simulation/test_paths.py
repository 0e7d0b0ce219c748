"""Described paths move as they say."""

import numpy as np
import pytest

from contract.errors import InputError
from contract.rotations import R_ENU_NED, euler_from_matrix
from simulation.paths import KINDS, PathSpec, fly_path

TIME = np.linspace(0.0, 60.0, 601)


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "waypoints"])
def test_speed_height_and_smoothness(kind: str) -> None:
    path = fly_path(PathSpec(kind, speed_m_s=15.0, height_m=120.0), 60.0, seed=1)
    velocity = path.velocity_enu_m_s(TIME)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    if kind == "hover":
        assert speed.max() < 2.0
        assert np.ptp(path.position_enu_m(TIME)[:, :2], axis=0).max() < 3.0
    else:
        np.testing.assert_allclose(speed, 15.0, atol=0.05)
    assert np.abs(path.position_enu_m(TIME)[:, 2] - 120.0).max() < 2.0
    assert np.abs(np.diff(velocity, axis=0)).max() < 0.1 * 9.0  # never more than 9 m/s2


def test_crab_turns_the_nose_right_of_travel() -> None:
    path = fly_path(PathSpec("straight", heading_deg=350.0, crab_deg=15.0, wobble_deg=0.0), 60.0, seed=1)
    yaw = np.degrees(euler_from_matrix(R_ENU_NED.T @ path.R_enu_body(TIME))[:, 2])
    velocity = path.velocity_enu_m_s(TIME)
    track = np.degrees(np.arctan2(velocity[:, 0], velocity[:, 1]))
    np.testing.assert_allclose((yaw - track) % 360.0, 15.0, atol=1e-6)
    np.testing.assert_allclose(track, -10.0, atol=1e-6)


def test_wobble_is_bounded_and_there() -> None:
    path = fly_path(PathSpec("straight", wobble_deg=1.0, pitch_deg=0.0), 60.0, seed=1)
    roll, pitch, _ = np.degrees(euler_from_matrix(R_ENU_NED.T @ path.R_enu_body(TIME))).T
    for angle in (roll, pitch):
        assert 0.4 < angle.std() < 1.8
        assert np.abs(angle).max() <= 3.01


def test_a_right_turn_banks_right() -> None:
    path = fly_path(PathSpec("orbit", speed_m_s=20.0, radius_m=150.0, wobble_deg=0.0), 60.0, seed=1)
    roll = np.degrees(euler_from_matrix(R_ENU_NED.T @ path.R_enu_body(TIME))[:, 0])
    np.testing.assert_allclose(roll, np.degrees(np.arctan(20.0**2 / 150.0 / 9.80665)), atol=0.2)


def test_waypoints_are_passed() -> None:
    points = ((0.0, 0.0), (0.0, 300.0), (400.0, 300.0), (400.0, 700.0))
    path = fly_path(PathSpec("waypoints", speed_m_s=20.0, heading_deg=0.0, waypoints_m=points), 60.0, seed=1)
    place = path.position_enu_m(np.linspace(-5.0, 65.0, 2000))[:, :2]
    for point in points:
        assert np.hypot(*(place - point).T).min() < 35.0


def test_an_unknown_path_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"'loop'.*orbit"):
        PathSpec("loop")
