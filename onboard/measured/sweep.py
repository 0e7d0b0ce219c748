"""A sweep along a clicked pixel's ray: the inverse depths that other pictures agree on. (29.5), (29.6)"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from onboard.measured.patches import OFFSETS, Patch, Values, middles, warped
from onboard.measured.views import View

Array = NDArray[np.float64]

STEP_PX = 0.7  # of the sweep, in the view that moves most
MOST_STEPS = 96
SMALL_PX, ASIDE_PX = 4, 3  # a small window is a square of 9 pixels, up to 3 away from the click
ASIDE = ((0, 0), (-1, -1), (1, -1), (-1, 1), (1, 1))
CORE_PX = 2  # a square of 5 pixels, for what is small
SMALL = len(ASIDE)  # windows of 9 pixels, the first
WHOLE, CORE = SMALL, SMALL + 1  # the numbers of the window that is the whole patch, and of the smallest
LEAST_VIEWS = 3


def windows() -> NDArray[np.float32]:
    """Masks (225, 7) of windows that hold the click: small ones about it and about its diagonals, the whole patch, and
    the pixels next to it.

    Next to an edge one of them lies on the click's own surface.
    """
    small = [np.abs(OFFSETS - np.multiply(aside, ASIDE_PX)).max(axis=1) <= SMALL_PX for aside in ASIDE]
    core = np.abs(OFFSETS).max(axis=1) <= CORE_PX
    return np.stack([*small, np.ones(len(OFFSETS), bool), core], axis=1).astype(np.float32)


WINDOWS = windows()


def correlations(reference: Values, values: Values, masks: NDArray[np.float32] = WINDOWS) -> Array:
    """Normalised correlation of a patch (P,) with patches (K, P), window by window (P, W): (K, W)."""
    count = masks.sum(axis=0)
    middle = np.float32(reference.mean())
    r, v = reference - middle, values - middle
    r_sum, v_sum = r @ masks, v @ masks
    covariance = (v * r) @ masks - v_sum * r_sum / count
    r_square = (r * r) @ masks - r_sum**2 / count
    v_square = (v * v) @ masks - v_sum**2 / count
    return np.asarray(covariance / np.sqrt(np.maximum(r_square * v_square, 1e-6)), float)


def steps_between(patch: Patch, views: Sequence[View], low: float, high: float) -> Array:
    """Inverse depths (K,) from low to high, as close together as the pictures can distinguish."""
    ends = np.array([low, high])
    travel = max(float(np.linalg.norm(np.ptp(middles(patch, view, ends), axis=0))) for view in views)
    return np.linspace(low, high, int(np.clip(np.ceil(travel / STEP_PX) + 1, 8, MOST_STEPS)))


def swept(patch: Patch, views: Sequence[View], w: Array, slope: Array) -> Array:
    """Correlations (V, K, W) of each view at each inverse depth; -1 where the patch is not whole in the view."""
    out = np.full((len(views), len(w), WINDOWS.shape[1]), -1.0)
    for one, view in zip(out, views, strict=True):
        values, inside = warped(patch, view, w, slope)
        one[inside] = correlations(patch.values, values[inside])
    return out


def agreement(each: Array) -> Array:
    """(K, W): the mean of the better half of the views (V, K, W), three at least: what hides the place in the others
    does not count. (29.6)
    """
    most = max(LEAST_VIEWS, (len(each) + 1) // 2)
    return np.asarray(np.sort(each, axis=0)[-most:].mean(axis=0), float)
