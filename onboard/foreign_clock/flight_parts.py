"""The scatter of costs between parts of a flight: what neighbouring pairs share does not count as often as pairs do.

Neighbours have a picture in common, the log's errors between two positions, a turn that the model of the vehicle does
not know: their costs are no independent evidence. Those of parts of the flight nearly are. (28.11), (28.12)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.telemetry.log_clocks import BLOCKS

Array = NDArray[np.float64]

RESAMPLES = 300
LOG_FACTORS, HALVINGS = (-10.0, 15.0), 40


def by_parts(costs: Array) -> Array:
    """Costs (T, K) of pairs in order of time -> those of the flight's parts (T, B), as many pairs in each."""
    first = first_of_parts(costs.shape[1])
    out: Array = np.add.reduceat(costs, first, axis=1) if len(first) else np.zeros((len(costs), 0))
    return out


def first_of_parts(pairs: int) -> NDArray[np.intp]:
    """The first pair of each part (B,) of a flight."""
    count = min(BLOCKS, pairs)
    return (np.arange(count) * pairs + count - 1) // max(count, 1)


def resampled(offsets_s: Array, parts: Array, others: Array) -> tuple[float, float] | None:
    """Mean and sigma of the offset (s) by resamples of a flight's parts (T, B), each with what is no pair's (T,);
    None of less than two parts. (28.11)

    A resample weighs the parts at random, evenly over all weights of their sum (the Bayesian bootstrap, Rubin 1981).
    """
    count = parts.shape[1]
    if count < 2:
        return None
    weights = count * np.random.default_rng(0).dirichlet(np.ones(count), RESAMPLES)
    costs = parts @ weights.T + others[:, None]
    likely = np.exp(-0.5 * (costs - costs.min(axis=0)))
    means_s = (offsets_s[:, None] * likely).sum(axis=0) / likely.sum(axis=0)
    return float(means_s.mean()), float(means_s.std() * np.sqrt((count + 1) / (count - 1)))


def overstated(worse: Array) -> Array:
    """By how much (T,) the costs of a flight's parts (T, B), as more than those of what is true, overstate: of a
    likelihood ratio the mean over all data is 1, in each part, whatever that part determines. 0 where no part speaks
    for the other, or all together do: then nothing is claimed. (28.12)
    """
    out = np.zeros(len(worse))
    has_root = (worse.min(axis=1, initial=0.0) < 0.0) & (worse.sum(axis=1) > 0.0)
    low, high = (np.full(np.count_nonzero(has_root), edge) for edge in LOG_FACTORS)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        ratios = np.exp(np.clip(-0.5 * worse[has_root] * np.exp(-middle)[:, None], -700.0, 700.0))
        is_larger = ratios.sum(axis=1) > worse.shape[1]
        low, high = np.where(is_larger, middle, low), np.where(is_larger, high, middle)
    out[has_root] = np.exp(high)
    return out
