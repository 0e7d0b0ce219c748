"""Other explanations of a window's pictures: starts that lead to them, which is likelier, how wide a valley is.

Least squares find the minimum next to their start, and a window that starts from the one before inherits its minimum.
Without attitude there may be another one: a plane's pictures have a second motion, which a climb's positions do not
distinguish from the first, and in a turn an aircraft may be upside down. What two minima are worth is the difference
of one cost, under one noise, (16.8): each window's own noise has grown until its residuals fit.

Of a climb without attitude the valley along the heading is also wider than the cost's curvature at its minimum, which
is the covariance, or has another bottom. So all views are held turned as one, at three sigmas either way and all round,
and all else is solved for again: what the cost has risen by there is what such a turn is really worth, (16.10).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from contract.feature_set import Status
from contract.rotations import exp_so3, log_so3, right_jacobian_inverse
from onboard.estimation.boresight import PlatformEstimate
from onboard.estimation.bundle_adjustment import Problem, Solution
from onboard.estimation.factors import AttitudePrior, Layout, PathPrior, Prior, RangePrior, State
from onboard.estimation.keyframe import Keyframe, have_attitude, turned
from onboard.estimation.pixel_noise import fit_of
from onboard.estimation.platform_states import BORESIGHT, HEADING
from onboard.estimation.sensor_factors import coordinated_turn, cosine_sine_of_heading
from onboard.estimation.solved_window import Solved
from onboard.estimation.window_acceptance import MIN_AHEAD, share_below
from onboard.estimation.window_problem import FIRST_SCALE, WindowProblem, approximate, from_request
from onboard.estimation.window_request import Outcome, Request, Weighed
from onboard.geometry.planar_ambiguity import mirrored
from onboard.geometry.plane_fit import fit_plane
from onboard.geometry.robust import robust_cost
from onboard.navigation.limits import CLEAR, FALSE_ALARM, SURE_SIGMAS
from onboard.navigation.navigator import NavState

Array = NDArray[np.float64]

CLEAR_SIGMAS = 3.1  # of a difference of two costs, by its own spread: one-sided a thousand to one
SAME_SIGMAS = 1.0  # of the points' own places, within which two solutions are the same
MAX_ROTATION_SIGMA_DEG = 20.0  # above it a turn's second order, which no covariance has, is a fifth of its first
EXACT = 1e-6  # of the cost: below a hundredth of a sigma
HELD = 0.01  # rad, how closely a turn is held
AROUND_RAD = np.radians(np.arange(45.0, 360.0, 45.0))  # valleys for which this is asked are as wide as these are apart


def by_attitude(nav: NavState, platform: PlatformEstimate, R_body_cam: Array) -> Array | None:
    """R_cam_enu from the autopilot through mount and boresight, or None without attitude."""
    if nav.R_enu_body is None:
        return None
    yaw = float(cosine_sine_of_heading(nav.R_enu_body) @ platform.mean[HEADING])
    R_enu_body = exp_so3(np.array([0.0, 0.0, -yaw])) @ nav.R_enu_body
    return (R_enu_body @ R_body_cam @ exp_so3(platform.mean[BORESIGHT])).T


def by_sensors(request: Request) -> Array | None:
    """R_cam_enu (K, 3, 3) by the autopilot, or where it gives no attitude by a coordinated turn along the path."""
    if have_attitude(request.keyframes):
        return np.array([by_attitude(k.nav, request.platform, request.R_body_cam) for k in request.keyframes])
    path = coordinated_turn(request.R_body_cam, list(request.keyframes))
    return None if path is None else path.transpose(0, 2, 1)


def other_starts(request: Request, found: Outcome) -> Iterator[tuple[Keyframe, ...]]:
    """Keyframes turned as other explanations of the pictures have them, which `found` is to be compared with.

    Without attitude the mirrored motion of the plane, if one is possible; and the sensors' own orientations where the
    window was refused, where the sensors are further from it than chance has them, (16.11), or, without attitude, where
    nothing confirms it yet.
    """
    has_attitude = have_attitude(request.keyframes)
    if found.weighed is not None and not has_attitude and found.status is not Status.LOW_PARALLAX:
        state, problem = found.weighed.solution.state, found.weighed.problem
        seen = problem.weight > 0
        plane, _ = fit_plane(state.points_enu_m[np.count_nonzero(seen, axis=0) > 1])
        R = mirrored(state.R_cam_enu, state.centres_enu_m, plane, problem.xy, seen, MIN_AHEAD)
        if R is not None:
            yield turned(request.keyframes, R)
    # The first start was the sensors' own if there is attitude, unless the window before gave it.
    is_other = request.previous is not None or not has_attitude
    is_doubtful = is_other and (found.status is Status.POOR_FIT or _is_far_from_sensors(found, has_attitude))
    is_confirmed = has_attitude or found.agreed is not None or bool(request.memory.windows)
    is_open = is_doubtful or (found.status is Status.OK and not is_confirmed)
    R = by_sensors(request) if is_open else None
    if R is not None:
        yield turned(request.keyframes, R)


def _is_far_from_sensors(found: Outcome, has_attitude: bool) -> bool:
    """Return whether a sensor's residuals in an accepted solution are larger than chance explains. (16.11)"""
    if found.solved is None or found.weighed is None:
        return False
    for prior in found.weighed.problem.priors:
        if isinstance(prior, PathPrior) or (has_attitude and isinstance(prior, AttitudePrior)):
            r = prior.evaluate(found.solved.solution.state)[0]
            if float(r @ r) > float(chdtri(len(r), FALSE_ALARM)):
                return True
    return False


def is_far_worse(found: Outcome, other: Request) -> bool:
    """Return whether the minimum reached from another start is clearly the less likely one, under `found`'s noise.

    False if none was reached from there, unless every keyframe has an attitude, as in `likelier`. True if the other
    start cannot even be set up.
    """
    if found.solved is None or found.weighed is None:
        return False
    window = from_request(other)
    if not isinstance(window, WindowProblem):
        return True
    problem = found.weighed.problem
    solution = _minimum(problem, window.state, window.unweighed.reference_enu_m)
    is_known = solution.converged or have_attitude(other.keyframes)
    return is_known and _preferred(found.weighed.solution, solution, problem) == 1


def likelier(request: Request, one: Outcome, two: Outcome) -> Outcome:
    """Choose between the outcomes from two starts: the clearly likelier one, accepted or not, or a refusal of both.

    If neither is clearly likelier, an accepted one is preferred to one that something contradicts, or that is known too
    badly and fits worse by (16.8), but not to one that has only not converged. An outcome that only the path's start
    finds, with nothing to compare it with, must be confirmed by an earlier window: a path is no attitude.
    """
    if two.weighed is None or (one.solved is None and two.solved is None):
        return one
    if one.weighed is None:
        return two if two.agreed is not None or have_attitude(request.keyframes) else one
    # Under the noise of the one that needed less: what a wrong solution needs would excuse it.
    problem = max((one.weighed.problem, two.weighed.problem), key=_precision)
    first, second = (
        w.solution if w.problem is problem else _minimum(problem, w.solution.state, w.problem.reference_enu_m)
        for w in (one.weighed, two.weighed)
    )
    preferred = _preferred(first, second, problem)
    better, worse = (one, two) if preferred == 1 else (two, one)
    if preferred and (worse.is_minimum or have_attitude(request.keyframes)):  # else its cost may fall yet
        return better
    accepted, other = (one, two) if one.solved is not None else (two, one)
    gain, _ = _gain(first, second, problem)
    is_dismissed = other.status is Status.POOR_FIT or (gain if accepted is one else -gain) > 0.5 * CLEAR
    if other.solved is None and other.is_minimum and is_dismissed:
        return accepted
    # Exactly: the first solves stop so early that one minimum found twice may lie a sigma from itself.
    first, second = (approximate(problem, s.state, EXACT) for s in (first, second))
    apart_m, apart_sigmas = _apart(first, second, accepted)
    if apart_sigmas < SAME_SIGMAS:
        return accepted
    reason = f"the pictures fit two orientations: {apart_m:.0f} m apart on the ground, fly on level"
    return replace(one, status=Status.LOW_PARALLAX, keyframes=request.keyframes, solved=None, reason=reason)


def _apart(first: Solution, second: Solution, accepted: Outcome) -> tuple[float, float]:
    """Median distance between two solutions' points, in m and in sigmas of the accepted one."""
    solved = accepted.solved
    assert solved is not None
    at = solved.good
    miss_m = np.linalg.norm(first.state.points_enu_m[at] - second.state.points_enu_m[at], axis=1)
    gain_of = solved.solution.point_gain[at]
    covariance = gain_of @ solved.covariance_at(solved.keyframes[-1].nav.stamp_ns) @ gain_of.transpose(0, 2, 1)
    sigma_m = np.sqrt(np.trace(covariance + solved.solution.point_covariance[at], axis1=1, axis2=2))
    return float(np.median(miss_m)), float(np.median(miss_m / sigma_m))


def _minimum(problem: Problem, state: State, reference_enu_m: Array) -> Solution:
    """The minimum next to another window's state, whose plane was counted about this point; own states as here."""
    layout, plane = problem.layout, state.plane.copy()
    if problem.terrain is None:
        between = problem.reference_enu_m - reference_enu_m
        plane[0] += plane[1:] @ between[:2] - between[2]
    shape = (layout.keyframes, layout.own)
    own = state.own if state.own.shape == shape else np.zeros(shape)
    return approximate(problem, replace(state, plane=plane, own=own))


def _precision(problem: Problem) -> float:
    """The logarithm of the weights of all that is measured: the larger, the less noise is assumed."""
    whiteners = [prior.whitener for prior in problem.priors if not isinstance(prior, RangePrior)]
    diagonals = [np.diagonal(W, axis1=-2, axis2=-1).ravel() for W in whiteners]
    pixels = 2.0 * float(np.log(problem.weight[problem.weight > 0]).sum())
    return pixels + float(np.log(np.abs(np.concatenate(diagonals))).sum())


def _preferred(one: Solution, two: Solution, problem: Problem) -> int:
    """Return which of two minima of the same cost is clearly the likelier: 1, 2, or 0 if both fit. (16.8), (16.9)

    In units of the noise that the better one's residuals show, where they show more than was assumed.
    """
    (gain, scale), by_point = _gain(one, two, problem), cost_by_point(two) - cost_by_point(one)
    spread = float(np.linalg.norm(by_point - by_point.mean())) / scale
    if abs(gain) < max(0.5 * CLEAR, CLEAR_SIGMAS * spread):
        return 0
    return 1 if gain > 0.0 else 2


def _gain(one: Solution, two: Solution, problem: Problem) -> tuple[float, float]:
    """The logarithm of the likelihood ratio of the first to the second, and the better one's noise, its unit."""
    scale = _noise_shown(one if one.cost < two.cost else two, problem)
    return (two.cost - one.cost) / scale, scale


def _noise_shown(solution: Solution, problem: Problem) -> float:
    """The variance that residuals show, in units of what was assumed, at least 1. (6.11)"""
    return max(fit_of(solution.residual_sigmas, problem.layout), 1.0) ** 2


def cost_by_point(solution: Solution) -> Array:
    """The cost of the measurements of each point (P,), robust as the first of a window's two solves is."""
    squared = np.nan_to_num(np.square(solution.residual_sigmas))
    out: Array = 0.5 * robust_cost(squared, FIRST_SCALE)[0].sum(axis=0)
    return out


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


def heading_unknown(turn_deg: float) -> str:
    """The reason for refusing a window whose rotation has so large a sigma, and what to do."""
    known = f"to {min(turn_deg, 180.0):.0f} degrees only"
    return f"heading hardly known: {known}, fly a straight leg, or send the attitude"


def by_profile(request: Request, found: Outcome) -> tuple[Outcome, tuple[Keyframe, ...] | None]:
    """An accepted window without attitude, its variances as wide as the cost shows; refused where that is too wide.

    And where the cost is lower elsewhere, the keyframes as they are there. As it is where three sigmas of its weakest
    turn are less than MAX_ROTATION_SIGMA_DEG: a covariance holds there. (16.10)
    """
    solved = found.solved
    if solved is None or found.weighed is None or have_attitude(request.keyframes):
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
    refused = replace(found, status=Status.LOW_PARALLAX, keyframes=request.keyframes, solved=None, reason=reason)
    lowest = min((s for _, s in possible), key=lambda s: s.cost)
    return refused, turned(request.keyframes, lowest.state.R_cam_enu) if lowest.cost < there.cost else None


def _turns(found: Weighed, axis_enu: Array, angles_rad: Array) -> tuple[Solution, list[tuple[float, Solution]]]:
    """The minimum as it is; and of turns that are not clearly unlikelier, (16.8), the width each shows, and its own."""
    problem, there = found.problem, _held(found, axis_enu, 0.0) or found.solution
    scale, possible = _noise_shown(there, problem), []
    for angle_rad in angles_rad:
        held = _held(found, axis_enu, float(angle_rad))
        if held is None or (held.converged and _preferred(there, held, problem) == 1):
            continue
        risen = max((held.cost - there.cost) / scale, 1e-6)
        possible.append((float(2.0 * abs(np.sin(0.5 * angle_rad)) / np.sqrt(2.0 * risen)), held))
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
