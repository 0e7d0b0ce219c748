"""The odds that a place on the ground holds a thing, by every look at it: (25.14) to (25.18)."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from contract.spot import ThingKind
from onboard.spots.thing_net import WEIGHTS

Array = NDArray[np.float64]

CALIBRATION = WEIGHTS / "thermal_things.json"
MISSED = -1  # the class of a look without a peak
NODES = np.linspace(-8.0, 8.0, 129)  # of what all looks at one place have in common, in its sigmas
LOG_WEIGHTS = -0.5 * NODES**2 - np.log(np.exp(-0.5 * NODES**2).sum())
LEAST = 1e-300
LEAST_SCORE = 0.1  # what scores less is too common to decide anything


@dataclass(frozen=True)
class Again:
    """The dependence of looks at one place on each other.

    `shared`: of what makes it score high, the part (of variance) that they have in common. `lost`: the share of looks
    that show nothing there, whatever it is like.
    """

    shared: float
    lost: float


@dataclass(frozen=True, eq=False)
class ScoreLaw:
    """The law by which peaks of one kind score. Class k is from `edges[k]` to `edges[k + 1]`, edges (N + 1,).

    `found` (N,): share of true things whose peak is in each class; the rest of 1 has no peak. `false_per_mpx` (N,):
    peaks in each class where no thing is, in a megapixel. `found_again` and `false_again`: how looks at one place with
    a thing, and without one, depend on each other. `flights`: the shape of the gamma law by which flights differ in the
    rate of false peaks.
    """

    edges: Array
    found: Array
    false_per_mpx: Array
    found_again: Again
    false_again: Again
    flights: float

    def class_of(self, score: float) -> int:
        """The class of a peak's score; MISSED below the least."""
        return min(int(np.searchsorted(self.edges, score, side="right")) - 1, len(self.found) - 1)

    @cached_property
    def found_reached(self) -> Array:
        """(N + 1,): the share of true things that reach each class."""
        return reached(self.found)

    @cached_property
    def false_reached(self) -> Array:
        """(N + 1,): the false peaks in a megapixel that reach each class."""
        return reached(self.false_per_mpx)

    @cached_property
    def low_classes(self) -> int:
        """The number of the lowest classes that hold half of all false peaks."""
        share = np.cumsum(self.false_per_mpx) / max(float(self.false_per_mpx.sum()), LEAST)
        return int(np.searchsorted(share, 0.5)) + 1


def read_laws(path: Path = CALIBRATION) -> dict[ThingKind, ScoreLaw]:
    """The calibration that belongs to the weights, by kind; lower classes than LEAST_SCORE count as no peak."""
    return {ThingKind(name): _law(of) for name, of in json.loads(path.read_text())["kinds"].items()}


def _law(of: dict[str, Any]) -> ScoreLaw:
    edges = np.array(of["edges"])
    first = int(np.searchsorted(edges, LEAST_SCORE))
    found, false = Again(**of["found_again"]), Again(**of["false_again"])
    # No lost look in n pairs is no proof that none ever is; and what hides a thing hides what resembles one as well, so
    # that a look without a peak hardly speaks for a thing.
    found = replace(found, lost=max(found.lost, 1.0 / (of["found_again_places"] + 2.0)))
    again = found, replace(false, lost=max(false.lost, found.lost))
    return ScoreLaw(
        edges[first:], np.array(of["found"])[first:], np.array(of["false_per_mpx"])[first:], *again, of["flights"]
    )


class PlaceOdds:
    """Two explanations of the looks at one place: a thing is there, or ground that resembles one. (25.15) to (25.17)"""

    def __init__(self, law: ScoreLaw) -> None:
        self._law = law
        self._thing, self._ground = LOG_WEIGHTS.copy(), LOG_WEIGHTS.copy()
        self._log_gate_km2 = np.nan  # of the first look
        self.log_km2 = 0.0
        """ln of the likelihood that a thing is there over the density (1/km2) of ground that looks so, in km2; 0 before
        the first look. (25.17)
        """

    def look(self, score_class: int, gate_mpx: float, gate_km2: float, rate: float) -> None:
        """Add a look: the class of the peak within a gate of that size, or MISSED.

        `rate`: of this flight's false peaks, over those of the calibration.
        """
        law = self._law
        if np.isnan(self._log_gate_km2):
            self._log_gate_km2 = float(np.log(gate_km2))
        false = -np.expm1(-rate * gate_mpx * law.false_reached)
        self._thing += _log_share(law.found_reached, score_class, law.found_again)
        self._ground += _log_share(false, score_class, law.false_again)
        self.log_km2 = _log_sum(self._thing) - _log_sum(self._ground) + self._log_gate_km2


def reached(shares: Array) -> Array:
    """Return what reaches the lower edge of each class (N + 1,), from what is in each (N,); then 0."""
    return np.append(np.cumsum(shares[::-1])[::-1], 0.0)


def reached_given(share: Array, again: Again) -> Array:
    """Return the probabilities (M, NODES) to reach classes, for each value of what looks have in common. (25.15)

    `share` (M,): the same over all places, of looks that are not lost.
    """
    above = ndtri(share)[:, None] + np.sqrt(again.shared) * NODES
    return np.asarray(ndtr(above / np.sqrt(1.0 - again.shared)), np.float64)


def _log_share(reach: Array, score_class: int, again: Again) -> Array:
    """ln of the probability (NODES,) of a class, for each value of what looks have in common. (25.15)

    `reach` (N + 1,): the probability to reach each class's lower edge, and 0.
    """
    lost = min(again.lost, 1.0 - float(reach[0]))
    shares = np.append(1.0, np.minimum(reach / (1.0 - lost), 1.0))  # the class without a peak is the first
    most, least = reached_given(shares[score_class + 1 : score_class + 3], again)
    shown = (1.0 - lost) * (most - least) + (lost if score_class == MISSED else 0.0)
    return np.asarray(np.log(np.maximum(shown, LEAST)), np.float64)


def _log_sum(logs: Array) -> float:
    """ln of the sum of exp(logs)."""
    most = float(logs.max())
    return most + float(np.log(np.exp(logs - most).sum()))
