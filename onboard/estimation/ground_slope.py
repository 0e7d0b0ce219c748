"""The prior of the ground's slope under a window, from what windows elsewhere found. Section 14 of mathematics.md.

The slope across a straight track shows in nothing but an attitude, so "the ground is level" is a prior. Where a turn or
a leg across has seen the slope nearby, the prior is that slope, and narrow; where nothing has, it is level ground with
the declared sigma or what the slopes seen elsewhere show it to be.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import softmax

from onboard.estimation.factors import SharedPrior
from onboard.estimation.information import Information, with_own_variance
from onboard.estimation.platform_states import BORESIGHT

Array = NDArray[np.float64]

# Over which slopes may be correlated, all equally likely beforehand.
LENGTHS_M = (30.0, 100.0, 300.0, 1000.0, 3000.0, 10000.0)
PRIOR_COUNT = 2.0  # slopes of the declared size, assumed before any has been seen
MEMORY = 24  # windows
NO_SLOPE_PRIOR = 3.0  # one sigma of a slope of which nothing is assumed (72 deg)
NO_MOUNT_PRIOR_RAD = 0.5


@dataclass(frozen=True, eq=False)
class SlopePrior:
    """The prior of the slope (east, north) where a window is: mean (2,), covariance (2, 2)."""

    mean: Array = field(default_factory=lambda: np.zeros(2))
    covariance: Array = field(default_factory=lambda: NO_SLOPE_PRIOR**2 * np.eye(2))

    @property
    def whitener(self) -> Array:
        """(2, 2), the symmetric one: it changes little where the covariance does. Sets share what it makes white."""
        values, vectors = np.linalg.eigh(self.covariance)
        out: Array = (vectors / np.sqrt(values)) @ vectors.T
        return out


@dataclass(frozen=True, eq=False)
class SlopeSeen:
    """The slope (2,) at a place (2,), ENU, by one window alone, with covariance (2, 2).

    `variance`: the variance of slopes on such ground, by its variogram.
    """

    end_ns: int
    place_enu_m: Array
    slope: Array
    covariance: Array
    variance: float


class GroundSlope:
    """Slopes that windows without common pictures have seen; the prior for a window elsewhere."""

    def __init__(self, sigma: float) -> None:
        """`sigma`: one sigma of a slope (its tangent) at a place of which nothing is known, and the least."""
        self.sigma = sigma
        self._seen: list[SlopeSeen] = []
        self.newest: SlopeSeen | None = None  # of the newest solved window, however short: how much slopes vary here

    def forget(self) -> None:
        """Places have another origin from now on."""
        self._seen.clear()
        self.newest = None

    def offer(self, start_ns: int, seen: SlopeSeen) -> bool:
        """Keep what a solved window saw, if it began (`start_ns`) after the one before ended; whether it did."""
        if self._seen and start_ns <= self._seen[-1].end_ns:
            return False
        self._seen.append(seen)
        del self._seen[:-MEMORY]
        return True

    def prior_for(self, start_ns: int, place_enu_m: Array) -> SlopePrior:
        """The prior for a window near a place (2,), by windows that ended before `start_ns`. (14.2) to (14.4)"""
        seen = [s for s in self._seen if s.end_ns < start_ns]
        variance = self._variance(seen)
        if not seen:
            return SlopePrior(np.zeros(2), variance * np.eye(2))
        slopes = np.concatenate([s.slope for s in seen])
        noise = block_diag(*(s.covariance for s in seen))
        places = np.stack([s.place_enu_m for s in seen])
        apart_m = np.linalg.norm(places[:, None] - places, axis=2)
        away_m = np.linalg.norm(places - place_enu_m, axis=1)
        logs, means, covariances = [], [], []
        for length_m in LENGTHS_M:
            factor = np.linalg.cholesky(variance * np.kron(np.exp(-apart_m / length_m), np.eye(2)) + noise)
            to_here = variance * np.kron(np.exp(-away_m / length_m)[:, None], np.eye(2))
            half = np.linalg.solve(factor, np.column_stack([slopes, to_here]))
            logs.append(-0.5 * half[:, 0] @ half[:, 0] - np.log(np.diag(factor)).sum())
            means.append(half[:, 1:].T @ half[:, 0])
            covariances.append(variance * np.eye(2) - half[:, 1:].T @ half[:, 1:])
        weight = softmax(logs)
        mean = weight @ np.stack(means)
        between = np.stack(means) - mean
        each = np.stack(covariances) + between[:, :, None] * between[:, None]
        return SlopePrior(mean, np.einsum("l,lij->ij", weight, each))

    def _variance(self, ended: list[SlopeSeen]) -> float:
        """A slope's variance by the windows that have `ended` and the newest one; at least the declared. (14.3)"""
        seen = ended if self.newest is None or self.newest in ended else [*ended, self.newest]
        declared, scale = self.sigma**2, 1.0
        found = np.array([s.variance for s in seen]) / declared
        known = np.linalg.eigvalsh(np.reshape([s.covariance for s in seen], (-1, 2, 2)))[:, 0] / declared
        for _ in range(3):
            share = scale / (scale + known)
            asked = PRIOR_COUNT + 2.0 * float(np.sum(share**2 * found))
            scale = max(asked / (PRIOR_COUNT + 2.0 * float(np.sum(share))), 1.0)
        return declared * scale


def seen_alone(prior: SharedPrior, shared: Array, covariance: Array) -> tuple[Array, Array]:
    """A window's own estimate of its ground's slope (2,) and covariance (2, 2), whatever the prior was. (14.1)

    `shared` (S,) and `covariance` (S, S) are the posterior of the shared states, `prior` theirs. Nothing is assumed of
    the slope, and nothing of the mount, whose error would be taken for the slope across every straight track.
    """
    slope = slice(len(shared) - 2, len(shared))
    given = prior.covariance
    loose = with_own_variance(with_own_variance(given, BORESIGHT, NO_MOUNT_PRIOR_RAD**2), slope, NO_SLOPE_PRIOR**2)
    mean = prior.mean.copy()
    mean[slope] = 0.0
    estimate, alone = Information.gained(shared, covariance, prior.mean, given).upon(mean, loose)
    return estimate[slope], alone[slope, slope]
