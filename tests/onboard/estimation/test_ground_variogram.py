"""The variance of the slope across a track, from the heights along it: for ground of any kind, despite wrong tracks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from benchmarks.sampled_flight import Ground, HillCountry
from onboard.estimation.ground_variogram import MIN_POINTS, slope_variance
from tests.rest_long import rest_long

Array = NDArray[np.float64]
COUNT, NOISE_M = 200, 0.4
ALONG = np.array([0.6, 0.8])
TO_TRACK = np.array([[0.6, -0.8], [0.8, 0.6]])


def strip(rng: np.random.Generator, ground: Ground, length_m: float, width_m: float) -> tuple[Array, float]:
    """Points (P, 3) of a strip somewhere, which slopes by nothing across its track as solved, and by what it does."""
    places = rng.uniform(-0.5, 0.5, (COUNT, 2)) * [length_m, width_m]
    height = ground.height_m(places @ TO_TRACK.T + rng.uniform(-1000.0, 1000.0, 2))
    across = np.linalg.lstsq(np.column_stack([np.ones(COUNT), places]), height, rcond=None)[0][2]
    solved = height - across * places[:, 1] + NOISE_M * rng.standard_normal(COUNT)
    return np.column_stack([places @ TO_TRACK.T, solved]), float(across)


@pytest.mark.parametrize("wrong", rest_long([0.05, 0.0]))
@pytest.mark.parametrize(("length_m", "width_m"), rest_long([(170.0, 110.0), (300.0, 170.0), (100.0, 100.0)], kept=2))
@pytest.mark.parametrize(
    ("kind", "sigma_m", "wavelength_m"),
    [(Ground, 6.0, 200.0), (Ground, 3.0, 400.0), (Ground, 20.0, 150.0), (HillCountry, 0.0, 200.0)],
)
def test_slopes_across_vary_as_the_heights_along_have_it(
    kind: type[Ground], sigma_m: float, wavelength_m: float, length_m: float, width_m: float, wrong: float
) -> None:
    """In the mean over many strips: waves shorter and longer than the strip, and hills of all lengths."""
    true, estimated = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        points, across = strip(rng, kind(rng, np.zeros(2), sigma_m, wavelength_m), length_m, width_m)
        points[rng.uniform(size=COUNT) < wrong, 2] += 60.0
        true.append(across**2)
        estimated.append(slope_variance(points, np.full(COUNT, NOISE_M**2), ALONG))
    assert 0.6 < np.sqrt(np.mean(estimated) / np.mean(true)) < 1.5
    assert np.std(estimated) < 1.7 * np.mean(estimated), "far less than the two squares it counts for"


def test_level_ground_has_no_slopes_but_noise() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        points, _ = strip(rng, Ground(rng, np.zeros(2), 0.0, 200.0), 200.0, 100.0)
        assert slope_variance(points, np.full(COUNT, NOISE_M**2), ALONG) < 0.002**2


def test_a_slope_along_the_track_counts_and_one_across_does_not() -> None:
    rng = np.random.default_rng(1)
    places = rng.uniform(-0.5, 0.5, (COUNT, 2)) * [300.0, 100.0]
    for along, across, low, high in ((0.2, 0.0, 0.15, 0.25), (0.0, 0.2, 0.0, 0.08)):
        points = np.column_stack([places @ TO_TRACK.T, places @ [along, across]])
        assert low <= np.sqrt(slope_variance(points, np.zeros(COUNT), ALONG)) <= high


def test_too_few_points_show_nothing() -> None:
    rng = np.random.default_rng(1)
    for count in (0, 3, MIN_POINTS - 1):
        assert slope_variance(rng.standard_normal((count, 3)), np.ones(count), ALONG) == 0.0


@given(st.integers(0, 2**32 - 1), st.integers(0, 80), st.floats(0.0, 1.0), st.sampled_from([0.0, 1e-6, 1.0, 300.0]))
def test_any_points_give_a_finite_variance(seed: int, count: int, lost: float, width_m: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((count, 3)) * [300.0, width_m, 5.0]
    points[rng.uniform(size=count) < lost] = np.nan
    for along in (ALONG, np.zeros(2)):
        variance = slope_variance(points, rng.uniform(0.0, 2.0, count), along)
        assert np.isfinite(variance) and variance >= 0.0
