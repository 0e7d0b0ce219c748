"""The dependence of looks at one place on each other: a law with one factor, fitted to pairs of pictures.

A place has a normal variable x that all looks at it share, and each look one of its own; together they decide the
class of its score (a Gaussian copula with one factor), unless the look is lost:

    P(class k | x) = lost [k is no peak] + (1 - lost) (F(S_k) - F(S_(k+1))),
    F(S) = Phi((Phi^-1(S / (1 - lost)) + sqrt(shared) x) / sqrt(1 - shared)),

S_k the probability to reach class k. `shared` and `lost` are those with the greatest likelihood of the second look
given the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from onboard.spots.thing_odds import LEAST, LEAST_SCORE, LOG_WEIGHTS, Again, reached, reached_given
from training.calibration import MEGA, Counted
from training.labelled_pictures import KINDS
from training.repeats import GATE_PX, Pair, correlation, moved_pairs, of_kind
from training.score import Looks

Array = NDArray[np.float64]

WEIGHTS = np.exp(LOG_WEIGHTS)
LOST, SHARED = np.arange(0.0, 0.62, 0.02), np.arange(0.0, 0.98, 0.02)
LEAST_PAIRS = 30
SHAPES = np.geomspace(0.1, 100.0, 121)


@dataclass(frozen=True)
class Fitted(Again):
    """The law that so many `places` follow best."""

    places: int


def classes(scores: Array, edges: Array) -> NDArray[np.int64]:
    """Return the class of each score, from 1 on; 0 for what has no peak, or a lower one than the first edge."""
    return np.minimum(np.searchsorted(edges, scores, side="right"), len(edges) - 1)


def shown(reach: Array, law: Again) -> Array:
    """Return the probability of each class (K + 1, nodes), the first no peak, at each value of what is shared."""
    above = reached_given(np.append(1.0, np.minimum(reach / (1.0 - law.lost), 1.0)), law)
    share: Array = (1.0 - law.lost) * np.maximum(above[:-1] - above[1:], 0.0)
    share[0] += law.lost
    return np.asarray(np.maximum(share, LEAST), dtype=np.float64)


def fitted(reach: Array, pairs: NDArray[np.int64]) -> Fitted:
    """Return the law that pairs of classes (N, 2) follow best."""
    table = np.zeros((len(reach), len(reach)))
    np.add.at(table, (pairs[:, 0], pairs[:, 1]), 1.0)
    best, most = Fitted(0.0, 0.0, len(pairs)), -np.inf
    for lost in LOST[1.0 - reach[0] >= LOST]:
        for shared in SHARED:
            law = Again(float(shared), float(lost))
            share = shown(reach, law)
            both = (share * WEIGHTS) @ share.T
            value = float((table * np.log(both / both.sum(1, keepdims=True))).sum())
            if value > most:
                best, most = Fitted(round(law.shared, 3), round(law.lost, 3), len(pairs)), value
    return best


def again(bins: Counted, pairs: Sequence[Pair], kind: int) -> dict[str, object]:
    """Return how looks depend on each other, as `thermal_things.json` states it; the cautious law where pairs lack.

    A place that is known to be a false peak is not independent of its next look, nor a thing that is missed: without
    enough pairs all is shared, and more looks add nothing.
    """
    first = int(np.searchsorted(bins.edges, LEAST_SCORE))
    edges = bins.edges[first:]
    gate_mpx = np.pi * GATE_PX**2 / MEGA
    ground = reached(bins.false_per_mpx[first:])
    laws = {"false": -np.expm1(-gate_mpx * ground), "found": reached(bins.found[first:])}
    out: dict[str, object] = {}
    for name, scores in zip(("false", "found"), of_kind(moved_pairs(pairs), kind), strict=True):
        pairs_of_classes = np.stack([classes(scores[:, 0], edges), classes(scores[:, 1], edges)], 1)
        used = pairs_of_classes[pairs_of_classes[:, 0] > 0] if name == "false" else pairs_of_classes
        law = fitted(laws[name], used) if len(used) >= LEAST_PAIRS else Fitted(float(SHARED[-1]), 0.0, len(used))
        out[f"{name}_again"] = {"shared": law.shared, "lost": law.lost}
        out[f"{name}_again_places"] = law.places
    return out


def flights(looks: Looks, kind: int, flight: NDArray[np.int64]) -> float:
    """Return the shape of the gamma law, of mean 1, by which flights differ in the rate of false peaks.

    `flight` (P,): which stretch of flight each picture is of. Of scores from `LEAST_SCORE` on the lower half counts.
    """
    false = (looks.peak_kind == kind) & ~looks.peak_true & (looks.peak_score >= LEAST_SCORE)
    counted = false & (looks.peak_score <= np.median(looks.peak_score[false])) if false.any() else false
    count = np.bincount(flight[looks.peak_picture[counted]], minlength=flight.max() + 1).astype(np.float64)
    pixels = np.bincount(flight, looks.pixels)
    mean = count.sum() * pixels / pixels.sum()
    a = SHAPES[:, None]
    by_shape = gammaln(count + a) - gammaln(a) + a * np.log(a / (a + mean))
    likelihood = (by_shape + count * np.log(np.maximum(mean, LEAST) / (a + mean))).sum(1)
    return round(float(SHAPES[int(np.argmax(likelihood))]), 3)


def described(pairs: Sequence[Pair]) -> dict[str, object]:
    """Return, for people to read, what pairs have in common: correlations of logits, and what comes again."""
    out: dict[str, object] = {"pairs": len(pairs) // 2}
    for kind, name in enumerate(KINDS):
        false, things = of_kind(pairs, kind)
        out[name] = {
            "false_places": len(false), "false_correlation": correlation(false), "things": len(things),
            "thing_correlation": correlation(things),
            "false_again": round(float((false[:, 1] >= LEAST_SCORE).mean()), 3) if len(false) else None,
            "false_above_0.5": int((false[:, 0] >= 0.5).sum()),
            "of_these_again_above_0.5": int(((false >= 0.5).all(1)).sum()),
        }  # fmt: skip
    return out
