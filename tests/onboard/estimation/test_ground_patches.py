"""Slopes of patches along a window's strip: as the ground has them, with noise as claimed, despite wrong tracks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from onboard.estimation.ground_patches import MIN_POINTS, MOST_PATCHES, patch_slopes

Array = NDArray[np.float64]
LENGTH_M, WIDTH_M, COUNT, SIGMA_M = 300.0, 100.0, 240, 0.5
TURN = 0.6  # rad, of the strip from east


def strip(rng: np.random.Generator, count: int = COUNT) -> tuple[Array, Array]:
    """Places (P, 2) in a strip that runs obliquely, and how far along it each is."""
    along, across = rng.uniform(-0.5, 0.5, (2, count)) * np.array([[LENGTH_M], [WIDTH_M]])
    c, s = np.cos(TURN), np.sin(TURN)
    return np.stack([along * c - across * s, along * s + across * c], axis=1), along


def ridges(along: Array) -> Array:
    """Ground of a slope of +0.2, -0.2 and +0.2 along each third of the strip."""
    third = LENGTH_M / 3.0
    return np.asarray(0.2 * np.where(np.abs(along) < third / 2, -along, along - np.sign(along) * third), float)


ALONG = np.array([np.cos(TURN), np.sin(TURN)])


@pytest.mark.parametrize("wrong", [0.0, 0.05])
def test_each_third_of_a_strip_three_times_as_long_as_wide_has_its_slope(wrong: float) -> None:
    """Of the middle third against both ends, along the strip; across it none. Also with wrong tracks."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        places, along = strip(rng)
        height = ridges(along) + SIGMA_M * rng.standard_normal(COUNT)
        height[rng.uniform(size=COUNT) < wrong] += 60.0
        slopes, noise = patch_slopes(np.column_stack([places, height]), np.full(COUNT, SIGMA_M**2))
        assert slopes.shape == (3, 2) and noise.shape == (3, 2, 2)
        by_patch = slopes @ ALONG
        assert sorted(np.argsort(by_patch)[1:]) in ([0, 2],), "the middle third falls where the others rise"
        assert np.ptp(by_patch) == pytest.approx(0.4, abs=0.07)
        assert np.abs(slopes @ [-ALONG[1], ALONG[0]]).max() < 0.05


def test_the_noise_of_patches_is_as_claimed() -> None:
    """Level ground: chi-square of the patches' slopes by their covariances, less what the whole takes of it."""
    chi2 = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        places, _ = strip(rng)
        points = np.column_stack([places, SIGMA_M * rng.standard_normal(COUNT)])
        slopes, noise = patch_slopes(points, np.full(COUNT, SIGMA_M**2))
        chi2 += [float(s @ np.linalg.solve(C, s)) for s, C in zip(slopes, noise, strict=True)]
    assert 1.6 < np.mean(chi2) < 2.6


def test_too_few_points_slope_as_all_do() -> None:
    rng = np.random.default_rng(1)
    for count in (0, 3, MIN_POINTS - 1):
        points = np.column_stack([strip(rng, count)[0], np.zeros(count)])
        slopes, noise = patch_slopes(points, np.ones(count))
        assert np.all(slopes == 0.0) and np.all(noise == 0.0) and len(slopes) == 1


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 80), st.floats(0.0, 1.0), st.sampled_from([0.0, 1e-6, 1.0, 300.0]))
def test_any_points_give_finite_slopes_and_covariances(seed: int, count: int, lost: float, width_m: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((count, 3)) * [300.0, width_m, 5.0]
    points[rng.uniform(size=count) < lost] = np.nan
    slopes, noise = patch_slopes(points, rng.uniform(0.0, 2.0, count))
    assert 1 <= len(slopes) == len(noise) <= MOST_PATCHES
    assert np.all(np.isfinite(slopes)) and np.all(np.isfinite(noise))
    assert np.all(np.linalg.eigvalsh(noise) >= -1e-9 * np.abs(noise).max(axis=(1, 2))[:, None])
