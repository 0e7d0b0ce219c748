"""A window after its second solve: how well it fits, the reasons against it, and what is derived once accepted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from onboard.estimation import camera_states, row_waves, window_start
from onboard.estimation.attitude_misfit import attitude_misfit
from onboard.estimation.bundle_adjustment import Solution
from onboard.estimation.factors import WAVES, Layout
from onboard.estimation.ground_motion import GroundMotion, ground_motion, ground_sigma_m_s
from onboard.estimation.keyframe import Keyframe, have_attitude
from onboard.estimation.pixel_noise import fit_of
from onboard.estimation.second_solve import Adjusted
from onboard.estimation.shared_errors import shared_errors
from onboard.estimation.solved_window import Solved
from onboard.estimation.weighing import Settled
from onboard.estimation.window_acceptance import (
    MAX_DEPTH_SIGMA,
    MAX_FIT_SIGMAS,
    MAX_ROTATION_SIGMA_DEG,
    MIN_POINTS,
    by_itself,
    by_memory,
    heading_unknown,
)
from onboard.estimation.window_problem import Outcome, Weighed
from onboard.estimation.window_request import Noise
from onboard.geometry.plane_fit import fit_plane
from onboard.navigation.limits import MOST_OF

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GROUND_MOVES = "the ground moves"
MIN_VIEW_INLIERS = 0.3  # of one picture's measurements; below it nothing ties that picture to the others
MIN_PIXEL_SIGMA_PX = 0.08  # tracks have common errors, larger than their residuals show


@dataclass(frozen=True, eq=False)
class Refined:
    """A window of K keyframes and P points after its second solve."""

    settled: Settled
    adjusted: Adjusted

    @property
    def weighed(self) -> Weighed:
        """The first solve, with the weights that the window settled on."""
        return self.settled.weighed

    @property
    def solution(self) -> Solution:
        """The second solve's."""
        return self.adjusted.solution

    @property
    def layout(self) -> Layout:
        """The columns of its states."""
        return self.weighed.window.layout

    @cached_property
    def keyframes(self) -> tuple[Keyframe, ...]:
        """The keyframes with the angular rates that the solution found."""
        window = self.weighed.window
        rows = window.unweighed.sweep
        return window_start.with_found_rates(window.request, window.keyframes, self.layout, rows, self.solution.state)

    @cached_property
    def good(self) -> Mask:
        """(P,) of points that two pictures or more still measure."""
        out: Mask = np.count_nonzero(self.adjusted.kept > 0, axis=0) >= 2
        return out

    @cached_property
    def fit(self) -> float:
        """The size of the residuals, in the noise that weighted them."""
        return fit_of(self.solution.residual_sigmas, self.layout)

    @property
    def inflation(self) -> float:
        """The factor on the flight's pixel sigma that this window shows."""
        return self.adjusted.own * self.fit * self.weighed.noise.noise_inflation

    @property
    def sigma_px(self) -> float:
        """One sigma of the window's measurements."""
        noise = self.weighed.noise
        return noise.pixel_sigma_px * noise.noise_inflation * self.adjusted.own * self.fit

    @cached_property
    def depth_m(self) -> float:
        """The median depth of what is measured."""
        return float(np.median(np.abs(self.solution.state.depths_m[self.adjusted.kept > 0])))

    def depth_share(self, covariance: Array) -> float:
        """The median of one sigma of a depth, as a share of the median depth, by a covariance of the states."""
        return float(np.median(depth_sigma_m(self.solution, covariance, self.good, self.layout))) / self.depth_m

    @cached_property
    def moving(self) -> GroundMotion:
        """The ground's motion, as far as it may have one."""
        s, sigma_m_s = self.solution, ground_sigma_m_s(self.keyframes, self.depth_m)
        return ground_motion(self.keyframes, self.weighed.problem.priors, s.state, s.covariance, sigma_m_s)

    def refused(self, status: Status, reason: str) -> Outcome:
        """Return the window's refusal."""
        return Outcome(status, self.keyframes, self.weighed.noise, reason=reason)


def judged(refined: Refined) -> Outcome:
    """Return the outcome of a refined window: solved, or refused with the reason."""
    for against in (_by_outliers, _by_fit, _by_geometry, _by_convergence, _by_motion, _by_sensors):
        refusal = against(refined)
        if refusal is not None:
            return refusal
    solved, memory = _solved(refined), refined.weighed.window.request.memory
    fitting = Outcome(Status.OK, solved.keyframes, _tracking_noise(refined), solved, agreed=memory.compared(solved))
    remembered = by_memory(memory, fitting.agreed)
    if remembered is None:
        return fitting
    refused = Status.POOR_FIT, refined.keyframes, fitting.noise  # its pixels' noise was found all the same
    return Outcome(*refused, reason=remembered, rejected=solved, agreed=fitting.agreed)


def _tracking_noise(refined: Refined) -> Noise:
    """The noise with the window's own in it: slowly, so that one odd window changes little."""
    noise = refined.weighed.noise
    learned = noise.pixel_sigma_px * refined.inflation**0.3
    return replace(noise, pixel_sigma_px=float(np.clip(learned, MIN_PIXEL_SIGMA_PX, 5.0)))


def _by_outliers(refined: Refined) -> Outcome | None:
    kept = (refined.adjusted.kept > 0).sum(axis=1)
    seen = np.count_nonzero(refined.weighed.problem.weight > 0, axis=1)
    if kept.sum() < MOST_OF * seen.sum() or np.count_nonzero(refined.good) < MIN_POINTS:
        return refined.refused(Status.POOR_FIT, f"outliers: {(seen - kept).sum()} of {seen.sum()} measurements")
    left = kept / np.maximum(seen, 1)
    if left.min() < MIN_VIEW_INLIERS:
        reason = f"a picture contradicts the others: {left.min():.0%} of its features agree"
        return refined.refused(Status.POOR_FIT, reason)
    return None


def _by_fit(refined: Refined) -> Outcome | None:
    request = refined.weighed.window.request
    if refined.sigma_px > MAX_FIT_SIGMAS * request.config.solve.pixel_sigma_px * max(
        1.0, request.camera.width_px / 640
    ):
        return refined.refused(Status.POOR_FIT, f"large residuals: {refined.sigma_px:.1f} px")
    return None


def _by_geometry(refined: Refined) -> Outcome | None:
    covariance = refined.solution.covariance
    still = refined.depth_share(covariance) * max(refined.fit, 1.0)
    if still > MAX_DEPTH_SIGMA:
        return refined.refused(Status.LOW_PARALLAX, f"little parallax: depths known to {100.0 * still:.0f} % only")
    turn = float(np.degrees(np.sqrt(np.diag(covariance)[refined.layout.rotations()].max())))
    return refined.refused(Status.LOW_PARALLAX, heading_unknown(turn)) if turn > MAX_ROTATION_SIGMA_DEG else None


def _by_convergence(refined: Refined) -> Outcome | None:
    s, request = refined.solution, refined.weighed.window.request
    # Another start, from the attitudes or from the path, may still converge: `judge` compares the two.
    if s.converged or (request.previous is None and have_attitude(refined.keyframes)):
        return None
    reason = f"the adjustment found no minimum in {s.iterations} steps"
    return replace(refined.refused(Status.POOR_FIT, reason), is_minimum=False)


def _by_motion(refined: Refined) -> Outcome | None:
    """Refuse where coarse and fine flow disagree too much to know the scale: water."""
    moving = refined.moving
    covariance = refined.solution.covariance + moving.covariance(moving.epoch_ns)
    is_unknown = refined.depth_share(covariance) > MAX_DEPTH_SIGMA
    return refined.refused(Status.POOR_FIT, GROUND_MOVES) if is_unknown else None


def _by_sensors(refined: Refined) -> Outcome | None:
    request, s, before = refined.weighed.window.request, refined.solution, refined.settled.priors_before()
    fitted = s, refined.layout, refined.adjusted.kept, refined.good
    against = by_itself(request.config, refined.keyframes, request.terrain, *fitted, before)
    against = against or attitude_misfit(s, refined.weighed.problem.priors, before).reason_against()
    return None if against is None else refined.refused(Status.POOR_FIT, against)


def _solved(refined: Refined) -> Solved:
    """The solved window: the solution, the keyframes with its poses, and all that is derived from it once."""
    weighed, s = refined.weighed, refined.solution
    window, priors = weighed.window, weighed.problem.priors
    request, state, layout = window.request, s.state, window.layout
    posed = tuple(
        replace(k, R_cam_enu=R, centre_enu_m=C)
        for k, R, C in zip(refined.keyframes, state.R_cam_enu, state.centres_enu_m, strict=True)
    )
    plane, _ = fit_plane(state.points_enu_m[refined.good])
    camera = camera_states.corrected(request.camera_file, state.camera)
    # A picture between keyframes vibrates too, as nothing measures: for it that is noise.
    swing_px = camera.focal_px * row_waves.swing_rad(state.own[:, layout.part(WAVES)])
    noise_px = float(np.hypot(refined.sigma_px, swing_px)), refined.sigma_px * 1.177
    shared = shared_errors(request.config, priors, state, s.covariance)
    readout_s = window_start.readout_of(request, layout, state)
    found = layout, s, window.ids, refined.good, plane, *noise_px, posed, shared, refined.moving, camera, readout_s
    return Solved(*found, mount_sigmas=weighed.noise.mount_sigmas, priors=tuple(priors))


def depth_sigma_m(s: Solution, covariance: Array, good: Mask, layout: Layout) -> Array:
    """One sigma (m) of each good point along the newest keyframe's axis, relative to that keyframe."""
    axis = s.state.R_cam_enu[-1, 2]
    M = -np.einsum("i,pid->pd", axis, s.point_gain[good])
    M[:, layout.centre(layout.keyframes - 1)] -= axis
    own = np.einsum("i,pij,j->p", axis, s.point_covariance[good], axis)
    out: Array = np.sqrt(np.maximum(np.sum((M @ covariance) * M, axis=1) + own, 0.0))
    return out
