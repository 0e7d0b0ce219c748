"""A covariance's codes are those of its Cholesky factor, and have their limits where there is none."""

import numpy as np
import pytest

from contract.wire import covariance_code as code
from tests.contract.sets import random_covariance


def correlation(rank: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    covariance = random_covariance(rng, rank, np.ones(9))
    np.fill_diagonal(covariance, 1.0)
    return covariance


def correlation_of(factor: code.Rows) -> np.ndarray:
    covariance = np.array(factor) @ np.transpose(factor)
    sigmas = np.sqrt(np.diag(covariance))
    return covariance / np.outer(sigmas, sigmas)


@pytest.mark.parametrize("rank", [10, 14, 40])
def test_codes_are_the_partial_correlations_of_the_cholesky_factor(rank: int) -> None:
    seen = 0
    for seed in range(100):
        matrix = correlation(rank, seed)
        L = np.linalg.cholesky(matrix)
        if L.diagonal().min() ** 2 < 1e-4:
            continue  # codes may be held at their limits
        before = np.cumsum(L * L, axis=1) - L * L
        partial = (L / np.sqrt(1.0 - np.minimum(before, 1.0 - 1e-12)))[np.tril_indices(9, -1)]
        _, codes, factor = code.covariance_codes(matrix)
        np.testing.assert_array_equal(codes, np.rint(np.arctanh(partial) / 0.05))
        np.testing.assert_allclose(np.array(code.inverse_of_factor(factor)) @ factor, np.eye(9), atol=1e-9)
        seen += 1
    assert seen > 50


@pytest.mark.parametrize("rank", [1, 4, 8])
def test_a_singular_matrix_has_codes_within_their_limits(rank: int) -> None:
    for seed in range(20):
        matrix = correlation(rank, seed)
        sigmas, codes, factor = code.covariance_codes(matrix)
        assert code.factor_from_codes(sigmas, codes) == factor
        assert np.abs(np.array(factor) @ np.transpose(factor) - matrix).max() < 0.1


def test_codes_that_keep_too_little_of_a_state_have_no_factor() -> None:
    codes = [127, 127] + [0] * 34
    assert code.factor_from_codes([5000] * 9, codes) is not None
    codes[2] = 127  # twice in one row
    assert code.factor_from_codes([5000] * 9, codes) is None


def test_the_units_of_the_states_change_their_sigmas_codes_alone() -> None:
    """And what is read is the covariance to its rounding: 0.03 % of each sigma, 0.025 of atanh of each correlation."""
    sigmas = 10.0 ** np.linspace(-4.0, 3.0, 9)
    for seed in range(20):
        matrix = correlation(40, seed)
        _, of_ones, unit = code.covariance_codes(matrix)
        _, codes, factor = code.covariance_codes(matrix * np.outer(sigmas, sigmas))
        assert codes == of_ones
        read = np.array(factor) @ np.transpose(factor)
        np.testing.assert_allclose(np.sqrt(np.diag(read)), sigmas, rtol=1.01 * code.SIGMA_UNIT / 2.0)
        np.testing.assert_allclose(correlation_of(factor), correlation_of(unit), atol=1e-12)
        assert 1e-4 < np.abs(correlation_of(factor) - matrix).max() < 0.1
        np.testing.assert_allclose(np.array(code.inverse_of_factor(factor)) @ factor, np.eye(9), atol=1e-9)


def test_a_covariance_whose_halves_differ_is_read_as_their_mean() -> None:
    above, below = np.eye(2), np.eye(2)
    above[0, 1], below[1, 0] = 0.9, 0.9
    _, codes, _ = code.covariance_codes(above)
    assert codes == code.covariance_codes(below)[1] == [round(np.arctanh(0.45) / 0.05)]
