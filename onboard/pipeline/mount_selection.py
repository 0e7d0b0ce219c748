"""Selects the mount hypothesis by reprojection error: fixed mount, gimbal angles, or joint angles.

An autopilot may report a gimbal that is not there, one that carries another camera, or joint angles against the body
where the message's flags promise angles against the horizon (ArduPilot 4.7's servo gimbal does). A wrong choice turns
the camera by tens of degrees. So each hypothesis predicts, from the vehicle's own motion, where a keyframe's features
come to lie in the next pictures, and the one that predicts them best is selected once it is clearly ahead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rotations import log_so3
from onboard.geometry.plane_homography import Pose, predict_pixels
from onboard.navigation.gimbal import MountHypothesis
from onboard.navigation.limits import MOST_OF
from onboard.navigation.navigator import Navigation, NavState

Array = NDArray[np.float64]

SIGMA_RAD = 0.01  # of a predicted feature: attitude noise, a little delay
SIGMA_SHARE = 0.15  # of how far it moved: height above ground
MOST = 9.0  # largest cost that one picture adds
MEMORY = 0.97  # decay of the cost per picture: about the last thirty count
LEAD = 20.0  # by which the cost of one hypothesis must be below all others
ALIKE_RAD = 0.05  # hypotheses this close need no decision


def cost_of(
    camera: Camera, poses: Sequence[Pose], plane: Array, from_px: Array, to_px: Array, sigmas: float = 1.0
) -> float:
    """How far tracks (N, 2) lie from where two `poses` over a plane predict them, squared in sigmas and at most `MOST`.

    `sigmas`: how many times as large as usual a sigma is.
    """
    flow_px = float(np.median(np.linalg.norm(to_px - from_px, axis=1)))
    predicted_px, known = predict_pixels(camera, from_px, poses[0], poses[1], plane)
    if np.count_nonzero(known) < MOST_OF * len(from_px):
        return MOST  # the right poses have a prediction for most
    miss_px = float(np.median(np.linalg.norm(predicted_px[known] - to_px[known], axis=1)))
    return min((miss_px / (sigmas * (SIGMA_RAD * camera.focal_px + SIGMA_SHARE * flow_px))) ** 2, MOST)


class MountSelection:
    """Fed with every picture's tracks; knows which mount hypothesis predicts them, once one clearly does."""

    def __init__(self, camera: Camera, R_body_cam: Array) -> None:
        self._camera, self._R_body_cam = camera, R_body_cam
        self._scores: dict[MountHypothesis, float] = {}
        self.verdict: MountHypothesis | None = None

    def is_open(self, nav: NavState) -> bool:
        """Whether hypotheses differ at this picture and none has been selected yet."""
        return self.verdict is None and _differ(nav.mount_hypotheses)

    def carrier(self, navigation: Navigation) -> str:
        """What the camera is assumed to be mounted on, and why, in words."""
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

    def change_lens(self, camera: Camera) -> None:
        """Take pixels by another lens from now on."""
        self._camera = camera

    def may_be(self, mount_hypothesis: MountHypothesis) -> bool:
        """Whether the pictures' motion contradicts a hypothesis by less than would decide for another."""
        least = min(self._scores.values(), default=0.0)
        return self._scores.get(mount_hypothesis, 0.0) - least <= LEAD

    def weigh(self, was: NavState, now: NavState, plane: Array, from_px: Array, to_px: Array) -> None:
        """Take the tracks (N, 2) from keyframe `was` to picture `now`; `plane` (3,): ground height at the ENU origin
        and its slopes. Does nothing where the hypotheses are the same.
        """
        if not _differ(now.mount_hypotheses) or not len(from_px):
            return
        both = [c for c in now.mount_hypotheses if c in was.mount_hypotheses]
        for reading in both:
            poses = [Pose((n.mount_hypotheses[reading] @ self._R_body_cam).T, n.position_enu_m) for n in (was, now)]
            cost = cost_of(self._camera, poses, plane, from_px, to_px)
            self._scores[reading] = MEMORY * self._scores.get(reading, 0.0) + cost
        best = min(both, key=lambda c: self._scores[c])
        others = [c for c in both if unlike(now.mount_hypotheses[c], now.mount_hypotheses[best])]
        if others and min(self._scores[c] for c in others) - self._scores[best] > LEAD:
            self.verdict = best


def _differ(mount_hypotheses: Mapping[MountHypothesis, Array]) -> bool:
    attitudes = list(mount_hypotheses.values())
    return any(unlike(attitudes[0], other) for other in attitudes[1:])


def unlike(one: Array, other: Array) -> bool:
    """Whether two attitudes (3, 3) differ by so much that one of them must be chosen."""
    return float(np.linalg.norm(log_so3(one.T @ other))) > ALIKE_RAD
