"""The judge of explanations: which of two is the likelier by the pictures, and what chance alone would make of one.

An explanation's evidence is twice the fall of one cost, in the variance of the pixels that it leaves, less the states
that it frees; it counts where that is more than the odds against it beforehand, (16.8), (19.3). All costs compared are
under one noise: each window's own has grown until its residuals fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from onboard.estimation.bundle_adjustment import Problem, Solution
from onboard.estimation.explanations import Explanation
from onboard.estimation.factors import RangePrior, State
from onboard.estimation.keyframe import Keyframe, have_attitude
from onboard.estimation.window_problem import FIRST_SCALE, Outcome, approximate
from onboard.geometry.robust import robust_cost
from onboard.navigation.limits import CLEAR, RARE

Array = NDArray[np.float64]

CLEAR_SIGMAS = 3.1  # of a difference of two costs, by its own spread: one-sided a thousand to one
SAME_SIGMAS = 1.0  # of the points' own places, within which two solutions are the same
EXACT = 1e-6  # of the cost: below a hundredth of a sigma


def is_far_worse(found: Outcome, other: Explanation) -> bool:
    """Return whether the minimum next to another start is clearly the less likely one, under `found`'s noise.

    False if none was reached from there, unless every keyframe has an attitude, as in `likelier`.
    """
    if found.solved is None or found.weighed is None:
        return False
    problem = found.weighed.problem
    solution = _minimum(problem, other.start, other.window.unweighed.reference_enu_m)
    is_known = solution.converged or have_attitude(other.window.request.keyframes)
    return is_known and preferred(found.weighed.solution, solution) == 1


def likelier(keyframes: tuple[Keyframe, ...], one: Outcome, two: Outcome) -> Outcome:
    """Choose between the outcomes from two starts: the clearly likelier one, accepted or not, or a refusal of both.

    If neither is clearly likelier, an accepted one is preferred to one that something contradicts, or that is known too
    badly and fits worse by (16.8), but not to one that has only not converged. An outcome that only the path's start
    finds, with nothing to compare it with, must be confirmed by an earlier window: a path is no attitude. `keyframes`:
    of the window as it was asked for, which a refusal of both leaves as they are.
    """
    if two.weighed is None or (one.solved is None and two.solved is None):
        return one
    if one.weighed is None:
        return two if two.agreed is not None or have_attitude(keyframes) else one
    # Under the noise of the one that needed less: what a wrong solution needs would excuse it.
    problem = max((one.weighed.problem, two.weighed.problem), key=_precision)
    first, second = (
        w.solution if w.problem is problem else _minimum(problem, w.solution.state, w.problem.reference_enu_m)
        for w in (one.weighed, two.weighed)
    )
    which = preferred(first, second)
    better, worse = (one, two) if which == 1 else (two, one)
    if which and (worse.is_minimum or have_attitude(keyframes)):  # else its cost may fall yet
        return better
    accepted, other = (one, two) if one.solved is not None else (two, one)
    excess = excess_over(second, first) if accepted is one else excess_over(first, second)
    is_dismissed = other.status is Status.POOR_FIT or excess.evidence > CLEAR
    if other.solved is None and other.is_minimum and is_dismissed:
        return accepted
    # Exactly: the first solves stop so early that one minimum found twice may lie a sigma from itself.
    first, second = (approximate(problem, s.state, EXACT) for s in (first, second))
    apart_m, apart_sigmas = _apart(first, second, accepted)
    if apart_sigmas < SAME_SIGMAS:
        return accepted
    reason = f"the pictures fit two orientations: {apart_m:.0f} m apart on the ground, fly on level"
    return replace(one, status=Status.LOW_PARALLAX, keyframes=keyframes, solved=None, reason=reason)


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


def preferred(one: Solution, two: Solution) -> int:
    """Return which of two minima of the same cost is clearly the likelier: 1, 2, or 0 if both fit. (16.8), (16.9)"""
    better, worse = (one, two) if one.cost < two.cost else (two, one)
    excess, by_point = excess_over(worse, better), 2.0 * (cost_by_point(worse) - cost_by_point(better))
    spread = float(np.linalg.norm(by_point - by_point.mean())) / excess.variance
    if excess.evidence < max(CLEAR, CLEAR_SIGMAS * spread):
        return 0
    return 1 if better is one else 2


def cost_by_point(solution: Solution) -> Array:
    """The cost of the measurements of each point (P,), robust as the first of a window's two solves is."""
    squared = np.nan_to_num(np.square(solution.residual_sigmas))
    out: Array = 0.5 * robust_cost(squared, FIRST_SCALE)[0].sum(axis=0)
    return out


@dataclass(frozen=True, eq=False)
class Excess:
    """Twice the fall of the cost under an explanation (in variances of the pixels), and how many states it frees."""

    gain: float
    freedom: int
    variance: float  # of the pixels under the explanation, in the one they were weighted by; at least 1
    solution: Solution

    @property
    def evidence(self) -> float:
        """The gain less the one that chance alone is expected to give."""
        return self.gain - self.freedom

    def is_clear(self, other: float = 0.0) -> bool:
        """Return whether it is beyond chance, and beyond the evidence of another explanation. (19.3)"""
        return self.evidence - max(other, 0.0) > RARE


def excess_of(gain: float, solution: Solution, freedom: int = 0) -> Excess:
    """A gain in variances of the solution's pixels: robust cost per measurement that is left over."""
    seen = np.isfinite(solution.residual_sigmas)
    # Each measurement has two coordinates; a point takes three freedoms, a pose six.
    left = 2 * int(np.count_nonzero(seen)) - 3 * seen.shape[1] - 6 * len(seen)
    variance = max(2.0 * float(cost_by_point(solution).sum()) / max(left, 1), 1.0)
    return Excess(gain / variance, freedom, variance, solution)


def excess_over(other: Solution, solution: Solution, freedom: int = 0) -> Excess:
    """The excess of a solution over another one's cost."""
    return excess_of(2.0 * (other.cost - solution.cost), solution, freedom)
