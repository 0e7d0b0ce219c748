"""How well a window's orientation is known where its covariance cannot say: the cost's profile along its weakest turn.

A covariance is the cost's curvature at its minimum. Of a climb without attitude the valley along the heading is wider
than that, or has another bottom. So all views are held as one at three sigmas from the minimum, either way, and all
else is solved for again: what the cost has risen by is what three sigmas are really worth. Equation (16.10).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import exp_so3, log_so3, right_jacobian_inverse
from onboard.estimation.factors import Layout, Prior, State
from onboard.estimation.keyframe import have_attitude, turned
from onboard.estimation.pixel_noise import fit_of, view_states
from onboard.estimation.second_start import as_seen_by
from onboard.estimation.solved_window import Solved
from onboard.estimation.window_problem import WindowProblem, approximate, from_request
from onboard.estimation.window_request import Outcome, Request

Array = NDArray[np.float64]

MAX_ROTATION_SIGMA_DEG = 20.0  # above it a turn's second order, which no covariance has, is a fifth of its first
FAR_SIGMAS = 3.0
HELD = 0.02  # of that turn: how closely it is held


@dataclass(frozen=True, eq=False)
class TurnPrior:
    """All views turned as one, by this angle about this axis, from where they were; one residual."""

    layout: Layout
    R_cam_enu: Array  # (K, 3, 3) where they were
    axis_enu: Array  # (3,)
    angle_rad: float

    def evaluate(self, state: State) -> tuple[Array, Array]:
        """Residual (1,), Jacobian (1, D)."""
        sigma_rad = HELD * abs(self.angle_rad)
        w = log_so3(self.R_cam_enu.transpose(0, 2, 1) @ state.R_cam_enu)
        J = np.zeros((1, self.layout.size))
        by_view = np.einsum("i,kij,klj->kl", self.axis_enu, right_jacobian_inverse(w), state.R_cam_enu)
        J[0, self.layout.rotations()] = by_view / (len(w) * sigma_rad)
        return np.array([(self.axis_enu @ w.mean(axis=0) - self.angle_rad) / sigma_rad]), J


def weakest_turn(solved: Solved) -> tuple[Array, float]:
    """The axis (3,), ENU, of the turn of all views as one that is known least, and its one sigma (rad)."""
    R = solved.solution.state.R_cam_enu
    C = solved.solution.covariance[np.ix_(*[solved.layout.rotations().ravel()] * 2)]
    as_one = np.concatenate(list(R), axis=0).T / len(R)  # (3, 3K)
    variances, axes = np.linalg.eigh(as_one @ C @ as_one.T)
    return axes[:, -1], float(np.sqrt(variances[-1]))


def heading_unknown(turn_deg: float) -> str:
    """Why a window is refused whose rotation has so large a sigma, and what to do."""
    return f"heading known to {min(turn_deg, 180.0):.0f} degrees only: fly a straight leg, or send the attitude"


def by_profile(request: Request, found: Outcome) -> Outcome:
    """An accepted window without attitude, its variances as wide as the cost shows; refused where that is too wide.

    As it is where three sigmas of its weakest turn are less than MAX_ROTATION_SIGMA_DEG: a covariance holds there.
    """
    solved = found.solved
    if solved is None or found.weighed is None or have_attitude(request.keyframes):
        return found
    axis, sigma_rad = weakest_turn(solved)
    if np.degrees(FAR_SIGMAS * sigma_rad) < MAX_ROTATION_SIGMA_DEG:
        return found
    risen = min(_risen(request, found, axis, side * FAR_SIGMAS * sigma_rad) for side in (1.0, -1.0))
    wider = FAR_SIGMAS / np.sqrt(2.0 * max(risen, 1e-6))
    turn_deg = float(np.degrees(sigma_rad) * max(wider, 1.0))
    if turn_deg > MAX_ROTATION_SIGMA_DEG:
        reason = heading_unknown(turn_deg)
        return replace(found, status=Status.LOW_PARALLAX, keyframes=request.keyframes, solved=None, reason=reason)
    return replace(found, solved=replace(solved, variance_factor=solved.variance_factor * max(wider, 1.0) ** 2))


def _risen(request: Request, found: Outcome, axis_enu: Array, angle_rad: float) -> float:
    """What the cost rises by where all views are held turned by this angle, in units of the noise as it was found."""
    assert found.weighed is not None
    first, problem = found.weighed.solution, found.weighed.problem
    R = first.state.R_cam_enu
    start = turned(request.keyframes, R @ exp_so3(angle_rad * axis_enu))
    window = from_request(replace(request, keyframes=start, previous=None, is_oriented=True))
    if not isinstance(window, WindowProblem):
        return 0.0
    held = TurnPrior(problem.layout, R, axis_enu, angle_rad)
    priors = [*problem.priors, cast(Prior, held)]  # no sensor's, but the solver asks nothing else of one
    state = as_seen_by(problem, window.state, window.reference_enu_m)
    solution = approximate(replace(problem, priors=priors), state)
    r = held.evaluate(solution.state)[0]
    scale = max(fit_of(first.residual_sigmas, view_states(problem.layout)), 1.0) ** 2
    return (solution.cost - 0.5 * float(r @ r) - first.cost) / scale
