"""One window adjusted: an immutable request goes in, an outcome comes out. Pure computation.

The same request gives the same outcome in whatever thread it runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import Status
from onboard.estimation import camera_states, ground_roughness, moved_optics, row_waves, window_problem, window_start
from onboard.estimation.bundle_adjustment import Problem, Solution, solve
from onboard.estimation.factors import WAVES, AttitudePrior, Layout, Prior, State, VelocityPrior
from onboard.estimation.ground_motion import GroundMotion, ground_motion, ground_sigma_m_s
from onboard.estimation.keyframe import Keyframe, have_attitude
from onboard.estimation.pixel_noise import fit_of
from onboard.estimation.second_start import (
    MAX_ROTATION_SIGMA_DEG,
    by_profile,
    heading_unknown,
    is_far_worse,
    likelier,
    other_starts,
)
from onboard.estimation.sensor_groups import Innovation, failing_groups, innovations
from onboard.estimation.sensor_table import PARTS
from onboard.estimation.shared_errors import shared_errors
from onboard.estimation.solved_window import AS_KNOWN, Solved
from onboard.estimation.variance_components import evidence_of
from onboard.estimation.window_acceptance import (
    MAX_DEPTH_SIGMA,
    MAX_FIT_SIGMAS,
    MIN_DEPTH_SHARE,
    MIN_POINTS,
    by_itself,
    by_memory,
    by_mount,
    mount_misfit_sigmas,
)
from onboard.estimation.window_problem import WindowProblem
from onboard.estimation.window_request import Noise, Outcome, Request, Weighed
from onboard.geometry.plane_fit import fit_plane
from onboard.geometry.robust import OUTLIER_SIGMAS
from onboard.navigation.limits import MOST_OF

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GROUND_MOVES = "the ground moves"
MIN_TRACK_INLIERS = 2.0 / 3.0  # of one track's measurements, (6.15)
MIN_VIEW_INLIERS = 0.3  # of one picture's measurements; below it nothing ties that picture to the others
MIN_PIXEL_SIGMA_PX = 0.08  # tracks have common errors, larger than their residuals show
WEIGHING_ROUNDS = 5
TOLERATED_RMS = 1.3  # of velocity's and attitude's whitened residuals
MAX_JITTER_S = 0.02
MAX_NOISE_INFLATION = 2.0
MIN_CHANGE = 0.3  # of a variance's logarithm, by which it must change to weigh a window again


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The second solve, the weights (K, P) that it kept, and the noise it found, relative to those weights."""

    solution: Solution
    kept: Array
    own: float


def lie_near(state: State, weight: Array) -> Mask:
    """A mask (P,) of points far nearer to a camera that saw them, by weight (K, P), than the others it saw. (6.16)

    A point at a camera's centre fits any measurement of that camera: a wrong track's may end there, and would then hold
    the camera to a place that nothing measured.
    """
    depth_m, seen = state.depths_m, weight > 0
    usual_m = np.array([np.median(d[s]) if s.any() else 0.0 for d, s in zip(depth_m, seen, strict=True)])
    out: Mask = np.any(seen & (depth_m < MIN_DEPTH_SHARE * usual_m[:, None]), axis=0)
    return out


def refine(problem: Problem, first: Solution, least_own: float, camera_file: Camera) -> Adjusted | None:
    """The second: without what lay beyond 4 sigma, weighted by the noise found, at least `least_own` of the stated.

    Of a track of which more than a third lay there, nothing: what agrees does so by chance, (6.15).

    Through the camera that the first found, which counts its states from `camera_file`. None where too little is left
    to estimate the noise from.
    """
    sigmas, layout = first.residual_sigmas, problem.layout
    kept = np.where(sigmas > OUTLIER_SIGMAS * max(fit_of(sigmas, layout), 1.0), 0.0, problem.weight)
    left, seen = np.count_nonzero(kept > 0, axis=0), np.count_nonzero(problem.weight > 0, axis=0)
    kept[:, left < np.maximum(2, MIN_TRACK_INLIERS * seen)] = 0.0
    # The window's own noise, not the flight's so far, is what its covariances must be built on.
    own = fit_of(np.where(kept > 0, sigmas, np.nan), layout)
    if not np.isfinite(own):
        return None
    own = max(own, least_own)
    if problem.camera is not None:
        camera, taken, xy = camera_states.seen_through(camera_file, problem.camera, first.state.camera, problem.xy)
        problem = replace(problem, camera=camera, camera_taken=taken, xy=xy)
    solution = solve(replace(problem, weight=kept / own), first.state, scale=6.0, tolerance=1e-5)
    near = lie_near(solution.state, kept)
    if near.any():
        kept[:, near] = 0.0
        solution = solve(replace(problem, weight=kept / own), solution.state, scale=6.0, tolerance=1e-5)
    return Adjusted(solution, kept, own)


def adjust(request: Request) -> Outcome:
    """Solve a window; the status of the outcome is OK, or the reason why it has no result.

    From other starts too, where its pictures may have another explanation: `second_start`, (16.8). A likelier one has
    its own: those of a first solve that stopped short of its minimum are none of them.
    """
    first = _adjusted(request)
    best = _likeliest(request, first)
    if best is not first and best.solved is not None:
        best = _likeliest(request, best)
    judged, lower = by_profile(request, best)
    if lower is None:
        return judged
    other = replace(request, keyframes=lower, previous=None, is_oriented=True)
    preferred = likelier(request, best, _adjusted(other))
    return judged if preferred is best else by_profile(request, preferred)[0]


def _likeliest(request: Request, found: Outcome) -> Outcome:
    """Return what other starts, than that of an outcome, lead to if it is likelier; a refusal if both fit."""
    best = found
    for start in other_starts(request, found):
        other = replace(request, keyframes=start, previous=None, is_oriented=True)
        if not is_far_worse(best, other):
            best = likelier(request, best, _adjusted(other))
    return best


def _adjusted(request: Request) -> Outcome:
    """Adjust from one start."""
    window = window_problem.from_request(request)
    if isinstance(window, Outcome):
        return window
    noise = replace(request.noise, factors=request.noise.factors_at(window.keyframes[0].nav.stamp_ns))
    window, first = _without_near_points(window, window.weighed(noise, window.state))
    window, first = _with_waves(window, first)
    changed = None if request.is_mount_open else moved_optics.found(window, first)
    if changed is not None:
        return changed
    weighed, failed = _without_failing_sensors(window, first)
    # From here on the sensors are weighted by what earlier windows found, and by which of them fail.
    request = replace(request, noise=weighed.noise)
    weighed, noise = _settled(request, window, weighed)
    own_share = _depth_share_without_known_ground(window, weighed)
    if own_share > MAX_DEPTH_SIGMA:
        reason = f"little parallax: depths known to {100.0 * own_share:.0f} % only, without the terrain model"
        return Outcome(Status.LOW_PARALLAX, window.keyframes, noise, reason=reason)
    window, weighed = _with_waves(window, weighed, WEIGHING_ROUNDS)
    hold = ground_roughness.correlated(weighed.problem, weighed.solution, window.unweighed.ground_weight)
    least_own = MIN_PIXEL_SIGMA_PX / (weighed.noise.pixel_sigma_px * weighed.noise.noise_inflation)
    adjusted = refine(replace(weighed.problem, ground_weight=hold), weighed.solution, least_own, request.camera_file)
    if adjusted is None:
        return Outcome(Status.POOR_FIT, window.keyframes, noise, reason="nearly all measurements are outliers")
    judged = _judged(request, window, weighed, adjusted)
    return replace(judged, weighed=weighed, noise=_learned(request, noise, weighed, adjusted, judged, failed))


def _without_near_points(window: WindowProblem, weighed: Weighed) -> tuple[WindowProblem, Weighed]:
    """The window without tracks whose point lies next to a camera that saw it, (6.16)."""
    near = lie_near(weighed.solution.state, weighed.problem.weight)
    if not near.any():
        return window, weighed
    window = window.with_problem(weight=np.where(near, 0.0, window.unweighed.weight))
    return window, window.weighed(weighed.noise, weighed.solution.state)


def _without_failing_sensors(window: WindowProblem, weighed: Weighed) -> tuple[Weighed, set[str]]:
    """The window with the sensors down-weighted that fail by it, and the names of those that were found to."""
    noise, held = weighed.noise, weighed.noise.factors.groups
    if not noise.factors.stamp_ns:  # a sensor that never agreed with pictures (a convoy) has not failed: refused below
        return weighed, set()

    def of(solved: Weighed, groups: Mapping[str, float]) -> list[Innovation]:
        s = solved.solution
        return innovations(solved.problem.priors, s.state, s.covariance, groups, noise.factors.known_by)

    def innovations_with(groups: Mapping[str, float]) -> list[Innovation]:
        factors = replace(noise.factors, groups=groups)
        return of(window.weighed(replace(noise, factors=factors), weighed.solution.state), groups)

    groups, failed = failing_groups(of(weighed, held), innovations_with, held)
    if not failed:
        return weighed, set()
    noise = replace(noise, factors=replace(noise.factors, groups=groups))
    return window.weighed(noise, weighed.solution.state), failed


def _settled(request: Request, window: WindowProblem, weighed: Weighed) -> tuple[Weighed, Noise]:
    """The window weighted until its own residuals ask for no other weights, and the noise that the next one is."""
    noise = weighed.noise
    for _ in range(WEIGHING_ROUNDS):
        noise, again = _reweighed(request, weighed)
        if not again:
            noise, again = _with_own_evidence(request, noise, weighed)
        if not again:
            break
        weighed = window.weighed(noise, weighed.solution.state)
    return _with_mount_as_found(request, window, weighed), noise


def _with_mount_as_found(request: Request, window: WindowProblem, weighed: Weighed) -> Weighed:
    """The window with its mount known to as many more sigmas as it is off what was known, where that is more. (16.13)

    An attitude that is off by a constant angle shows in level flight by nothing else: the ground slopes instead.
    """
    found = mount_misfit_sigmas(weighed.solution, weighed.problem.priors, _priors_before(request, window, weighed))
    if found.max() < np.exp(0.5 * MIN_CHANGE):
        return weighed
    x, y, z = np.maximum(found, 1.0).tolist()
    return window.weighed(replace(weighed.noise, mount_sigmas=(x, y, z)), weighed.solution.state)


def _priors_before(request: Request, window: WindowProblem, weighed: Weighed) -> list[Prior]:
    """The priors as earlier windows weighted the sensors: this window's own weights would excuse them."""
    noise, factors = weighed.noise, request.noise.factors
    if noise.factors is factors and noise.mount_sigmas == AS_KNOWN:
        return weighed.problem.priors
    return window.problem(replace(noise, factors=factors, mount_sigmas=AS_KNOWN)).priors


def _depth_share_without_known_ground(window: WindowProblem, weighed: Weighed) -> float:
    """One sigma of a depth, as a share of it, by the pictures and the sensors alone; 0 where no ground is known. (6.14)

    Terrain gives every picture its depth. What a window without parallax then shows of its tilt is no more than the
    noise of a baseline as long as its own error, which linear covariances do not show.
    """
    if window.unweighed.terrain is None and not window.unweighed.priors:
        return 0.0
    free, state = window.without_known_ground(weighed), weighed.solution.state
    seen = np.count_nonzero(weighed.problem.weight > 0, axis=0) >= 2
    depth_m = np.abs((state.points_enu_m - state.centres_enu_m[-1])[seen] @ state.R_cam_enu[-1, 2])
    return float(np.median(_depth_sigma(free, free.covariance, seen, window.layout)) / np.median(depth_m))


def _with_waves(window: WindowProblem, weighed: Weighed, rounds: int = 1) -> tuple[WindowProblem, Weighed]:
    """The window with the vibration that its rows show, if they are read in turn: again while it grows.

    Strong waves turn features into outliers, and poses take some of them, until they are modelled.
    """
    for _ in range(rounds * (window.unweighed.sweep is not None)):
        waves = row_waves.seen(weighed.problem, weighed.solution)
        if waves is None:
            break
        assert window.unweighed.sweep is not None
        has_grown = waves.sigma_rad > np.exp(0.5 * MIN_CHANGE) * window.unweighed.sweep.sigma_wave_rad
        window = window.vibrating(waves)
        weighed = window.weighed(weighed.noise, weighed.solution.state.with_block(window.layout, WAVES))
        if not has_grown:
            break
    return window, weighed


def _learned(
    request: Request, noise: Noise, weighed: Weighed, adjusted: Adjusted, judged: Outcome, failed: set[str]
) -> Noise:
    """The noise that weights the next window: `noise`, with the sensors' evidence if the window was accepted."""
    factors, failing = replace(request.noise.factors, groups={}), noise.failing
    if judged.status is Status.OK:
        start_ns, end_ns = request.keyframes[0].nav.stamp_ns, request.keyframes[-1].nav.stamp_ns
        used, solution = weighed.noise.factors, adjusted.solution
        evidence = evidence_of(weighed.problem.priors, solution.state, solution.covariance, used)
        factors = factors.with_evidence(evidence, end_ns, 1.0 / len(request.keyframes))
        groups = request.noise.factors.groups
        failing = failing.after(start_ns, end_ns, {name: groups[name] for name in failed})
    return replace(noise, pixel_sigma_px=judged.noise.pixel_sigma_px, factors=factors, failing=failing)


def _with_own_evidence(request: Request, used: Noise, weighed: Weighed) -> tuple[Noise, bool]:
    """The sensors' variances with what this window itself shows of them; True if that changes its weights. (13.2)"""
    first = weighed.solution
    evidence = evidence_of(weighed.problem.priors, first.state, first.covariance, used.factors)
    own = request.noise.factors.with_evidence(evidence, request.keyframes[-1].nav.stamp_ns)
    changed = any(abs(np.log(own.of(n) / used.factors.of(n))) > MIN_CHANGE for n in PARTS)
    return (replace(used, factors=own), True) if changed else (used, False)


def _reweighed(request: Request, weighed: Weighed) -> tuple[Noise, bool]:
    """Stamp jitter and noise inflation from velocity and attitude residuals; True if weights changed.

    Stamps that are off by some milliseconds (photographs, USB) raise both residuals at once, and are allowed for first.
    What disagreement remains is the picture's: a calibration's error moves many features together, biases the poses and
    hardly shows in the features' own residuals. The sigma of all pixels is then raised until both sides agree. (6.7)
    """
    noise, state = weighed.noise, weighed.solution.state
    kinds = VelocityPrior | AttitudePrior if have_attitude(request.keyframes) else VelocityPrior
    measured = [p.evaluate(state)[0] for p in weighed.problem.priors if isinstance(p, kinds)]
    if not measured:
        return noise, False
    rms = max(float(np.sqrt(np.mean(r**2))) for r in measured)
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


def _judged(request: Request, window: WindowProblem, weighed: Weighed, adjusted: Adjusted) -> Outcome:
    """The outcome of an adjusted window: solved, or refused with the reason."""
    s, kept, own = adjusted.solution, adjusted.kept, adjusted.own
    noise, camera, config, layout = weighed.noise, request.camera, request.config, window.layout
    keyframes = window_start.with_found_rates(request, window.keyframes, layout, window.unweighed.sweep, s.state)

    def refused(status: Status, reason: str) -> Outcome:
        return Outcome(status, keyframes, noise, reason=reason)

    used = kept > 0
    by_picture, seen_by_picture = used.sum(axis=1), np.count_nonzero(weighed.problem.weight > 0, axis=1)
    count, seen = by_picture.sum(), seen_by_picture.sum()
    good = np.count_nonzero(used, axis=0) >= 2
    if count < MOST_OF * seen or np.count_nonzero(good) < MIN_POINTS:
        return refused(Status.POOR_FIT, f"outliers: {seen - count} of {seen} measurements")
    left = by_picture / np.maximum(seen_by_picture, 1)
    if left.min() < MIN_VIEW_INLIERS:
        return refused(Status.POOR_FIT, f"a picture contradicts the others: {left.min():.0%} of its features agree")
    fit = fit_of(s.residual_sigmas, layout)
    sigma_px = noise.pixel_sigma_px * noise.noise_inflation * own * fit
    if sigma_px > MAX_FIT_SIGMAS * config.solve.pixel_sigma_px * max(1.0, camera.width_px / 640.0):
        return refused(Status.POOR_FIT, f"large residuals: {sigma_px:.1f} px")
    depth_m = float(np.median(np.abs(s.state.depths_m[used])))
    still = float(np.median(_depth_sigma(s, s.covariance, good, layout))) / depth_m * max(fit, 1.0)
    if still > MAX_DEPTH_SIGMA:
        return refused(Status.LOW_PARALLAX, f"little parallax: depths known to {100.0 * still:.0f} % only")
    turn = float(np.degrees(np.sqrt(np.diag(s.covariance)[layout.rotations()].max())))
    if turn > MAX_ROTATION_SIGMA_DEG:
        return refused(Status.LOW_PARALLAX, heading_unknown(turn))
    # Another start, from the attitudes or from the path, may still converge: `second_start` compares the two.
    if not s.converged and (request.previous is not None or not have_attitude(keyframes)):
        reason = f"the adjustment found no minimum in {s.iterations} steps"
        return replace(refused(Status.POOR_FIT, reason), is_minimum=False)
    priors = weighed.problem.priors
    moving = ground_motion(keyframes, priors, s.state, s.covariance, ground_sigma_m_s(keyframes, depth_m))
    covariance = s.covariance + moving.covariance(moving.epoch_ns)
    if float(np.median(_depth_sigma(s, covariance, good, layout))) / depth_m > MAX_DEPTH_SIGMA:
        # coarse and fine flow disagree too much to know the scale: water
        return refused(Status.POOR_FIT, GROUND_MOVES)
    before = _priors_before(request, window, weighed)
    against = by_itself(config, keyframes, request.terrain, s, layout, kept, good, before)
    against = against or by_mount(mount_misfit_sigmas(s, priors, before))
    if against is not None:
        return refused(Status.POOR_FIT, against)
    solved = _solved(request, window, weighed, s, good, sigma_px, moving, keyframes)
    # The tracking noise is updated slowly, so that one odd window changes little.
    learned = noise.pixel_sigma_px * (own * fit * noise.noise_inflation) ** 0.3
    noise = replace(noise, pixel_sigma_px=float(np.clip(learned, MIN_PIXEL_SIGMA_PX, 5.0)))
    agreed = request.memory.compared(solved)
    remembered = by_memory(request.memory, agreed)
    if remembered is not None:
        return replace(refused(Status.POOR_FIT, remembered), rejected=solved, agreed=agreed)
    return Outcome(Status.OK, solved.keyframes, noise, solved, agreed=agreed)


def _solved(
    request: Request,
    window: WindowProblem,
    weighed: Weighed,
    s: Solution,
    good: Mask,
    sigma_px: float,
    moving: GroundMotion,
    keyframes: tuple[Keyframe, ...],
) -> Solved:
    """The solved window: the solution, the keyframes with its poses, and all that is derived from it once."""
    state, layout, priors = s.state, window.layout, weighed.problem.priors
    posed = tuple(
        replace(k, R_cam_enu=R, centre_enu_m=C)
        for k, R, C in zip(keyframes, state.R_cam_enu, state.centres_enu_m, strict=True)
    )
    plane, _ = fit_plane(state.points_enu_m[good])
    camera = camera_states.corrected(request.camera_file, state.camera)
    # A picture between keyframes vibrates too, as nothing measures: for it that is noise.
    swing_px = camera.focal_px * row_waves.swing_rad(state.own[:, layout.part(WAVES)])
    noise_px = float(np.hypot(sigma_px, swing_px)), sigma_px * 1.177
    shared = shared_errors(request.config, priors, state, s.covariance)
    readout_s = window_start.readout_of(request, layout, state)
    found = layout, s, window.ids, good, plane, *noise_px, posed, shared, moving, camera, readout_s
    return Solved(*found, mount_sigmas=weighed.noise.mount_sigmas, priors=tuple(priors))


def _depth_sigma(s: Solution, covariance: Array, good: Mask, layout: Layout) -> Array:
    """One sigma (m) of each good point along the newest keyframe's axis, relative to that keyframe."""
    axis = s.state.R_cam_enu[-1, 2]
    M = -np.einsum("i,pid->pd", axis, s.point_gain[good])
    M[:, layout.centre(layout.keyframes - 1)] -= axis
    own = np.einsum("i,pij,j->p", axis, s.point_covariance[good], axis)
    out: Array = np.sqrt(np.maximum(np.sum((M @ covariance) * M, axis=1) + own, 0.0))
    return out
