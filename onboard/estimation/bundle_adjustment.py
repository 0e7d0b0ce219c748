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
from onboard.estimation.noise_shape import rounded, shape_of
from onboard.estimation.platform_states import PLANE
from onboard.estimation.rolling_shutter import Sweep
from onboard.geometry.linalg import solve_positive
from onboard.geometry.robust import robust_cost
from onboard.geometry.terrain_grid import Terrain

Array = NDArray[np.float64]

DIFFERENCE = 1e-5  # of normalised image coordinates
UNMOVED = 1e-3  # of them: what they move by without their stretch making a difference to steps
_BEHIND = 100.0  # the residual, in sigmas, of a point behind a camera that saw it

# The plane's whitened residuals: their columns (G,), `Problem.ground_columns`, by point (3, P), by columns (G, P).
_Ground = tuple[NDArray[np.intp], Array, Array]


@dataclass(frozen=True, eq=False)
class Problem:
    """One window: image measurements, priors over the camera side, and a soft plane under the points."""

    layout: Layout
    xy: Array  # (K, P, 2) normalised image coordinates, anything where weight is 0
    weight: Array  # (K, P) 1 / sigma in normalised image coordinates; 0 where not seen
    priors: list[Prior]
    reference_enu_m: Array = field(default_factory=lambda: np.zeros(3))  # the plane's reference point
    ground_weight: float = 0.0  # 1 / sigma of the ground (1/m); 0: no plane under the points
    terrain: Terrain | None = None  # what the plane's heights are counted from, if the ground is known
    # The ground's sigma is relative to what a metre of height moves in the pictures, and `ground_weight` holds where
    # that is this (1/m, `parallax_of`); None: it is in metres. In metres least squares prefer whatever takes the points
    # nearer to the plane, a smaller scene or a larger focal length: see (5.9).
    parallax: float | None = None
    # The camera that `xy` was made with, and its own states (C,) in that, where they are estimated: (15.2).
    camera: Camera | None = None
    camera_taken: Array = field(default_factory=lambda: np.zeros(0))
    # The rows' motion, if `xy` is as rows read one after the other saw it; None: all rows at once. (18.3)
    sweep: Sweep | None = None
    # The camera, where its pixels' noise may not be round in these coordinates: (30.4).
    seen_by: Camera | None = None

    @cached_property
    def measured(self) -> Array:
        """`xy` as (K, 2, P): points run along the last axis, so that every operation is one long loop."""
        return np.ascontiguousarray(self.xy.transpose(0, 2, 1))

    @cached_property
    def shape(self) -> Array | None:
        """`shape_of` the measurements' noise, (K, 3, P)."""
        return shape_of(self.seen_by, self.measured)

    @cached_property
    def blocks(self) -> tuple[ImageBlock, ...]:
        return blocks_of(self.layout, self.camera, self.camera_taken, self.sweep)

    @cached_property
    def columns(self) -> NDArray[np.intp]:
        """Column numbers (K, 6 + M) of everything that moves the image coordinates of a picture but its points."""
        views = np.arange(6 * self.layout.keyframes).reshape(-1, 6)
        return np.concatenate([views, *(block.columns for block in self.blocks)], axis=1)

    @cached_property
    def ground_columns(self) -> NDArray[np.intp]:
        """Column numbers (G,) of what moves the ground's residuals: plane, centres, and focal length if estimated."""
        layout, every = self.layout, np.arange(self.layout.size)
        return np.concatenate([every[layout.plane], layout.centres().ravel(), every[layout.camera][:1]])


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
        return np.ascontiguousarray(np.einsum("jip,djp->idp", self.reduced.root, self.reduced.Z).transpose(2, 0, 1))

    @cached_property
    def ground_pull(self) -> Array:
        """(D, P): what one sigma of the ground's deviation under each point adds to the reduced right side. (20.4)"""
        columns, by_point, by_side = self.reduced.ground
        out: Array = -np.einsum("djp,jip,ip->dp", self.reduced.Z, self.reduced.root, by_point)
        out[columns] += by_side
        return out

    @cached_property
    def point_covariance(self) -> Array:
        """(P, 3, 3) of the points given the camera side."""
        root = self.reduced.root
        return np.ascontiguousarray(np.einsum("kip,kjp->ijp", root, root).transpose(2, 0, 1))


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
    ground: tuple[Array, Array, Array]  # `_ground`
    ground_robust: Array  # (P,)
    stiffness: Array
    pull: Array
    cost: float
    moved: Array  # (K, 2, P) image coordinates, by rows read in turn and image states
    by_block: Array | None  # (K, M, 2, P) the same by the states of all blocks


@dataclass(frozen=True, eq=False)
class _Linear:
    """Normal equations (6.2), the coupling W of cameras and points still as its factors: W = by_view' by_point."""

    U: Array  # (D, D)
    V: Array  # (3, 3, P)
    bc: Array  # (D,)
    bp: Array  # (3, P)
    by_view: Array  # (K, 6 + M, 2, P)
    by_point: Array  # (K, 3, 2, P)
    views: NDArray[np.intp]  # (K, 6 + M) columns of the camera side, `Problem.columns`
    ground: _Ground


@dataclass(frozen=True, eq=False)
class Reduced:
    """Schur complement (6.3): S, its right side, and Z = W L^-T with V = L L'."""

    S: Array  # (D, D)
    right: Array  # (D,)
    Z: Array  # (D, 3, P)
    zb: Array  # (3, P) L^-1 bp
    root: Array  # (3, 3, P) L^-1
    ground: _Ground


def evaluate(problem: Problem, state: State, scale: float | None) -> float:
    """The cost (6.1) at a state: half the sum of squares after the loss."""
    return _residuals(problem, state, scale).cost


def image_residuals(problem: Problem, state: State) -> Array:
    """Predicted minus measured image coordinates (K, 2, P), normalised; anything where a point is not seen."""
    return _residuals(problem, state, None).image


def _residuals(problem: Problem, state: State, scale: float | None) -> _Residuals:
    weight = problem.weight
    image, predicted, depth = reprojection(state.R_cam_enu, state.centres_enu_m, state.points_enu_m, problem.measured)
    moved, by_block = _moved(problem, state, predicted, depth)
    image += moved
    round_image = rounded(problem.shape, image)
    squared = round_image[:, 0] ** 2
    squared += round_image[:, 1] ** 2
    squared *= weight
    squared *= weight
    behind = (depth <= 1e-6) & (weight > 0)
    squared[behind] = _BEHIND**2
    loss, robust = robust_cost(squared, scale)
    ground = _ground(problem, state)
    ground_loss, ground_robust = robust_cost(ground[0] ** 2, scale)
    r, J = (np.concatenate(part) for part in zip(*(p.evaluate(state) for p in problem.priors), strict=True))
    stiffness, pull = J.T @ J, J.T @ r
    cost = float(loss.sum() + ground_loss.sum() + r @ r)
    for block in problem.blocks:
        if block.sigma is not None:
            columns, values = block.columns.ravel(), block.values(state).ravel()
            cost += block.sigma**-2 * float(values @ values)
            stiffness[columns, columns] += block.sigma**-2
            pull[columns] += block.sigma**-2 * values
    parts = image, predicted, depth, behind, squared, robust, ground, ground_robust, stiffness, pull
    return _Residuals(state, *parts, 0.5 * cost, moved, by_block)


def _moved(problem: Problem, state: State, predicted: Array, depth: Array) -> tuple[Array, Array | None]:
    """The displacement (K, 2, P) of coordinates by rows read in turn and by image states.

    Second: its derivative (K, M, 2, P) by the states of all blocks; None without blocks.
    """
    moved, by_block = np.zeros_like(predicted), None
    if problem.sweep is not None:
        moved += problem.sweep.readout_s * problem.sweep.by_readout(state.R_cam_enu, predicted, depth)
    if problem.blocks:
        by_block = np.concatenate([b.jacobian(state, predicted, depth) for b in problem.blocks], axis=1)
        moved += np.einsum("kmip,km->kip", by_block, np.concatenate([b.values(state) for b in problem.blocks], axis=1))
    return moved, by_block


def _stretched(problem: Problem, at: _Residuals, *by: Array) -> list[Array]:
    """Correct Jacobians (K, M, 2, P) for a displacement that differs over the picture. (19.1)

    Its gradient is taken by differences. Without it the solver converges slowly: focal length, lens and poses can
    compensate one another.
    """
    if np.abs(at.moved).max() < UNMOVED:
        return list(by)
    gradient = np.empty((len(at.moved), 2, *at.moved.shape[1:]))  # (K, coordinate of where, of what is moved, P)
    for i in range(2):
        aside = at.predicted.copy()
        aside[:, i] += DIFFERENCE
        gradient[:, i] = (_moved(problem, at.state, aside, at.depth)[0] - at.moved) / DIFFERENCE
    return [J + np.einsum("kijp,kmip->kmjp", gradient, J) for J in by]


def _ground(problem: Problem, state: State) -> tuple[Array, Array, Array]:
    """Whitened residuals (P,) of the plane under the points, (5.9), by the point (3, P), by `ground_columns` (G, P)."""
    r, by_point, by_plane = ground_plane(state.points_enu_m, problem.reference_enu_m, state.plane, problem.terrain)
    weight, by_side = problem.ground_weight, np.zeros((len(problem.ground_columns), len(r)))
    if problem.parallax is not None:
        parallax, by_log = _parallax(state.centres_enu_m, problem.reference_enu_m, state.plane)
        log_focal = state.camera[:1]
        weight = weight * (parallax / problem.parallax * float(np.exp(log_focal.sum())))
        by_side = np.outer(np.append(by_log, np.ones(len(log_focal))), weight * r)
    by_side[:PLANE] += weight * by_plane.T
    return weight * r, weight * by_point.T, by_side


def parallax_of(centres_enu_m: Array, reference_enu_m: Array, plane: Array) -> float:
    """The parallax (rad/m, about) of a metre of height over a plane in pictures from views (K, 3). (5.9)"""
    return _parallax(centres_enu_m, reference_enu_m, plane)[0]


def _parallax(centres_enu_m: Array, reference_enu_m: Array, plane: Array) -> tuple[float, Array]:
    """The same, and the derivatives (3 + 3 K,) of its logarithm by the plane and the centres."""
    middle = centres_enu_m.mean(axis=0)
    span, (east, north, up) = centres_enu_m - middle, middle - reference_enu_m
    squared, steep = float(np.sum(span**2)), 1.0 + float(plane[1:] @ plane[1:])
    clearance_m = max(float(up - plane[0] - plane[1] * east - plane[2] * north), 1.0)
    by_clearance = -2.0 / clearance_m
    by_plane = -by_clearance * np.array([1.0, east, north])
    by_plane[1:] += plane[1:] / steep
    by_centre = span / max(squared, 1e-12) + by_clearance / len(span) * np.array([-plane[1], -plane[2], 1.0])
    parallax = float(np.sqrt(steep * squared / len(span))) / clearance_m**2
    return parallax, np.concatenate([by_plane, by_centre.ravel()])


def _linearise(problem: Problem, at: _Residuals) -> _Linear:
    """Normal equations (6.2) in blocks: camera side U, points V, coupling W."""
    K, P = problem.weight.shape
    s = problem.weight * np.sqrt(at.robust)
    s[at.behind] = 0.0
    B, A = _stretched(problem, at, *reprojection_jacobians(at.state.R_cam_enu, at.predicted, at.depth, s))
    J = np.empty((K, problem.columns.shape[1], 2, P))
    J[:, :3] = B
    np.negative(A, out=J[:, 3:6])
    if at.by_block is not None:
        np.multiply(at.by_block, s[:, None, None], out=J[:, 6:])
    J, A = rounded(problem.shape, J), rounded(problem.shape, A)
    r = rounded(problem.shape, at.image) * s[:, None]
    flat, views = J.reshape(K, -1, 2 * P), problem.columns
    U, bc = at.stiffness.copy(), at.pull.copy()
    np.add.at(U, (views[:, :, None], views[:, None]), flat @ flat.transpose(0, 2, 1))
    np.add.at(bc, views, (flat @ r.reshape(K, 2 * P, 1))[..., 0])
    V = np.einsum("kicp,kjcp->ijp", A, A)
    bp = np.einsum("kicp,kcp->ip", A, r)
    rg, gp, gs = (part * np.sqrt(at.ground_robust) for part in at.ground)
    V += gp[:, None] * gp
    bp += gp * rg
    columns = problem.ground_columns
    U[np.ix_(columns, columns)] += gs @ gs.T
    bc[columns] += gs @ rg
    return _Linear(U, V, bc, bp, J, A, views, (columns, gp, gs))


def _point_root(V: Array, damping: float) -> Array:
    """L^-1 of all (3, 3, P) point blocks V = L L'; a tiny ridge keeps a point seen once finite."""
    x, y, z = V.diagonal().T * (1.0 + damping) + (1e-14 * V.trace() + 1e-12)
    root = np.zeros_like(V)
    root[0, 0] = 1.0 / np.sqrt(x)
    l10, l20 = V[1:, 0] * root[0, 0]
    root[1, 1] = 1.0 / np.sqrt(np.maximum(y - l10 * l10, 1e-300))
    l21 = (V[2, 1] - l20 * l10) * root[1, 1]
    root[2, 2] = 1.0 / np.sqrt(np.maximum(z - l20 * l20 - l21 * l21, 1e-300))
    root[1, 0] = -root[1, 1] * l10 * root[0, 0]
    root[2, 1] = -root[2, 2] * l21 * root[1, 1]
    root[2, 0] = -root[2, 2] * (l20 * root[0, 0] + l21 * root[1, 0])
    return root


def _reduce(system: _Linear, damping: float) -> Reduced:
    """Eliminate the points, (6.3)."""
    D, P, K = len(system.U), system.bp.shape[-1], len(system.by_view)
    root = _point_root(system.V, damping)
    J = system.by_view
    A = np.einsum("ijp,kjcp->kcip", root, system.by_point)
    Z = np.zeros((D, 3, P))
    np.einsum("kmip,kijp->kmjp", J[:, :6], A, out=Z[: 6 * K].reshape(K, 6, 3, P))
    for k in range(K * (J.shape[1] > 6)):  # pictures share some of these columns
        Z[system.views[k, 6:]] += np.einsum("mip,ijp->mjp", J[k, 6:], A[k])
    columns, by_point, by_side = system.ground
    Z[columns] += by_side[:, None] * np.einsum("ijp,jp->ip", root, by_point)
    zb = np.einsum("ijp,jp->ip", root, system.bp)
    flat = Z.reshape(D, -1)
    S = system.U - flat @ flat.T
    S.flat[:: D + 1] += damping * system.U.diagonal()
    return Reduced(S, system.bc - flat @ zb.reshape(-1), Z, zb, root, system.ground)


def solve(
    problem: Problem,
    state: State,
    *,
    scale: float | None = 3.0,
    max_iterations: int = 50,
    tolerance: float = 1e-6,
) -> Solution:
    """Minimise (6.1) from `state`. `scale` is the Cauchy loss's, in sigmas; None for plain least squares.

    Stops when a step promises to gain less than `tolerance` of the cost, or after `max_iterations` accepted or refused
    steps.
    """
    at = _residuals(problem, state, scale)
    system = _linearise(problem, at)
    seen = problem.weight > 0
    converged, iterations, damping, growth = False, 0, 1e-8, 2.0
    reduced: Reduced | None = None
    while iterations < max_iterations:
        iterations += 1
        reduced = _reduce(system, damping)
        dc = solve_positive(reduced.S, -reduced.right)
        if dc is None:
            damping = max(damping * 10.0, 1e-6)
            continue
        dp = -np.einsum("jip,jp->ip", reduced.root, reduced.zb + np.tensordot(dc, reduced.Z, 1))
        expected = -0.5 * float(dc @ system.bc + np.sum(dp * system.bp))
        trial = _residuals(problem, at.state.retract(dc, dp.T), scale)
        is_better = trial.cost <= at.cost  # not where it is no number
        at = trial if is_better else at
        if expected <= tolerance * (at.cost + 1e-12) or (not is_better and np.abs(dc).max() < 1e-9):
            # So small a step changes no derivative: what was reduced before it serves the covariances.
            converged = True
            break
        if is_better:
            system = _linearise(problem, at)
            damping, growth = (0.2 * damping if damping > 1e-8 else 0.0), 2.0
        else:
            damping, growth = max(damping, 1e-8) * growth * 2.0, growth * 2.0
            if damping > 1e9:
                break
    if reduced is None or damping > 0.0 or not converged:
        reduced = _reduce(system, 0.0)
    sigmas = np.where(seen, np.sqrt(at.squared), np.nan)
    return Solution(at.state, at.cost, iterations, converged, at.robust, sigmas, reduced)
