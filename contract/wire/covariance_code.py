"""A covariance matrix in few bytes that stays one: logarithmic sigmas and canonical partial correlations.

The correlation matrix is written through its Cholesky factor L, row by row, as the partial correlations
p_ij = L_ij / sqrt(1 - sum_k<j L_ik^2), each free in (-1, 1) (Joe 2006, "Generating random correlation matrices based on
partial correlations"). Any values give a valid correlation matrix, so rounding cannot make the covariance indefinite,
and rounding atanh(p) keeps the conditional variances to a fixed relative accuracy however strong a correlation is.
"""

from __future__ import annotations

import math
from itertools import islice
from operator import mul

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = list[list[float]]

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
    """A sigma >= 0 -> 0..65535; 0 means exactly 0. Raises ValueError for what has no code."""
    if not 0.0 <= sigma <= MAX_SIGMA:
        raise ValueError(f"{name} must be between 0 and {MAX_SIGMA:.3g}, not {sigma!r}")
    if sigma < SIGMA_FLOOR:
        return 0
    return 1 + round(math.log(sigma / SIGMA_FLOOR) / SIGMA_UNIT)


def sigma_from_code(code: int) -> float:
    """Inverse of `sigma_code`."""
    return SIGMA_FLOOR * math.exp(SIGMA_UNIT * (code - 1)) if code else 0.0


# Of the codes 0 to 127 and -127 to -1, so that a code is its own index: partial correlation p, and 1 - p^2. Scalars'
# tanh, so that every machine has the same.
_CODES = [*range(MAX_CORRELATION_CODE + 1), *range(-MAX_CORRELATION_CODE, 0)]
_PARTIAL = [math.tanh(CORRELATION_STEP * code) for code in _CODES]
_LEFT = [1.0 - p * p for p in _PARTIAL]


def covariance_codes(covariance: Array) -> tuple[list[int], list[int], Rows]:
    """Covariance (n, n) -> n sigma codes, n (n - 1) / 2 signed correlation codes (rows of the lower triangle).

    And what `factor_from_codes` makes of them. Raises ValueError if the matrix is not a covariance. In plain numbers:
    for nine states that takes half the time of LAPACK, whose calls alone cost more than the sums.
    """
    rows = covariance.tolist()
    n = len(rows)
    if covariance.shape != (n, n) or not math.isfinite(sum(map(sum, rows))):
        raise ValueError("the covariance must be a square matrix of finite numbers")
    variances = [rows[i][i] for i in range(n)]
    if (least := min(variances, default=0.0)) < 0.0:
        raise ValueError(f"the covariance has a negative variance: {least!r}")
    sigmas = [math.sqrt(v) for v in variances]
    sigma_codes = [sigma_code(s, "a sigma of the covariance") for s in sigmas]
    scale = [1.0 / s if code else 0.0 for s, code in zip(sigmas, sigma_codes, strict=True)]
    correlation = [
        [0.5 * (row[j] + rows[j][i]) * (scale[i] * scale[j]) for j in range(i)] for i, row in enumerate(rows)
    ]
    codes, is_at_limit = _codes_within_limits(correlation)
    if is_at_limit:
        full = np.eye(n)
        for i, row in enumerate(correlation):
            full[i, :i] = row
        if (smallest := float(np.linalg.eigvalsh(full)[0])) < -1e-6:
            raise ValueError(f"this is not a covariance: its correlations have the eigenvalue {smallest:.3g}")
    factor = factor_from_codes(sigma_codes, codes)
    assert factor is not None
    return sigma_codes, codes, factor


def _codes_within_limits(correlation: Rows) -> tuple[list[int], bool]:
    """Codes of any correlation matrix, rows below its diagonal, each lowered as far as `MIN_CONDITIONAL` requires.

    And whether an entry had to be held at that limit, as it never is in a matrix well within the positive ones.
    """
    L: Rows = []
    codes: list[int] = []
    is_at_limit = False
    for i, target in enumerate(correlation):
        row: list[float] = []
        rest, kept = 1.0, 1.0  # of row i: what L leaves of the variance, and what the codes leave of it
        for j in range(i):
            other = L[j]
            value = (target[j] - sum(map(mul, row, other))) / other[j]
            p = value / math.sqrt(rest)
            code = MAX_CORRELATION_CODE
            if -1.0 < p < 1.0:
                code = min(round(math.atanh(abs(p)) / CORRELATION_STEP), MAX_CORRELATION_CODE)
            while kept * _LEFT[code] < MIN_CONDITIONAL:
                code -= 1
            kept *= _LEFT[code]
            codes.append(code if p >= 0.0 else -code)
            square = value * value
            if rest - square < MIN_CONDITIONAL:
                # A correlation beyond what can be written is held at the limit, so that later entries stay finite.
                is_at_limit = True
                limit = math.sqrt(max(rest - MIN_CONDITIONAL, 0.0))
                value = min(max(value, -limit), limit)
                square = value * value
            row.append(value)
            rest = max(rest - square, MIN_CONDITIONAL)
        L.append([*row, math.sqrt(rest)])
    return codes, is_at_limit


def factor_from_codes(sigma_codes: list[int], correlation_codes: list[int]) -> Rows | None:
    """L, the rows of a lower triangular (n, n), of the covariance L L' that `covariance_codes` wrote.

    None if the codes break `MIN_CONDITIONAL` and so were not written by it.
    """
    n = len(sigma_codes)
    rows: Rows = []
    codes = iter(correlation_codes)
    for i, sigma_code_ in enumerate(sigma_codes):
        sigma = sigma_from_code(sigma_code_)
        kept = 1.0  # of the state's variance, before each column
        row = []
        for code in islice(codes, i):
            row.append(_PARTIAL[code] * math.sqrt(kept) * sigma)
            kept *= _LEFT[code]
        if kept < MIN_CONDITIONAL:
            return None
        rows.append([*row, math.sqrt(kept) * sigma] + [0.0] * (n - 1 - i))
    return rows


def inverse_of_factor(rows: Rows) -> Rows:
    """The inverse of a lower triangular matrix (n, n) with no zero on its diagonal: its rows."""
    n = len(rows)
    columns: Rows = []  # of the inverse, from the diagonal down
    for j in range(n):
        column = [1.0 / rows[j][j]]
        for i in range(j + 1, n):
            row = rows[i]
            column.append(-sum(map(mul, row[j:i], column)) / row[i])
        columns.append(column)
    return [[columns[j][i - j] if j <= i else 0.0 for j in range(n)] for i in range(n)]
