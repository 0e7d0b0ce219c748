"""How the ground strays from its plane, and what that leaves known of the plane's slope."""

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.estimation.ground_roughness import effective_sigma_m, plane_and_roughness

Array = NDArray[np.float64]

POINTS = 180
HALF_M = np.array([90.0, 170.0])
CLEARANCE_M = 250.0


def waves(rng: np.random.Generator, xy: Array, sigma_m: float, length_m: float) -> Array:
    """Heights (N,) of a ground of 32 waves of about one length."""
    bearing, phase = rng.uniform(0.0, 2.0 * np.pi, (2, 32))
    wave = 2.0 * np.pi / (length_m * rng.uniform(0.5, 1.5, 32))
    along = xy @ np.stack([np.cos(bearing), np.sin(bearing)]) * wave + phase
    return sigma_m * np.sqrt(2.0 / 32) * np.sin(along).sum(axis=1)


def slopes_nees(length_m: float, sigma_m: float = 10.0, flights: int = 150) -> tuple[float, float]:
    """Mean square of a fitted plane's slopes over what the points, as independent, claim: with and without (5.13)."""
    honest, naive = [], []
    for seed in range(flights):
        rng = np.random.default_rng([seed, 44])
        xy = rng.uniform(-1.0, 1.0, (POINTS, 2)) * HALF_M
        height = waves(rng, xy, sigma_m, length_m)
        across, _ = np.linalg.qr(np.concatenate([np.ones((POINTS, 1)), xy], axis=1))
        square = float(np.mean((across[:, 1:].T @ height) ** 2))
        noise = np.full(POINTS, 0.2**2)
        honest.append(
            square / effective_sigma_m(xy, height + 0.2 * rng.standard_normal(POINTS), noise, CLEARANCE_M) ** 2
        )
        naive.append(square / sigma_m**2)
    return float(np.mean(honest)), float(np.mean(naive))


def test_the_slope_of_a_plane_through_hills_is_as_uncertain_as_claimed() -> None:
    honest, naive = slopes_nees(200.0)
    assert 0.5 < honest < 1.6
    assert naive > 8.0


def test_hills_much_shorter_than_the_window_are_not_undersold() -> None:
    honest, _ = slopes_nees(60.0)
    assert 0.1 < honest < 1.0


@pytest.mark.parametrize("sigma_m", [1.0, 10.0])
def test_points_that_stray_one_by_one_count_as_many_as_they_are(sigma_m: float) -> None:
    claims = []
    for seed in range(40):
        rng = np.random.default_rng([seed, 45])
        xy = rng.uniform(-1.0, 1.0, (POINTS, 2)) * HALF_M
        height = 0.03 * xy[:, 0] + sigma_m * rng.standard_normal(POINTS)
        claims.append(effective_sigma_m(xy, height, np.full(POINTS, 1e-4), CLEARANCE_M) / sigma_m)
    assert 0.9 < np.median(claims) < 1.5


def test_noise_of_the_points_is_no_relief() -> None:
    rng = np.random.default_rng(46)
    xy = rng.uniform(-1.0, 1.0, (POINTS, 2)) * HALF_M
    quiet = effective_sigma_m(xy, 2.0 * rng.standard_normal(POINTS), np.full(POINTS, 4.0), CLEARANCE_M)
    assert 0.0 < quiet < 1.5


def range_per_m(points: Array, centre: Array, down: float) -> float:
    """One over the correlation length of the ground as a camera at `centre` (3,), pitched `down` (rad), finds it."""
    forward, side = np.array([0.0, np.cos(down), -np.sin(down)]), np.array([1.0, 0.0, 0.0])
    p = (points - centre) @ np.stack([side, np.cross(forward, side), forward]).T
    H, w = np.column_stack([np.ones(len(p)), p[:, :2] / p[:, 2:]]), 1.0 / p[:, 2]
    plane, spread, slope = plane_and_roughness(H, w, np.full(len(p), 1e-8))
    return slope / spread**2 * float(np.linalg.norm(plane))


def test_the_same_ground_is_correlated_as_far_whether_seen_straight_down_from_aside_or_from_twice_as_high() -> None:
    """Distances in the picture, which counted before, are others on the ground from row to row. (9.20)"""
    found = []
    for seed in range(20):
        rng = np.random.default_rng([seed, 47])
        xy = rng.uniform(-60.0, 60.0, (90, 2))
        apart = np.linalg.norm(xy[:, None] - xy, axis=2)
        points = np.column_stack([xy, np.linalg.cholesky(4.0 * np.exp(-apart / 15.0)) @ rng.standard_normal(90)])
        centres = np.array([[0.0, 0.0, 120.0], [0.0, -120.0, 120.0], [0.0, 0.0, 240.0]])
        found.append([range_per_m(points, c, np.arctan2(c[2], -c[1])) for c in centres])
    straight, aside, higher = np.median(found, axis=0)
    assert 0.7 / 15.0 < straight < 1.8 / 15.0
    assert aside == pytest.approx(straight, rel=0.15)
    assert higher == pytest.approx(straight, rel=0.15)


def test_too_few_points_claim_nothing() -> None:
    assert effective_sigma_m(np.zeros((5, 2)), np.arange(5.0), np.ones(5), CLEARANCE_M) == 0.0
