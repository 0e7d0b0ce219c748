"""Offset and rate of one clock against another, from noisy offsets, with a covariance: a bank of Kalman filters.

State: offset b (ns) and rate r of the host's clock minus the other's, over the other's time. r is a random walk, and
how fast it walks is what differs between clocks: a crystal's rate stands still, a simulator's changes by thousandths
within seconds. So one filter runs for each of several densities of that walk, and the observations weigh them
(interacting multiple models: before each observation every filter starts from the mixture that could have led to it).
The mathematics: (12.3), (12.4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

NS_PER_S = 1e9
# Density of the rate's random walk, 1/s: one sigma of its change in one second is the root. From crystals, which hold
# their rate to 1e-6 over minutes, by factors of 30 in that sigma to simulators that change by 1e-3 in a second.
DENSITIES_PER_S = (1e-15, 1e-12, 1e-9, 1e-6)
# One sigma of the rate before anything is known, for the same: crystals are cut to some 1e-4, simulators to per cents.
PRIOR_RATES = (2e-4, 2e-4, 1e-2, 3e-2)
MEAN_STAY_S = 3600.0  # in one model before it changes to another: a crystal stays one; an order of magnitude
MAX_RATE = 0.1  # more is no clock


@dataclass
class _Model:
    """One filter: offset and rate with their covariance; offsets in ns against the bank's base."""

    density: float
    weight: float
    b: float = 0.0
    r: float = 0.0
    p_bb: float = 0.0
    p_br: float = 0.0
    p_rr: float = 0.0


class ClockFilter:
    """Observations of an offset -> offset, rate and their covariance at any later time of the observed clock."""

    def __init__(self, boot_ns: int, offset_ns: int, variance_ns2: float) -> None:
        """Begin with one observation: at `boot_ns` the offset was `offset_ns`, give or take `variance_ns2`."""
        self.boot_ns = boot_ns
        self._base_ns = offset_ns
        share = 1.0 / len(DENSITIES_PER_S)
        self._models = [
            _Model(density, share, p_bb=variance_ns2, p_rr=prior**2)
            for density, prior in zip(DENSITIES_PER_S, PRIOR_RATES, strict=True)
        ]

    def update(self, boot_ns: int, offset_ns: int, variance_ns2: float) -> None:
        """Take one more observation. One older than the newest is taken as if it came with the newest."""
        seconds = max(boot_ns - self.boot_ns, 0) / NS_PER_S
        self._mix(seconds)
        for model in self._models:
            _predict(model, seconds)
        self.boot_ns = max(self.boot_ns, boot_ns)
        observed = float(offset_ns - self._base_ns)
        logs = [math.log(model.weight) + _correct(model, observed, variance_ns2) for model in self._models]
        greatest = max(logs)
        likelihoods = [math.exp(max(log - greatest, -600.0)) for log in logs]
        total = sum(likelihoods)
        for model, likelihood in zip(self._models, likelihoods, strict=True):
            model.weight = likelihood / total

    def at(self, boot_ns: int) -> tuple[float, float, float]:
        """Offset less `base_ns`, rate, and the offset's variance (ns^2) by (12.4), at a time of the observed clock."""
        seconds = max(boot_ns - self.boot_ns, 0) / NS_PER_S
        b, r = self._mean()
        variance = sum(
            m.weight * (_spread(m, seconds) + (m.b - b + (m.r - r) * seconds * NS_PER_S) ** 2) for m in self._models
        )
        r = min(max(r, -MAX_RATE), MAX_RATE)
        return b + r * (boot_ns - self.boot_ns), r, variance

    @property
    def base_ns(self) -> int:
        """The offset that others are counted from, ns, so that they keep their nanoseconds as floats."""
        return self._base_ns

    def _mean(self) -> tuple[float, float]:
        return sum(m.weight * m.b for m in self._models), sum(m.weight * m.r for m in self._models)

    def _mix(self, seconds: float) -> None:
        """Every filter starts from the mixture of all that may have changed to it since the last observation."""
        models, count = self._models, len(self._models)
        stay = math.exp(-seconds / MEAN_STAY_S)
        leave = max((1.0 - stay) / (count - 1), 1e-12)
        mixed = []
        for j, target in enumerate(models):
            shares = [source.weight * (stay if i == j else leave) for i, source in enumerate(models)]
            weight = sum(shares)
            shares = [share / weight for share in shares]
            b = sum(s * m.b for s, m in zip(shares, models, strict=True))
            r = sum(s * m.r for s, m in zip(shares, models, strict=True))
            new = _Model(target.density, weight, b, r)
            for share, m in zip(shares, models, strict=True):
                new.p_bb += share * (m.p_bb + (m.b - b) ** 2)
                new.p_br += share * (m.p_br + (m.b - b) * (m.r - r))
                new.p_rr += share * (m.p_rr + (m.r - r) ** 2)
            mixed.append(new)
        self._models = mixed


def _predict(model: _Model, seconds: float) -> None:
    ns = seconds * NS_PER_S
    model.b += model.r * ns
    model.p_bb = _spread(model, seconds)
    model.p_br += ns * model.p_rr + model.density * seconds * ns / 2.0
    model.p_rr += model.density * seconds


def _spread(model: _Model, seconds: float) -> float:
    """Variance of the offset so much later, by (12.3)."""
    ns = seconds * NS_PER_S
    walk = model.density * seconds * ns * ns / 3.0
    return model.p_bb + 2.0 * ns * model.p_br + ns * ns * model.p_rr + walk


def _correct(model: _Model, observed: float, variance: float) -> float:
    """Take the observation in; returns the logarithm of its likelihood, but for a constant."""
    total = model.p_bb + variance
    innovation = observed - model.b
    gain_b, gain_r = model.p_bb / total, model.p_br / total
    model.b += gain_b * innovation
    model.r += gain_r * innovation
    # Joseph's form: stays positive however small the variance of the observation.
    rest = 1.0 - gain_b
    p_bb, p_br = model.p_bb, model.p_br
    model.p_rr += -2.0 * gain_r * p_br + gain_r**2 * total
    model.p_br = rest * p_br - gain_r * (rest * p_bb - gain_b * variance)
    model.p_bb = rest**2 * p_bb + gain_b**2 * variance
    return -0.5 * (math.log(total) + innovation**2 / total)
