"""The error of a click that may be of the ground behind the surface that was matched about it. (29.12), (29.13)

What stands on the ground takes its edge along from picture to picture. Where the ground behind the edge is smooth,
nothing about a click there contradicts the edge's depth: what is matched is the edge, and not what was clicked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from onboard.measured.matching import CORRELATED
from onboard.measured.patches import OFFSETS, Patch, Values, warped
from onboard.measured.sweep import LEAST_VIEWS
from onboard.measured.views import View

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ABOUT = np.exp(-0.5 * (OFFSETS**2).sum(axis=1) / 1.2**2)  # what counts as the click's own pixels
LEAST_NOISE = 1.0  # grey levels squared
TURNS = 16  # bearings in which an edge may pass
EDGE_PX = 1.0  # an edge is no sharper than a pixel
RADIUS_PX = 4.5
REACH = 2.5  # sigmas of the ground between the features
LEAST_DEPTHS, MOST_DEPTHS = 5, 24  # at which it is tried


DISC = np.hypot(*OFFSETS.T) <= RADIUS_PX


def halves() -> Values:
    """Halves of the disc (N, TURNS), of its N pixels, whose straight side passes the click at a pixel's distance."""
    bearing = np.arange(TURNS) * (2.0 * np.pi / TURNS)
    return np.asarray(OFFSETS[DISC] @ np.stack([np.cos(bearing), np.sin(bearing)]) >= EDGE_PX, np.float32)


HALVES = halves()


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground between the features at a click: inverse depth with one sigma (1/m), slope, the step (1/m) at which
    pictures distinguish depths, and how densely (m) inverse depths of what stands on it lie.
    """

    per_m: float
    sigma_per_m: float
    slope: Array
    step_per_m: float
    density_m: float

    def depths(self) -> tuple[Array, Array]:
        """Inverse depths (K,) that it may have, and how likely each is (K,)."""
        count = math.ceil(2.0 * REACH * self.sigma_per_m / self.step_per_m) + 1
        sigmas = np.linspace(-REACH, REACH, min(max(count, LEAST_DEPTHS), MOST_DEPTHS))
        likely = np.exp(-0.5 * sigmas**2)
        return self.per_m + sigmas * self.sigma_per_m, likely / likely.sum()

    def edge_odds(self, w: float) -> float:
        """The odds that an edge of something at w passes: it stands on the ground as likely as it is of it, and if it
        does, its edge is here as likely as not. (29.12)
        """
        off = (w - self.per_m) / self.sigma_per_m
        of_ground = math.exp(-0.5 * off**2) / (math.sqrt(2.0 * math.pi) * self.sigma_per_m)
        return self.density_m / (2.0 * of_ground + self.density_m)


def behind(patch: Patch, views: Sequence[View], surface: tuple[float, Array], window: Mask, ground: Ground) -> float:
    """Return the variance of a surface's inverse depth that is matched in a window (225,), for the click may be of the
    ground behind it. `surface`: that depth and its slope. (29.13)
    """
    w, likely = ground.depths()
    farther = w < surface[0]
    if not farther.any():
        return 0.0
    w, likely = w[farther], likely[farther]
    unlikelier = _unlikelier(patch, views, surface, window, (w, ground.slope))
    # What fits better still has done so by chance: other pixels of the views, with noise of their own.
    odds = ground.edge_odds(surface[0]) * likely * np.exp(-np.maximum(unlikelier.min(axis=1), 0.0))
    return float(odds @ (w - surface[0]) ** 2) / (1.0 + float(odds.sum()))


def _unlikelier(
    patch: Patch, views: Sequence[View], surface: tuple[float, Array], window: Mask, other: tuple[Array, Array]
) -> Array:
    """Return how much unlikelier, as a logarithm, each half disc is of another surface at inverse depths (K,): (K, T).

    Either by the better half of the views: what hides it in the others does not count. Gain and offset are the
    window's.
    """
    clicked = patch.values - patch.values[window].mean()
    own, others, noises = [], [], []
    for view in views:
        seen = warped(patch, view, np.array([surface[0]]), surface[1])[0][0]
        there = warped(patch, view, *other)[0][:, DISC]
        middle = seen[window].mean()
        seen = seen - middle
        gain = np.float32(clicked[window] @ seen[window] / max(float(seen[window] @ seen[window]), 1e-12))
        left = (clicked - gain * seen) ** 2
        noises.append(float(left[window].mean()))
        own.append(left[None, DISC] @ HALVES)
        others.append((clicked[DISC] - gain * (there - middle)) ** 2 @ HALVES)
    half = max(LEAST_VIEWS, (len(views) + 1) // 2)
    better = [np.sort(each, axis=0)[:half].sum(axis=0) for each in (own, others)]  # (1 or K, T)
    noise = max(float(np.sort(noises)[:half].mean()), LEAST_NOISE)
    return np.asarray((better[1] - better[0]) / (2.0 * CORRELATED * noise), float)
