"""Variances of the sensors' errors, estimated from the flight's own residuals. Section 13 of docs/mathematics.md.

Every sensor's covariance is a sum of parts (a Gauss-Markov and a white part, `sensor_table`), each a known correlation
times an unknown variance. After a window is solved, each part's share of the residuals is compared with what that part
should have left in them, (13.1), which is Helmert's estimate of variance components. The estimate starts from the
configured sigmas; only what a receiver or filter claims of its own errors is a floor as well.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.factors import Prior, State, of_sensors
from onboard.estimation.sensor_table import CLAIMED

Array = NDArray[np.float64]

# Effective measurements that the configured sigma counts for: after so many of its own the flight counts for as much.
PRIOR_COUNT = 10.0
MEMORY_S = 240.0  # over which what was seen is forgotten: compasses and winds change


@dataclass(frozen=True)
class Evidence:
    """The sum of squares found of each part in residuals, in configured variances, and the expected one, (13.1)."""

    found: Mapping[str, float] = field(default_factory=dict)
    expected: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class VarianceFactors(Evidence):
    """Factors on the configured variances, from evidence so far. `stamp_ns` is when it was last added to."""

    stamp_ns: int = 0
    groups: Mapping[str, float] = field(default_factory=dict)  # on all of a sensor's variance, while it fails

    def group_sigma(self, group: str) -> float:
        """The factor on the sigma of a sensor that contradicts the others (`sensor_groups`), at least 1."""
        return float(np.sqrt(self.groups.get(group, 1.0)))

    def of(self, name: str) -> float:
        """The factor on one part's variance; at least 1 where the sensor claims its own errors. (13.2)"""
        factor = (PRIOR_COUNT + self.found.get(name, 0.0)) / self.known_by(name)
        return max(factor, 1.0) if name in CLAIMED else factor

    def known_by(self, name: str) -> float:
        """Effective measurements that a part's variance is known by: what the configured one counts for, and more."""
        return PRIOR_COUNT + self.expected.get(name, 0.0)

    def sigma(self, name: str) -> float:
        """The factor on one part's sigma."""
        return float(np.sqrt(self.of(name)))

    def slow_sigma(self, sensor: str) -> float:
        """The factor on the sigma of a sensor's Gauss-Markov part, that of its group included."""
        return self.sigma(sensor) * self.group_sigma(sensor)

    def with_evidence(self, evidence: Evidence, stamp_ns: int, weight: float = 1.0) -> VarianceFactors:
        """More evidence; older evidence fades."""
        age_s = max(stamp_ns - self.stamp_ns, 0) / 1e9 if self.stamp_ns else 0.0
        keep = float(np.exp(-age_s / MEMORY_S))

        def joined(old: Mapping[str, float], new: Mapping[str, float]) -> dict[str, float]:
            return {name: keep * old.get(name, 0.0) + weight * new.get(name, 0.0) for name in {**old, **new}}

        found, expected = joined(self.found, evidence.found), joined(self.expected, evidence.expected)
        return replace(self, stamp_ns=stamp_ns, found=found, expected=expected)


def evidence_of(priors: list[Prior], state: State, covariance: Array, used: VarianceFactors) -> Evidence:
    """Compare each part's residuals at a solution with their expectation, (13.1).

    `covariance` (D, D) is the camera side's; `used` are the factors that the priors were weighted by.
    """
    found: dict[str, float] = defaultdict(float)
    expected: dict[str, float] = defaultdict(float)
    for prior in of_sensors(priors):
        for W, parts, r, J in zip(prior.whitener, prior.parts, *prior.by_axis(state), strict=True):
            weighted = W.T @ r
            # C^-1 (C - J P J') C^-1: what is left of each residual after the fit.
            left = W.T @ (np.eye(len(r)) - J @ covariance @ J.T) @ W
            for name, Q in parts.items():
                found[name] += used.of(name) * float(weighted @ Q @ weighted)
                expected[name] += max(float(np.sum(Q * left)), 0.0)
    return Evidence(found, expected)
