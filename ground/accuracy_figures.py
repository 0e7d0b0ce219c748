"""Differences between answers and surveyed marks -> the figures that surveyors and soldiers use.

ASPRS Positional Accuracy Standards for Digital Geospatial Data, Edition 2 (2023): RMSE_H, RMSE_V, with the survey's own
error added. NSSDA (FGDC-STD-007.3-1998): 95 % figures from the RMSE. Clopper and Pearson 1934 for the coverage.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NSSDA_RADIAL = 2.4477  # 95 % of a circular normal error, in its RMSE along one axis
NSSDA_HEIGHT = 1.9600
ASPRS_LEAST_MARKS = 30
LEAST_MARKS = 10  # with fewer the interval is useless: 90 % of 9 is not different enough from 70 %
STATED = 0.9


@dataclass(frozen=True)
class Figures:
    """Accuracy over N marks, metres. Heights: None where none is known. `coverage`: the share inside the ellipse."""

    marks: int
    rmse_east_m: float
    rmse_north_m: float
    rmse_radial_m: float
    rmse_height_m: float | None
    bias_east_m: float
    bias_north_m: float
    bias_height_m: float | None
    bias_significant: bool  # longer than chance makes it, once in a hundred
    cep_m: float
    ce90_m: float
    le90_m: float | None
    asprs_rmse_h_m: float  # with the survey's own error
    nssda_radial_95_m: float
    nssda_height_95_m: float | None
    coverage: float
    coverage_low: float  # its 95 % interval
    coverage_high: float
    verdict: str


def figures(error_en_m: Array, error_up_m: Array, inside: list[bool], survey_sigma_m: Array) -> Figures:
    """Summarise answers minus truth: (N, 2), heights (M,) where known, inside the ellipse or not, survey sigma (N,)."""
    n = len(error_en_m)
    east, north = (float(v) for v in np.sqrt(np.mean(error_en_m**2, axis=0)))
    radial = np.linalg.norm(error_en_m, axis=1)
    bias = error_en_m.mean(axis=0)
    up = error_up_m if len(error_up_m) else None
    rmse_up = None if up is None else float(np.sqrt(np.mean(up**2)))
    held = sum(inside)
    low, high = coverage_interval(held, n)
    survey = float(np.sqrt(np.mean(2.0 * survey_sigma_m**2)))
    rmse_h = math.hypot(east, north)
    return Figures(
        marks=n, rmse_east_m=east, rmse_north_m=north, rmse_radial_m=rmse_h, rmse_height_m=rmse_up,
        bias_east_m=float(bias[0]), bias_north_m=float(bias[1]), bias_height_m=None if up is None else float(up.mean()),
        bias_significant=_is_significant(error_en_m), cep_m=float(np.quantile(radial, 0.5)),
        ce90_m=float(np.quantile(radial, 0.9)), le90_m=None if up is None else float(np.quantile(np.abs(up), 0.9)),
        asprs_rmse_h_m=math.hypot(rmse_h, survey), nssda_radial_95_m=NSSDA_RADIAL * 0.5 * (east + north),
        nssda_height_95_m=None if rmse_up is None else NSSDA_HEIGHT * rmse_up, coverage=held / n, coverage_low=low,
        coverage_high=high, verdict=_verdict(held, n, low, high),
    )  # fmt: skip


def coverage_interval(held: int, of: int, confidence: float = 0.95) -> tuple[float, float]:
    """The interval of shares that do not make the count `held` of `of` unlikely. Clopper and Pearson."""
    half = 0.5 * (1.0 - confidence)
    low = 0.0 if held == 0 else _share(lambda p: 1.0 - _at_most(held - 1, of, p) >= half)
    high = 1.0 if held == of else _share(lambda p: _at_most(held, of, p) < half)
    return low, high


def _share(is_reached: object) -> float:
    """Bisect for the share in 0 to 1 from which on a condition holds."""
    assert callable(is_reached)
    low, high = 0.0, 1.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if is_reached(middle) else (middle, high)
    return 0.5 * (low + high)


def _at_most(held: int, of: int, p: float) -> float:
    """Probability of at most so many; by logarithms, so that thousands do not overflow."""
    if p <= 0.0:
        return 1.0
    if p >= 1.0:
        return 1.0 if held >= of else 0.0
    logs = [
        math.lgamma(of + 1) - math.lgamma(k + 1) - math.lgamma(of - k + 1) + k * math.log(p) + (of - k) * math.log1p(-p)
        for k in range(held + 1)
    ]
    return min(math.fsum(math.exp(value) for value in logs), 1.0)


def _is_significant(error_en_m: Array) -> bool:
    """Hotelling's T^2 of the mean, against its limit for large N (chi-square of two, 1 %), widened for few."""
    n = len(error_en_m)
    if n < 5:
        return False
    mean, V = error_en_m.mean(axis=0), np.cov(error_en_m.T) / n
    if not np.linalg.det(V) > 0.0:
        return False
    t2 = float(mean @ np.linalg.solve(V, mean))
    # F with 2 and n - 2 degrees has the closed upper quantile ((1/p)^(2/(n-2)) - 1) (n - 2) / 2.
    limit = (n - 1) * (0.01 ** (-2.0 / (n - 2)) - 1.0)
    return bool(t2 > limit)


def _verdict(held: int, n: int, low: float, high: float) -> str:
    holds = f"{held} of {n} marks lie inside their stated 90 % ellipse"
    if n < LEAST_MARKS:
        return f"too few marks to judge ({holds}); click {LEAST_MARKS} or more"
    if high < STATED:
        return f"the stated ellipses are too small: {holds}"
    if low > STATED:
        return f"the stated ellipses hold, and are wider than they need be: {holds}"
    return f"the stated ellipses hold what they state: {holds}"
