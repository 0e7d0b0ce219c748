"""One view's pose from known points: right, as sure as it says, and not misled."""

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.rotations import R_ENU_NED, exp_so3, log_so3, matrix_from_euler, mount_rotation
from onboard.estimation.resection import Sighted, resect

Array = NDArray[np.float64]

SIGMA = 0.3 / 900.0
WIDE = np.array([0.1, 0.1, 0.1, 30.0, 30.0, 30.0])


def view(rng: np.random.Generator, P: int = 40) -> tuple[Array, Array, Array, Array]:
    """Points, exact measurements, R_cam_enu and centre: 250 m up, 20 degrees off the vertical, rough ground."""
    R = (R_ENU_NED @ matrix_from_euler(0.05, -0.03, 0.7) @ mount_rotation(0.0, -70.0, 10.0)).T
    centre = np.array([5.0, -7.0, 250.0])
    rays = np.column_stack([rng.uniform(-0.36, 0.36, P), rng.uniform(-0.27, 0.27, P), np.ones(P)])
    d = rays @ R
    points = centre + d * ((rng.normal(0.0, 10.0, P) - centre[2]) / d[:, 2])[:, None]
    return points, rays[:, :2], R, centre


def error(R: Array, centre: Array, R_true: Array, centre_true: Array) -> Array:
    return np.concatenate([log_so3(R @ R_true.T), centre - centre_true])


def test_the_pose_is_found_from_five_degrees_and_ten_metres_off() -> None:
    points, xy, R, C = view(np.random.default_rng(0))
    start = exp_so3(np.radians([5.0, -4.0, 3.0])) @ R
    out = resect(Sighted(points, xy, np.full(40, 1.0 / SIGMA)), start, C + [6.0, -5.0, 6.0], 100.0 * WIDE, steps=30)
    assert np.abs(error(out.R_cam_enu, out.centre_enu_m, R, C)[:3]).max() < 1e-5
    assert np.abs(out.centre_enu_m - C).max() < 5e-3
    assert out.inliers.all()


def test_the_information_is_that_of_the_errors() -> None:
    """Prior and pixels drawn from their stated sigmas: normalised errors are chi-square with six degrees."""
    prior = np.array([0.02, 0.02, 0.02, 2.0, 2.0, 2.0])
    values = []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        points, xy, R, C = view(rng)
        off = prior * rng.standard_normal(6)
        noisy = xy + SIGMA * rng.standard_normal(xy.shape)
        out = resect(
            Sighted(points, noisy, np.full(40, 1.0 / SIGMA)),
            exp_so3(off[:3]) @ R,
            C + off[3:],
            prior,
            scale=1e3,
            steps=20,
        )
        e = error(out.R_cam_enu, out.centre_enu_m, R, C)
        values.append(e @ out.information @ e / 6)
    assert 1.0 - 4 * 0.047 < np.mean(values) < 1.0 + 4 * 0.047


def test_the_information_is_the_dense_one_and_points_pull_as_they_say() -> None:
    """d pose = -information^-1 by_point d point: moving a point moves the pose by what (7.2) says."""
    points, xy, R, C = view(np.random.default_rng(1))
    weight = np.full(40, 1.0 / SIGMA)
    base = resect(Sighted(points, xy, weight), R, C, WIDE, scale=1e6, steps=30)
    move = np.array([0.02, -0.01, 0.015])
    shifted = points.copy()
    shifted[7] += move
    out = resect(Sighted(shifted, xy, weight), R, C, WIDE, scale=1e6, steps=30)
    moved = error(out.R_cam_enu, out.centre_enu_m, base.R_cam_enu, base.centre_enu_m)
    expected = -np.linalg.solve(base.information, base.by_point[7] @ move)
    assert moved == pytest.approx(expected, rel=0.02, abs=0.01 * np.abs(expected).max())
    assert np.linalg.norm(expected[3:]) > 1e-4


def test_without_points_the_prior_stays() -> None:
    points, xy, R, C = view(np.random.default_rng(2))
    out = resect(Sighted(points[:0], xy[:0], np.zeros(0)), R, C, WIDE)
    assert out.R_cam_enu == pytest.approx(R)
    assert out.information == pytest.approx(np.diag(1.0 / WIDE**2))


def test_a_quarter_of_wrong_points_is_told_apart() -> None:
    rng = np.random.default_rng(3)
    points, xy, R, C = view(rng, 80)
    wrong = np.arange(80) % 4 == 0
    noisy = xy + SIGMA * rng.standard_normal(xy.shape)
    noisy[wrong] += rng.choice([-1.0, 1.0], (20, 2)) * rng.uniform(15.0, 60.0, (20, 2)) / 900.0
    start = exp_so3(np.radians([1.0, -1.0, 1.0])) @ R
    out = resect(Sighted(points, noisy, np.full(80, 1.0 / SIGMA)), start, C + [2.0, -2.0, 1.0], WIDE, steps=30)
    assert not out.inliers[wrong].any()
    assert out.inliers[~wrong].mean() > 0.95
    sigma = np.sqrt(np.diag(np.linalg.inv(out.information)))
    assert np.abs(error(out.R_cam_enu, out.centre_enu_m, R, C) / sigma).max() < 4.0


def test_points_behind_the_view_are_no_inliers() -> None:
    points, xy, R, C = view(np.random.default_rng(4))
    points[:5] = 2.0 * C - points[:5]
    out = resect(Sighted(points, xy, np.full(40, 1.0 / SIGMA)), R, C, WIDE)
    assert not out.inliers[:5].any()
    assert out.inliers[5:].all()
