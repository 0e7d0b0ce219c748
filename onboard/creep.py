"""Ground that moves as a whole: what betrays it, and what it does to a solution. Equations (6.8) to (6.10).

A pattern that drifts at a constant velocity is seen exactly as solid ground from an aircraft of another velocity: no
residual shows it, and the scene comes out too large or too small. But waves are many patterns at once, and long ones
outrun short ones, so that water slips past itself: what is seen coarsely moves otherwise than what is seen finely.
Solid ground does not, however badly it is seen. That slip says how fast the ground may move, and covariances allow
for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.keyframe import Keyframe
from onboard.picture import Picture
from onboard.prediction import move
from onboard.residuals import PositionPrior, Prior, State, VelocityPrior

Array = NDArray[np.float64]

HALVINGS = 2  # of the picture's size: patterns four times as large as those that are tracked
WINDOW_PX = 21
# One sigma of the ground's own motion, per axis, against that of its patterns past each other. In deep water patterns
# four times as long run twice as fast, so that the slip should be the motion; but the coarse view still sees some of
# the fine. Measured over simulated seas the motion is up to three times the slip.
CREEP_PER_SLIP = 3.0


@dataclass(frozen=True, eq=False)
class Creep:
    """How a window's camera side answers to ground that moves by one sigma, east and north: (D, 2) and its growth.

    Points and poses are those of the instant a picture was taken, so the answer depends on that instant, linearly.
    """

    sigma_m_s: float
    epoch_ns: int
    at_epoch: Array  # (D, 2)
    per_s: Array  # (D, 2)

    def covariance(self, stamp_ns: int) -> Array:
        """What the ground's motion adds to the camera side's covariance (D, D) for a picture of that time. (6.10)"""
        gain = self.at_epoch + self.per_s * ((stamp_ns - self.epoch_ns) / 1e9)
        out: Array = gain @ gain.T
        return out


def slip(was: Picture, now: Picture, motion: Array, at: Array, to: Array) -> Array:
    """How far (2,), px, the ground's large patterns have moved past its small ones between two prepared pictures.

    `at` (N, 2) are the features in `was`, `to` where they were found in `now`, `motion` the homography of the whole
    picture. The median over features of what LK finds at a quarter of the size, beyond where the feature itself went.
    """
    shrink = np.diag([0.5**HALVINGS, 0.5**HALVINGS, 1.0])
    for _ in range(HALVINGS):
        was, now = np.asarray(cv2.pyrDown(was), np.uint8), np.asarray(cv2.pyrDown(now), np.uint8)
    was = np.asarray(cv2.GaussianBlur(was, (0, 0), 1.0), np.uint8)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    H: Array = np.asarray(shrink @ motion @ np.linalg.inv(shrink), np.float64)
    size = was.shape[1], was.shape[0]
    warped = cv2.warpPerspective(now, H, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    now = np.asarray(cv2.GaussianBlur(warped, (0, 0), 1.0), np.uint8)
    start = move(shrink, at)
    fine = move(shrink @ np.linalg.inv(motion), to)
    coarse, status, _ = cv2.calcOpticalFlowPyrLK(
        was,
        now,
        start.astype(np.float32),
        fine.astype(np.float32).copy(),
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=1,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    found = status[:, 0] == 1
    if not found.any():
        return np.zeros(2)
    out: Array = np.median((np.asarray(coarse, float) - fine)[found], axis=0) / shrink[0, 0]
    return out


def ground_sigma_m_s(keyframes: Sequence[Keyframe], depth_m: float) -> float:
    """One sigma per axis, m/s, of the ground's own motion, by how its patterns slip past each other. (6.8)"""
    speeds = [
        float(np.linalg.norm(k.slip_xy)) * depth_m / max((k.nav.stamp_ns - before.nav.stamp_ns) / 1e9, 1e-3)
        for before, k in pairwise(keyframes)
        if k.slip_xy is not None
    ]
    return CREEP_PER_SLIP * float(np.sqrt(np.mean(np.square(speeds)))) if speeds else 0.0


def creep(
    keyframes: Sequence[Keyframe], priors: list[Prior], state: State, covariance: Array, sigma_m_s: float
) -> Creep:
    """What ground moving by `sigma_m_s` does to a solution with this camera-side covariance (D, D). Equation (6.9).

    Pictures show the aircraft's motion over the ground, position and velocity that over the Earth: to both residuals
    the ground's motion is a measurement that strays.
    """
    epoch_ns = keyframes[-1].nav.stamp_ns
    stamps = np.array([(k.nav.stamp_ns - epoch_ns) / 1e9 for k in keyframes])
    K, D = len(keyframes), len(covariance)
    at_epoch, per_s = np.zeros((D, 2)), np.zeros((D, 2))
    for prior in priors:
        if isinstance(prior, PositionPrior):
            J = prior.evaluate(state)[1].reshape(3, K, D)
            for axis in (0, 1):
                pull = J[axis].T @ prior.whitener[axis]
                at_epoch[:, axis] += pull @ stamps
                per_s[:, axis] -= pull.sum(axis=1)
        elif isinstance(prior, VelocityPrior):
            J = prior.evaluate(state)[1].reshape(K - 1, 3, D)
            for axis in (0, 1):
                at_epoch[:, axis] += J[:, axis].T @ (np.diff(stamps) / prior.sigma_m)
    return Creep(sigma_m_s, epoch_ns, sigma_m_s * covariance @ at_epoch, sigma_m_s * covariance @ per_s)
