"""A clicked pixel -> its own inverse depth with an error of its own, or why it has none. (29.1) to (29.16)"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Measured
from onboard.measured.edge import ABOUT, LEAST_NOISE, Ground, behind
from onboard.measured.matching import CORRELATED, Match, matched
from onboard.measured.patches import HALF_PX, OFFSETS, SIDE_PX, Patch, Values, warped
from onboard.measured.sweep import CORE, LEAST_VIEWS, SMALL, WHOLE, WINDOWS, agreement, steps_between, swept
from onboard.measured.views import Features, View

Array = NDArray[np.float64]

LEAST_AGREEMENT = 0.7
CLEAR_AGREEMENT = 0.92  # above it patches that face the camera are not tried too
SEES = 0.6  # correlation of a view that sees the place
SAME_STEPS = 3.5  # of the sweep, within which two maxima are of one surface
UNEVEN_STEPS = 6.0
PARABOLA_STEPS = 0.15  # one sigma of where a window's maximum lies between steps, as a parabola has it
TWIN = 0.05  # of correlation: a maximum that is less than this below the best may as well be it
FLAT_GREY = 4.0  # standard deviation of a patch without texture
NEXT = slice(HALF_PX - 1, HALF_PX + 2)  # rows and columns of the click and of the pixels next to it
LEAST_GROUND_SIGMA = 1e-6  # of the logarithm of its inverse depth
NESTED = (WHOLE, 0, CORE)  # windows about the click, from the largest to the smallest
CLEAR = 5.0  # natural logarithm of how much likelier one surface must be than another


@dataclass(frozen=True, eq=False)
class Sought:
    """The range of the search: inverse depths from the farthest to the nearest (1/m); the ground between the features,
    its inverse depth with one sigma of its logarithm, and its slope d ln w / d (x, y).
    """

    far_per_m: float
    near_per_m: float
    ground_per_m: float
    ground_sigma: float
    slope: Array


@dataclass(frozen=True, eq=False)
class _Swept:
    """The sweep's result for every window about the click: its best inverse depth w (W,), how well the views agree
    there (W,), and which of them see it (W, V). `step` is the sweep's.
    """

    w: Array
    agreement: Array
    sees: NDArray[np.bool_]
    slope: Array
    step: float


def measure(patch: Patch, views: Sequence[View], features: Features, sought: Sought) -> Match | Measured:
    """Match the patch in the views and triangulate it; else why that cannot be done."""
    if len(views) < LEAST_VIEWS:
        return Measured.FEW_VIEWS
    found = _sweep(patch, views, sought)
    if isinstance(found, Measured):
        return found
    window = _own(patch, views, found)
    if window is None:
        return Measured.EDGE
    seeing = [view for view, sees in zip(views, found.sees[window], strict=True) if sees]
    if len(seeing) < LEAST_VIEWS:
        return Measured.HIDDEN
    masks = [WINDOWS[:, each] > 0.0 for each in _within(found, window)]
    match = matched(patch, seeing, features, (float(found.w[window]), found.slope), masks)
    if match is None:
        return Measured.NO_TEXTURE
    surface = match.inverse_depth_per_m, match.slope
    by_edge = behind(patch, seeing, surface, match.window, _ground(sought, found.step))
    w = match.inverse_depth_per_m * (1.0 + match.toward_set)
    return replace(match, inverse_depth_per_m=w, by_surface=_uneven(match, found), by_edge=by_edge)


def _within(found: _Swept, window: int) -> list[int]:
    """A window and those about the click that lie within it and are matched on its surface, the largest first."""
    nested = NESTED[NESTED.index(window) :] if window in NESTED else (window,)
    same = np.abs(found.w - found.w[window]) <= SAME_STEPS * found.step
    return [each for each in nested if each == window or (same[each] and found.agreement[each] >= SEES)]


def _uneven(match: Match, found: _Swept) -> float:
    """The variance of a matched depth by how uneven the surface is next to the click: windows that are smaller than a
    patch show it. (29.11)
    """
    small = np.array([*range(SMALL), CORE])
    off = found.w[small] - match.inverse_depth_per_m
    near = np.abs(off) < UNEVEN_STEPS * found.step
    if not near.any():
        return 0.0
    count = WINDOWS.sum(axis=0)[small]
    alone = match.by_pictures * match.window.sum() / count + (PARABOLA_STEPS * found.step) ** 2
    return max(float(np.mean((off**2 - alone)[near])), 0.0)


def _ground(sought: Sought, step: float) -> Ground:
    """Return the ground between the features, on which something may stand anywhere in the sweep."""
    sigma_per_m = max(sought.ground_sigma, LEAST_GROUND_SIGMA) * sought.ground_per_m
    density_m = 1.0 / (sought.near_per_m - sought.far_per_m)
    return Ground(sought.ground_per_m, sigma_per_m, sought.slope, step, density_m)


def _sweep(patch: Patch, views: Sequence[View], sought: Sought) -> _Swept | Measured:
    w = steps_between(patch, views, sought.far_per_m, sought.near_per_m)
    each, slope = swept(patch, views, w, sought.slope), sought.slope
    agreed = agreement(each)
    if agreed[:, 0].max() < CLEAR_AGREEMENT:  # a wall, perhaps: a patch that faces the camera
        facing = swept(patch, views, w, np.zeros(2))
        if (other := agreement(facing))[:, 0].max() > agreed[:, 0].max():
            each, agreed, slope = facing, other, np.zeros(2)
    best = agreed.argmax(axis=0)
    window = np.arange(len(best))
    top = agreed[best, window]
    if top.max() < LEAST_AGREEMENT:
        return Measured.NO_TEXTURE if float(patch.values.std()) < FLAT_GREY else Measured.HIDDEN
    if _is_repeated(agreed[:, 0], int(best[0])) and _is_repeated(agreed[:, WHOLE], int(best[WHOLE])):
        return Measured.REPEATED
    sees = (each[:, best, window] > SEES).T
    return _Swept(w[best] + (w[1] - w[0]) * _part(agreed, best), top, sees, slope, float(w[1] - w[0]))


def _part(agreed: Array, best: NDArray[np.intp]) -> Array:
    """Return each window's maximum as a fraction of a step from the best one: that of a parabola."""
    window = np.arange(agreed.shape[1])
    k = np.clip(best, 1, len(agreed) - 2)
    before, at, after = (agreed[k + i, window] for i in (-1, 0, 1))
    bend = before - 2.0 * at + after
    part = 0.5 * (before - after) / np.where(bend < -1e-9, bend, -1.0)
    return np.where(k == best, np.clip(part, -0.5, 0.5), 0.0)


def _is_repeated(agreed: Array, k: int) -> bool:
    """Return whether another maximum is as good as that at k."""
    inner = np.flatnonzero((agreed[1:-1] >= agreed[:-2]) & (agreed[1:-1] >= agreed[2:])) + 1
    others = agreed[inner[np.abs(inner - k) > SAME_STEPS]]
    return bool(len(others) and others.max() > agreed[k] - TWIN)


def _own(patch: Patch, views: Sequence[View], found: _Swept) -> int | None:
    """The window whose surface the click's own pixels are of; None if that is not clear. (29.6)"""
    squares, noises = _misfits(patch, views, found, np.flatnonzero(found.agreement >= SEES))
    about = np.array([float(ABOUT @ each) if np.isfinite(each[0]) else np.inf for each in squares])
    own = int(np.where(found.agreement >= LEAST_AGREEMENT, about, np.inf).argmin())
    elsewhere = np.abs(found.w - found.w[own]) > SAME_STEPS * found.step
    if elsewhere[CORE]:
        return None
    likelier = (squares[elsewhere] - squares[own]) / (2.0 * CORRELATED * max(noises[own], LEAST_NOISE))
    likelier = likelier[np.isfinite(likelier[:, 0])]
    for each in likelier:
        next_to = cv2.blur(each.reshape(SIDE_PX, SIDE_PX), (3, 3))[NEXT, NEXT]
        # The click's pixels must be of this surface, and those next to it too: an edge is no sharper than a pixel.
        if float(ABOUT @ each) <= CLEAR or float(next_to.min()) <= 0.0:
            return None
    # The largest window of that surface knows its depth best.
    same = ~elsewhere & (found.agreement >= LEAST_AGREEMENT)
    return WHOLE if same[:CORE].all() else 0 if same[0] else own


def _misfits(patch: Patch, views: Sequence[View], found: _Swept, usable: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return each pixel's misfit (W, 225) if it were of a window's surface, the sum of squares (grey levels) over the
    better half of the views, and the mean square of a pixel of the window there (W,); infinite where not usable.
    """
    squares = np.full((len(found.w), len(OFFSETS)), np.inf)
    noises = np.full(len(found.w), np.inf)
    masks = np.asarray(WINDOWS.T[usable], float)  # (U, 225)
    clicked = patch.values - _means(patch.values, masks)
    each = np.empty((len(views), *masks.shape))
    whole = np.empty((len(views), len(usable)), bool)
    for number, view in enumerate(views):
        values, whole[number] = warped(patch, view, found.w[usable], found.slope)
        seen = values - _means(values, masks)
        gain = (masks * clicked * seen).sum(axis=1) / np.maximum((masks * seen**2).sum(axis=1), 1e-12)
        each[number] = (clicked - gain[:, None] * seen) ** 2
    for number, window in enumerate(usable):
        of_views = each[whole[:, number], number]
        half = np.argsort(of_views @ ABOUT)[: max(LEAST_VIEWS, (len(of_views) + 1) // 2)]
        squares[window] = of_views[half].sum(axis=0)
        means = np.sort(of_views[:, masks[number] > 0.0].mean(axis=1))
        noises[window] = float(np.median(means[: len(half)]))
    return squares, noises


def _means(values: Values, masks: Array) -> Array:
    return np.asarray((masks * values).sum(axis=1, keepdims=True) / masks.sum(axis=1, keepdims=True), float)
