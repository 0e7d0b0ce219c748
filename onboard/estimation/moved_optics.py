"""Optics that are not what they are taken for: a zoom, a stabilised frame, a stretch. (19.2) to (19.5), (19.7)

Twice the fall of the cost under each explanation is held against what chance makes of as many states, and against the
same with the attitude set aside: the explanation with the largest excess is the cause.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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
    open_lens,
    open_optics,
    read_longer,
    shifted,
    stretched,
    zoomed,
)
from onboard.estimation.factors import READ, SHIFT, STRETCH, ZOOM
from onboard.estimation.judge import Excess, excess_of, excess_over
from onboard.estimation.keyframe import have_attitude
from onboard.estimation.sensor_groups import contradictions, innovations
from onboard.estimation.sensor_table import HEADING, TILT
from onboard.estimation.window_problem import Outcome, Weighed
from onboard.navigation.limits import CLEAR, SURE_SIGMAS

MOVED = (Status.STABILISED, Status.ZOOMED, Status.MIRRORED, Status.STRETCHED)
LEAST_STRETCH = 0.03  # a logarithm: no calibration is off by so much along one side alone
MAX_VARIANCE = 3.0  # of pixels, above which an explanation leaves too much to explain anything


@dataclass(frozen=True)
class Stretch:
    """The stretch that all pictures of a window share, a logarithm, with one sigma and its evidence."""

    value: float
    sigma: float
    excess: Excess

    @property
    def is_large(self) -> bool:
        """Return whether it is surely more than calibrations of one shape of picture differ by."""
        return abs(self.value) - SURE_SIGMAS * self.sigma > LEAST_STRETCH

    @property
    def is_none(self) -> bool:
        """Return whether it is surely less than that."""
        return abs(self.value) + SURE_SIGMAS * self.sigma < LEAST_STRETCH


@dataclass(frozen=True)
class Signs:
    """The expected excess of a focal length for each picture and of a shared one, (19.4), and the stretch, (19.7)."""

    zoom: Excess
    focal_length: Excess
    stretch: Stretch


def found(weighed: Weighed, signs: Signs) -> Outcome | None:
    """The refusal of a window in which the optics changed; None if nothing did. `weighed` is its first solve.

    Every window is asked for the signs that its first solve shows; the explanations are weighed where there is one.
    """
    window, has_attitude = weighed.window, have_attitude(weighed.window.keyframes)
    each, common = signs.zoom, signs.focal_length
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


def are_stretched(weighed: Weighed, stretch: Stretch) -> bool | None:
    """Return whether a window shows its pictures to be stretched, or not to be; None if neither. (19.7)"""
    if stretch.is_none:
        return False
    window, has_attitude = weighed.window, have_attitude(weighed.window.keyframes)
    is_oriented = has_attitude or window.request.previous is not None
    if not (is_oriented and stretch.is_large and stretch.excess.is_clear()):
        return None
    return True if window.request.is_stretched or _is_likeliest(weighed, has_attitude) else None


def _is_likeliest(weighed: Weighed, has_attitude: bool) -> bool:
    """Return whether a stretch explains a window's pictures clearly better than what else may have changed.

    Rows turn no other than the vehicle does: what they would have to do for a stretch of all pictures, none does.
    """
    optics = open_lens(weighed)
    stretch = try_one(optics, stretched(optics))
    rivals = {READ: try_one(optics, read_longer(optics)), **_explained(optics, has_attitude)}
    next_best = max(t.evidence for t in rivals.values())
    # A shift of each frame follows a stretch in part: which of those is right needs no such odds as that one is.
    is_sure = stretch.is_clear() and stretch.evidence - next_best > CLEAR
    return is_sure and stretch.variance < MAX_VARIANCE


def signs_of(weighed: Weighed) -> Signs:
    """The signs that a window's first solve shows, by the first step of a zoom and a stretch of each picture."""
    tried, state = weighed.window.with_readout().with_block(ZOOM).with_block(STRETCH), weighed.solution.state
    state = replace(state, own=np.pad(state.own, ((0, 0), (0, tried.layout.own - state.own.shape[1]))))
    priors = [replace(p, layout=tried.layout) for p in weighed.problem.priors]
    opened = replace(weighed.problem, layout=tried.layout, priors=priors, sweep=tried.unweighed.sweep)
    step, K = solve(opened, state, max_iterations=0), tried.layout.keyframes
    columns = tried.layout.by_picture[:, -3:].T.ravel()  # (readouts, zooms, stretches)
    information = np.linalg.pinv(step.covariance[np.ix_(columns, columns)], hermitian=True)
    pull = -information @ (step.covariance[columns] @ step.reduced.right)
    zooms = slice(K, 2 * K)
    alone = float(pull[zooms] @ np.linalg.pinv(information[zooms, zooms], hermitian=True) @ pull[zooms])
    shared, pulled = information.reshape(3, K, 3, K).sum(axis=(1, 3)), pull.reshape(3, K).sum(axis=1)
    common, by_all = float(pulled[1] ** 2 / shared[1, 1]), np.linalg.inv(shared)
    each = excess_of(alone - common, weighed.solution, K - 1)
    value, sigma = float(by_all[2] @ pulled), float(np.sqrt(by_all[2, 2]))
    stretch = Stretch(value, sigma, excess_of((value / sigma) ** 2, weighed.solution, 1))
    return Signs(each, excess_of(common, weighed.solution, 1), stretch)
