"""The stages of a window's adjustment: begin, explain, weigh, refine, accept.

Each takes the value of the one before, and gives the next one's, or the outcome that ends the adjustment there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from contract.feature_set import Status
from onboard.estimation import ground_roughness, mirror_image, moved_optics
from onboard.estimation.refined_window import MIN_PIXEL_SIGMA_PX, Refined, depth_sigma_m, judged
from onboard.estimation.second_solve import solve_again
from onboard.estimation.variance_components import evidence_of
from onboard.estimation.weighing import (
    WEIGHING_ROUNDS,
    Settled,
    settled,
    with_waves,
    without_failing_sensors,
    without_near_points,
)
from onboard.estimation.window_acceptance import MAX_DEPTH_SIGMA, off_terrain
from onboard.estimation.window_problem import Outcome, Weighed, WindowProblem, from_request
from onboard.estimation.window_request import Noise, Request

STEPS = 10  # from ground that the terrain model holds to where pictures and sensors alone have it


def from_one_start(request: Request) -> Outcome:
    """Adjust a window from the start that its request gives."""
    window = from_request(request)
    return window if isinstance(window, Outcome) else adjusted(window)


def adjusted(window: WindowProblem) -> Outcome:
    """Take a window through every stage, from the state that it begins with."""
    weighed = begin(window)
    is_mirrored = mirror_image.shown(weighed)
    if is_mirrored or (is_mirrored is None and window.request.is_mirrored):
        reason = "the pictures are mirror images of the ground"
        return replace(moved_optics.refused(weighed, Status.MIRRORED, reason), is_mirrored=is_mirrored)
    return replace(_as_seen(weighed), is_mirrored=is_mirrored)


def _as_seen(weighed: Weighed) -> Outcome:
    """Take a window whose pictures are what the camera sees through the stages after its first solve."""
    if weighed.window.request.is_mount_open:  # what carries the camera is not known yet
        return _of_known_optics(weighed)
    signs = moved_optics.signs_of(weighed)
    is_stretched = moved_optics.are_stretched(weighed, signs.stretch)
    if is_stretched or (is_stretched is None and weighed.window.request.is_stretched):
        reason = "the pictures are stretched along one side against the camera file"
        return replace(moved_optics.refused(weighed, Status.STRETCHED, reason), is_stretched=is_stretched)
    moved = moved_optics.found(weighed, signs)
    return replace(_of_known_optics(weighed) if moved is None else moved, is_stretched=is_stretched)


def _of_known_optics(weighed: Weighed) -> Outcome:
    """Take a window through the stages after its optics were found to be what they are taken for."""
    found = weigh(weighed)
    refined = refine(found) if isinstance(found, Settled) else found
    return accept(refined) if isinstance(refined, Refined) else refined


def begin(window: WindowProblem) -> Weighed:
    """Solve a window for the first time, by the noise of the windows before."""
    noise = window.request.noise
    noise = replace(noise, factors=noise.factors_at(window.keyframes[0].nav.stamp_ns))
    return with_waves(without_near_points(window.weighed(noise, window.state)))


def weigh(weighed: Weighed) -> Settled | Outcome:
    """Weigh the sensors by which of them fail, and all by the window's residuals; a refusal where depths rest on them.

    The sensors are weighted by what earlier windows found, and by which of them fail in this one.
    """
    found = settled(*without_failing_sensors(weighed))
    own_share = _depth_share_without_known_ground(found.weighed)
    if own_share > MAX_DEPTH_SIGMA:
        reason = f"little parallax: depths known to {100.0 * own_share:.0f} % only, without the terrain model"
        return Outcome(Status.LOW_PARALLAX, weighed.window.keyframes, found.noise, reason=reason)
    off = _off_known_ground(weighed)
    if off is not None:
        return Outcome(Status.POOR_FIT, weighed.window.keyframes, found.noise, reason=off)
    return replace(found, weighed=with_waves(found.weighed, WEIGHING_ROUNDS))


def refine(found: Settled) -> Refined | Outcome:
    """Solve again without outliers, with points held to the ground as closely as they lie to it."""
    weighed = found.weighed
    window = weighed.window
    hold = ground_roughness.correlated(weighed.problem, weighed.solution, window.unweighed.ground_weight)
    least_own = MIN_PIXEL_SIGMA_PX / (weighed.noise.pixel_sigma_px * weighed.noise.noise_inflation)
    problem = replace(weighed.problem, ground_weight=hold)
    again = solve_again(problem, weighed.solution, least_own, window.request.camera_file)
    if again is None:
        reason = "nearly all measurements are outliers"
        return Outcome(Status.POOR_FIT, window.keyframes, found.noise, reason=reason)
    return Refined(found, again)


def accept(refined: Refined) -> Outcome:
    """Judge a window, and learn from it the noise of the next: solved, or refused with the reason."""
    found = judged(refined)
    noise = replace(_learned(refined, found.status), pixel_sigma_px=found.noise.pixel_sigma_px)
    return replace(found, weighed=refined.settled.weighed, noise=noise)


def _off_known_ground(weighed: Weighed) -> str | None:
    """Return by how much ground that pictures and sensors alone show is off the terrain model; None if not. (16.16)"""
    window = weighed.window
    if window.unweighed.terrain is None:
        return None
    free, seen = weighed.without_known_ground(STEPS), np.count_nonzero(weighed.problem.weight > 0, axis=0) >= 2
    return off_terrain(window.request.config, window.unweighed.terrain, free, seen)


def _depth_share_without_known_ground(weighed: Weighed) -> float:
    """One sigma of a depth, as a share of it, by the pictures and the sensors alone; 0 where no ground is known. (6.14)

    Terrain gives every picture its depth. What a window without parallax then shows of its tilt is no more than the
    noise of a baseline as long as its own error, which linear covariances do not show.
    """
    window = weighed.window
    if window.unweighed.terrain is None and not window.unweighed.priors:
        return 0.0
    free, state = weighed.without_known_ground(), weighed.solution.state
    seen = np.count_nonzero(weighed.problem.weight > 0, axis=0) >= 2
    depth_m = np.abs((state.points_enu_m - state.centres_enu_m[-1])[seen] @ state.R_cam_enu[-1, 2])
    return float(np.median(depth_sigma_m(free, free.covariance, seen, window.layout)) / np.median(depth_m))


def _learned(refined: Refined, status: Status) -> Noise:
    """The noise of the next window: the settled one, with the sensors' evidence if this window was accepted."""
    found, solution = refined.settled, refined.adjusted.solution
    keyframes = found.weighed.window.request.keyframes
    factors, failing = replace(found.before.factors, groups={}), found.noise.failing
    if status is Status.OK:
        start_ns, end_ns = keyframes[0].nav.stamp_ns, keyframes[-1].nav.stamp_ns
        used = found.weighed.noise.factors
        evidence = evidence_of(found.weighed.problem.priors, solution.state, solution.covariance, used)
        factors = factors.with_evidence(evidence, end_ns, 1.0 / len(keyframes))
        groups = found.before.factors.groups
        failing = failing.after(start_ns, end_ns, {name: groups[name] for name in found.failed})
    return replace(found.noise, factors=factors, failing=failing)
