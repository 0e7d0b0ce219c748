"""Bundle adjustment: Levenberg-Marquardt with the points eliminated (Schur complement), and marginal covariances.

Triggs et al. 2000; Engels, Stewenius, Nister 2006; the seed's section 2.2 and figure 5. Equations (6.1) to (6.6).

Measurements lie on a dense (keyframe, point) grid with weight 0 where a point was not seen. In a sliding window most
points are seen by most views, so the grid wastes little, and it makes every step one array operation.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from onboard.estimation.factors import (
    Layout,
    Prior,
    State,
    ground_plane,
    reprojection,
    reprojection_jacobians,
)
from onboard.estimation.image_blocks import ImageBlock, blocks_of
from onboard.estimation.rolling_shutter import Sweep
from onboard.geometry.linalg import solve_positive
from onboard.geometry.robust import robust_cost
from onboard.geometry.terrain_grid import Terrain

Array = NDArray[np.float64]

_BEHIND = 100.0  # the residual, in sigmas, of a point behind a camera that saw it
_MAX_LEAP = 0.5  # of its least depth: the longest step of a point


@dataclass(frozen=True, eq=False)
class Problem:
    """One window: image measurements, priors over the camera side, and a soft plane under the points."""

    layout: Layout
    xy: Array  # (K, P, 2) normalised image coordinates, anything where weight is 0
    weight: Array  # (K, P) 1 / sigma in normalised image coordinates; 0 where not seen
    priors: list[Prior]
    reference_enu_m: Array = field(default_factory=lambda: np.zeros(3))  # the plane's reference point
    ground_weight: Array | None = None  # (P,) 1 / sigma of the ground (1/m), or None for no plane under the points
    terrain: Terrain | None = None  # what the plane's heights are counted from, if the ground is known
    # The ground's sigma is relative to what a metre of height moves in the pictures, and `ground_weight` holds where
    # that is this (1/m, `parallax_of`); None: it is in metres. In metres least squares prefer whatever takes the points
    # nearer to the plane, a smaller scene or a larger focal length: see (5.9).
    parallax: float | None = None
    # The camera that `xy` was made with, and its own states (C,) in that, where they are estimated: (15.2).
    camera: Camera | None = None
    camera_taken: Array = field(default_factory=lambda: np.zeros(0))
    # Where `xy` is what each picture's rows saw, one after the other; None: all at once. (18.3)
    sweep: Sweep | None = None

    @cached_property
    def blocks(self) -> tuple[ImageBlock, ...]:
        """States that move image coordinates."""
        return blocks_of(self.layout, self.camera, self.camera_taken, self.sweep)

    @cached_property
    def columns(self) -> NDArray[np.intp]:
        """Column numbers (K, 6 + M) of everything that moves the image coordinates of a picture but its points."""
        views = np.arange(6 * self.layout.keyframes).reshape(-1, 6)
        return np.concatenate([views, *(block.columns for block in self.blocks)], axis=1)


@dataclass(frozen=True, eq=False)
class Solution:
    """The optimum and what it is worth. What only the covariances need is computed when they are first asked for."""

    state: State
    cost: float
    iterations: int
    converged: bool
    robust_weight: Array  # (K, P) final weights of the loss, 0..1
    residual_sigmas: Array  # (K, P) length of the whitened image residual; nan where not seen
    reduced: Reduced  # at the optimum, undamped

    @cached_property
    def covariance(self) -> Array:
        """(D, D) of the camera side, points marginalised."""
        S = self.reduced.S
        covariance = solve_positive(S, np.eye(len(S)))
        return covariance if covariance is not None else np.asarray(np.linalg.pinv(S, hermitian=True), np.float64)

    @cached_property
    def point_gain(self) -> Array:
        """(P, 3, D): E[d point | d camera side] = -point_gain @ d."""
        return np.ascontiguousarray(_backward(self.reduced.factor, self.reduced.Z).transpose(2, 1, 0))

    @cached_property
    def ground_pull(self) -> Array:
        """(D, P): what one sigma of the ground's deviation under each point adds to the reduced right side. (20.4)"""
        r = self.reduced
        out: Array = -np.einsum("djp,jp->dp", r.Z, _forward(r.factor, r.ground_by_point))
        out[r.columns] += r.ground_by_side
        return out

    @cached_property
    def point_covariance(self) -> Array:
        """(P, 3, 3) of the points given the camera side."""
        factor = self.reduced.factor
        each = np.repeat(np.eye(3)[..., None], len(factor[0]), axis=2)
        return np.ascontiguousarray(_backward(factor, _forward(factor, each)).transpose(2, 0, 1))


@dataclass(frozen=True, eq=False)
class _Residuals:
    """Everything at one state that the cost needs; the normal equations start from it."""

    state: State
    image: Array  # (K, 2, P)
    predicted: Array  # (K, 2, P)
    depth: Array  # (K, P)
    behind: NDArray[np.bool_]  # (K, P)
    squared: Array  # (K, P) sigmas
    robust: Array  # (K, P)
    ground: tuple[Array, Array, Array, Array] | None  # residual (P,), by point, by plane, weight of the loss
    stiffness: Array
    pull: Array
    cost: float
    by_block: Array | None  # (K, M, 2, P) how image coordinates move with the states of all blocks


@dataclass(frozen=True, eq=False)
class _Linear:
    """Normal equations (6.2), the coupling W of cameras and points still as its factors: W = by_view' by_point.

    Points run along the last axis, so that every operation is one long loop.
    """

    U: Array  # (D, D)
    V: Array  # (3, 3, P)
    bc: Array  # (D,)
    bp: Array  # (3, P)
    by_view: Array  # (K, 6 + M, 2, P)
    by_point: Array  # (K, 3, 2, P)
    views: NDArray[np.intp]  # (K, 6 + M) columns of the camera side, `Problem.columns`
    columns: NDArray[np.intp]  # of the camera side that the ground depends on
    ground_by_side: Array  # (G, P)
    ground_by_point: Array  # (3, P)


@dataclass(frozen=True, eq=False)
class Reduced:
    """Schur complement (6.3): S, its right side, and Z = W L^-T with V = L L', points along the last axis."""

    S: Array  # (D, D)
    right: Array  # (D,)
    Z: Array  # (D, 3, P)
    zb: Array  # (3, P) L^-1 bp
    factor: tuple[Array, ...]
    columns: NDArray[np.intp]  # of the camera side that the ground depends on
    ground_by_side: Array  # (G, P) whitened
    ground_by_point: Array  # (3, P)


def evaluate(problem: Problem, state: State, scale: float | None) -> float:
    """The cost (6.1) at a state: half the sum of squares after the loss."""
    return _residuals(problem, np.ascontiguousarray(problem.xy.transpose(0, 2, 1)), state, scale).cost


def image_residuals(problem: Problem, state: State) -> Array:
    """Predicted minus measured image coordinates (K, 2, P), normalised; anything where a point is not seen."""
    return _residuals(problem, np.ascontiguousarray(problem.xy.transpose(0, 2, 1)), state, None).image


def _residuals(problem: Problem, xy: Array, state: State, scale: float | None) -> _Residuals:
    weight = problem.weight
    image, predicted, depth = reprojection(state.R_cam_enu, state.centres_enu_m, state.points_enu_m, xy)
    if problem.sweep is not None:
        image += problem.sweep.readout_s * problem.sweep.by_readout(state.R_cam_enu, predicted, depth)
    by_block = None
    if problem.blocks:
        by_block = np.concatenate([b.jacobian(state, predicted, depth) for b in problem.blocks], axis=1)
        image += np.einsum("kmip,km->kip", by_block, np.concatenate([b.values(state) for b in problem.blocks], axis=1))
    squared = image[:, 0] ** 2
    squared += image[:, 1] ** 2
    squared *= weight
    squared *= weight
    behind = (depth <= 1e-6) & (weight > 0)
    squared[behind] = _BEHIND**2
    loss, robust = robust_cost(squared, scale)
    cost = float(loss.sum())
    ground = None
    if problem.ground_weight is not None:
        r, by_point, by_plane = ground_plane(state.points_enu_m, problem.reference_enu_m, state.plane, problem.terrain)
        r = r * (problem.ground_weight * _seen_larger(problem, state))
        ground_loss, ground_robust = robust_cost(r * r, scale)
        cost += float(ground_loss.sum())
        ground = (r, by_point, by_plane, ground_robust)
    priors = [prior.evaluate(state) for prior in problem.priors]
    for r, _ in priors:
        cost += float(r @ r)
    J = np.concatenate([J for _, J in priors])
    stiffness, pull = J.T @ J, J.T @ np.concatenate([r for r, _ in priors])
    for block in problem.blocks:
        if block.sigma is not None:
            columns, values = block.columns.ravel(), block.values(state).ravel()
            cost += block.sigma**-2 * float(values @ values)
            stiffness[columns, columns] += block.sigma**-2
            pull[columns] += block.sigma**-2 * values
    cost *= 0.5
    return _Residuals(state, image, predicted, depth, behind, squared, robust, ground, stiffness, pull, cost, by_block)


def _clearance(centres_enu_m: Array, reference_enu_m: Array, plane: Array) -> float:
    """Mean height (m) of views (K, 3) over the plane, each over the place below it."""
    east, north, up = centres_enu_m.mean(axis=0) - reference_enu_m
    return max(float(up - plane[0] - plane[1] * east - plane[2] * north), 1.0)


def parallax_of(centres_enu_m: Array, reference_enu_m: Array, plane: Array) -> float:
    """How much (rad/m, about) a metre of height over a plane moves in pictures from views (K, 3). (5.9)"""
    span = centres_enu_m - centres_enu_m.mean(axis=0)
    spread_m = float(np.sqrt(np.mean(np.sum(span**2, axis=1))))
    steepness = float(np.hypot(1.0, np.hypot(*plane[1:])))
    return steepness * spread_m / _clearance(centres_enu_m, reference_enu_m, plane) ** 2


def _seen_larger(problem: Problem, state: State) -> float:
    """The factor on the ground residuals' weight: how much more a metre of height moves than at problem.parallax."""
    if problem.parallax is None:
        return 1.0
    grown = float(np.exp(state.camera[0])) if len(state.camera) else 1.0
    return grown * parallax_of(state.centres_enu_m, problem.reference_enu_m, state.plane) / problem.parallax


def _by_seen_larger(problem: Problem, state: State) -> tuple[NDArray[np.intp], Array]:
    """Columns (G,) that the logarithm of that factor depends on, and its derivatives (G,)."""
    layout, centres, plane = problem.layout, state.centres_enu_m, state.plane
    mean = centres.mean(axis=0)
    east, north, _ = mean - problem.reference_enu_m
    by_clearance = -2.0 / _clearance(centres, problem.reference_enu_m, plane)
    by_centre = (centres - mean) / max(float(np.sum((centres - mean) ** 2)), 1e-12)
    by_centre += by_clearance / len(centres) * np.array([-plane[1], -plane[2], 1.0])
    by_plane = -by_clearance * np.array([1.0, east, north])
    by_plane[1:] += plane[1:] / (1.0 + float(plane[1:] @ plane[1:]))
    columns = [np.arange(layout.size)[layout.plane], layout.centres().ravel()]
    by = [by_plane, by_centre.ravel()]
    if layout.camera_states:
        columns, by = [*columns, np.array([layout.camera.start])], [*by, np.ones(1)]
    return np.concatenate(columns), np.concatenate(by)


def _linearise(problem: Problem, at: _Residuals) -> _Linear:
    """Normal equations (6.2) in blocks: camera side U, points V, coupling W."""
    layout = problem.layout
    K, P = problem.weight.shape
    s = problem.weight * np.sqrt(at.robust)
    s[at.behind] = 0.0
    B, A = reprojection_jacobians(at.state.R_cam_enu, at.predicted, at.depth, s)
    J = np.empty((K, problem.columns.shape[1], 2, P))
    J[:, :3] = B
    np.negative(A, out=J[:, 3:6])
    if at.by_block is not None:
        np.multiply(at.by_block, s[:, None, None], out=J[:, 6:])
    r = at.image * s[:, None]
    flat, views = J.reshape(K, -1, 2 * P), problem.columns
    U, bc = at.stiffness.copy(), at.pull.copy()
    np.add.at(U, (views[:, :, None], views[:, None]), flat @ flat.transpose(0, 2, 1))
    np.add.at(bc, views, (flat @ r.reshape(K, 2 * P, 1))[..., 0])
    rows = A.transpose(1, 0, 2, 3).reshape(3, 2 * K, P)
    V = np.empty((3, 3, P))
    for i in range(3):
        for j in range(i + 1):
            np.einsum("kp,kp->p", rows[i], rows[j], out=V[i, j])
            V[j, i] = V[i, j]
    bp = np.einsum("ikp,kp->ip", rows, r.reshape(2 * K, P))
    columns, gs, gp = np.zeros(0, np.intp), np.zeros((0, P)), np.zeros((3, P))
    if at.ground is not None:
        assert problem.ground_weight is not None
        rg, by_point, by_plane, robust = at.ground
        root = np.sqrt(robust)
        w = problem.ground_weight * root * _seen_larger(problem, at.state)
        gp, gs, rg = by_point.T * w, by_plane.T * w, rg * root
        columns = np.arange(layout.size)[layout.plane]
        if problem.parallax is not None:
            columns, by_factor = _by_seen_larger(problem, at.state)
            by_factor = by_factor[:, None] * rg
            by_factor[: len(gs)] += gs
            gs = by_factor
        V += gp[:, None] * gp[None]
        bp += gp * rg
        U[np.ix_(columns, columns)] += gs @ gs.T
        bc[columns] += gs @ rg
    return _Linear(U, V, bc, bp, J, A, views, columns, gs, gp)


def _point_factor(V: Array, damping: float) -> tuple[Array, ...]:
    """Cholesky factors of all (3, 3, P) point blocks; a tiny ridge keeps a point seen once finite.

    Returns reciprocals of the diagonal and the three below it, (P,) each: d0, d1, d2, l10, l20, l21.
    """
    ridge = 1e-10 * (V[0, 0] + V[1, 1] + V[2, 2]) + 1e-12
    grow = 1.0 + damping
    d0 = 1.0 / np.sqrt(V[0, 0] * grow + ridge)
    l10, l20 = V[1, 0] * d0, V[2, 0] * d0
    d1 = 1.0 / np.sqrt(np.maximum(V[1, 1] * grow + ridge - l10 * l10, 1e-300))
    l21 = (V[2, 1] - l20 * l10) * d1
    d2 = 1.0 / np.sqrt(np.maximum(V[2, 2] * grow + ridge - l20 * l20 - l21 * l21, 1e-300))
    return d0, d1, d2, l10, l20, l21


def _forward(factor: tuple[Array, ...], b: Array) -> Array:
    """L^-1 b for b (..., 3, P)."""
    d0, d1, d2, l10, l20, l21 = factor
    z = np.empty_like(b)
    z0, z1, z2 = z[..., 0, :], z[..., 1, :], z[..., 2, :]
    np.multiply(b[..., 0, :], d0, out=z0)
    np.subtract(b[..., 1, :], z0 * l10, out=z1)
    z1 *= d1
    np.subtract(b[..., 2, :], z0 * l20, out=z2)
    z2 -= z1 * l21
    z2 *= d2
    return z


def _backward(factor: tuple[Array, ...], z: Array) -> Array:
    """L^-T z for z (..., 3, P)."""
    d0, d1, d2, l10, l20, l21 = factor
    x = np.empty_like(z)
    x2 = z[..., 2, :] * d2
    x1 = (z[..., 1, :] - l21 * x2) * d1
    x[..., 0, :] = (z[..., 0, :] - l10 * x1 - l20 * x2) * d0
    x[..., 1, :], x[..., 2, :] = x1, x2
    return x


def _reduce(system: _Linear, damping: float) -> Reduced:
    """Eliminate the points, (6.3)."""
    D, P = len(system.U), system.bp.shape[-1]
    K = len(system.by_view)
    factor = _point_factor(system.V, damping)
    J = system.by_view
    A = _forward(factor, system.by_point.transpose(0, 2, 1, 3))
    Z = np.zeros((D, 3, P))
    views = Z[: 6 * K].reshape(K, 6, 3, P)
    np.multiply(J[:, :6, None, 0], A[:, None, 0], out=views)
    views += J[:, :6, None, 1] * A[:, None, 1]
    for k in range(K * (J.shape[1] > 6)):  # pictures share some of these columns
        Z[system.views[k, 6:]] += np.einsum("mip,ijp->mjp", J[k, 6:], A[k])
    if len(system.columns):
        Z[system.columns] += system.ground_by_side[:, None] * _forward(factor, system.ground_by_point)
    zb = _forward(factor, system.bp)
    flat = Z.reshape(D, -1)
    S = system.U - flat @ flat.T
    S.flat[:: D + 1] += damping * system.U.diagonal()
    ground = system.columns, system.ground_by_side, system.ground_by_point
    return Reduced(S, system.bc - flat @ zb.reshape(-1), Z, zb, factor, *ground)


def solve(
    problem: Problem,
    state: State,
    *,
    scale: float | None = 3.0,
    max_iterations: int = 25,
    tolerance: float = 1e-6,
    damping: float = 1e-8,
) -> Solution:
    """Minimise (6.1) from `state`. `scale` is the Cauchy loss's, in sigmas; None for plain least squares.

    Stops when a step promises to gain less than `tolerance` of the cost, or after `max_iterations` accepted or refused
    steps.
    """
    xy = np.ascontiguousarray(problem.xy.transpose(0, 2, 1))
    at = _residuals(problem, xy, state, scale)
    system = _linearise(problem, at)
    seen = problem.weight > 0
    converged, iterations, growth = False, 0, 2.0
    reduced: Reduced | None = None
    while iterations < max_iterations:
        iterations += 1
        reduced = _reduce(system, damping)
        dc = solve_positive(reduced.S, -reduced.right)
        if dc is None:
            damping = max(damping * 10.0, 1e-6)
            continue
        dp = -_backward(reduced.factor, reduced.zb + (dc @ reduced.Z.reshape(len(dc), -1)).reshape(3, -1))
        # A point with little parallax may be sent behind the cameras, from where no derivative brings it back.
        nearest = np.where(seen, at.depth, np.inf).min(axis=0)
        dp *= np.minimum(1.0, _MAX_LEAP * np.maximum(nearest, 1.0) / np.maximum(np.sqrt((dp * dp).sum(axis=0)), 1e-12))
        expected = -0.5 * float(dc @ system.bc + np.sum(dp * system.bp))
        trial = _residuals(problem, xy, at.state.retract(dc, dp.T), scale)
        if np.isfinite(trial.cost) and trial.cost <= at.cost:
            at = trial
            if expected <= tolerance * (at.cost + 1e-12):
                # So small a step changes no derivative: what was reduced before it serves the covariances.
                converged = True
                break
            system = _linearise(problem, at)
            damping, growth = (0.2 * damping if damping > 1e-8 else 0.0), 2.0
        else:
            if expected <= tolerance * (at.cost + 1e-12) or np.abs(dc).max(initial=0.0) < 1e-9:
                converged = True
                break
            damping, growth = max(damping, 1e-8) * growth * 2.0, growth * 2.0
            if damping > 1e9:
                break
    if reduced is None or damping > 0.0 or not converged:
        reduced = _reduce(system, 0.0)
    sigmas = np.where(seen, np.sqrt(at.squared), np.nan)
    return Solution(at.state, at.cost, iterations, converged, at.robust, sigmas, reduced)
