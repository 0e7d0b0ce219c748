"""The chi-square distribution with a whole number of degrees of freedom, without SciPy."""

from __future__ import annotations

import math


def exceeded_with(chi2: float, freedom: int) -> float:
    """Probability that chi-square of so many degrees of freedom (1 or more) is above `chi2`.

    Abramowitz and Stegun 26.4.4 and 26.4.5: a finite sum, after erfc where the number is odd.
    """
    half = 0.5 * max(chi2, 0.0)
    if half > 700.0:
        return 0.0
    odd = freedom % 2
    total = math.erfc(math.sqrt(half)) if odd else 0.0
    term = math.exp(-half) * (math.sqrt(half) / math.gamma(1.5) if odd else 1.0)
    for k in range(freedom // 2):
        total += term
        term *= half / (k + (1.5 if odd else 1.0))
    return min(total, 1.0)


def limit(probability: float, freedom: int) -> float:
    """The value that chi-square exceeds with this probability (above 1e-12)."""
    low, high = 0.0, freedom + 20.0 * math.sqrt(2.0 * freedom) + 60.0
    while high - low > 1e-9 * high:
        middle = 0.5 * (low + high)
        if exceeded_with(middle, freedom) > probability:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
