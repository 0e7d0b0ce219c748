"""Ground that moves as a whole (water): how it is detected, and what it does to a solution. Equations (6.8) to (6.10).

A pattern that drifts at a constant velocity looks exactly like solid ground seen from an aircraft of another velocity.
But long waves are faster than short ones: over water the flow at coarse resolution differs from that at fine
resolution, over solid ground the two agree, however blurred or noisy the pictures are. Their disagreement determines
how fast the ground may move, and the covariances allow for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.factors import PathPrior, Prior, State
from onboard.estimation.keyframe import Keyframe

Array = NDArray[np.float64]

# One sigma of the ground's own motion, per axis, over the disagreement of coarse and fine flow. In deep water patterns
# four times as long run twice as fast, so that the disagreement should equal the motion; but the coarse picture still
# shows some of the fine pattern. Measured over simulated seas the motion is up to three times the disagreement.
MOTION_PER_SLIP = 3.0


@dataclass(frozen=True, eq=False)
class GroundMotion:
    """The displacement (D, 2), and its rate, of a window's camera side by ground moving east and north by one sigma.

    Points and poses are those of the instant a picture was taken, so the effect is linear in that instant.
    """

    epoch_ns: int
    at_epoch: Array  # (D, 2)
    per_s: Array  # (D, 2)

    def covariance(self, stamp_ns: int) -> Array:
        """The ground motion's share of the camera side's covariance (D, D) for a picture of that time. (6.10)"""
        gain = self.at_epoch + self.per_s * ((stamp_ns - self.epoch_ns) / 1e9)
        return gain @ gain.T


def ground_sigma_m_s(keyframes: Sequence[Keyframe], depth_m: float) -> float:
    """One sigma per axis, m/s, of the ground's own motion, from the disagreement of coarse and fine flow. (6.8)"""
    speeds_m_s = [
        k.flow_disagreement_xy * depth_m / max((k.nav.stamp_ns - before.nav.stamp_ns) / 1e9, 1e-3)
        for before, k in pairwise(keyframes)
        if k.flow_disagreement_xy is not None
    ]
    return MOTION_PER_SLIP * float(np.linalg.norm(speeds_m_s) / np.sqrt(max(len(speeds_m_s), 1)))


def ground_motion(
    keyframes: Sequence[Keyframe], priors: list[Prior], state: State, covariance: Array, sigma_m_s: float
) -> GroundMotion:
    """The effect of ground moving by `sigma_m_s` on a solution with this camera-side covariance (D, D). (6.9)

    Pictures show the aircraft's motion over the ground, position and velocity that over the Earth: for both residuals
    the ground's motion acts as a measurement error.
    """
    epoch_ns = keyframes[-1].nav.stamp_ns
    stamps = np.array([(k.nav.stamp_ns - epoch_ns) / 1e9 for k in keyframes])
    drift = np.column_stack([stamps, -np.ones(len(stamps))])  # of places, over speed: at the epoch, and a second later
    pull = np.zeros((len(covariance), 2, 2))
    for prior in priors:
        if isinstance(prior, PathPrior):
            moved = np.diff(drift, prior.order, axis=0)
            pull += np.einsum("and,anm,mt->dat", prior.by_axis(state)[1][:2], prior.whitener[:2], moved)
    gain = sigma_m_s * np.einsum("de,eat->tda", covariance, pull)
    return GroundMotion(epoch_ns, gain[0], gain[1])
