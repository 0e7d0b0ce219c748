"""One window adjusted: an immutable request goes in, an outcome comes out. Pure computation.

The same request gives the same outcome in whatever thread it runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import Status
from onboard.config.schema import Config
from onboard.estimation import camera_states, ground_weight, row_waves, window_start
from onboard.estimation.boresight import BORESIGHT, HEADING, OFFSET, STATES, VELOCITY_DELAY, Belief
from onboard.estimation.bundle_adjustment import Problem, Solution, solve
from onboard.estimation.factors import AttitudePrior, Layout, Prior, State, VelocityPrior
from onboard.estimation.ground_motion import ground_motion, ground_sigma_m_s
from onboard.estimation.ground_slope import SlopePrior
from onboard.estimation.keyframe import Ids, Keyframe, have_attitude
from onboard.estimation.reobservation import Agreement
from onboard.estimation.second_start import by_sensors, confirms, is_worth_another, verdict
from onboard.estimation.sensor_factors import range_prior, sensor_priors
from onboard.estimation.sensor_groups import Failing, Innovation, failing_groups, innovations
from onboard.estimation.shared_errors import shared_errors
from onboard.estimation.solved_window import Solved
from onboard.estimation.variance_components import NAMES, VarianceFactors, evidence_of
from onboard.estimation.window_acceptance import (
    MAX_DEPTH_SIGMA,
    MAX_FIT_SIGMAS,
    MIN_INLIERS,
    MIN_POINTS,
    Memory,
    by_itself,
    by_memory,
)
from onboard.geometry.plane_fit import fit_plane
from onboard.geometry.terrain_grid import Terrain

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GROUND_MOVES = "the ground moves"
MIN_KEYFRAMES = 3
MAX_ROTATION_SIGMA_DEG = 20.0  # above it a turn's second order, which no covariance has, is a fifth of its first
MIN_VIEW_INLIERS = 0.3  # of one picture's measurements; below it nothing ties that picture to the others
OUTLIER_SIGMAS = 4.0
# Median length of a residual (of noise of one sigma an axis) of a point seen in so many views, from 2 on: along the
# travel the point's place and depth have been fitted, across it its place. First: without any fit (Rayleigh).
MEDIAN_LENGTH = np.array([1.1774, np.inf, 0.4769, 0.7833, 0.9085, 0.9732, 1.0112, 1.0373, 1.0560, 1.0713, 1.0816])
MIN_PIXEL_SIGMA_PX = 0.08  # tracks have common errors, larger than their residuals show
WEIGHING_ROUNDS = 5
TOLERATED_RMS = 1.3  # of velocity's and attitude's whitened residuals
MAX_JITTER_S = 0.02
MAX_NOISE_INFLATION = 2.0
WAVE_ROUNDS = 2
MIN_CHANGE = 0.3  # of a variance's logarithm, by which it must change to weigh a window anew


@dataclass(frozen=True)
class Noise:
    """The flight's own noise as estimated so far; every window is weighted by it and updates it a little."""

    pixel_sigma_px: float
    jitter_s: float
    noise_inflation: float = 1.0  # times the sigma that the tracks' own residuals show
    factors: VarianceFactors = field(default_factory=VarianceFactors)
    failing: Failing = field(default_factory=Failing)  # sensors that contradict the others
    shifted_ns: int = 0  # stamp of the newest window whose frame was seen to be shifted: `moved_optics`
    zoomed_ns: int = 0  # the same of a zoom
    looked_ns: tuple[int, int] = (0, 0)  # the same of ones accepted, and refused, that neither explains
    past: tuple[tuple[int, float, float], ...] = ()  # of earlier windows: end, jitter, inflation: `moved_optics`

    def factors_at(self, start_ns: int) -> VarianceFactors:
        """The sensors' variances for a window that begins then, those of failing sensors as they fade."""
        return replace(self.factors, groups=self.failing.factors(start_ns))


@dataclass(frozen=True, eq=False)
class Request:
    """A window as it stands, with the priors of the sensors and of the tracking noise so far."""

    config: Config
    camera: Camera  # that the keyframes' observations were made with
    camera_file: Camera
    camera_taken: Array  # the states that part the two, (C,)
    R_body_cam: Array
    keyframes: tuple[Keyframe, ...]
    previous: Solved | None
    terrain: Terrain | None
    belief: Belief  # of boresight and time offset, for a window that begins where this one does
    noise: Noise
    slope: SlopePrior | None = None  # of the ground where the window is; None: as configured
    memory: Memory = field(default_factory=Memory)
    is_carrier_open: bool = False  # it is not known yet whether mount or gimbal carries the camera
    is_oriented: bool = False  # the keyframes' orientations are a start, whatever they came from


@dataclass(frozen=True, eq=False)
class Outcome:
    """The result of a request: OK and `solved`, or the reason why there is none; and the noise as estimated anew."""

    status: Status
    keyframes: tuple[Keyframe, ...]
    noise: Noise
    solved: Solved | None = None
    reason: str = ""  # why not, in words
    cost: float = np.inf  # by `comparable_cost`
    rejected: Solved | None = None  # a solution that only earlier windows speak against
    agreed: Agreement | None = None  # with an earlier window that shares points and no picture


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The second solve, the weights (K, P) that it kept, and the noise it found, relative to those weights."""

    solution: Solution
    kept: Array
    own: float


def approximate(problem: Problem, state: State) -> Solution:
    """The first of the two solves: robust, only as exact as finding outliers needs."""
    return solve(problem, state, scale=3.0, tolerance=1e-4)


def refine(problem: Problem, first: Solution, least_own: float) -> Adjusted | None:
    """The second: without what lay beyond 4 sigma, weighted by the noise found, at least `least_own` of the stated.

    None where too little is left to estimate the noise from.
    """
    sigmas, states = first.residual_sigmas, view_states(problem.layout)
    kept = np.where(sigmas > OUTLIER_SIGMAS * max(fit_of(sigmas, states), 1.0), 0.0, problem.weight)
    kept[:, np.count_nonzero(kept > 0, axis=0) < 2] = 0.0
    # The window's own noise, not the flight's so far, is what its covariances must be built on.
    own = fit_of(np.where(kept > 0, sigmas, np.nan), states)
    if not np.isfinite(own):
        return None
    own = max(own, least_own)
    return Adjusted(solve(replace(problem, weight=kept / own), first.state, scale=6.0, tolerance=1e-6), kept, own)


def adjust(request: Request) -> Outcome:
    """Solve a window; the status of the outcome is OK, or the reason why it has no result.

    From a second start too, where the first is refused or nothing confirms it yet.
    """
    first = _adjusted(request)
    is_confirmed = first.agreed is not None or bool(request.memory.windows)
    if not is_worth_another(first.status, first.keyframes, request.R_body_cam, is_confirmed):
        return first
    start = by_sensors(request.keyframes, request.belief, request.R_body_cam)
    has_attitude = have_attitude(request.keyframes)
    if start is None or (has_attitude and request.previous is None):
        return first  # the sensors' start was the first one
    second = _adjusted(replace(request, keyframes=start, previous=None, is_oriented=True))
    if second.solved is None:
        return first
    # A path is no attitude: what only its start finds needs an earlier window to confirm it.
    is_supported = has_attitude or second.agreed is not None or confirms(request.previous, second.solved)
    if first.solved is None and not is_supported:
        return first
    if first.solved is None:
        return second
    better, reason = verdict(first.solved, second.solved, (first.cost, second.cost))
    if better is None:
        return replace(first, status=Status.POOR_FIT, keyframes=request.keyframes, solved=None, reason=reason)
    return replace(first, solved=better) if better is not second.solved else second


def _adjusted(request: Request) -> Outcome:
    """From one start."""
    keyframes, noise = request.keyframes, request.noise
    if len(keyframes) < MIN_KEYFRAMES:
        return Outcome(Status.STARTING, keyframes, noise)
    ids, counts = np.unique(np.concatenate([k.observation.ids for k in keyframes]), return_counts=True)
    ids = ids[counts >= 2]
    if len(ids) < MIN_POINTS:
        return Outcome(Status.FEATURELESS, keyframes, noise)
    xy, raw, weight, share = window_start.grid(request, ids)
    start = window_start.oriented(request, xy, weight > 0)
    if start is None:
        status = Status.LOW_PARALLAX if window_start.travel_m(keyframes) < 1.0 else Status.POOR_FIT
        return Outcome(status, keyframes, noise, reason="the pictures' rays support no orientation")
    keyframes = start
    rows = window_start.sweep(request, keyframes, share)
    layout = window_start.layout_of(request, keyframes, rows)
    R = np.stack([k.R_cam_enu for k in keyframes])
    C = np.stack([k.centre_enu_m for k in keyframes])
    points, reference, plane = window_start.starting_points(request, ids, R, C, xy, weight > 0)
    belief = request.belief
    offset_s, late_s, velocity_late_s = belief.mean[OFFSET : VELOCITY_DELAY + 1].tolist()
    platform = belief.mean[BORESIGHT], belief.mean[HEADING], belief.mean[STATES:]
    off = np.zeros(layout.rates.shape)
    state = State(R, C, points, platform[0], offset_s, plane, late_s, velocity_late_s, *platform[1:], off)
    hold, terrain = ground_weight.weight_and_terrain(request, points)
    if terrain is not None:
        reference[2] = 0.0
        state = replace(state, plane=np.zeros(3))
    clearance_m = None if terrain is not None else float(C[:, 2].mean() - reference[2])
    strays_m = ground_weight.strays_m(request, points - reference, state.plane, terrain)
    ranged = range_prior(list(keyframes), layout, reference, state.plane, strays_m, terrain)
    if ranged is not None:  # what it measures is the plane: the points must be held to that as closely as they lie
        hold = np.full(len(points), 1.0 / strays_m)

    def sensors(noise: Noise) -> list[Prior]:
        found = sensor_priors(
            request.config,
            request.R_body_cam,
            list(keyframes),
            layout,
            belief,
            terrain is not None,
            noise.jitter_s,
            noise.factors,
            request.slope,
        )
        return found if ranged is None else [*found, ranged]

    def weighed(noise: Noise, state: State) -> tuple[Problem, list[Prior], Solution]:
        priors = sensors(noise)
        problem = Problem(
            layout,
            raw,
            weight / noise.noise_inflation,
            priors,
            reference,
            hold,
            terrain,
            clearance_m,
            request.camera if layout.camera_states else None,
            request.camera_taken,
            rows,
        )
        return problem, priors, approximate(problem, state)

    start_ns, end_ns = keyframes[0].nav.stamp_ns, keyframes[-1].nav.stamp_ns
    noise = replace(noise, factors=noise.factors_at(start_ns))
    problem, priors, first = weighed(noise, state)
    has_attitude = have_attitude(keyframes)

    def innovations_with(groups: Mapping[str, float]) -> list[Innovation]:
        other = replace(noise, factors=replace(noise.factors, groups=groups))
        _, priors, solution = weighed(other, first.state)
        return innovations(priors, solution.state, solution.covariance, groups, has_attitude)

    held = noise.factors.groups
    found = innovations(priors, first.state, first.covariance, held, has_attitude)
    groups, failed = dict(held), set[str]()
    if noise.factors.stamp_ns:  # a sensor that never agreed with pictures (a convoy) has not failed: refused below
        groups, failed = failing_groups(found, innovations_with, held)
    if failed:
        noise = replace(noise, factors=replace(noise.factors, groups=groups))
        problem, priors, first = weighed(noise, first.state)
    # What follows is judged by what earlier windows found of the sensors, and by which of them fail.
    request = replace(request, noise=noise)
    for _ in range(WEIGHING_ROUNDS):
        used = noise  # what this problem is weighted by; `noise` becomes what the next is
        noise, again = _reweighed(request, used, priors, first.state)
        if not again:
            noise, again = _with_own_evidence(request, noise, priors, first)
        if not again:
            break
        problem, priors, first = weighed(noise, first.state)
    for _ in range(WAVE_ROUNDS * (rows is not None)):  # the second time with what the first made of poses and points
        waves = row_waves.seen(problem, first)
        if waves is None or rows is None:
            break
        rows, layout = rows.vibrating(waves.cycles, waves.sigma_rad), replace(layout, has_waves=True)
        if ranged is not None:
            ranged = replace(ranged, layout=layout)
        problem, priors, first = weighed(used, replace(first.state, waves_rad=np.zeros(layout.waves.shape)))
    problem = replace(problem, ground_weight=ground_weight.alike(problem, first, hold))
    adjusted = refine(problem, first, MIN_PIXEL_SIGMA_PX / (used.pixel_sigma_px * used.noise_inflation))
    if adjusted is None:
        return Outcome(Status.POOR_FIT, keyframes, noise, reason="too little is left without outliers")
    keyframes = window_start.with_found_rates(request, keyframes, rows, adjusted.solution.state)
    # Whether sensors contradict the pictures is judged by what earlier windows found, not by this one's own excuse.
    before = sensors(replace(used, factors=request.noise.factors))
    judged = _judged(
        replace(request, keyframes=keyframes, noise=used), ids, layout, priors, before, problem.weight, adjusted
    )
    factors, failing = replace(request.noise.factors, groups={}), noise.failing
    if judged.status is Status.OK:
        evidence = evidence_of(priors, adjusted.solution.state, adjusted.solution.covariance, used.factors)
        factors = factors.with_evidence(evidence, end_ns, 1.0 / len(keyframes))
        failing = failing.after(start_ns, end_ns, {name: groups[name] for name in failed})
    learned = replace(noise, pixel_sigma_px=judged.noise.pixel_sigma_px, factors=factors, failing=failing)
    return replace(judged, cost=first.cost, noise=learned)


def _with_own_evidence(request: Request, used: Noise, priors: list[Prior], first: Solution) -> tuple[Noise, bool]:
    """The sensors' variances with what this window itself says of them; True if that changes its weights. (13.2)"""
    evidence = evidence_of(priors, first.state, first.covariance, used.factors)
    own = request.noise.factors.with_evidence(evidence, request.keyframes[-1].nav.stamp_ns)
    changed = any(abs(np.log(own.scale(n) / used.factors.scale(n))) > MIN_CHANGE for n in NAMES)
    return (replace(used, factors=own), True) if changed else (used, False)


def _reweighed(request: Request, noise: Noise, priors: list[Prior], state: State) -> tuple[Noise, bool]:
    """Stamp jitter and noise inflation from velocity and attitude residuals; True if weights changed.

    Stamps that are off by some milliseconds (photographs, USB) raise both residuals at once, and are allowed for first.
    What disagreement remains is the picture's: a calibration's error moves many features together, biases the poses and
    hardly shows in the features' own residuals. The sigma of all pixels is then raised until both sides agree. (6.7)
    """
    measured = [p for p in priors if isinstance(p, VelocityPrior | AttitudePrior)]
    if request.keyframes[0].nav.R_enu_body is None:
        measured = [p for p in measured if isinstance(p, VelocityPrior)]
    if not measured:
        return noise, False
    rms = max(float(np.sqrt(np.mean(p.evaluate(state)[0] ** 2))) for p in measured)
    if rms > TOLERATED_RMS:
        if noise.jitter_s < MAX_JITTER_S:
            return replace(noise, jitter_s=min(max(noise.jitter_s, 0.003) * min(rms, 3.0), MAX_JITTER_S)), True
        if noise.noise_inflation < MAX_NOISE_INFLATION:
            return replace(noise, noise_inflation=min(noise.noise_inflation * min(rms, 2.0), MAX_NOISE_INFLATION)), True
    elif rms < 1.0 / TOLERATED_RMS:
        least_s = request.config.camera.sigma_jitter_s
        jitter_s, inflation = max(0.95 * noise.jitter_s, least_s), max(0.95 * noise.noise_inflation, 1.0)
        return replace(noise, jitter_s=jitter_s, noise_inflation=inflation), False
    return noise, False


def _judged(
    request: Request,
    ids: Ids,
    layout: Layout,
    priors: list[Prior],
    before: list[Prior],
    weight: Array,
    adjusted: Adjusted,
) -> Outcome:
    """Whether a solution may be published. `weight` (K, P): the first solve's; `before`: priors by earlier windows."""
    s, kept, own = adjusted.solution, adjusted.kept, adjusted.own
    noise, camera, config = request.noise, request.camera, request.config

    def refused(status: Status, reason: str) -> Outcome:
        return Outcome(status, request.keyframes, noise, reason=reason)

    seen, used = np.count_nonzero(weight > 0), np.count_nonzero(kept > 0)
    fit = fit_of(s.residual_sigmas, view_states(layout))
    sigma_px = noise.pixel_sigma_px * noise.noise_inflation * own * fit
    depth = np.abs(
        np.einsum("kj,kpj->kp", s.state.R_cam_enu[:, 2], s.state.points_enu_m - s.state.centres_enu_m[:, None])
    )
    turn = float(np.degrees(np.sqrt(np.diag(s.covariance)[layout.rotations()].max())))
    depth_m = np.where(kept > 0, depth, np.nan)
    median_depth = float(np.nanmedian(depth_m)) if used else np.nan
    good = np.count_nonzero(kept > 0, axis=0) >= 2
    if used < MIN_INLIERS * seen or np.count_nonzero(good) < MIN_POINTS or not np.isfinite(median_depth):
        return refused(Status.POOR_FIT, f"outliers: {seen - used} of {seen} measurements")
    left = np.count_nonzero(kept > 0, axis=1) / np.maximum(np.count_nonzero(weight > 0, axis=1), 1)
    if left.min() < MIN_VIEW_INLIERS:
        return refused(Status.POOR_FIT, f"a picture has {left.min():.0%} of its features where the others see them")
    if sigma_px > MAX_FIT_SIGMAS * config.solve.pixel_sigma_px * max(1.0, camera.width_px / 640.0):
        return refused(Status.POOR_FIT, f"large residuals: {sigma_px:.1f} px")
    scale = max(fit, 1.0) ** 2
    still = float(np.median(_depth_sigma(s, s.covariance, good, layout))) / median_depth
    if still * np.sqrt(scale) > MAX_DEPTH_SIGMA:
        return refused(Status.LOW_PARALLAX, f"little parallax: depths to {100.0 * still * np.sqrt(scale):.0f} %")
    if turn > MAX_ROTATION_SIGMA_DEG:
        return refused(Status.LOW_PARALLAX, f"neither the path nor a sensor tells the heading: to {turn:.0f} degrees")
    moving = ground_motion(
        request.keyframes, priors, s.state, s.covariance, ground_sigma_m_s(request.keyframes, median_depth)
    )
    covariance = s.covariance + moving.covariance(moving.epoch_ns)
    if float(np.median(_depth_sigma(s, covariance, good, layout))) / median_depth > MAX_DEPTH_SIGMA:
        # coarse and fine flow disagree too much to know the scale: water
        return refused(Status.POOR_FIT, GROUND_MOVES)
    against = by_itself(config, camera, request.keyframes, request.terrain, s, layout, kept, good, before)
    if against is not None:
        return refused(against.status, against.reason)
    keyframes = tuple(
        replace(k, R_cam_enu=R, centre_enu_m=C)
        for k, R, C in zip(request.keyframes, s.state.R_cam_enu, s.state.centres_enu_m, strict=True)
    )
    plane, _ = fit_plane(s.state.points_enu_m[good])
    # The tracking noise is updated slowly, so that one odd window changes little.
    learned = noise.pixel_sigma_px * (own * fit * noise.noise_inflation) ** 0.3
    noise = replace(noise, pixel_sigma_px=float(np.clip(learned, MIN_PIXEL_SIGMA_PX, 5.0)))
    frames = tuple(k.frame for k in keyframes)
    shared = shared_errors(config, priors, s.state, s.covariance)
    camera = camera_states.corrected(request.camera_file, s.state.camera)
    readout_s = window_start.readout_of(request, s.state)
    sigma_p = sigma_px * 1.177
    # A picture between keyframes vibrates too, and nobody knows how: to it that is noise.
    unknown_px = float(np.hypot(sigma_px, camera.focal_px * row_waves.swing_rad(s.state.waves_rad)))
    solved = Solved(
        frames, layout, s, ids, good, plane, unknown_px, sigma_p, keyframes, shared, moving, camera, readout_s
    )
    agreed = request.memory.compared(solved)
    remembered = by_memory(config, request.memory, solved, agreed)
    if remembered is not None:
        return replace(refused(remembered.status, remembered.reason), rejected=solved, agreed=agreed)
    return Outcome(Status.OK, keyframes, noise, solved, agreed=agreed)


def view_states(layout: Layout) -> int:
    """How many states each picture has that its own features tell."""
    return 6 + 6 * layout.has_waves


def fit_of(sigmas: Array, view_states: int = 6) -> float:
    """Robust one sigma per axis of whitened residual lengths (K, P): their median over what it should be. (6.11)

    Residuals are smaller than the noise by the degrees of freedom fitted: of a point seen twice, three out of four.
    """
    known = np.isfinite(sigmas)
    seen = np.count_nonzero(known, axis=0)
    several = seen >= 2
    if not np.any(several):
        return float("inf")
    many = MEDIAN_LENGTH[0] * np.sqrt(1.0 - 1.5 / np.maximum(seen, 2))
    last = len(MEDIAN_LENGTH) - 1
    expected = np.where(seen <= last, MEDIAN_LENGTH[np.minimum(seen, last)], many)
    ratio = (sigmas / expected)[known & several]
    left = float(np.sum(2 * seen[several] - 3))
    return float(np.median(ratio) * np.sqrt(left / max(left - view_states * len(sigmas), 0.2 * left)))


def _depth_sigma(s: Solution, covariance: Array, good: Mask, layout: Layout) -> Array:
    """One sigma (m) of each good point along the newest keyframe's axis, relative to that keyframe."""
    axis = s.state.R_cam_enu[-1, 2]
    gain = s.point_gain[good] * -1.0
    M = np.einsum("i,pid->pd", axis, gain)
    M[:, layout.centre(layout.keyframes - 1)] -= axis
    own = np.einsum("i,pij,j->p", axis, s.point_covariance[good], axis)
    out: Array = np.sqrt(np.maximum(np.sum((M @ covariance) * M, axis=1) + own, 0.0))
    return out
