"""Bundle adjustment: Levenberg-Marquardt with the points eliminated (Schur complement), and marginal covariances.

Triggs et al. 2000; Engels, Stewenius, Nister 2006; the seed's section 2.2 and figure 5. Equations (6.1) to (6.6).

Measurements lie on a dense (keyframe, point) grid with weight 0 where a point was not seen. In a sliding window most
points are seen by most views, so the grid wastes little, and it makes every step one array operation.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from onboard.residuals import HeightModel, Layout, Prior, State, ground_plane, reprojection, reprojection_jacobians

Array = NDArray[np.float64]

_BEHIND = 100.0  # sigmas charged for a point behind a camera that saw it


@dataclass(frozen=True, eq=False)
class Problem:
    """One window: image measurements, priors over the camera side, and a soft plane under the points."""

    layout: Layout
    xy: Array  # (K, P, 2) unit-depth measurements, anything where weight is 0
    weight: Array  # (K, P) 1 / sigma in unit-depth coordinates; 0 where not seen
    priors: list[Prior]
    reference_enu_m: Array = field(default_factory=lambda: np.zeros(3))  # the plane's reference point
    relief_weight: Array | None = None  # (P,) 1 / sigma_relief (1/m), or None for no plane under the points
    terrain: HeightModel | None = None  # what the plane's heights are counted from, if the ground is known


@dataclass(frozen=True, eq=False)
class Solution:
    """The optimum and what it is worth."""

    state: State
    cost: float
    iterations: int
    converged: bool
    robust_weight: Array  # (K, P) final weights of the loss, 0..1
    residual_sigmas: Array  # (K, P) length of the whitened image residual; nan where not seen
    covariance: Array  # (D, D) of the camera side, points marginalised
    point_gain: Array  # (P, 3, D): E[d point | d camera side] = -point_gain @ d
    point_covariance: Array  # (P, 3, 3) of the points given the camera side


@dataclass(frozen=True, eq=False)
class _Linear:
    U: Array
    V: Array
    W: Array
    bc: Array
    bp: Array
    cost: float
    robust: Array
    sigmas: Array


def robust_cost(squared: Array, scale: float | None) -> tuple[Array, Array]:
    """Cauchy loss of squared sigmas, (6.5): its value and its weight. `scale` None is plain least squares."""
    if scale is None:
        return squared, np.ones_like(squared)
    ratio = squared / scale**2
    return scale**2 * np.log1p(ratio), 1.0 / (1.0 + ratio)


def evaluate(problem: Problem, state: State, scale: float | None) -> float:
    """The cost (6.1) at a state: half the sum of squares after the loss."""
    residual, _, depth = reprojection(state.R_cam_enu, state.centres_enu_m, state.points_enu_m, problem.xy)
    squared = (residual[..., 0] ** 2 + residual[..., 1] ** 2) * problem.weight**2
    squared = np.where((depth <= 1e-6) & (problem.weight > 0), _BEHIND**2, squared)
    total = float(robust_cost(squared, scale)[0].sum())
    for prior in problem.priors:
        r = prior.evaluate(state)[0]
        total += float(r @ r)
    if problem.relief_weight is not None:
        r = (
            ground_plane(state.points_enu_m, problem.reference_enu_m, state.plane, problem.terrain)[0]
            * problem.relief_weight
        )
        total += float(robust_cost(r * r, scale)[0].sum())
    return 0.5 * total


def _linearise(problem: Problem, state: State, scale: float | None) -> _Linear:
    """Normal equations (6.2) in blocks: camera side U, points V, coupling W (P, 3, D)."""
    layout, weight = problem.layout, problem.weight
    K, P = weight.shape
    D = layout.size
    residual, predicted, depth = reprojection(state.R_cam_enu, state.centres_enu_m, state.points_enu_m, problem.xy)
    by_view, by_point = reprojection_jacobians(state.R_cam_enu, predicted, depth)
    squared = (residual[..., 0] ** 2 + residual[..., 1] ** 2) * weight**2
    behind = (depth <= 1e-6) & (weight > 0)
    squared = np.where(behind, _BEHIND**2, squared)
    loss, robust = robust_cost(squared, scale)
    s = weight * np.sqrt(robust) * ~behind
    by_view *= s[..., None, None]
    by_point *= s[..., None, None]
    residual *= s[..., None]

    U = np.zeros((D, D))
    bc = np.zeros(D)
    flat_view = by_view.reshape(K, 2 * P, 6)
    flat_t = flat_view.transpose(0, 2, 1)
    blocks = flat_t @ flat_view
    for k in range(K):
        U[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = blocks[k]
    bc[: 6 * K] = (flat_t @ residual.reshape(K, 2 * P, 1)).reshape(-1)

    W = np.zeros((P, 3, D))
    cross = by_point[..., 0, :, None] * by_view[..., 0, None, :]
    cross += by_point[..., 1, :, None] * by_view[..., 1, None, :]
    W[:, :, : 6 * K] = cross.transpose(1, 2, 0, 3).reshape(P, 3, 6 * K)
    point_rows = by_point.transpose(1, 0, 2, 3).reshape(P, 2 * K, 3)
    point_t = point_rows.transpose(0, 2, 1)
    V = point_t @ point_rows
    bp = (point_t @ residual.transpose(1, 0, 2).reshape(P, 2 * K, 1))[..., 0]

    cost = float(loss.sum())
    if problem.relief_weight is not None:
        r, plane_by_point, by_plane = ground_plane(
            state.points_enu_m, problem.reference_enu_m, state.plane, problem.terrain
        )
        r = r * problem.relief_weight
        plane_loss, plane_robust = robust_cost(r * r, scale)
        w = problem.relief_weight * np.sqrt(plane_robust)
        r = r * np.sqrt(plane_robust)
        gp = w[:, None] * plane_by_point
        gs = w[:, None] * by_plane
        V += gp[:, :, None] * gp[:, None, :]
        bp += gp * r[:, None]
        W[:, :, layout.plane] += gp[:, :, None] * gs[:, None, :]
        U[layout.plane, layout.plane] += gs.T @ gs
        bc[layout.plane] += gs.T @ r
        cost += float(plane_loss.sum())
    for prior in problem.priors:
        r, J = prior.evaluate(state)
        U += J.T @ J
        bc += J.T @ r
        cost += float(r @ r)
    sigmas = np.where(weight > 0, np.sqrt(squared), np.nan)
    return _Linear(U, V, W, bc, bp, 0.5 * cost, robust, sigmas)


def _invert_points(V: Array) -> Array:
    """Inverses of symmetric (P, 3, 3) blocks by cofactors; a tiny ridge keeps a point seen once finite."""
    trace = V[:, 0, 0] + V[:, 1, 1] + V[:, 2, 2]
    ridge = 1e-10 * trace + 1e-12
    a, b, c = V[:, 0, 0] + ridge, V[:, 0, 1], V[:, 0, 2]
    e, f, i = V[:, 1, 1] + ridge, V[:, 1, 2], V[:, 2, 2] + ridge
    m00, m01, m02 = e * i - f * f, c * f - b * i, b * f - c * e
    inverse_det = 1.0 / (a * m00 + b * m01 + c * m02)
    out = np.empty_like(V)
    out[:, 0, 0] = m00
    out[:, 0, 1] = out[:, 1, 0] = m01
    out[:, 0, 2] = out[:, 2, 0] = m02
    out[:, 1, 1] = a * i - c * c
    out[:, 1, 2] = out[:, 2, 1] = b * c - a * f
    out[:, 2, 2] = a * e - b * b
    out *= inverse_det[:, None, None]
    return out


def _reduce(system: _Linear, damping: float) -> tuple[Array, Array, Array, Array]:
    """Schur complement (6.3): S, its right side, point gain Y = V^-1 W (P, 3, D), and V^-1."""
    V, U = system.V, system.U
    D = len(U)
    if damping > 0.0:
        V = V.copy()
        diagonal = np.einsum("pii->pi", V)
        diagonal *= 1.0 + damping
        U = U.copy()
        U[np.diag_indices(D)] *= 1.0 + damping
    V_inverse = _invert_points(V)
    Y = V_inverse @ system.W
    S = U - system.W.reshape(-1, D).T @ Y.reshape(-1, D)
    right = system.bc - Y.reshape(-1, D).T @ system.bp.reshape(-1)
    return S, right, Y, V_inverse


def _solve_positive(S: Array, right: Array) -> Array | None:
    """S x = right for a symmetric positive definite S; None where it is not."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(S), 1e-300))
    factor, info = lapack.dpotrf(S * scale[:, None] * scale[None, :], lower=1)
    if info != 0:
        return None
    x, info = lapack.dpotrs(factor, right * scale if right.ndim == 1 else right * scale[:, None], lower=1)
    if info != 0:
        return None
    out: Array = x * (scale if right.ndim == 1 else scale[:, None])
    return out


def solve(
    problem: Problem,
    state: State,
    *,
    scale: float | None = 3.0,
    max_iterations: int = 25,
    tolerance: float = 1e-6,
    damping: float = 1e-4,
) -> Solution:
    """Minimise (6.1) from `state`. `scale` is the Cauchy loss's, in sigmas; None for plain least squares.

    Stops when a step gains less than `tolerance` of the cost, or after `max_iterations` accepted or refused steps.
    """
    system = _linearise(problem, state, scale)
    converged, iterations, growth = False, 0, 2.0
    while iterations < max_iterations:
        iterations += 1
        S, right, Y, V_inverse = _reduce(system, damping)
        dc = _solve_positive(S, -right)
        if dc is None:
            damping = max(damping * 10.0, 1e-6)
            continue
        dp = -(np.einsum("pij,pj->pi", V_inverse, system.bp) + Y @ dc)
        candidate = state.retract(dc, dp)
        trial = _linearise(problem, candidate, scale)
        if np.isfinite(trial.cost) and trial.cost <= system.cost:
            gain = system.cost - trial.cost
            state, system = candidate, trial
            damping, growth = max(damping * 0.2, 1e-9), 2.0
            if gain <= tolerance * (trial.cost + 1e-12):
                converged = True
                break
        else:
            if np.abs(dc).max(initial=0.0) < 1e-9:
                converged = True
                break
            damping, growth = max(damping, 1e-9) * growth * 2.0, growth * 2.0
            if damping > 1e9:
                break
    S, _, Y, V_inverse = _reduce(system, 0.0)
    inverse = _solve_positive(S, np.eye(len(S)))
    covariance: Array = np.asarray(np.linalg.pinv(S, hermitian=True), float) if inverse is None else inverse
    return Solution(state, system.cost, iterations, converged, system.robust, system.sigmas, covariance, Y, V_inverse)
