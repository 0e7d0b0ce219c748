"""Reweighting: what lies far off counts little, what is known beforehand counts as much as it is said to."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.geometry.robust import cauchy_weight, irls, middle, robust_cost

Array = NDArray[np.float64]


def mean_of(values: Array, seen: list[Array]):
    def fit(weight: Array) -> tuple[float, Array]:
        seen.append(weight)
        mean = float(weight @ values / weight.sum())
        return mean, values - mean

    return fit


def in_spreads(residual: Array) -> Array:
    return (residual / max(1.4826 * middle(np.abs(residual)), 1e-12)) ** 2


def test_a_fifth_of_wrong_values_moves_a_mean_by_less_than_its_own_noise() -> None:
    rng = np.random.default_rng(0)
    values = 5.0 + 0.1 * rng.standard_normal(200)
    values[:40] += 30.0
    mean, residual = irls(mean_of(values, []), np.ones(200), in_spreads)
    assert abs(mean - 5.0) < 0.05 < abs(values.mean() - 5.0)
    np.testing.assert_allclose(residual, values - mean)


def test_it_is_reweighted_by_the_residuals_so_far_times_the_weight_given() -> None:
    values, weight, seen = np.array([0.0, 1.0, 2.0, 50.0]), np.array([1.0, 2.0, 1.0, 0.5]), list[Array]()
    mean, residual = irls(mean_of(values, seen), weight, in_spreads, rounds=3)
    assert len(seen) == 3
    np.testing.assert_array_equal(seen[0], weight)
    for before, after in pairwise(seen):
        off = values - before @ values / before.sum()
        np.testing.assert_allclose(after, weight / (1.0 + in_spreads(off)), rtol=1e-12)
    assert mean == pytest.approx(seen[-1] @ values / seen[-1].sum())
    assert residual[3] > 40.0


def test_one_round_is_plain_least_squares() -> None:
    values = np.array([0.0, 1.0, 50.0])
    assert irls(mean_of(values, []), np.ones(3), in_spreads, rounds=1)[0] == pytest.approx(17.0)


def test_the_weight_is_the_slope_of_the_cauchy_loss() -> None:
    residual = np.linspace(-4.0, 4.0, 41)
    np.testing.assert_allclose(cauchy_weight(residual, 1.7), robust_cost(residual**2, 1.7)[1], rtol=1e-12)
    step = 1e-6
    slope = (robust_cost(residual**2 + step, 1.7)[0] - robust_cost(residual**2 - step, 1.7)[0]) / (2.0 * step)
    keep = residual != 0.0
    np.testing.assert_allclose(cauchy_weight(residual, 1.7)[keep], slope[keep], rtol=1e-6)
