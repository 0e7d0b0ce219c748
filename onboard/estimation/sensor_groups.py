"""Sensors that contradict all the others in a window, and the weight they then get. Section 13, (13.3) to (13.5).

Variance components (`variance_components`) find errors that are larger than declared all along; a sensor that is
suddenly wrong (a compass near metal, an attitude that jumps) is rare over minutes but dominates its window. So each
group of residuals is compared with what all others predict for it, its innovation. The group that contradicts them
most is weighted with a variance that makes it consistent, in that window and, fading, in those after it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, fdtri

from onboard.estimation.factors import Prior, State, of_sensors
from onboard.estimation.sensor_table import BY_NAME
from onboard.navigation.limits import FALSE_ALARM, FORGOTTEN

Array = NDArray[np.float64]

# Share of a residual's variance that the fit leaves: where the others know a tenth of what the sensor knows, or less,
# they do not contradict it, and what remains there is the solver's tolerance.
LEAST_REDUNDANCY = 0.01
LEFT_OUT = 9.0  # times the variance that makes a failing group consistent: its values are not to be averaged with
FADING_S = 20.0  # after its last failure, in which a group's added variance falls to a third


@dataclass(frozen=True)
class Failure:
    """A group that contradicts the others: since when and until when it was seen to, and its variance's factor then."""

    since_ns: int
    last_ns: int
    variance: float

    def at(self, stamp_ns: int) -> float:
        """The factor on the group's variance in a window that begins then."""
        age_s = max(stamp_ns - self.last_ns, 0) / 1e9
        return 1.0 + (self.variance - 1.0) * float(np.exp(-age_s / FADING_S))


@dataclass(frozen=True)
class Failing:
    """The groups that fail or have failed of late, by name."""

    failures: Mapping[str, Failure] = field(default_factory=dict)
    windows: Mapping[str, int] = field(default_factory=dict)  # in which each has failed since the start

    def factors(self, start_ns: int) -> dict[str, float]:
        """Factors on the variances of groups, for a window that begins at `start_ns`."""
        return {name: f.at(start_ns) for name, f in self.failures.items()}

    def fails_at(self, end_ns: int) -> bool:
        """Return whether any group failed in the window that ended then."""
        return any(f.last_ns == end_ns for f in self.failures.values())

    def after(self, start_ns: int, end_ns: int, failed: Mapping[str, float]) -> Failing:
        """The failing groups after a window in which those of `failed` failed, with factors that make them fit."""
        kept = {n: f for n, f in self.failures.items() if f.at(start_ns) > FORGOTTEN}
        for name, factor in failed.items():
            before = kept.get(name, Failure(end_ns, end_ns, 1.0))
            kept[name] = Failure(before.since_ns, end_ns, max(factor, before.at(start_ns)))
        return Failing(kept, {n: self.windows.get(n, 0) + (n in failed) for n in {**self.windows, **failed}})


def _limit(states: int, count: float) -> float:
    """The limit that the sum of so many normalised squares exceeds by chance with probability FALSE_ALARM.

    `count`: measurements that the variance is known by.
    """
    if not np.isfinite(count):
        return float(chdtri(states, FALSE_ALARM))
    return states / float(fdtri(count, states, FALSE_ALARM))  # F's upper quantile


@dataclass(frozen=True, eq=False)
class Innovation:
    """One group's innovation: its residual against all the others, whitened by the group's own errors. (13.3)

    `residual` (n,); `predicted` (n, n), the covariance that the others leave it; `constant` (n, m) a constant error of
    each of its m axes. `count`: effective measurements that the group's own variance is known by.
    """

    group: str
    residual: Array
    predicted: Array
    constant: Array
    count: float = np.inf

    def excess(self) -> float:
        """Above 1: the group contradicts the others, even with the largest variance that it may have. (13.4)"""
        return self._excess(1.0, self.count)

    def _excess(self, variance: float, count: float) -> float:
        """T of (13.4) with the group's variance times `variance`, which is known by so many measurements."""
        n, m = self.constant.shape
        factor = np.linalg.cholesky(self.predicted + variance * np.eye(n))
        half = np.linalg.solve(factor, np.column_stack([self.residual, self.constant]))
        of_all, of_constant = half[:, 0], half[:, 1:]
        pull = of_constant.T @ of_all
        by_constant = pull @ np.linalg.solve(of_constant.T @ of_constant, pull)
        return float(max(of_all @ of_all / _limit(n, count), by_constant / _limit(m, count)))

    def consistent_variance(self) -> float:
        """The least factor on its variance with which the group is as near to the others as errors usually are."""
        low, high = 0.0, 14.0  # of its logarithm
        usual = len(self.residual) / _limit(len(self.residual), np.inf)
        while high - low > 0.1:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._excess(float(np.exp(middle)), np.inf) > usual else (low, middle)
        return float(np.exp(high))


def innovations(
    priors: list[Prior],
    state: State,
    covariance: Array,
    factors: Mapping[str, float],
    known_by: Callable[[str], float] = lambda name: np.inf,
) -> list[Innovation]:
    """Each group's innovation, from a solution that holds all residuals; `covariance` (D, D) is the camera side's.

    `factors`: those on the groups' variances that the whiteners already hold: what is held against the others are
    the variances without them. `known_by`: how many effective measurements each group's variance was estimated from,
    by its name.
    """
    out = []
    for prior in of_sensors(priors):
        residuals, jacobians = prior.by_axis(state)
        for group in dict.fromkeys(prior.sensors):
            axes, sigma = np.array(prior.sensors) == group, np.sqrt(factors.get(group, 1.0))
            r = residuals[axes].ravel()
            J = jacobians[axes].reshape(len(r), -1)
            constant = prior.constant_errors(axes)
            values, vectors = np.linalg.eigh(np.eye(len(r)) - J @ covariance @ J.T)
            known = values > LEAST_REDUNDANCY
            values = np.clip(values, LEAST_REDUNDANCY, 1.0)
            own = sigma * (vectors * (known / values)) @ (vectors.T @ r)
            predicted = sigma**2 * (vectors * (1.0 / values - 1.0)) @ vectors.T
            out.append(Innovation(group, own, predicted, sigma * constant, known_by(group)))
    return out


def contradictions(found: list[Innovation]) -> list[Innovation]:
    return [i for i in found if i.excess() > 1.0]


def failing_groups(
    found: list[Innovation], solve: Callable[[Mapping[str, float]], list[Innovation]], held: Mapping[str, float]
) -> tuple[dict[str, float], set[str]]:
    """The factors by which groups' variances grow in a window, and the groups that contradict the others in it.

    `found`: innovations with the factors of `held`, which fade since earlier windows; `solve` gives them with other
    factors. That group fails without which the others agree best, (13.5), and only if those that may not fail then do
    not contradict the pictures: where they do, the pictures are as likely to be wrong (a convoy, water). Position and
    velocity are held against each other before any window (`navigation.position_doubt`).
    """
    factors, failed = dict(held), set[str]()
    while True:
        against = contradictions(found)
        for i in against:
            if i.group in factors and i.group not in failed:
                failed.add(i.group)
                factors[i.group] = max(factors[i.group], LEFT_OUT * i.consistent_variance())
        trials = []
        for i in against:
            if i.group in factors or not BY_NAME[i.group].may_fail:
                continue
            trial = {**factors, i.group: LEFT_OUT * i.consistent_variance()}
            left = solve(trial)
            if all(BY_NAME[j.group].may_fail for j in contradictions(left)):
                rest = max((j.excess() for j in left if j.group not in trial), default=0.0)
                trials.append((rest, i.group, trial, left))
        if not trials:
            return factors, failed
        _, group, factors, found = min(trials, key=lambda t: t[0])
        failed.add(group)
