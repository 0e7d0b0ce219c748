"""Selects the mount hypothesis by reprojection error: fixed mount, gimbal angles, or joint angles.

An autopilot may report a gimbal that is not there, one that carries another camera, or joint angles against the body
where the message's flags promise angles against the horizon (ArduPilot 4.7's servo gimbal does). A wrong choice turns
the camera by tens of degrees. So each hypothesis predicts, from the vehicle's own motion, where a keyframe's features
come to lie in the next pictures, and the one that predicts them best is selected once it is clearly ahead.

Pictures that come rarely, of a camera that a gimbal holds level under a leaning aircraft, move nearly as with a fixed
mount. But a window's solve with the wrong attitudes contradicts its positions: while nothing is solved the window is
solved by every hypothesis, and one that alone fits is ahead of the others by as much more. A selection that windows or
tracks contradict afterwards is open again. What was seen meanwhile is kept: only the attitudes are exchanged.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import Status
from contract.rotations import log_so3
from onboard.estimation.keyframe import turned
from onboard.estimation.sliding_window import Window
from onboard.estimation.solver_executor import Promise, Worker, timed_adjust
from onboard.estimation.window_problem import Outcome
from onboard.estimation.window_request import Noise, Request
from onboard.geometry.plane_homography import Pose, predict_pixels
from onboard.navigation.gimbal import MountHypothesis
from onboard.navigation.limits import CLEAR, MOST_OF
from onboard.navigation.navigator import Navigation, NavState
from onboard.pipeline.record_book import Record
from onboard.vision.klt_tracker import PREDICTED_SHARE

Array = NDArray[np.float64]

SIGMA_RAD = 0.01  # of a predicted feature, with `PREDICTED_SHARE` of how far it moved: attitude noise, a little delay
MOST = 9.0  # largest cost that one picture adds
MEMORY = 0.97  # decay of the cost per picture: about the last thirty count
LEAD = 20.0  # by which the cost of one hypothesis must be below all others
SAME_RAD = 0.05  # hypotheses this close need no decision
REFUSALS = 3  # windows in a row that do not fit by the hypothesis that was selected


def cost_of(
    camera: Camera, poses: Sequence[Pose], plane: Array, from_px: Array, to_px: Array, sigmas: float = 1.0
) -> float:
    """The squared distance, in sigmas and at most `MOST`, of tracks (N, 2) from their prediction by two `poses`.

    The median of the tracks counts. `plane`: of the ground. `sigmas`: the factor on the usual sigma.
    """
    flow_px = float(np.median(np.linalg.norm(to_px - from_px, axis=1)))
    predicted_px, known = predict_pixels(camera, from_px, poses[0], poses[1], plane)
    if np.count_nonzero(known) < MOST_OF * len(from_px):
        return MOST  # the right poses have a prediction for most
    miss_px = float(np.median(np.linalg.norm(predicted_px[known] - to_px[known], axis=1)))
    return min((miss_px / (sigmas * (SIGMA_RAD * camera.focal_px + PREDICTED_SHARE * flow_px))) ** 2, MOST)


class MountSelection:
    """Takes every picture's tracks and every window; knows the mount hypothesis once they clearly show one."""

    def __init__(self, R_body_cam: Array) -> None:
        self._R_body_cam = R_body_cam
        self._scores: dict[MountHypothesis, float] = {}
        self._trials: dict[MountHypothesis, Promise] = {}
        self._noise: dict[MountHypothesis, Noise] = {}  # as earlier windows have found it by each hypothesis
        self._refused = 0
        self.verdict: MountHypothesis | None = None

    def is_open(self, nav: NavState) -> bool:
        """Return whether hypotheses differ at this picture and none has been selected yet."""
        return self.verdict is None and _differ(nav.mount_hypotheses.values())

    def mounted_on(self, navigation: Navigation) -> str:
        """The assumed mount of the camera, and why, in words."""
        has_vehicle, has_gimbal = navigation.received
        if not has_gimbal:
            return "fixed mount" if has_vehicle else "unknown: no attitude is used"
        if not has_vehicle:
            return "gimbal, as no attitude of the vehicle is received"
        if navigation.config.mount.gimbal == "always":
            return 'gimbal, as mount.gimbal = "always" specifies'
        if navigation.gimbal.is_certain:
            return "gimbal, as the camera wrote its angles itself"
        if self.verdict is None:
            return f"{navigation.mount_hypothesis.value}; not yet confirmed by the pictures"
        return f"{self.verdict.value}, as the pictures show"

    def weigh(self, camera: Camera, was: NavState, now: NavState, plane: Array, from_px: Array, to_px: Array) -> None:
        """Take the tracks (N, 2) from keyframe `was` to picture `now`; `plane` (3,): ground height at the ENU origin
        and its slopes. Does nothing where the hypotheses are the same.
        """
        attitudes = now.mount_hypotheses
        if not _differ(attitudes.values()):
            return
        both = [c for c in attitudes if c in was.mount_hypotheses]
        if not both:  # the keyframe lies in a gap of the attitudes
            return
        for hypothesis in both:
            poses = [Pose((n.mount_hypotheses[hypothesis] @ self._R_body_cam).T, n.position_enu_m) for n in (was, now)]
            cost = cost_of(camera, poses, plane, from_px, to_px)
            self._scores[hypothesis] = MEMORY * self._scores.get(hypothesis, 0.0) + cost
        self._decide({c: attitudes[c] for c in both})

    def _decide(self, attitudes: Mapping[MountHypothesis, Array]) -> None:
        """Select the one of these hypotheses that is clearly ahead of all that differ from it, if one is."""
        scores = {c: self._scores.get(c, 0.0) for c in attitudes}
        best = min(scores, key=lambda c: scores[c])
        others = [scores[c] for c in attitudes if _differ((attitudes[c], attitudes[best]))]
        if others and min(others) - scores[best] > LEAD:
            self.verdict = best

    def contradicted(self, nav: NavState) -> None:
        """Pictures contradict the hypothesis that was selected: where others differ from it at `nav`, open it again.

        A gimbal may report the attitude of its power-up first, or none of its own: what was seen then decides nothing.
        """
        if self.verdict is not None and _differ(nav.mount_hypotheses.values()):
            self.verdict, self._refused = None, 0
            self._scores, self._noise = {}, {}

    def _follow_refusals(self, outcome: Outcome) -> None:
        """Windows in a row that do not fit by the selected hypothesis contradict it."""
        is_refused = outcome.status is Status.POOR_FIT
        self._refused = self._refused + 1 if is_refused else self._refused * (outcome.status is Status.STARTING)
        if self._refused >= REFUSALS:
            self.contradicted(outcome.keyframes[-1].nav)

    def begin_trials(self, window: Window, worker: Worker, navigation: Navigation) -> None:
        """Submit the newest request by the other hypotheses, if that is open and nothing is solved yet."""
        self._trials = {}
        newest = window.keyframes[-1].nav
        own = newest.mount_hypotheses.get(navigation.mount_hypothesis)
        if window.solved is not None or own is None or not self.is_open(newest):
            return
        for hypothesis, R in newest.mount_hypotheses.items():
            request = _request(window, hypothesis, self._noise.get(hypothesis)) if _differ((R, own)) else None
            if request is not None:
                self._trials[hypothesis] = worker.submit(timed_adjust, request)

    def judged(
        self, outcome: Outcome, window: Window, records: list[Record], navigation: Navigation
    ) -> tuple[Outcome, float]:
        """The outcome to continue with, and the processor time of trials. Where it is another hypothesis's, that one is
        accepted from now on, and window and records hold it.
        """
        self._follow_refusals(outcome)
        done = {hypothesis: promise.result() for hypothesis, promise in self._trials.items()}
        self._trials = {}
        self._noise |= {hypothesis: each.outcome.noise for hypothesis, each in done.items()}
        spent_s = sum(each.processor_s for each in done.values())
        held = outcome.keyframes[-1].nav.mount_hypotheses
        fitting = [held[hypothesis] for hypothesis, each in done.items() if each.outcome.status is Status.OK]
        if self.verdict is None and outcome.status is Status.POOR_FIT and fitting and not _differ(fitting):
            for hypothesis, R in held.items():
                if _differ((R, fitting[0])):
                    self._scores[hypothesis] = self._scores.get(hypothesis, 0.0) + CLEAR
            self._decide(held)
        if self.verdict not in done or not carry_over(window, records, navigation, self.verdict):
            return outcome, spent_s
        return done[self.verdict].outcome, spent_s


def _differ(attitudes: Iterable[Array]) -> bool:
    """Return whether any attitude (3, 3) differs from the first by so much that one of them must be chosen."""
    known = list(attitudes)
    return any(np.linalg.norm(log_so3(known[0].T @ other)) > SAME_RAD for other in known[1:])


def _by_hypothesis(navs: Sequence[NavState], hypothesis: MountHypothesis) -> list[NavState] | None:
    """The states with another hypothesis's attitudes; None where any has none."""
    if any(hypothesis not in nav.mount_hypotheses for nav in navs):
        return None
    return [replace(nav, R_enu_body=nav.mount_hypotheses[hypothesis], attitude_sigma_rad=0.0) for nav in navs]


def _request(window: Window, hypothesis: MountHypothesis, noise: Noise | None = None) -> Request | None:
    """The window's newest request as it would be by another hypothesis: with the noise of its earlier windows, or
    as if it were the first.
    """
    navs = _by_hypothesis([k.nav for k in window.keyframes], hypothesis)
    if navs is None:
        return None
    attitudes = [R for nav in navs if (R := window.attitude_guess(nav)) is not None]  # all of them have one
    keyframes = turned([replace(k, nav=nav) for k, nav in zip(window.keyframes, navs, strict=True)], attitudes)
    noise = noise or Noise(window.config.solve.pixel_sigma_px, window.config.camera.sigma_jitter_s)
    return replace(window.prepare(is_mount_open=True), keyframes=keyframes, previous=None, noise=noise)


def carry_over(window: Window, records: list[Record], navigation: Navigation, hypothesis: MountHypothesis) -> bool:
    """Exchange the attitudes of all that a window and its pictures hold for another hypothesis's, and accept that one.

    What was solved by the old one is forgotten. False, with nothing exchanged, where any of them has no such attitude.
    """
    navigation.mount_hypothesis = hypothesis
    request = _request(window, hypothesis) if window.keyframes else None
    navs = _by_hypothesis([record.nav for record in records], hypothesis)
    if request is None or navs is None:
        return False
    rates = [navigation.body_rate_at(k.nav.stamp_ns + round(k.nav_offset_s * 1e9)) for k in request.keyframes]
    kept = zip(request.keyframes, rates, strict=True)
    keyframes = [k if rate is None else replace(k, body_rate_rad_s=rate) for k, rate in kept]
    window.change_mount(keyframes, request.noise)
    for record, nav in zip(records, navs, strict=True):
        record.change_mount(nav)
    return True
