"""A covariance's codes are the same by LAPACK as entry by entry, and where LAPACK finds no factor."""

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
def test_codes_by_lapack_are_those_entry_by_entry(rank: int) -> None:
    """Where no entry had to be held at a limit: elsewhere the factor of the codes says so, or there is none."""
    quick, refused = 0, 0
    for seed in range(200):
        matrix = correlation(rank, seed)
        slow = code._codes_within_limits(matrix)
        codes = code._codes_of_definite(matrix)
        if codes is None or code.factor_from_codes([10000] * 9, codes) is None:
            refused += 1
            continue
        np.testing.assert_array_equal(codes, slow)
        quick += 1
    assert quick > 150


@pytest.mark.parametrize("rank", [1, 4, 8])
def test_a_singular_matrix_has_codes_within_their_limits(rank: int) -> None:
    for seed in range(20):
        matrix = correlation(rank, seed)
        sigmas, codes, factor = code.covariance_codes(matrix)
        np.testing.assert_array_equal(codes, code._codes_within_limits(matrix))
        again = code.factor_from_codes(sigmas, codes)
        assert again is not None
        np.testing.assert_array_equal(again, factor)
        assert np.abs(factor @ factor.T - matrix).max() < 0.1


def test_codes_that_keep_too_little_of_a_state_have_no_factor() -> None:
    codes = np.zeros(36, np.int64)
    codes[[0, 1]] = 127
    assert code.factor_from_codes([5000] * 9, codes) is not None
    codes[2] = 127  # twice in one row
    assert code.factor_from_codes([5000] * 9, codes) is None
