"""Optics that changed between the pictures of a window: zoom or refocus, and a stabilised frame. (19.2) to (19.5)

Each is a hypothesis: the window's first adjustment again with one more image block. Twice the fall of the cost is held
against what chance makes of as many states, and against the same with the attitude set aside: the explanation with the
largest excess is the cause. Open under every hypothesis are focal length and k1 (a camera file that is wrong is no
zoom), and rates and vibration of rows, declared or not, which scale and shear each picture by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import chdtri

from contract.feature_set import Status
from contract.rotations import exp_so3, log_so3
from onboard.estimation import ground_roughness, row_waves, window_problem
from onboard.estimation.bundle_adjustment import Solution, solve
from onboard.estimation.camera_states import COUNT, FOCAL_LENGTH, K1
from onboard.estimation.factors import OWN_STATES, RATES, SHIFT, WAVES, ZOOM, State
from onboard.estimation.information import with_own_variance
from onboard.estimation.keyframe import have_attitude
from onboard.estimation.platform_states import STATES
from onboard.estimation.second_start import by_sensors, cost_by_point
from onboard.estimation.sensor_groups import contradictions, innovations
from onboard.estimation.sensor_table import HEADING, TILT
from onboard.estimation.window_problem import WindowProblem
from onboard.estimation.window_request import Noise, Outcome, Request, Weighed
from onboard.navigation.limits import SURE_SIGMAS

MOVED = (Status.STABILISED, Status.ZOOMED)
MOVED_BY_CHANCE = 1e-9  # that chance makes as much of a hypothesis
SET_ASIDE = 1e6  # on the variance of a sensor that is to count for nothing
OPEN_LENS = {FOCAL_LENGTH: 0.3, K1: 0.1}  # one sigma of what all pictures share, under every hypothesis
MAX_VARIANCE = 3.0  # of pixels, above which a hypothesis leaves too much to explain anything
ATTITUDE = "attitude"


@dataclass(frozen=True)
class Excess:
    """Twice the fall of the cost under a hypothesis (in variances of the pixels), and how many states it frees."""

    gain: float
    freedom: int
    variance: float  # of the pixels under the hypothesis, in the one they were weighted by; at least 1

    @property
    def evidence(self) -> float:
        """The gain less the one that chance alone is expected to give."""
        return self.gain - self.freedom

    def exceeds_chance(self, explained: float = 0.0) -> bool:
        """Return whether the gain beyond what another hypothesis `explained` is too large for chance. (19.3)"""
        return self.gain - explained > float(chdtri(self.freedom, MOVED_BY_CHANCE))


def found(window: WindowProblem, weighed: Weighed) -> Outcome | None:
    """The refusal of a window in which the optics changed; None if nothing did. `weighed` is its first adjustment."""
    groups, has_attitude = weighed.noise.factors.groups, have_attitude(window.keyframes)
    s = weighed.solution
    against = contradictions(innovations(weighed.problem.priors, s.state, s.covariance, groups))
    is_turned = has_attitude and any(i.group in (TILT, HEADING) for i in against)
    each, common = zoom_scores(window, weighed)
    is_file_doubted = common.exceeds_chance() and not window.layout.camera_states
    # Pictures that are turned wrong look zoomed: the start of a window without attitude may be anywhere.
    is_oriented = has_attitude or window.request.previous is not None
    if not is_turned and not is_file_doubted and not (is_oriented and each.exceeds_chance()):
        return None
    hypotheses = Hypotheses(window, weighed)
    excess = {ZOOM: hypotheses.with_block(ZOOM)}
    if has_attitude:
        excess |= {ATTITUDE: hypotheses.without_attitude(), SHIFT: hypotheses.with_block(SHIFT)}
    cause = max(excess, key=lambda name: excess[name].evidence)
    if cause == SHIFT:
        excess[ATTITUDE] = max(excess[ATTITUDE], hypotheses.turned_instead(), key=lambda e: e.gain)
        cause = max(excess, key=lambda name: excess[name].evidence)
    next_best = max([0.0, *(e.evidence for name, e in excess.items() if name != cause)])
    is_sure = excess[cause].exceeds_chance(next_best) and excess[cause].variance < MAX_VARIANCE
    refused = partial(Outcome, keyframes=window.keyframes, noise=window.request.noise, weighed=weighed)
    if cause == ZOOM and is_sure and is_oriented:
        moved = float(np.ptp(hypotheses.solved[ZOOM].state.own[:, -1]))
        reason = f"the lens zoomed or refocused: by {np.expm1(moved):.1%} within the window"
        return refused(Status.ZOOMED, reason=reason, lens_moved=moved)
    # A frame that is shifted to hide a rotation contradicts the attitude; one that does not has hidden nothing.
    if cause == SHIFT and is_sure and is_turned:
        return refused(Status.STABILISED, reason="the frame is shifted from picture to picture (stabilisation)")
    # A lens that stopped elsewhere than its file has it, and whose file admits no error: nothing else refuses that.
    if not is_file_doubted:
        return None
    lens, log_focal = hypotheses.lens()
    if lens.exceeds_chance() and lens.evidence > max(excess[cause].evidence, hypotheses.rows().evidence):
        reason = f"the focal length is {np.expm1(log_focal):+.1%} off the camera file, which states it without error"
        return refused(Status.POOR_FIT, reason=reason)
    return None


def zoom_scores(window: WindowProblem, weighed: Weighed) -> tuple[Excess, Excess]:
    """The expected excess of a focal length for each picture, and of one that all share, by the first step. (19.4)"""
    tried = window.with_block(ZOOM)
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


def excess_of(gain: float, solution: Solution, freedom: int) -> Excess:
    """A gain in variances of the solution's pixels: robust cost per measurement that is left over."""
    seen = np.isfinite(solution.residual_sigmas)
    # Each measurement has two coordinates; a point takes three freedoms, a pose six.
    left = 2 * int(np.count_nonzero(seen)) - 3 * seen.shape[1] - 6 * len(seen)
    variance = max(2.0 * float(cost_by_point(solution).sum()) / max(left, 1), 1.0)
    return Excess(gain / variance, freedom, variance)


class Hypotheses:
    """One window adjusted under several of them, all with the same open lens and the same open rows.

    `solved` holds the newest solution under each.
    """

    def __init__(self, window: WindowProblem, weighed: Weighed) -> None:
        asked = replace(window.request, keyframes=window.keyframes, is_oriented=True)
        stated = window_problem.from_request(with_open_lens(asked))
        assert isinstance(stated, WindowProblem)
        # A sensor that was found to fail may have been innocent.
        noise = replace(weighed.noise, factors=replace(weighed.noise.factors, groups={}))
        # Nor do hills contradict the pictures, whose points all lie above or below a plane together.
        hold = ground_roughness.correlated(weighed.problem, weighed.solution, stated.unweighed.ground_weight)
        weight = np.where(window.unweighed.weight > 0.0, stated.unweighed.weight, 0.0)
        stated = stated.with_problem(ground_weight=hold, weight=weight)
        self._closed, self._first = window.with_problem(ground_weight=hold), weighed.solution
        self._noise, self._lens = noise, stated.weighed(noise, stated.state).solution
        self._window, self._none = with_open_rows(stated, noise, self._lens)
        self.solved: dict[str, Solution] = {}

    def lens(self) -> tuple[Excess, float]:
        """The excess of the open lens over the camera file's, and the logarithm of its relative focal length."""
        gain = 2.0 * (self._closed.weighed(self._noise, self._first.state).solution.cost - self._lens.cost)
        return excess_of(gain, self._lens, len(OPEN_LENS)), float(self._lens.state.camera[FOCAL_LENGTH])

    def rows(self) -> Excess:
        """The excess of the rows' own states, beyond the open lens."""
        return excess_of(2.0 * (self._lens.cost - self._none.cost), self._none, self._none.state.own.size)

    def without_attitude(self, state: State | None = None) -> Excess:
        """The excess of ignoring all attitudes; the adjustment begins from `state`."""
        factors = replace(self._noise.factors, groups=dict.fromkeys((TILT, HEADING), SET_ASIDE))
        noise = replace(self._noise, factors=factors)
        return self._explained(ATTITUDE, self._window.weighed(noise, state or self._none.state).solution, 3)

    def turned_instead(self) -> Excess:
        """The same, begun where shifts have led, each taken for the rotation that moves a picture's middle as far."""
        shifted = self.solved[SHIFT].state
        x, y = shifted.own[:, -2:].T
        R = exp_so3(np.column_stack([-y, x, np.zeros(len(x))])) @ shifted.R_cam_enu
        return self.without_attitude(replace(shifted, R_cam_enu=R, own=self._none.state.own))

    def with_block(self, block: str) -> Excess:
        """The excess of a block of image states, 0 if their values are impossible.

        `SHIFT` begins from the solution of `without_attitude`, which must have run before.
        """
        tried = self._window.with_block(block)
        state = self._none.state.with_block(tried.layout, block)
        if block == SHIFT:
            state = self._hiding(self.solved[ATTITUDE].state, state)
        solution = tried.weighed(self._noise, state).solution
        explained = self._explained(block, solution, OWN_STATES[block])
        # States far outside what they may be bend to wrong tracks, and explain nothing.
        return explained if _are_possible(tried, solution.state) else replace(explained, gain=0.0)

    def _hiding(self, turned: State, state: State) -> State:
        """A start for shifts: the frames hide by how much the pictures' rotations part from the attitudes'. (19.5)"""
        R = by_sensors(self._window.request)
        assert R is not None
        hidden = log_so3(turned.R_cam_enu @ R.transpose(0, 2, 1))
        own = state.own.copy()
        own[:, -2:] = np.column_stack([hidden[:, 1], -hidden[:, 0]]) - [hidden[0, 1], -hidden[0, 0]]
        return replace(turned, R_cam_enu=R, own=own)

    def _explained(self, name: str, solution: Solution, states: int) -> Excess:
        """The excess of a hypothesis with so many states a picture; the first picture's image states are fixed."""
        self.solved[name] = solution
        pictures = self._window.layout.keyframes - (name != ATTITUDE)
        return excess_of(2.0 * (self._none.cost - solution.cost), solution, states * pictures)


def _are_possible(window: WindowProblem, state: State) -> bool:
    """Return whether every image state is within three sigmas of its prior."""
    blocks = window.unweighed.blocks
    return not any(b.sigma is not None and np.abs(b.values(state)).max() > SURE_SIGMAS * b.sigma for b in blocks)


def with_open_rows(window: WindowProblem, noise: Noise, solution: Solution) -> tuple[WindowProblem, Solution]:
    """The window, whose own solution is given, with rates and waves of its rows that nothing measures; its solution."""
    rates = window.with_rows_in_turn()
    state = solution.state if rates.layout == window.layout else solution.state.with_block(rates.layout, RATES)
    solution = rates.weighed(noise, state).solution
    waves = row_waves.seen(rates.problem(noise), solution)
    if waves is None:
        return rates, solution
    vibrating = rates.vibrating(waves)
    return vibrating, vibrating.weighed(noise, solution.state.with_block(vibrating.layout, WAVES)).solution


def with_open_lens(request: Request) -> Request:
    """The request with focal length and k1 open, whatever the camera file claims."""
    platform = request.platform.with_camera()
    covariance = platform.covariance
    for state, sigma in OPEN_LENS.items():
        covariance = with_own_variance(covariance, STATES + state, sigma**2)
    taken = request.camera_taken if len(request.camera_taken) else np.zeros(COUNT)
    return replace(request, platform=replace(platform, covariance=covariance), camera_taken=taken)
