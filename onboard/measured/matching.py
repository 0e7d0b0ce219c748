"""A place's inverse depth to a part of a step and its error: least-squares matching in all views at once. (29.7)

The clicked patch and each view's are taken at mean zero and length one. What is left between them, r, a step of the
inverse depth or of the surface's slope explains by J.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from onboard.geometry.robust import student_widening
from onboard.measured.common import in_common
from onboard.measured.patches import OFFSETS, Patch, Values, by_inverse_depth, by_view, shifted
from onboard.measured.views import Features, View

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ROUNDS = 3
SMALL_STEP = 0.1  # sigmas of the pictures' noise: another round would change nothing
LEAST_NOISE = 1e-4  # squared, of a patch of length one: no two pictures agree better
MOST_STEP = 0.05  # of the inverse depth, relative: what runs farther has found another place
APART = 3.0  # sigmas of the pictures' noise: windows whose depths are farther apart are of an uneven surface
CORRELATED = 3.0  # pixels of a picture that are one measurement
SLOPE_SIGMA = 1.0  # of d ln w / d (x, y) about the ground's or the picture's: a roof of 45 degrees seen from above


@dataclass(frozen=True, eq=False)
class Match:
    """Inverse depth (1/m), the surface's slope, and the parts of the depth's variance: the pictures' noise, the poses
    of the views. `rest`: by how much more than by both the views contradict each other, squared, over what is expected.

    `toward_set`: by how much of itself the depth changes to have the errors that the set's features have in common, and
    `by_common`, the variance of that and of what the camera's own errors do.
    """

    inverse_depth_per_m: float
    slope: Array
    by_pictures: float
    by_poses: float
    rest: float
    toward_set: float
    by_common: float
    by_surface: float = 0.0  # how uneven the surface is next to the click
    by_edge: float = 0.0  # the ground behind the surface, which the click may be of
    window: Mask = field(default_factory=lambda: np.ones(len(OFFSETS), bool))  # the pixels (225,) that counted

    @property
    def sigma_per_m(self) -> float:
        """One sigma of the inverse depth. (29.16)"""
        by_views = (self.by_pictures + self.by_poses) * max(self.rest, 1.0)
        return math.sqrt(by_views + self.by_common + self.by_surface + self.by_edge)


@dataclass(frozen=True, eq=False)
class Rows:
    """The V views at the present depth and slope, of the n pixels that count."""

    residual: Array  # (V, n)
    J: Array  # (V, n, 3) by inverse depth and slope
    by_pixel: Array  # (V, n, 2) by the place in the view
    noise: Array  # (V,) squared, of one pixel of the residual


@dataclass(frozen=True, eq=False)
class Warped:
    """The patch in V views at a depth and a slope: values (V, 225), their derivatives by the place in the view
    (V, 225, 2), and the derivative (V, 2) of that place by the depth.
    """

    values: Values
    by_pixel: Array
    by_inverse_depth: Array

    @classmethod
    def at(cls, patch: Patch, views: Sequence[View], w: float, slope: Array) -> Warped:
        """Take the patch from all views at an inverse depth (1/m) and a slope of its surface."""
        each = [shifted(patch, view, w, slope) for view in views]
        by_depth = [by_inverse_depth(patch, view, w) for view in views]
        return cls(np.stack([values for values, _ in each]), np.stack([by for _, by in each]), np.stack(by_depth))


def matched(
    patch: Patch, views: Sequence[View], features: Features, start: tuple[float, Array], windows: Sequence[Mask]
) -> Match | None:
    """Refine an inverse depth and a slope and state the depth's error; None if it runs away.

    `windows`: the pixels (225,) that may count, from the largest window to the smallest. Those of the largest do whose
    depth none within it contradicts. (29.19)
    """
    at = start
    for number, window in enumerate(windows):
        found = _converged(patch, views, at, start[1], window)
        if found is None or not abs(found.w / start[0] - 1.0) < MOST_STEP:
            return None
        at = found.w, found.slope
        within = [_solved(patch, found.there, found.before, each, found.prior) for each in windows[number + 1 :]]
        if not any(_apart(found.last, each) for each in within):
            rows, _, covariance = found.last
            return replace(_with_errors(rows, covariance[0], views, features, (patch, *at)), window=window)
    return None


_Solution = tuple[Rows, Array, Array]  # of one round: the views' rows, the step (3,), its covariance (3, 3)


@dataclass(frozen=True, eq=False)
class _Converged:
    """The end of the steps in one window: depth and slope; the last step, the depth before it, the views there and the
    slope's prior.
    """

    w: float
    slope: Array
    last: _Solution
    before: float
    there: Warped
    prior: tuple[Array, Array]


def _converged(
    patch: Patch, views: Sequence[View], start: tuple[float, Array], usual: Array, window: Mask
) -> _Converged | None:
    """Step until another step would change nothing; None without texture. `usual`: the slope's mean."""
    w, slope = start
    out: _Converged | None = None
    information = np.diag([0.0, SLOPE_SIGMA**-2, SLOPE_SIGMA**-2])
    for _ in range(ROUNDS):
        there = Warped.at(patch, views, w, slope)
        prior = information, np.asarray(information @ [0.0, *(slope - usual)], float)
        last = _solved(patch, there, w, window, prior)
        _, step, covariance = last
        if not covariance[0, 0] > 0.0 or not abs(step[0]) < MOST_STEP * abs(w):
            return None
        out = _Converged(w + float(step[0]), slope + step[1:], last, w, there, prior)
        w, slope = out.w, out.slope
        if step[0] ** 2 < SMALL_STEP**2 * covariance[0, 0]:
            break
    return out


def _solved(patch: Patch, there: Warped, w: float, window: Mask, prior: tuple[Array, Array]) -> _Solution:
    """One step in a window. `prior`: the slope's information, and its pull."""
    rows = linearised(patch, there, w, window)
    J, weighted = rows.J.reshape(-1, 3), (rows.J / rows.noise[:, None, None]).reshape(-1, 3)
    N = prior[0] + weighted.T @ J
    if not N[0, 0] > 0.0:
        return rows, np.zeros(3), np.zeros((3, 3))
    covariance = np.asarray(np.linalg.inv(N), float)
    return rows, np.asarray(covariance @ (rows.residual.ravel() @ weighted - prior[1]), float), covariance


def _apart(large: _Solution, small: _Solution) -> bool:
    """Return whether a window's depth differs from that of one within it by more than the pictures' noise. (29.19)"""
    if not small[2][0, 0] > 0.0:  # no texture
        return False
    of_large, of_small = (
        _by_pictures(rows, _by_residual(rows, covariance[0])) for rows, _, covariance in (large, small)
    )
    # A smaller window that knows the depth as well as the larger one is preferred.
    noise = CORRELATED * max(of_small - of_large, 0.0)
    return float(small[1][0] - large[1][0]) ** 2 > APART**2 * noise


def linearised(patch: Patch, there: Warped, w: float, window: Mask) -> Rows:
    """Return the residuals between the clicked patch and the views', and their derivatives. (29.7)"""
    clicked, _ = normalised(patch.values[window])
    seen, length = normalised(there.values[:, window])
    g = there.by_pixel[:, window]
    g = (g - g.mean(axis=1, keepdims=True)) / length[..., None]
    g -= seen[..., None] * np.einsum("vn,vni->vi", seen, g)[:, None]
    along = (g @ there.by_inverse_depth[..., None])[..., 0]
    J = np.concatenate([along[..., None], w * along[..., None] * patch.by_offset[window]], axis=2)
    residual = clicked - seen
    pixels = residual.shape[1]
    noise = np.maximum((residual**2).sum(axis=1) / max(pixels - 6, 1), LEAST_NOISE / pixels)
    return Rows(residual, J, g, noise)


def normalised(values: Values) -> tuple[Array, Array]:
    """Values (..., n) at mean zero and length one, and their length (..., 1) before."""
    centred = np.asarray(values, float) - np.mean(values, axis=-1, keepdims=True, dtype=float)
    length = np.maximum(np.sqrt((centred**2).sum(axis=-1, keepdims=True)), 1e-6)
    return centred / length, length


def _by_residual(rows: Rows, by_score: Array) -> Array:
    """Return d w / d residual (V, n). `by_score` (3,): the first row of the normal matrix's inverse."""
    return np.asarray(rows.J @ by_score / rows.noise[:, None], float)


def _with_errors(
    rows: Rows, by_score: Array, views: Sequence[View], features: Features, found: tuple[Patch, float, Array]
) -> Match:
    """(29.8) to (29.15). `by_score` (3,): the first row of the normal matrix's inverse; `found`: what, w, slope."""
    patch, w, slope = found
    L = _by_residual(rows, by_score)
    own = (L**2).sum(axis=1) * rows.noise
    by_pictures = _by_pictures(rows, L)
    c, by_camera = _by_views(patch, w, views, np.einsum("vn,vni->vi", L, rows.by_pixel))
    by_noise = np.stack(
        [np.einsum("k,kni->ni", ck, v.by_feature) * v.pixel_sigma_px for ck, v in zip(c, views, strict=True)]
    )
    by_depth = np.sum([ck @ view.by_depth for ck, view in zip(c, views, strict=True)], axis=0)
    posed = (by_noise**2).sum(axis=(1, 2))
    half_common = 0.5 * float((by_noise.sum(axis=0) ** 2).sum())
    by_poses = 0.5 * float(posed.sum()) + half_common + float((by_depth**2).sum())
    apart = (L * rows.residual).sum(axis=1)
    free = max(len(views) - 1, 1)
    rest = float((apart**2 / (own + posed)).sum()) / free * float(student_widening(free)) ** 2
    # Minus d ln w by what all features have in common: through the poses, and by the camera's errors of themselves.
    common = in_common(
        [view.shown for view in views], features.modes, features.relative_sigma**2, features.common_cov,
        features.is_adjusted,
    )  # fmt: skip
    seen = -np.einsum("vk,vkm->m", c, common.by_pose) / w
    missing = np.concatenate([[1.0, *patch.rays[0, :2]], by_camera / w]) - seen
    toward_set, by_common = float(missing @ common.estimate), common.variance(missing) * w * w
    return Match(w, slope, by_pictures, by_poses, rest, toward_set, by_common)


def _by_pictures(rows: Rows, L: Array) -> float:
    """The depth's variance by the pictures' noise. `L`: d w / d residual, (V, n). (29.8)"""
    own = float((L**2).sum(axis=1) @ rows.noise)
    # Half of the residual's noise is the clicked patch's, the same in all views.
    common = L.sum(axis=0)
    return 0.5 * own + 0.5 * float(rows.noise.mean()) * float(common @ common)


def _by_views(patch: Patch, w: float, views: Sequence[View], by_pixel: Array) -> tuple[Array, Array]:
    """Minus d w / d pose (V, 6) of each view, and minus d w / d the camera's errors (5,), of all views together.

    `by_pixel` (V, 2): minus d w / d the click's pixel.
    """
    each = [by_view(patch, view, w) for view in views]
    by_pose, by_camera = (np.stack(by) for by in zip(*each, strict=True))
    return np.einsum("vi,vik->vk", by_pixel, by_pose), np.einsum("vi,vik->k", by_pixel, by_camera)
