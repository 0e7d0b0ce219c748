"""The optics that changed between the pictures of a window: zoom or refocus, and a stabilised frame. (19.2) to (19.5)

Twice the fall of the cost under each explanation is held against what chance makes of as many states, and against the
same with the attitude set aside: the explanation with the largest excess is the cause.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from contract.feature_set import Status
from onboard.estimation.bundle_adjustment import solve
from onboard.estimation.camera_states import FOCAL_LENGTH
from onboard.estimation.explanations import (
    ATTITUDE,
    OPEN_LENS,
    Explanation,
    OpenOptics,
    attitude_aside,
    attitude_aside_as_shifted,
    open_optics,
    shifted,
    zoomed,
)
from onboard.estimation.factors import SHIFT, ZOOM
from onboard.estimation.judge import Excess, excess_of, excess_over
from onboard.estimation.keyframe import have_attitude
from onboard.estimation.sensor_groups import contradictions, innovations
from onboard.estimation.sensor_table import HEADING, TILT
from onboard.estimation.window_problem import Outcome, Weighed

MOVED = (Status.STABILISED, Status.ZOOMED, Status.MIRRORED)
MAX_VARIANCE = 3.0  # of pixels, above which an explanation leaves too much to explain anything


def found(weighed: Weighed) -> Outcome | None:
    """The refusal of a window in which the optics changed; None if nothing did. `weighed` is its first solve.

    Every window is asked for the signs that its first solve shows; the explanations are weighed where there is one.
    """
    window, has_attitude = weighed.window, have_attitude(weighed.window.keyframes)
    each, common = zoom_scores(weighed)
    is_turned = has_attitude and is_attitude_contradicted(weighed)
    is_file_doubted = common.is_clear() and not window.layout.camera_states  # of a file that admits no error
    # Pictures that are turned wrong look zoomed, and a start without attitude may be anywhere.
    is_oriented = has_attitude or window.request.previous is not None
    if not (is_turned or is_file_doubted or (is_oriented and each.is_clear())):
        return None
    optics = open_optics(weighed)
    tried = _explained(optics, has_attitude)
    cause = max(tried, key=lambda name: tried[name].evidence)
    likeliest = tried[cause]
    next_best = max((t.evidence for name, t in tried.items() if name != cause), default=0.0)
    is_sure = likeliest.is_clear(next_best) and likeliest.variance < MAX_VARIANCE
    if cause == ZOOM and is_sure and is_oriented:
        moved = float(np.ptp(likeliest.solution.state.own[:, -1]))
        reason = f"the lens zoomed or refocused: by {np.expm1(moved):.1%} within the window"
        return replace(refused(weighed, Status.ZOOMED, reason), lens_moved=moved)
    # A frame that is shifted to hide a rotation contradicts the attitude; one that does not has hidden nothing.
    if cause == SHIFT and is_sure and is_turned:
        reason = "the frame is shifted from picture to picture (stabilisation)"
        return refused(weighed, Status.STABILISED, reason)
    return _by_file(weighed, optics, likeliest) if is_file_doubted else None


def refused(weighed: Weighed, status: Status, reason: str) -> Outcome:
    """The refusal of a window by its first solve."""
    window = weighed.window
    return Outcome(status, window.keyframes, window.request.noise, weighed=weighed, reason=reason)


def is_attitude_contradicted(weighed: Weighed) -> bool:
    """Return whether tilt or heading contradicts the pictures and the other sensors. (13.4)"""
    s, groups = weighed.solution, weighed.noise.factors.groups
    against = contradictions(innovations(weighed.problem.priors, s.state, s.covariance, groups))
    return any(i.group in (TILT, HEADING) for i in against)


def _explained(optics: OpenOptics, has_attitude: bool) -> dict[str, Excess]:
    """Try every explanation that the window's sensors allow, by name."""
    tried = {ZOOM: try_one(optics, zoomed(optics))}
    if has_attitude:
        tried[ATTITUDE] = try_one(optics, attitude_aside(optics))
        tried[SHIFT] = try_one(optics, shifted(optics, tried[ATTITUDE].solution.state))
        if max(tried, key=lambda name: tried[name].evidence) == SHIFT:
            again = try_one(optics, attitude_aside_as_shifted(optics, tried[SHIFT].solution.state))
            tried[ATTITUDE] = max(tried[ATTITUDE], again, key=lambda t: t.gain)
    return tried


def try_one(optics: OpenOptics, explanation: Explanation) -> Excess:
    """The excess of a window's solution under an explanation; no gain if its image states are impossible."""
    solution = explanation.solved()
    excess = excess_over(optics.solution, solution, explanation.freedom)
    # States far outside what they may be bend to wrong tracks, and explain nothing.
    is_possible = explanation.name == ATTITUDE or explanation.is_possible(solution)
    return excess if is_possible else replace(excess, gain=0.0)


def _by_file(weighed: Weighed, optics: OpenOptics, likeliest: Excess) -> Outcome | None:
    """The refusal of a lens that stopped elsewhere than its file, which admits no error, has it."""
    closed = optics.closed.weighed(optics.noise, weighed.solution.state).solution
    lens = excess_over(closed, optics.lens, len(OPEN_LENS))
    rows = excess_over(optics.lens, optics.solution, optics.solution.state.own.size)
    if not lens.is_clear() or lens.evidence <= max(likeliest.evidence, rows.evidence):
        return None
    off = np.expm1(float(optics.lens.state.camera[FOCAL_LENGTH]))
    reason = f"the focal length is {off:+.1%} off the camera file, which states it without error"
    return refused(weighed, Status.POOR_FIT, reason)


def zoom_scores(weighed: Weighed) -> tuple[Excess, Excess]:
    """The expected excess of a focal length for each picture, and of one that all share, by the first step. (19.4)"""
    tried = weighed.window.with_block(ZOOM)
    state = weighed.solution.state.with_block(tried.layout, ZOOM)
    priors = [replace(p, layout=tried.layout) for p in weighed.problem.priors]
    step = solve(replace(weighed.problem, layout=tried.layout, priors=priors), state, max_iterations=0)
    columns = tried.layout.by_picture[:, -1]
    moved = step.covariance[columns] @ step.reduced.right
    information = np.linalg.pinv(step.covariance[np.ix_(columns, columns)], hermitian=True)
    pull = information @ moved
    shared = float(pull.sum() ** 2 / information.sum())
    each = excess_of(float(moved @ pull) - shared, weighed.solution, len(columns) - 1)
    return each, excess_of(shared, weighed.solution, 1)
