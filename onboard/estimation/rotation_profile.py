"""How well a window's orientation is known where its covariance cannot say: the cost's profile along its weakest turn.

A covariance is the cost's curvature at its minimum. Of a climb without attitude the valley along the heading is wider
than that, or has another bottom. So all views are held turned as one, at three sigmas either way and all round, and all
else is solved for again: what the cost has risen by there is what such a turn is really worth. Equation (16.10).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import exp_so3, log_so3, right_jacobian_inverse
from onboard.estimation.bundle_adjustment import Problem
from onboard.estimation.factors import Layout, Prior, State
from onboard.estimation.keyframe import Keyframe, have_attitude, turned
from onboard.estimation.pixel_noise import fit_of, view_states
from onboard.estimation.solved_window import Solved
from onboard.estimation.window_acceptance import MIN_AHEAD, share_below
from onboard.estimation.window_problem import approximate
from onboard.estimation.window_request import Outcome, Request, Weighed
from onboard.geometry.plane_fit import fit_plane

Array = NDArray[np.float64]

MAX_ROTATION_SIGMA_DEG = 20.0  # above it a turn's second order, which no covariance has, is a fifth of its first
FAR_SIGMAS = 3.0
HELD = 0.01  # rad, how closely a turn is held
AROUND_RAD = np.radians(np.arange(45.0, 360.0, 45.0))  # valleys for which this is asked are as wide as these are apart


@dataclass(frozen=True, eq=False)
class TurnPrior:
    """All views are turned as one about this axis by nothing from where they were; one residual."""

    layout: Layout
    R_cam_enu: Array  # (K, 3, 3) where they were
    axis_enu: Array  # (3,)
    sigma_rad: float

    def evaluate(self, state: State) -> tuple[Array, Array]:
        """Residual (1,), Jacobian (1, D)."""
        w = log_so3(self.R_cam_enu.transpose(0, 2, 1) @ state.R_cam_enu)
        J = np.zeros((1, self.layout.size))
        by_view = np.einsum("i,kij,klj->kl", self.axis_enu, right_jacobian_inverse(w), state.R_cam_enu)
        J[0, self.layout.rotations()] = by_view / (len(w) * self.sigma_rad)
        return np.array([self.axis_enu @ w.mean(axis=0) / self.sigma_rad]), J


def weakest_turn(solved: Solved) -> tuple[Array, float]:
    """The axis (3,), ENU, of the turn of all views as one that is known least, and its one sigma (rad)."""
    R = solved.solution.state.R_cam_enu
    C = solved.solution.covariance[np.ix_(*[solved.layout.rotations().ravel()] * 2)]
    as_one = np.concatenate(list(R), axis=0).T / len(R)  # (3, 3K)
    variances, axes = np.linalg.eigh(as_one @ C @ as_one.T)
    return axes[:, -1], float(np.sqrt(variances[-1]))


def heading_unknown(turn_deg: float) -> str:
    """Why a window is refused whose rotation has so large a sigma, and what to do."""
    turn_deg = min(turn_deg, 180.0)
    return f"heading hardly known: to {turn_deg:.0f} degrees only, fly a straight leg, or send the attitude"


def by_profile(request: Request, found: Outcome) -> tuple[Outcome, tuple[Keyframe, ...] | None]:
    """An accepted window without attitude, its variances as wide as the cost shows; refused where that is too wide.

    And where the cost is lower elsewhere, the keyframes as they are there. As it is where three sigmas of its weakest
    turn are less than MAX_ROTATION_SIGMA_DEG: a covariance holds there. (16.10)
    """
    solved = found.solved
    if solved is None or found.weighed is None or have_attitude(request.keyframes):
        return found, None
    axis, sigma_rad = weakest_turn(solved)
    if np.degrees(FAR_SIGMAS * sigma_rad) < MAX_ROTATION_SIGMA_DEG:
        return found, None
    angles = np.append(AROUND_RAD, [FAR_SIGMAS * sigma_rad, -FAR_SIGMAS * sigma_rad])
    held = [_held(found.weighed, axis, float(angle)) for angle in (0.0, *angles)]
    risen = np.array([cost for cost, _ in held[1:]]) - held[0][0]
    wide_rad = float(np.max(2.0 * np.abs(np.sin(0.5 * angles)) / np.sqrt(2.0 * np.maximum(risen, 1e-6))))
    if np.degrees(wide_rad) <= MAX_ROTATION_SIGMA_DEG:
        wider = max(wide_rad / sigma_rad, 1.0)
        return replace(found, solved=replace(solved, variance_factor=solved.variance_factor * wider**2)), None
    reason = heading_unknown(float(np.degrees(wide_rad)))
    refused = replace(found, status=Status.LOW_PARALLAX, keyframes=request.keyframes, solved=None, reason=reason)
    lowest, state = min(held, key=lambda h: h[0])
    return refused, turned(request.keyframes, state.R_cam_enu) if lowest < held[0][0] else None


def _held(found: Weighed, axis_enu: Array, angle_rad: float) -> tuple[float, State]:
    """The cost where all views are held turned by this angle, in units of the noise as it was found, and the state."""
    first, problem = found.solution, found.problem
    start = turned_as_one(first.state, angle_rad * axis_enu, problem)
    held = TurnPrior(problem.layout, start.R_cam_enu, axis_enu, HELD)
    priors = [*problem.priors, cast(Prior, held)]  # no sensor's, but the solver asks nothing else of one
    solution = approximate(replace(problem, priors=priors), start)
    if share_below(solution.state, problem.weight > 0) < MIN_AHEAD:
        return np.inf, start  # turned over: the ground is not above the aircraft
    r = held.evaluate(solution.state)[0]
    scale = max(fit_of(first.residual_sigmas, view_states(problem.layout)), 1.0) ** 2
    return (solution.cost - 0.5 * float(r @ r)) / scale, solution.state


def turned_as_one(state: State, turn_enu_rad: Array, problem: Problem) -> State:
    """Views, points and the ground's plane turned about the middle of the views, so that pictures stay what they are.

    Views are turned by `turn_enu_rad` (3,) of their own axes, what they see by its opposite.
    """
    E, middle = exp_so3(turn_enu_rad), state.centres_enu_m.mean(axis=0)
    points, centres = ((x - middle) @ E + middle for x in (state.points_enu_m, state.centres_enu_m))
    plane = state.plane
    if problem.terrain is None:
        plane, _ = fit_plane(points - problem.reference_enu_m)
    return replace(state, R_cam_enu=state.R_cam_enu @ E, centres_enu_m=centres, points_enu_m=points, plane=plane)
