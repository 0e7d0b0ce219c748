"""The contrast that the ground alone reaches only so often a square kilometre. (25.6) to (25.8)"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc

from onboard.spots.counted_ground import KEPT, CountedGround

Array = NDArray[np.float64]

LARGEST = 100  # contrasts of a picture
FITTED, FITTED_KM2 = 40, 1000.0  # that the tail is fitted to: at least so many, and so many a square kilometre
LEAST_PEAKS = 20
UNLIKELY = 20.0  # flights like this one, in less than one of which a single contrast of the ground is so large
CROWDED = 0.05  # probability of as many such contrasts by chance, below which a picture's are things and no ground
CENSORED = 0.1  # of them, the largest, which may be what is looked for: only that they are large is used
SHAPE, SHAPE_SIGMA = 0.1, 0.03  # of the tail: rather heavier than an exponential, as far as that is not known
_SHAPES = np.linspace(-0.4, 0.4, 34)  # without 0
_SCALES = np.geomspace(0.2, 5.0, 48)  # of the mean excess


class ClutterTail:
    """Fed with the largest contrasts of pictures; each part of the ground counts once."""

    def __init__(self, false_per_km2: float) -> None:
        self._rate = false_per_km2
        self.ground = CountedGround()
        self._contrasts: deque[Array] = deque(maxlen=KEPT)
        self._threshold: float | None = None

    def add(self, place_m: Array, area_km2: float, contrasts: Array) -> None:
        """The largest contrasts of what might have been a spot on `area_km2` of ground."""
        self.ground.add(place_m, area_km2)
        self._contrasts.append(np.sort(contrasts)[::-1][:LARGEST])
        self._threshold = None

    @property
    def threshold(self) -> float:
        """The contrast that a spot must have, in sigmas of the clutter; infinite while too little has been seen."""
        if self._threshold is None:
            self._threshold = self._fitted()
        return self._threshold

    def _fitted(self) -> float:
        peaks = self._of_ground()
        allowed = self._rate * self.ground.km2
        count = min(self._wanted(), len(peaks)) - 1
        if count < LEAST_PEAKS:
            return float("inf")
        base = float(peaks[count])
        shape, scale = _fit(peaks[:count] - base)
        return base + scale * float(np.expm1(shape * np.log(max(count / allowed, 1.0)))) / shape

    def _wanted(self) -> int:
        """Return how many of the largest contrasts the tail is fitted to."""
        return int(np.ceil(max(FITTED, FITTED_KM2 * self.ground.km2, 4.0 * self._rate * self.ground.km2)))

    def _of_ground(self) -> Array:
        """Return the contrasts (N,), largest first, without things that are together in a few pictures. (25.21)

        Where such contrasts are all over the pictures they are ground all the same: rocks.
        """
        if not self._contrasts:
            return np.zeros(0)
        every = np.sort(np.concatenate(self._contrasts))[::-1]
        fitted = every[: self._wanted()]
        if len(fitted) <= LEAST_PEAKS:
            return every
        base = float(fitted[-1])
        scale = (float(np.median(fitted)) - base) * SHAPE / float(2.0**SHAPE - 1.0)
        most = base + scale * float((len(fitted) * UNLIKELY) ** SHAPE - 1.0) / SHAPE
        beyond = np.array([np.count_nonzero(c > most) for c in self._contrasts])
        left_out = np.concatenate([np.zeros(0), *(self._contrasts[k][: beyond[k]] for k in _crowded(beyond))])
        out: Array = every[~np.isin(every, left_out)]
        return out


def _crowded(counts: NDArray[np.int64]) -> list[int]:
    """Return the pictures, the fullest first, whose counts (N,) the others' rate makes unlikely. (25.22)"""
    out: list[int] = []
    order = np.argsort(counts)[::-1]
    for k in order:
        left = int(counts.sum() - counts[[*out, k]].sum())
        rate = (0.5 + left) / (len(counts) - len(out))  # of the others, by Jeffreys' prior
        if gammainc(counts[k], rate) >= CROWDED or counts[k] == 0:
            break
        out.append(int(k))
    return out


def _fit(excess: Array) -> tuple[float, float]:
    """Shape and scale of the generalised Pareto law of excesses (N,), largest first: (25.7)."""
    censored = int(np.ceil(CENSORED * len(excess)))
    seen, mean = excess[censored:], max(float(excess[censored:].mean()), 1e-6)
    shape, scale = (axis[:, :, None] for axis in np.meshgrid(_SHAPES, mean * _SCALES, indexing="ij"))
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = np.log1p(shape * seen / scale)
        at_edge = np.log1p(shape * excess[censored - 1] / scale)
        likelihood = -len(seen) * np.log(scale) - ((1.0 + 1.0 / shape) * inside).sum(axis=2, keepdims=True)
        likelihood = likelihood - censored * at_edge / shape - 0.5 * ((shape - SHAPE) / SHAPE_SIGMA) ** 2
    best = np.nanargmax(np.where(np.isfinite(likelihood), likelihood, -np.inf))
    i, j, _ = np.unravel_index(best, likelihood.shape)
    return float(_SHAPES[i]), float(mean * _SCALES[j])
