"""Points where rays meet, and the parallax that says how well."""

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.rotations import R_ENU_NED, exp_so3, mount_rotation
from onboard.geometry.triangulation import triangulate

Array = NDArray[np.float64]


def strip(rng: np.random.Generator, K: int = 5, P: int = 40, step_m: float = 20.0) -> tuple[Array, Array, Array, Array]:
    """R_cam_enu, centres, points, exact normalised image coordinates of a pass straight overhead at 250 m."""
    base = (R_ENU_NED @ mount_rotation(0.0, -90.0, 0.0)).T
    R = exp_so3(0.05 * rng.standard_normal((K, 3))) @ base
    centres = np.arange(K)[:, None] * np.array([step_m, 0.0, 0.0]) + [0.0, 0.0, 250.0]
    points = rng.uniform([-60.0, -60.0, -20.0], [120.0, 60.0, 20.0], (P, 3))
    p = np.einsum("kij,kpj->kpi", R, points[None] - centres[:, None])
    return R, centres, points, p[..., :2] / p[..., 2:]


@pytest.mark.parametrize("K", [2, 3, 8])
def test_exact_rays_meet_in_the_point(K: int) -> None:
    R, C, points, xy = strip(np.random.default_rng(0), K)
    out = triangulate(R, C, xy, np.ones(xy.shape[:2], bool))
    assert out.points_enu_m == pytest.approx(points, abs=1e-6)
    assert out.is_ahead.all()


def test_only_the_views_that_saw_a_point_speak() -> None:
    rng = np.random.default_rng(1)
    R, C, points, xy = strip(rng)
    seen = rng.random(xy.shape[:2]) < 0.6
    xy = np.where(seen[..., None], xy, 99.0)
    out = triangulate(R, C, xy, seen)
    often = np.count_nonzero(seen, axis=0) >= 2
    assert out.points_enu_m[often] == pytest.approx(points[often], abs=1e-6)
    assert not out.is_ahead[~often].any()


def test_parallax_of_two_views_is_the_angle_between_the_rays() -> None:
    """Twice the root of the mean squared sine about the mean ray: for two rays 2 sin(half the angle)."""
    R, C, points, xy = strip(np.random.default_rng(2), 2)
    out = triangulate(R, C, xy, np.ones(xy.shape[:2], bool))
    a, b = (points - c for c in C)
    cosine = np.sum(a * b, axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    assert out.parallax_rad == pytest.approx(2.0 * np.sin(0.5 * np.arccos(cosine)), rel=1e-6)
    assert 0.06 < np.median(out.parallax_rad) < 0.09  # 20 m seen from 250 m


def test_without_a_baseline_there_is_no_parallax_and_nothing_breaks() -> None:
    R, C, _, xy = strip(np.random.default_rng(3), 3, step_m=0.0)
    out = triangulate(R, C, xy, np.ones(xy.shape[:2], bool))
    assert out.parallax_rad == pytest.approx(0.0, abs=1e-6)
    assert np.all(np.isfinite(out.points_enu_m))


def test_noise_makes_the_error_that_the_geometry_says() -> None:
    """Depth error of many views: sigma z^2 / (baseline spread), within a factor that covers the approximation."""
    rng = np.random.default_rng(4)
    R, C, points, xy = strip(rng, 5, 400)
    sigma = 0.3 / 900.0
    out = triangulate(R, C, xy + sigma * rng.standard_normal(xy.shape), np.ones(xy.shape[:2], bool))
    spread = np.sqrt(np.sum((C[:, 0] - C[:, 0].mean()) ** 2))
    expected = sigma * 250.0**2 / spread
    assert 0.8 * expected < np.std((out.points_enu_m - points)[:, 2]) < 1.25 * expected


def test_rays_that_part_are_not_ahead() -> None:
    """Two parallel cameras whose measurements are swapped: the rays meet behind them."""
    _, C, points, _ = strip(np.random.default_rng(5), 2)
    base = (R_ENU_NED @ mount_rotation(0.0, -90.0, 0.0)).T
    p = np.stack([(points - c) @ base.T for c in C])
    xy = p[..., :2] / p[..., 2:]
    both = np.stack([base, base])
    assert triangulate(both, C, xy, np.ones(xy.shape[:2], bool)).is_ahead.all()
    assert not triangulate(both, C, xy[::-1], np.ones(xy.shape[:2], bool)).is_ahead.any()
