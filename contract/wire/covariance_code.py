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


@cache
def _partial(code: int) -> tuple[float, float]:
    """Partial correlation p and 1 - p^2 of a code."""
    t = math.tanh(CORRELATION_STEP * code)
    return t, 1.0 - t * t


def covariance_codes(covariance: Array) -> tuple[list[int], list[int]]:
    """Covariance (n, n) -> n sigma codes, n (n - 1) / 2 signed correlation codes (rows of the lower triangle).

    Raises ValueError if the matrix is not a covariance.
    """
    n = len(covariance)
    if covariance.shape != (n, n) or not np.all(np.isfinite(covariance)):
        raise ValueError("the covariance must be a square matrix of finite numbers")
    variances = np.diag(covariance)
    if np.any(variances < 0.0):
        raise ValueError(f"the covariance has a negative variance: {variances.min()!r}")
    sigmas = np.sqrt(variances)
    sigma_codes = [sigma_code(float(s), "a sigma of the covariance") for s in sigmas]
    scale = np.where([code > 0 for code in sigma_codes], 1.0 / np.where(sigmas > 0.0, sigmas, 1.0), 0.0)
    correlation = 0.5 * (covariance + covariance.T) * np.outer(scale, scale)
    np.fill_diagonal(correlation, 1.0)
    if (smallest := float(np.linalg.eigvalsh(correlation)[0])) < -1e-6:
        raise ValueError(f"this is not a covariance: its correlations have the eigenvalue {smallest:.3g}")

    target = correlation.tolist()
    L: list[list[float]] = []
    codes: list[int] = []
    for i in range(n):
        row: list[float] = []
        rest, kept = 1.0, 1.0  # of row i: what L leaves of the variance, and what the codes leave of it
        for j in range(i):
            value = (target[i][j] - sum(map(mul, row, L[j]))) / L[j][j]
            p = value / math.sqrt(rest)
            code = MAX_CORRELATION_CODE
            if abs(p) < 1.0:
                code = min(round(math.atanh(abs(p)) / CORRELATION_STEP), MAX_CORRELATION_CODE)
            while kept * _partial(code)[1] < MIN_CONDITIONAL:
                code -= 1
            kept *= _partial(code)[1]
            codes.append(code if p >= 0.0 else -code)
            # A correlation beyond what can be written is held at the limit, so that later entries stay finite.
            limit = math.sqrt(max(rest - MIN_CONDITIONAL, 0.0))
            row.append(min(max(value, -limit), limit))
            rest = max(rest - row[j] ** 2, MIN_CONDITIONAL)
        L.append([*row, math.sqrt(rest)])
    return sigma_codes, codes


def factor_from_codes(sigma_codes: list[int], correlation_codes: list[int]) -> Array | None:
    """L (n, n), lower triangular, of the covariance L L' that `covariance_codes` wrote.

    None if the codes break `MIN_CONDITIONAL` and so were not written by it.
    """
    n = len(sigma_codes)
    L = np.zeros((n, n))
    position = 0
    for i in range(n):
        kept = 1.0
        for j in range(i):
            p, left = _partial(correlation_codes[position])
            L[i, j] = p * math.sqrt(kept)
            kept *= left
            position += 1
        if kept < MIN_CONDITIONAL:
            return None
        L[i, i] = math.sqrt(kept)
    L *= np.array([sigma_from_code(code) for code in sigma_codes])[:, None]
    return L
