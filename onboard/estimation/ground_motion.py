"""Ground that moves as a whole (water): how it is detected, and what it does to a solution. Equations (6.8) to (6.10).

A pattern that drifts at a constant velocity looks exactly like solid ground seen from an aircraft of another velocity:
no residual shows it, and the scene comes out too large or too small. But waves are many patterns at once, and long ones
are faster than short ones, so that over water the flow measured at coarse resolution differs from the flow measured at
fine resolution. Over solid ground the two agree, however blurred or noisy the pictures are. Their disagreement says how
fast the ground may move, and the covariances allow for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.factors import PositionPrior, Prior, State, VelocityPrior
from onboard.estimation.keyframe import Keyframe

Array = NDArray[np.float64]

# One sigma of the ground's own motion, per axis, over the disagreement of coarse and fine flow. In deep water patterns
# four times as long run twice as fast, so that the disagreement should equal the motion; but the coarse picture still
# shows some of the fine pattern. Measured over simulated seas the motion is up to three times the disagreement.
MOTION_PER_SLIP = 3.0


@dataclass(frozen=True, eq=False)
class GroundMotion:
    """How far ground that moves by one sigma, east and north, moves a window's camera side: (D, 2) and its rate.

    Points and poses are those of the instant a picture was taken, so the effect is linear in that instant.
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


def ground_sigma_m_s(keyframes: Sequence[Keyframe], depth_m: float) -> float:
    """One sigma per axis, m/s, of the ground's own motion, from the disagreement of coarse and fine flow. (6.8)"""
    speeds = [
        float(np.linalg.norm(k.flow_disagreement_xy))
        * depth_m
        / max((k.nav.stamp_ns - before.nav.stamp_ns) / 1e9, 1e-3)
        for before, k in pairwise(keyframes)
        if k.flow_disagreement_xy is not None
    ]
    return MOTION_PER_SLIP * float(np.sqrt(np.mean(np.square(speeds)))) if speeds else 0.0


def ground_motion(
    keyframes: Sequence[Keyframe], priors: list[Prior], state: State, covariance: Array, sigma_m_s: float
) -> GroundMotion:
    """What ground moving by `sigma_m_s` does to a solution with this camera-side covariance (D, D). Equation (6.9).

    Pictures show the aircraft's motion over the ground, position and velocity that over the Earth: for both residuals
    the ground's motion acts as a measurement error.
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
            J = prior.evaluate(state)[1].reshape(3, K - 1, D)
            for axis in (0, 1):
                at_epoch[:, axis] += J[axis].T @ prior.whitener[axis] @ np.diff(stamps)
    return GroundMotion(sigma_m_s, epoch_ns, sigma_m_s * covariance @ at_epoch, sigma_m_s * covariance @ per_s)
