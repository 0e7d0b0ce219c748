"""How large the sensors' errors are, estimated from the flight's own residuals. Section 13 of docs/mathematics.md.

Every sensor's covariance is a sum of parts (a Gauss-Markov and a white part, for tilt, heading, velocity and position),
each a known correlation times an unknown variance. After a window is solved, each part's share of the residuals is
compared with what that part should have left in them, (13.1), which is Helmert's estimate of variance components. The
configuration's sigmas are where it starts and its floors; there is no ceiling.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.factors import AttitudePrior, PositionPrior, Prior, State, VelocityPrior

Array = NDArray[np.float64]

TILT, HEADING, TILT_WHITE, HEADING_WHITE = "tilt", "heading", "tilt_white", "heading_white"
VELOCITY, POSITION = "velocity", "position"
NAMES = (TILT, HEADING, TILT_WHITE, HEADING_WHITE, VELOCITY, POSITION)
# Effective measurements that the configured sigma counts for: after so many of its own the flight has as much to say.
PRIOR_COUNT = 10.0
VELOCITY_SLOW_SHARE = 0.05  # of the declared variance, in the lasting part where nothing more has been found
MEMORY_S = 240.0  # over which what was seen is forgotten: compasses and winds change


@dataclass(frozen=True)
class Parts:
    """The covariance of one sensor's errors by axis: `matrices[axis]` maps a part's name to its (n, n), as believed."""

    matrices: tuple[Mapping[str, Array], Mapping[str, Array], Mapping[str, Array]]


@dataclass(frozen=True)
class Evidence:
    """What residuals say of each part: squares found, in configured variances, and how many were expected, (13.1)."""

    found: Mapping[str, float] = field(default_factory=dict)
    expected: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class VarianceFactors:
    """Factors on the configured variances, from evidence so far. `stamp_ns` is when it was last added to."""

    stamp_ns: int = 0
    found: Mapping[str, float] = field(default_factory=dict)
    expected: Mapping[str, float] = field(default_factory=dict)
    groups: Mapping[str, float] = field(default_factory=dict)  # on all of a sensor's variance, while it fails

    def group_sigma(self, group: str) -> float:
        """The factor on the sigma of a sensor that contradicts the others (`sensor_groups`), at least 1."""
        return float(np.sqrt(self.groups.get(group, 1.0)))

    def of(self, name: str) -> float:
        """The factor on one part's variance, at least 1."""
        if name == VELOCITY:  # the declared part and the lasting one together
            return 1.0 - VELOCITY_SLOW_SHARE + self.scale(name)
        return self.scale(name)

    def scale(self, name: str) -> float:
        """What a part is scaled by. A velocity's lasting part begins at a small share of the declared one."""
        least = VELOCITY_SLOW_SHARE if name == VELOCITY else 1.0
        found, expected = self.found.get(name, 0.0), self.expected.get(name, 0.0)
        return max((PRIOR_COUNT * least + found) / (PRIOR_COUNT + expected), least)

    def sigma(self, name: str) -> float:
        """The factor on one part's sigma."""
        return float(np.sqrt(self.of(name)))

    def with_evidence(self, evidence: Evidence, stamp_ns: int, weight: float = 1.0) -> VarianceFactors:
        """More evidence; older evidence fades."""
        age_s = max(stamp_ns - self.stamp_ns, 0) / 1e9 if self.stamp_ns else 0.0
        keep = float(np.exp(-age_s / MEMORY_S))
        found = {n: keep * v for n, v in self.found.items()}
        expected = {n: keep * v for n, v in self.expected.items()}
        for name, value in evidence.expected.items():
            found[name] = found.get(name, 0.0) + weight * evidence.found[name]
            expected[name] = expected.get(name, 0.0) + weight * value
        return VarianceFactors(stamp_ns, found, expected, self.groups)


def evidence_of(priors: list[Prior], state: State, covariance: Array, used: VarianceFactors) -> Evidence:
    """Compare each part's residuals at a solution with their expectation, (13.1).

    `covariance` (D, D) is the camera side's; `used` are the factors that the priors were weighted by.
    """
    found: dict[str, float] = {}
    expected: dict[str, float] = {}
    for prior in priors:
        if not isinstance(prior, PositionPrior | VelocityPrior | AttitudePrior) or prior.parts is None:
            continue
        residual, J = prior.evaluate(state)
        n = prior.whitener.shape[1]
        r, J = residual.reshape(3, n), J.reshape(3, n, -1)
        for axis, parts in enumerate(prior.parts.matrices):
            W = prior.whitener[axis]
            weighted = W.T @ r[axis]
            # C^-1 (C - J P J') C^-1: what is left of each residual after the fit.
            left = W.T @ (np.eye(n) - J[axis] @ covariance @ J[axis].T) @ W
            for name, Q in parts.items():
                found[name] = found.get(name, 0.0) + float(weighted @ Q @ weighted)
                expected[name] = expected.get(name, 0.0) + max(float(np.sum(Q * left)), 0.0)
    return Evidence({n: v * used.scale(n) for n, v in found.items()}, expected)
