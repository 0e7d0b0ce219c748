"""The correlation of the slow errors of two windows, by when their pictures were taken. Equation (9.13).

Ground and aircraft both compare the results of two windows of a flight, and must agree on what these have in common.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import ALIGNMENT, ATTITUDE, NUISANCES, POSITION, SharedErrors

Array = NDArray[np.float64]
Span = tuple[float, float]  # first and last moment, s, of any one clock

LEAST_SPAN_S = 0.05


def slow_error_correlations(one: SharedErrors, one_span: Span, two: SharedErrors, two_span: Span) -> Array:
    """(NUISANCES,) between the nuisance parameters of two windows. (9.13)

    Gauss-Markov errors by their age, the mount and the clock by how far their estimates have come.
    """
    out = np.ones(NUISANCES)
    for part, tau1, tau2 in (
        (POSITION, one.position_time_s, two.position_time_s),
        (ATTITUDE, one.attitude_time_s, two.attitude_time_s),
    ):
        out[part] = averages_correlation(one_span, two_span, min(tau1, tau2))
    less = np.minimum(one.alignment_sigma, two.alignment_sigma)
    more = np.maximum(one.alignment_sigma, two.alignment_sigma)
    out[ALIGNMENT] = np.where(more > 0.0, less / np.where(more > 0.0, more, 1.0), 0.0)
    return out


def averages_correlation(a: Span, b: Span, time_constant_s: float) -> float:
    """Correlation of a Gauss-Markov error's averages over two spans."""
    if time_constant_s <= 0.0:
        return 0.0

    def twice_integrated(lag_s: float) -> float:
        u = abs(lag_s) / time_constant_s
        return math.expm1(-u) + u

    def together(p: Span, q: Span) -> float:
        return (
            twice_integrated(p[1] - q[0])
            + twice_integrated(p[0] - q[1])
            - twice_integrated(p[0] - q[0])
            - twice_integrated(p[1] - q[1])
        )

    return min(max(together(a, b) / math.sqrt(together(a, a) * together(b, b)), 0.0), 1.0)
