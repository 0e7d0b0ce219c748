"""A covariance matrix in few bytes that stays one: logarithmic sigmas and canonical partial correlations.

The correlation matrix is written through its Cholesky factor L, row by row, as the partial correlations
p_ij = L_ij / sqrt(1 - sum_k<j L_ik^2), each free in (-1, 1) (Joe 2006, "Generating random correlation matrices based on
partial correlations"). Any values give a valid correlation matrix, so rounding cannot make the covariance indefinite,
and rounding atanh(p) keeps the conditional variances to a fixed relative accuracy however strong a correlation is.
"""

from __future__ import annotations

import math
from functools import cache
from operator import mul

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SIGMA_UNIT = 0.0006  # natural logarithm per step of a sigma code: 0.03 % of rounding, 0.06 % of a variance
SIGMA_FLOOR = 1e-12
MAX_SIGMA_CODE = 65535
MAX_SIGMA = SIGMA_FLOOR * math.exp(SIGMA_UNIT * (MAX_SIGMA_CODE - 1))

CORRELATION_STEP = 0.05  # of atanh(p): 2.5 % of rounding in what is left of a sigma given the states before it
MAX_CORRELATION_CODE = 127
# The smallest share of its variance a state may keep given the states before it. Below it the Cholesky factor of a
# decoded matrix could not be recovered exactly, and encoding twice would not give the same bytes.
MIN_CONDITIONAL = 1e-6


def sigma_code(sigma: float, name: str = "sigma") -> int:
    """A sigma >= 0 -> 0..65535; 0 stands for exactly 0. Raises ValueError for what has no code."""
    if not 0.0 <= sigma <= MAX_SIGMA:
        raise ValueError(f"{name} must be between 0 and {MAX_SIGMA:.3g}, not {sigma!r}")
    if sigma < SIGMA_FLOOR:
        return 0
    return 1 + round(math.log(sigma / SIGMA_FLOOR) / SIGMA_UNIT)


def sigma_from_code(code: int) -> float:
    """Inverse of `sigma_code`."""
    return SIGMA_FLOOR * math.exp(SIGMA_UNIT * (code - 1)) if code else 0.0


# Of the codes -127 to 127: partial correlation p, and 1 - p^2. Scalars' tanh, so that every machine has the same.
_TANH = [math.tanh(CORRELATION_STEP * code) for code in range(-MAX_CORRELATION_CODE, MAX_CORRELATION_CODE + 1)]
_LEFT = [1.0 - p * p for p in _TANH]
_PARTIAL, _KEPT = np.array(_TANH), np.array(_LEFT)


@cache
def _lower(n: int) -> NDArray[np.intp]:
    """Where rows of the lower triangle without its diagonal lie in a flattened (n, n) matrix."""
    return np.ravel_multi_index(np.tril_indices(n, -1), (n, n))


@cache
def _diagonal(n: int) -> NDArray[np.intp]:
    """Likewise its diagonal."""
    return np.arange(n) * (n + 1)


def covariance_codes(covariance: Array) -> tuple[list[int], Ints, Array]:
    """Covariance (n, n) -> n sigma codes, n (n - 1) / 2 signed correlation codes (rows of the lower triangle).

    And what `factor_from_codes` makes of them. Raises ValueError if the matrix is not a covariance.
    """
    n = len(covariance)
    if covariance.shape != (n, n) or not np.isfinite(covariance).all():
        raise ValueError("the covariance must be a square matrix of finite numbers")
    variances = covariance.diagonal()
    if (least := variances.min(initial=0.0)) < 0.0:
        raise ValueError(f"the covariance has a negative variance: {least!r}")
    sigmas = np.sqrt(variances).tolist()
    sigma_codes = [sigma_code(s, "a sigma of the covariance") for s in sigmas]
    scale = np.array([1.0 / s if code else 0.0 for s, code in zip(sigmas, sigma_codes, strict=True)])
    correlation = 0.5 * (covariance + covariance.T) * (scale[:, None] * scale)
    correlation.put(_diagonal(n), 1.0)
    codes = _codes_of_definite(correlation)
    factor = None if codes is None else factor_from_codes(sigma_codes, codes)
    if codes is None or factor is None:
        if (smallest := float(np.linalg.eigvalsh(correlation)[0])) < -1e-6:
            raise ValueError(f"this is not a covariance: its correlations have the eigenvalue {smallest:.3g}")
        codes = _codes_within_limits(correlation)
        factor = factor_from_codes(sigma_codes, codes)
        assert factor is not None
    return sigma_codes, codes, factor


def _codes_of_definite(correlation: Array) -> Ints | None:
    """Codes by LAPACK's Cholesky factor; None where a state keeps so little that entries must be held at limits."""
    n = len(correlation)
    try:
        L = np.linalg.cholesky(correlation)
    except np.linalg.LinAlgError:
        return None
    if n == 0 or L.diagonal().min() ** 2 <= MIN_CONDITIONAL:
        return None
    rest = np.empty((n, n))  # of the variance of each row's state, before each column
    rest[:, 0] = 1.0
    np.multiply(L[:, :-1], L[:, :-1], out=rest[:, 1:])
    np.subtract.accumulate(rest, axis=1, out=rest)
    at = _lower(n)
    p = L.take(at) / np.sqrt(rest.take(at))
    codes = np.rint(np.arctanh(p) / CORRELATION_STEP)
    out: Ints = np.minimum(np.maximum(codes, -MAX_CORRELATION_CODE), MAX_CORRELATION_CODE).astype(np.int64)
    return out


def _codes_within_limits(correlation: Array) -> Ints:
    """Codes of any correlation matrix, each lowered as far as `MIN_CONDITIONAL` asks."""
    target = correlation.tolist()
    L: list[list[float]] = []
    codes: list[int] = []
    for i in range(len(target)):
        row: list[float] = []
        rest, kept = 1.0, 1.0  # of row i: what L leaves of the variance, and what the codes leave of it
        for j in range(i):
            value = (target[i][j] - sum(map(mul, row, L[j]))) / L[j][j]
            p = value / math.sqrt(rest)
            code = MAX_CORRELATION_CODE
            if abs(p) < 1.0:
                code = min(round(math.atanh(abs(p)) / CORRELATION_STEP), MAX_CORRELATION_CODE)
            while kept * _LEFT[MAX_CORRELATION_CODE + code] < MIN_CONDITIONAL:
                code -= 1
            kept *= _LEFT[MAX_CORRELATION_CODE + code]
            codes.append(code if p >= 0.0 else -code)
            # A correlation beyond what can be written is held at the limit, so that later entries stay finite.
            limit = math.sqrt(max(rest - MIN_CONDITIONAL, 0.0))
            row.append(min(max(value, -limit), limit))
            rest = max(rest - row[j] ** 2, MIN_CONDITIONAL)
        L.append([*row, math.sqrt(rest)])
    return np.array(codes, np.int64)


def factor_from_codes(sigma_codes: list[int], correlation_codes: Ints) -> Array | None:
    """L (n, n), lower triangular, of the covariance L L' that `covariance_codes` wrote.

    None if the codes break `MIN_CONDITIONAL` and so were not written by it.
    """
    n = len(sigma_codes)
    code = correlation_codes + MAX_CORRELATION_CODE
    below = _lower(n)
    # Of each state's variance, what is kept before each column: entry (i, j) is a product over the columns before j.
    kept = np.ones(n * n + 1)
    kept[1:].put(below, _KEPT.take(code))
    shares = kept[:-1].reshape(n, n)
    np.multiply.accumulate(shares, axis=1, out=shares)
    if shares.diagonal().min(initial=1.0) < MIN_CONDITIONAL:
        return None
    L = np.zeros((n, n))
    L.put(below, _PARTIAL.take(code))
    L.put(_diagonal(n), 1.0)
    L *= np.sqrt(shares)
    L *= np.array([sigma_from_code(code) for code in sigma_codes])[:, None]
    return L
