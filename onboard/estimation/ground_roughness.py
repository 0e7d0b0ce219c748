"""Ground roughness: how far the ground is from its plane, and over what distance neighbours deviate together.

And how closely a window's points may therefore be held to it. Equations (9.6) and (5.13).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from contract.kriging import distances, on_plane
from onboard.estimation.bundle_adjustment import Problem, Solution
from onboard.estimation.factors import ground_plane
from onboard.geometry.linalg import solve_small
from onboard.geometry.robust import irls, middle
from onboard.geometry.sampling import evenly

Array = NDArray[np.float64]

MIN_PLANE_SIGMA = 2e-4
MIN_ROUGHNESS = 1e-8
ROUGHNESS_RANGES = 3.0 ** np.arange(-3.0, 5.0)  # 1 / correlation length, in 1 / camera heights
MOST_POINTS = 100  # that a window's variogram is estimated from: its cost grows with their cube


def plane_and_roughness(
    H: Array, w: Array, variance: Array, ground_range: float | None = None
) -> tuple[Array, float, float]:
    """The ground plane (3,) in inverse depth, the relative spread about it, its variogram's slope per camera height.

    `ground_range` (1/m): one over the ground's correlation length where that is known of the same ground. It is then
    not estimated again: how far the ground is correlated does not change between pictures that show it.
    """
    plane, relative = _plane(H, w, variance)
    spread = _spread(relative, variance)
    if ground_range is not None:
        height_m = 1.0 / float(np.linalg.norm(plane))
        return plane, spread, max(ground_range * height_m * spread * spread, MIN_ROUGHNESS)
    return plane, spread, _roughness(on_plane(H[:, 1:], plane), relative, variance, spread)


def _spread(relative: Array, variance: Array) -> float:
    """One sigma of the ground about the plane: the spread beyond the features' noise, noisy ones weighted less."""
    s2 = 2.2 * middle(relative**2)  # of a normal distribution, the square's median is 0.455 of its mean
    squared = np.minimum(relative**2, 16.0 * (s2 + variance))
    for _ in range(3):
        weight = 1.0 / (variance + s2 + MIN_PLANE_SIGMA**2) ** 2
        s2 = max(float(weight @ (squared - variance)) / float(weight.sum()), 0.0)
    return max(float(np.sqrt(s2)), MIN_PLANE_SIGMA)


def _plane(H: Array, w: Array, variance: Array) -> tuple[Array, Array]:
    """Robust affine fit of inverse depth (3.1) and each feature's relative deviation from it."""
    scale = middle(w)
    relative_w, known = w / scale, 1.0 / (variance + 1e-4)

    def fit(weight: Array) -> tuple[Array, Array]:
        weighted = (H * weight[:, None]).T
        N = weighted @ H
        N.flat[::4] += 1e-9 * N.trace()
        plane = solve_small(N, weighted @ relative_w)
        return plane, relative_w - H @ plane

    plane, _ = irls(fit, known, lambda miss: (miss / (3.0 * max(1.4826 * middle(np.abs(miss)), 1e-6))) ** 2)
    plane *= scale
    fitted = H @ plane
    relative = np.where(fitted > 1e-3 * scale, w / np.where(fitted > 1e-3 * scale, fitted, 1.0) - 1.0, 0.0)
    return plane, relative


def _roughness(places: Array, relative: Array, variance: Array, spread: float) -> float:
    """Slope of the variogram of relative inverse depth at distance zero: the likeliest for these features. (9.6)

    `places` (N, 3) of features on the ground's plane, in camera heights; linear in them is the trend.
    The field is the one that kriging interpolates, (9.8), with its trend and nuggets.
    """
    s2 = spread * spread
    distance = distances(places, places)
    known = places @ places.T + np.diag(variance + 1e-12)
    value = np.clip(relative, -5.0 * np.sqrt(s2 + variance), 5.0 * np.sqrt(s2 + variance))

    def unlikely(log_slope: float) -> float:
        K = np.multiply(distance, -np.exp(log_slope) / s2)
        np.exp(K, out=K)
        K *= s2
        K += known
        # Symmetric, so that its transpose is it, in the order of LAPACK: factored where it is, without a copy.
        factor, info = lapack.dpotrf(K.T, lower=1, clean=0, overwrite_a=1)
        if info != 0:
            return np.inf
        whitened, _ = lapack.dtrtrs(factor, value, lower=1)
        return float(np.log(np.diag(factor)).sum() + 0.5 * (whitened @ whitened))

    # Correlation lengths from 27 camera heights down to an eightieth of one.
    ladder = np.log(s2) + np.log(ROUGHNESS_RANGES)
    costs = [unlikely(float(step)) for step in ladder]
    k = int(np.argmin(costs))
    best = ladder[k]
    if 0 < k < len(ladder) - 1 and np.all(np.isfinite(costs[k - 1 : k + 2])):
        left, here, right = costs[k - 1 : k + 2]  # of equal ones `here` is the first, so `left` is above it
        best += 0.5 * (left - right) / (left - 2.0 * here + right) * (ladder[1] - ladder[0])
    return max(float(np.exp(best)), MIN_ROUGHNESS)


def correlated(problem: Problem, first: Solution, ground_weight: float) -> float:
    """1 / sigma (1/m) of the ground for correlated deviations: no more than `ground_weight`. (5.13)"""
    s = first.state
    height, _, _ = ground_plane(s.points_enu_m, problem.reference_enu_m, s.plane, problem.terrain)
    seen = np.isfinite(height) & (np.count_nonzero(problem.weight > 0, axis=0) >= 2)
    offset = (s.points_enu_m - problem.reference_enu_m)[seen, :2]
    clearance_m = float((s.centres_enu_m[:, 2]).mean() - np.median(s.points_enu_m[seen, 2]))
    sigma_m = effective_sigma_m(offset, height[seen], first.point_covariance[seen, 2, 2], clearance_m)
    return min(ground_weight, 1.0 / max(sigma_m, 1e-3))


def effective_sigma_m(offset_m: Array, height_m: Array, variance_m2: Array, clearance_m: float) -> float:
    """One sigma (m) to give each of P heights, as if independent, for their plane to be as sure of its slope as it is.

    Neighbours on a hill are off the plane together, so they carry less information. `offset_m` (P, 2) places about
    their middle, `height_m` (P,) over any plane, `variance_m2` (P,) of their noise; `clearance_m`: height above ground.
    Equation (5.13).
    """
    if len(height_m) < 8 or not clearance_m > 0.0:
        return 0.0
    some = evenly(len(height_m), MOST_POINTS)
    H = np.concatenate([np.ones((len(some), 1)), offset_m[some] / clearance_m], axis=1)
    value, noise = height_m[some] / clearance_m, variance_m2[some] / clearance_m**2
    weighted = (H / (noise + max(middle(np.abs(value - middle(value))), 1e-4) ** 2)[:, None]).T
    relative = value - H @ solve_small(weighted @ H, weighted @ value)
    spread = _spread(relative, noise)
    slope = _roughness(H, relative, noise, spread)
    across, _ = np.linalg.qr(H)
    correlation = np.exp(distances(H, H) * (-slope / spread**2))
    # The two slopes' variance with correlated deviations over that with independent ones.
    effect = float((across[:, 1:] * (correlation @ across[:, 1:])).sum()) / 2.0
    effect = 1.0 + max(effect - 1.0, 0.0) * len(height_m) / len(some)
    return spread * clearance_m * float(np.sqrt(effect))
