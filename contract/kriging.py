"""Inverse depth between the features: universal kriging of its ratio to the ground plane.

What is interpolated is r = w / w_plane - 1, the ground's height over the plane in units of the camera's: zero on flat
ground but for a linear trend, which is what noise left in the plane's fit (docs/mathematics.md section 9; Cressie 1993,
section 3.4). It is a field on the ground, so places and distances are those where rays meet the plane: turning the
camera changes no answer. Each feature's own variance is its nugget, so neighbours average their noise away instead of
passing it on, as the three corners of a Delaunay triangle do; and kriging gives the variance of its prediction, from
the distance to the features and the ground's roughness. Delaunay interpolation was the first design:
tests/contract/test_kriging.py compares both.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# With fewer features than this the trend is not estimated: the plane is taken as it was sent.
MIN_TREND_FEATURES = 6
# One sigma of the trend's prior. Loose (the ground's inverse depth is known to a factor of two), so that it only
# matters where the features leave a direction of the trend undetermined.
TREND_SIGMA = 1.0
LEAST_HALF = 32  # rows; below, one call of NumPy is faster
SURFACE_NUGGET = 1e-8  # of a feature that is on a surface known before
OUTERMOST, MIN_OUTERMOST = 0.2, 2  # share and least number of features that stand for what is beyond all of them
AS_STATED = 2.0  # directions in which they are as far off as stated, assumed before any is looked at
# A plane's inverse depth below this share of its largest over the features is too near the horizon to be divided by.
MIN_PLANE_SHARE = 0.02
_ANGLES = 0.25 * np.pi * np.arange(8)
EIGHT = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


class Kriging:
    """Prediction of r at any (x, y) from features at `xy` (N, 2) with values `r` (N,) and variances `nugget` (N,).

    `plane` (3,): the ground's, w = a + b x + c y. `slope` is that of the ground's variogram at distance zero, per
    camera height, `sill_sigma` the one sigma it levels off at: gamma(d) = s^2 (1 - exp(-slope d / s^2)). Everything
    that does not depend on the click is solved here, once.

    `is_surface`: the features are not measured but are on a surface known before. They give exactly where that is;
    the ground differs from it by at least `nugget`, at a click as at the feature next to it, and no average makes that
    less.

    Beyond the features' `hull` the ground is extrapolated, and hills leave their plane by more than the dispersion
    within it: what the outermost features show of that, predicted by all others, counts there. (9.19)
    """

    def __init__(
        self,
        xy: Array,
        r: Array,
        nugget: Array,
        plane: Array,
        slope: float,
        sill_sigma: float,
        *,
        is_surface: bool = False,
    ) -> None:
        self._xy, self._plane = xy, plane
        self._places = on_plane(xy, plane)
        self._sill = sill_sigma**2
        self._slope = slope
        n = len(r)
        prior = TREND_SIGMA**2 if n >= MIN_TREND_FEATURES else 0.0
        # Rounding of the wire and of this solve: 1e-8 of relative depth, 3 micrometres at 300 m.
        apart = distances(self._places, self._places)
        measured = np.full(n, SURFACE_NUGGET) if is_surface else nugget
        self._nugget = measured
        self._astray = nugget if is_surface and n > 1 else None
        self._spacing = float(np.median(np.sort(apart, axis=1)[:, 1])) if n > 1 else 1.0
        K = self._covariance(apart) + np.diag(measured + 1e-16)
        self._whiten = _whitening(K)
        self._trend = self._whiten @ self._places  # (N, 3)
        white = self._whiten @ r
        self._trend_cov = np.zeros((3, 3))
        if prior:
            inverse = _whitening(self._trend.T @ self._trend + np.eye(3) / prior)
            self._trend_cov = inverse.T @ inverse
        self._beta = self._trend_cov @ (self._trend.T @ white)
        self._residual = white - self._trend @ self._beta  # (N,)
        self.hull = convex_hull(xy)
        self._is_surface = is_surface

    def predict(self, xy: Array) -> tuple[Array, Array]:
        """r (..., M) at points (..., M, 2) and the covariance (..., M, M) of its errors: each group of M by itself."""
        groups = xy.shape[:-1]
        places, away, known, left = self._from_features(xy.reshape(-1, 2))
        r, grown = places @ self._beta + known @ self._residual, np.sqrt(self._grown(xy.reshape(-1, 2)))
        nearest = None if self._astray is None else self._astray[np.argmin(away, axis=1)].reshape(groups)
        places, known, left = (found.reshape(*groups, -1) for found in (places, known, left))
        apart = distances(places, places)
        covariance = self._covariance(apart) - known @ _turned(known) + left @ self._trend_cov @ _turned(left)
        if nearest is not None:
            # A rough surface is rough by its own errors too: what interpolation allows for already is not added again.
            stated = np.diagonal(covariance, axis1=-2, axis2=-1)
            sigma = np.sqrt(np.maximum(nearest - stated, 0.0))
            covariance = covariance + _outer(sigma) * np.exp(-apart / max(self._spacing, 1e-9))
        return r.reshape(groups), covariance * _outer(grown.reshape(groups))

    def predict_each(self, xy: Array) -> tuple[Array, Array]:
        """r (M,) at points (M, 2) and the variances (M,) of its errors: `predict` of each as a group by itself."""
        r, covariance = self.predict(xy[:, None])
        return r[:, 0], covariance[:, 0, 0]

    def values(self, xy: Array) -> Array:
        """r (M,) at points (M, 2) alone."""
        places, _, known, _ = self._from_features(xy)
        out: Array = places @ self._beta + known @ self._residual
        return out

    def measured_variance(self, xy: Array) -> Array:
        """The part (M,) of the variances at points (M, 2) that comes from the features' own noise.

        The rest is the ground's between the features. (17.1)
        """
        _, _, known, left = self._from_features(xy)
        weights = (known + left @ self._trend_cov @ self._trend.T) @ self._whiten  # (M, N) of the features
        return np.asarray((weights**2) @ self._nugget, np.float64)

    def _from_features(self, xy: Array) -> tuple[Array, Array, Array, Array]:
        """Return for points (M, 2) their places (M, 3), distances to the features (M, N), whitened covariance with the
        features (M, N), and what that covariance leaves of the trend (M, 3).
        """
        places = on_plane(xy, self._plane)
        away = distances(places, self._places)
        known = self._covariance(away) @ self._whiten.T
        return places, away, known, places - known @ self._trend

    def _shown_beyond(self) -> float:
        """The factor on variances beyond the hull: how far off all others predict the outermost features. (9.19)

        Of each of eight directions the outermost fifth, mean squares over their variances.
        """
        if len(self._xy) < MIN_OUTERMOST / OUTERMOST:
            return 1.0
        by_trend = self._whiten.T @ self._trend
        inverse = self._whiten.T @ self._whiten - by_trend @ self._trend_cov @ by_trend.T
        missed = self._whiten.T @ self._residual
        squares = []
        for direction in EIGHT:
            along = self._xy @ direction
            rows = np.nonzero(along >= np.quantile(along, 1.0 - OUTERMOST))[0]
            covariance = np.linalg.inv(inverse[np.ix_(rows, rows)])
            squares.append(float(np.mean((covariance @ missed[rows]) ** 2 / np.diag(covariance))))
        return max(1.0, (AS_STATED + sum(squares)) / (AS_STATED + len(squares)))

    @cached_property
    def _beyond(self) -> float:
        """The factor of (9.19), computed when the first click beyond the hull needs it: most sets get no such click."""
        return 1.0 if self._is_surface else self._shown_beyond()

    def _grown(self, xy: Array) -> Array:
        """The factor (M,) on the variances at points (M, 2)."""
        outside = distances_outside(self.hull, xy) > 0.0
        return np.where(outside, self._beyond, 1.0) if np.any(outside) else np.ones(len(xy))

    def _covariance(self, distance: Array) -> Array:
        if self._sill == 0.0 or self._slope == 0.0:
            # A ground without roughness may still be off the plane as a whole: that is common to all of it.
            return np.full_like(distance, self._sill)
        return self._sill * np.exp(-(self._slope / self._sill) * distance)


def _whitening(covariance: Array) -> Array:
    """W (N, N) with W' W the inverse of a covariance: that of its Cholesky factor.

    Where rounding leaves no factor (features in one place, next to no noise) each gets as much more noise as it takes.
    """
    rounding = float(np.finfo(float).eps * np.trace(covariance))
    for added in (0.0, *(rounding * 10.0**power for power in range(8))):
        try:
            factor = np.linalg.cholesky(covariance + added * np.eye(len(covariance)))
        except np.linalg.LinAlgError:
            continue
        return _inverse_of_lower(np.asarray(factor, np.float64))
    raise np.linalg.LinAlgError("no covariance: far from positive definite")


def _inverse_of_lower(factor: Array) -> Array:
    """The inverse of a lower-triangular matrix by halves: NumPy has no solve that uses the zeros."""
    n = len(factor)
    if n <= LEAST_HALF:
        return np.asarray(np.tril(np.linalg.inv(factor)), np.float64)
    half = n // 2
    out = np.zeros_like(factor)
    first = out[:half, :half] = _inverse_of_lower(factor[:half, :half])
    second = out[half:, half:] = _inverse_of_lower(factor[half:, half:])
    out[half:, :half] = -second @ (factor[half:, :half] @ first)
    return out


def on_plane(xy: Array, plane: Array) -> Array:
    """Points (N, 3) where rays (N, 2) meet the plane w = a + b x + c y; unit: the camera's height above it. (9.20)"""
    H = np.concatenate([np.ones((len(xy), 1)), xy], axis=1)
    return H / _below_horizon(xy, plane)[:, None]


def stretch(xy: Array, plane: Array) -> float:
    """The length on that plane of a unit of (x, y) at the mean of rays (N, 2): the root of an area's. (9.20)"""
    return float(_below_horizon(np.mean(xy, axis=0)[None], plane)[0]) ** -1.5 if len(xy) else 1.0


def _below_horizon(xy: Array, plane: Array) -> Array:
    """Inverse depths (N,) of the plane in units of the camera's height above it, towards the horizon no less than
    `MIN_PLANE_SHARE`.
    """
    w = (plane[0] + xy @ plane[1:]) / max(float(np.linalg.norm(plane)), 1e-12)
    out: Array = np.maximum(w, MIN_PLANE_SHARE)
    return out


def distances(a: Array, b: Array) -> Array:
    """Between every two places (..., M, D) and (..., N, D): (..., M, N)."""
    out: Array = np.zeros((*a.shape[:-1], b.shape[-2]))
    for axis in range(a.shape[-1]):
        along = a[..., :, None, axis] - b[..., None, :, axis]
        along *= along
        out += along
    return np.asarray(np.sqrt(out), np.float64)


def _turned(rows: Array) -> Array:
    return np.swapaxes(rows, -1, -2)


def _outer(a: Array) -> Array:
    return a[..., :, None] * a[..., None, :]


def convex_hull(points: Array) -> Array:
    """Corners (K, 2) of the convex hull, counter-clockwise; fewer than three if the points do not span an area.

    Andrew's monotone chain (1979).
    """
    ordered: list[tuple[float, float]] = sorted({(float(x), float(y)) for x, y in points})

    def half(path: list[tuple[float, float]]) -> list[tuple[float, float]]:
        chain: list[tuple[float, float]] = []
        for x, y in path:
            while len(chain) > 1:
                (ax, ay), (bx, by) = chain[-2:]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0:
                    break
                chain.pop()
            chain.append((x, y))
        return chain[:-1]

    return np.array(half(ordered) + half(ordered[::-1])).reshape(-1, 2)


def hull_area(hull: Array) -> float:
    """Area of a polygon, 0 with fewer than three corners."""
    if len(hull) < 3:
        return 0.0
    x, y = hull.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def distances_outside(hull: Array, xy: Array) -> Array:
    """Distances (M,) from points (M, 2) to a convex polygon, 0 inside; infinite for a hull without area."""
    if len(hull) < 3:
        return np.full(len(xy), np.inf)
    edges = np.concatenate([hull[1:], hull[:1]]) - hull
    to_point = xy[:, None] - hull
    is_in = np.all(edges[:, 0] * to_point[..., 1] - edges[:, 1] * to_point[..., 0] >= -1e-12, axis=1)
    if is_in.all():  # as most clicks are
        return np.zeros(len(xy))
    along = np.clip((edges * to_point).sum(axis=-1) / (edges**2).sum(axis=1), 0.0, 1.0)
    distance = np.linalg.norm(to_point - along[..., None] * edges, axis=-1).min(axis=1)
    return np.where(is_in, 0.0, distance)
