"""Other explanations of a window's pictures: the starts that lead to them, and which of two solutions is likelier.

Least squares find the minimum next to their start, and a window that starts from the one before inherits its minimum.
Without attitude there may be another one: a plane's pictures have a second motion, which a climb's positions do not
tell from the first, and in a turn an aircraft may be upside down. What two minima are worth is the difference of one
cost, under one noise, (16.8): each window's own noise has grown until its residuals fit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import exp_so3
from onboard.estimation.boresight import PlatformEstimate
from onboard.estimation.bundle_adjustment import Problem, Solution
from onboard.estimation.factors import State
from onboard.estimation.keyframe import Keyframe, have_attitude, turned
from onboard.estimation.pixel_noise import fit_of, view_states
from onboard.estimation.platform_states import BORESIGHT, HEADING
from onboard.estimation.sensor_factors import coordinated_turn, cosine_sine_of_heading
from onboard.estimation.window_acceptance import MIN_AHEAD
from onboard.estimation.window_problem import FIRST_SCALE, WindowProblem, approximate, from_request
from onboard.estimation.window_request import Outcome, Request, Weighed
from onboard.geometry.planar_ambiguity import mirrored
from onboard.geometry.plane_fit import fit_plane
from onboard.geometry.robust import robust_cost
from onboard.navigation.navigator import NavState

Array = NDArray[np.float64]

CLEAR_COST = float(np.log(1000.0))  # by which one of two solutions is the likelier, a thousand to one
CLEAR_SIGMAS = 3.1  # of that difference's own spread, one-sided the same odds
SAME_SIGMAS = 1.0  # of the points' own places, within which two solutions are the same


def by_attitude(nav: NavState, platform: PlatformEstimate, R_body_cam: Array) -> Array | None:
    """R_cam_enu from the autopilot through mount and boresight, or None without attitude."""
    if nav.R_enu_body is None:
        return None
    yaw = float(cosine_sine_of_heading(nav.R_enu_body) @ platform.mean[HEADING])
    R_enu_body = exp_so3(np.array([0.0, 0.0, -yaw])) @ nav.R_enu_body
    out: Array = (R_enu_body @ R_body_cam @ exp_so3(platform.mean[BORESIGHT])).T
    return out


def by_sensors(
    keyframes: tuple[Keyframe, ...], platform: PlatformEstimate, R_body_cam: Array
) -> tuple[Keyframe, ...] | None:
    """Keyframes oriented by the autopilot, or where it gives no attitude by a coordinated turn along the path."""
    attitudes = [by_attitude(k.nav, platform, R_body_cam) for k in keyframes]
    known = [R for R in attitudes if R is not None]
    if len(known) == len(keyframes):
        return turned(keyframes, np.stack(known))
    path = coordinated_turn(R_body_cam, list(keyframes))
    return None if path is None else turned(keyframes, path.transpose(0, 2, 1))


def other_starts(request: Request, found: Outcome) -> Iterator[tuple[Keyframe, ...]]:
    """Keyframes turned as other explanations of the pictures have them, which `found` is to be compared with.

    Without attitude the mirrored motion of the plane, if one is possible; and the sensors' own orientations where the
    window was refused, or, without attitude, nothing confirms it yet.
    """
    keyframes = request.keyframes
    has_attitude = have_attitude(keyframes)
    if found.weighed is not None and not has_attitude and found.status is not Status.LOW_PARALLAX:
        state, problem = found.weighed.solution.state, found.weighed.problem
        seen = problem.weight > 0
        several = np.count_nonzero(seen, axis=0) > 1
        plane, _ = fit_plane(state.points_enu_m[several])
        R = mirrored(state.R_cam_enu, state.centres_enu_m, plane, problem.xy, seen, MIN_AHEAD)
        if R is not None:
            yield turned(keyframes, R)
    if has_attitude:
        # The sensors' start was the first one, but where the window before gave it.
        is_open = found.status is Status.POOR_FIT and request.previous is not None
    else:
        is_confirmed = found.agreed is not None or bool(request.memory.windows)
        is_open = found.status is Status.POOR_FIT or (found.status is Status.OK and not is_confirmed)
    start = by_sensors(keyframes, request.platform, request.R_body_cam) if is_open else None
    if start is not None:
        yield start


def is_far_worse(found: Outcome, other: Request) -> bool:
    """Whether the minimum next to another start is clearly the unlikelier one, under the noise that `found` has."""
    if found.solved is None or found.weighed is None:
        return False
    window = from_request(other)
    if not isinstance(window, WindowProblem):
        return True
    problem = found.weighed.problem
    solution = approximate(problem, as_seen_by(problem, window.state, window.reference_enu_m))
    return _preferred(found.weighed.solution, solution, found.weighed) == 1


def likelier(request: Request, one: Outcome, two: Outcome) -> Outcome:
    """Which of the outcomes from two starts stands: the only accepted one, the clearly likelier one, or a refusal.

    What only the path's start finds, without anything to be compared with, needs an earlier window to confirm it: a
    path is no attitude.
    """
    if two.solved is None or two.weighed is None:
        return one
    if one.weighed is None:
        return two if two.agreed is not None or have_attitude(request.keyframes) else one
    # Under the noise of the one that needed less: what a wrong solution needs would excuse it.
    common = max((one.weighed, two.weighed), key=lambda w: _precision(w.problem))
    first, second = (_under(common, w) for w in (one.weighed, two.weighed))
    preferred = _preferred(first, second, common)
    if one.solved is None:
        return one if preferred == 1 else two
    if preferred:
        return one if preferred == 1 else two
    at1, at2 = one.solved.common(two.solved)
    miss_m = np.linalg.norm(first.state.points_enu_m[at1] - second.state.points_enu_m[at2], axis=1)
    gain_of = one.solved.solution.point_gain[at1]
    covariance = gain_of @ one.solved.covariance_at(one.keyframes[-1].nav.stamp_ns) @ gain_of.transpose(0, 2, 1)
    sigma_m = np.sqrt(np.trace(covariance + one.solved.solution.point_covariance[at1], axis1=1, axis2=2))
    if len(at1) and float(np.median(miss_m / sigma_m)) < SAME_SIGMAS:
        return one
    apart_m = float(np.median(miss_m)) if len(at1) else np.inf
    reason = f"the pictures fit two orientations: {apart_m:.0f} m apart on the ground, fly on level"
    return replace(one, status=Status.LOW_PARALLAX, keyframes=request.keyframes, solved=None, reason=reason)


def _under(common: Weighed, other: Weighed) -> Solution:
    """A window's minimum as another weighs it."""
    if other is common:
        return common.solution
    state = as_seen_by(common.problem, other.solution.state, other.problem.reference_enu_m)
    return approximate(common.problem, state)


def as_seen_by(problem: Problem, state: State, reference_enu_m: Array) -> State:
    """A state whose plane was counted about another reference point, with the pictures' own states of this problem."""
    layout, plane = problem.layout, state.plane.copy()
    if problem.terrain is None:
        between = problem.reference_enu_m - reference_enu_m
        plane[0] += plane[1:] @ between[:2] - between[2]
    shape = (layout.keyframes, layout.own)
    return replace(state, plane=plane, own=state.own if state.own.shape == shape else np.zeros(shape))


def _precision(problem: Problem) -> float:
    """The logarithm of the weights of all that is measured: the larger, the less noise is assumed."""
    total = 2.0 * float(np.log(problem.weight[problem.weight > 0]).sum())
    for prior in problem.priors:
        whitener = getattr(prior, "whitener", None)
        if isinstance(whitener, np.ndarray):
            total += float(np.log(np.abs(np.diagonal(whitener, axis1=-2, axis2=-1))).sum())
    return total


def _preferred(one: Solution, two: Solution, common: Weighed) -> int:
    """Which of two minima of the same cost is clearly the likelier: 1, 2, or 0 where both fit. (16.8), (16.9)

    In units of the noise that the better one's residuals show, where they show more than was assumed.
    """
    better = one if one.cost < two.cost else two
    scale = max(fit_of(better.residual_sigmas, view_states(common.problem.layout)), 1.0) ** 2
    gain = (two.cost - one.cost) / scale
    by_point = cost_by_point(two) - cost_by_point(one)
    spread = float(np.sqrt(np.sum((by_point - by_point.mean()) ** 2))) / scale
    if abs(gain) < max(CLEAR_COST, CLEAR_SIGMAS * spread):
        return 0
    return 1 if gain > 0.0 else 2


def cost_by_point(solution: Solution) -> Array:
    """The cost of the measurements of each point (P,), robust as the first of a window's two solves is."""
    squared = np.nan_to_num(np.square(solution.residual_sigmas))
    out: Array = 0.5 * robust_cost(squared, FIRST_SCALE)[0].sum(axis=0)
    return out
