"""The width of an accepted window's valley along its heading, by the cost itself, and the valley's other bottoms.

Of a climb without attitude the valley along the heading is wider than the cost's curvature at its minimum, which is the
covariance, or has another bottom. So all views are held turned as one, at three sigmas either way and all round, and
all else is solved for again: what the cost has risen by there is what such a turn is really worth, (16.10).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import exp_so3, log_so3, right_jacobian_inverse
from onboard.estimation.bundle_adjustment import Problem, Solution
from onboard.estimation.factors import Layout, Prior, State
from onboard.estimation.judge import excess_over, preferred
from onboard.estimation.keyframe import Keyframe, have_attitude
from onboard.estimation.solved_window import Solved
from onboard.estimation.window_acceptance import MAX_ROTATION_SIGMA_DEG, MIN_AHEAD, heading_unknown, share_below
from onboard.estimation.window_problem import Outcome, Weighed, approximate
from onboard.geometry.plane_fit import fit_plane
from onboard.navigation.limits import SURE_SIGMAS

Array = NDArray[np.float64]

HELD = 0.01  # rad, how closely a turn is held
AROUND_RAD = np.radians(np.arange(45.0, 360.0, 45.0))  # valleys for which this is asked are as wide as these are apart


@dataclass(frozen=True, eq=False)
class TurnPrior:
    """A prior of no common turn of all views about this axis from where they were; one residual."""

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


def by_profile(keyframes: tuple[Keyframe, ...], found: Outcome) -> tuple[Outcome, Array | None]:
    """An accepted window without attitude, its variances as wide as the cost shows; refused where that is too wide.

    And where the cost is lower elsewhere, R_cam_enu (K, 3, 3) there. As it is where three sigmas of its weakest turn
    are less than MAX_ROTATION_SIGMA_DEG: a covariance holds there. (16.10) `keyframes`: of the window as asked for.
    """
    solved = found.solved
    if solved is None or found.weighed is None or have_attitude(keyframes):
        return found, None
    axis, sigma_rad = weakest_turn(solved)
    if np.degrees(SURE_SIGMAS * sigma_rad) < MAX_ROTATION_SIGMA_DEG:
        return found, None
    angles = np.append(AROUND_RAD, [SURE_SIGMAS * sigma_rad, -SURE_SIGMAS * sigma_rad])
    there, possible = _turns(found.weighed, axis, angles)
    wide_rad = max((width_rad for width_rad, _ in possible), default=0.0)
    if np.degrees(wide_rad) <= MAX_ROTATION_SIGMA_DEG:
        wider = max(wide_rad / sigma_rad, 1.0)
        return replace(found, solved=replace(solved, variance_factor=solved.variance_factor * wider**2)), None
    reason = heading_unknown(float(np.degrees(wide_rad)))
    refused = replace(found, status=Status.LOW_PARALLAX, keyframes=keyframes, solved=None, reason=reason)
    lowest = min((s for _, s in possible), key=lambda s: s.cost)
    return refused, lowest.state.R_cam_enu if lowest.cost < there.cost else None


def _turns(found: Weighed, axis_enu: Array, angles_rad: Array) -> tuple[Solution, list[tuple[float, Solution]]]:
    """The minimum as it is; and of turns that are not clearly unlikelier, (16.8), the width each shows, and its own."""
    there, possible = _held(found, axis_enu, 0.0) or found.solution, []
    for angle_rad in angles_rad:
        held = _held(found, axis_enu, float(angle_rad))
        if held is None or (held.converged and preferred(there, held) == 1):
            continue
        risen = max(excess_over(held, there).gain, 2e-6)
        possible.append((float(2.0 * abs(np.sin(0.5 * angle_rad)) / np.sqrt(risen)), held))
    return there, possible


def _held(found: Weighed, axis_enu: Array, angle_rad: float) -> Solution | None:
    """The minimum where all views are held turned by this angle; None where the ground is above the aircraft then."""
    problem = found.problem
    start = turned_as_one(found.solution.state, angle_rad * axis_enu, problem)
    held = TurnPrior(problem.layout, start.R_cam_enu, axis_enu, HELD)
    priors = [*problem.priors, cast(Prior, held)]  # no sensor's, but the solver asks nothing else of one
    solution = approximate(replace(problem, priors=priors), start)
    if share_below(solution.state, problem.weight > 0) < MIN_AHEAD:
        return None
    r = held.evaluate(solution.state)[0]
    return replace(solution, cost=solution.cost - 0.5 * float(r @ r))


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
