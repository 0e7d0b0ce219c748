"""A window's own information about some states: taken out of a posterior, weakened, added to another prior.

It is held along independent directions, in units of the prior's sigmas: the states' units differ by orders of
magnitude, and rounding in one must not look like data in another. Directions without information are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST = 1e-6  # of the given precision: less is rounding


@dataclass(frozen=True, eq=False)
class Information:
    """Information about B states along D directions: a precision of `directions @ diag(precisions) @ directions.T`."""

    mean: Array  # (B,) that was known before
    precisions: Array  # (D,)
    directions: Array  # (B, D)
    pull: Array  # (D,) on that mean, along the directions

    @classmethod
    def gained(cls, mean: Array, covariance: Array, known: Array, known_covariance: Array) -> Information:
        """The information of a posterior, mean (B,) and covariance (B, B), less that of its prior (`known`)."""
        scale, precision = np.sqrt(np.diag(known_covariance)), np.linalg.inv(covariance)
        beyond = (precision - np.linalg.inv(known_covariance)) * np.outer(scale, scale)
        values, basis = np.linalg.eigh(beyond)
        kept = values > LEAST  # a posterior may have been widened after the solve: there it adds nothing
        basis = (basis / scale[:, None])[:, kept]
        return cls(known, values[kept], basis, (basis * np.square(scale)[:, None]).T @ (precision @ (mean - known)))

    def weakened(self, variance: Array) -> Information:
        """The same with the variance of each direction times so much (D,)."""
        return replace(self, precisions=self.precisions / variance, pull=self.pull / variance)

    def upon(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """The posterior, mean (B,) and covariance (B, B), that follows from another prior."""
        alone = (self.directions * self.precisions) @ self.directions.T
        out = np.linalg.inv(np.linalg.inv(covariance) + alone)
        return mean + out @ (self.directions @ self.pull + alone @ (self.mean - mean)), 0.5 * (out + out.T)


def with_own_variance(covariance: Array, states: slice | int, variance: float) -> Array:
    """A covariance (B, B) with some states independent of all others, each of this variance."""
    out, at = covariance.copy(), np.arange(len(covariance))[states]
    out[at], out[:, at] = 0.0, 0.0
    out[at, at] = variance
    return out


def with_marginal(mean: Array, covariance: Array, at: int, value: float, variance: float) -> tuple[Array, Array]:
    """A posterior, mean (B,) and covariance (B, B), with another of the state `at`; the rest given it stays. (10.6)"""
    along, more = covariance[:, at] / covariance[at, at], variance - covariance[at, at]
    return mean + (value - mean[at]) * along, covariance + more * np.outer(along, along)
