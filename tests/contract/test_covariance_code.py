"""A covariance's codes are those of its Cholesky factor, and have their limits where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from contract.wire import covariance_code as code
from tests.contract.sets import random_covariance


def correlation(rank: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    covariance = random_covariance(rng, rank, np.ones(9))
    np.fill_diagonal(covariance, 1.0)
    return covariance


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
