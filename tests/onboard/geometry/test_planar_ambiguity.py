"""A plane's pictures have a second motion, and `mirrored` finds it where it is possible. Equations (3.9), (3.10)."""

import numpy as np
import pytest

from contract.rotations import R_ENU_NED, exp_so3, matrix_from_euler, mount_rotation
from onboard.geometry.planar_ambiguity import mirrored, second_motion

NORMAL = np.array([0.0, 0.0, -1.0])
PLANE = np.zeros(3)


def homography(Q: np.ndarray, travel_m: np.ndarray, normal: np.ndarray, distance_m: float) -> np.ndarray:
    return Q @ (np.eye(3) - np.outer(travel_m, normal) / distance_m)


@pytest.mark.parametrize("travel", [(3.0, 0.0, 20.0), (-4.0, 7.0, -15.0), (20.0, 5.0, 1.0)])
def test_the_second_motion_is_a_motion_and_explains_the_same_pictures(travel: tuple[float, float, float]) -> None:
    first = np.array(travel)
    Q, second, plane = second_motion(first, NORMAL, 80.0)
    assert np.allclose(Q @ Q.T, np.eye(3)) and np.linalg.det(Q) == pytest.approx(1.0)
    assert np.linalg.norm(plane) == pytest.approx(1.0) and np.linalg.norm(second) == pytest.approx(
        np.linalg.norm(first)
    )
    assert np.allclose(homography(np.eye(3), first, NORMAL, 80.0), homography(Q, second, plane, 80.0))
    again = second_motion(second, plane, 80.0)[1]
    assert np.allclose(again, first) or np.allclose(again, -first)


def test_a_view_that_does_not_travel_has_no_second_motion() -> None:
    Q, travel, plane = second_motion(np.zeros(3), NORMAL, 80.0)
    assert np.array_equal(Q, np.eye(3)) and not travel.any() and np.array_equal(plane, NORMAL)


def views(velocity: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Orientations, centres and noise-free coordinates of level ground, from six views that look straight down."""
    rng = np.random.default_rng(3)
    times = np.arange(6)[:, None] - 2.5
    centres = np.array([0.0, 0.0, 80.0]) + times * np.array(velocity)
    base = (R_ENU_NED @ matrix_from_euler(0.0, 0.0, 0.7) @ mount_rotation(0.0, -90.0, 0.0)).T
    R = exp_so3(0.03 * rng.standard_normal((6, 3))) @ base
    points = np.column_stack([rng.uniform(-15.0, 15.0, (60, 2)), np.zeros(60)])
    seen = (points - centres[:, None]) @ R.transpose(0, 2, 1)
    return R, centres, seen[..., :2] / seen[..., 2:], points


def test_a_climb_has_a_mirrored_explanation_turned_half_round() -> None:
    R, centres, xy, points = views((0.5, 0.3, 3.0))
    other = mirrored(R, centres, PLANE, xy, np.ones(xy.shape[:2], bool), 0.9)
    turned = np.degrees(np.arccos(np.clip((np.trace(other[0] @ R[0].T) - 1.0) / 2.0, -1.0, 1.0)))
    assert turned > 150.0
    # Where its rays meet level ground is where one point is, but for what travel and plane do not fit exactly.
    rays = np.einsum("kji,kpj->kpi", other, np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=2))
    on_ground = centres[:, None, :2] - rays[..., :2] * (centres[:, None, 2:] / rays[..., 2:])
    assert np.ptp(on_ground, axis=0).max() < 2.0
    assert np.linalg.norm(on_ground.mean(axis=0) - points[:, :2], axis=1).max() > 10.0


def test_level_flight_over_a_camera_that_looks_down_has_none() -> None:
    R, centres, xy, _ = views((12.0, 5.0, 0.2))
    assert mirrored(R, centres, PLANE, xy, np.ones(xy.shape[:2], bool), 0.9) is None
