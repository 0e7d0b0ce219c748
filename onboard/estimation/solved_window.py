"""The solved window, which poses, depths and covariances are taken from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import SharedErrors
from onboard.estimation.bundle_adjustment import Solution
from onboard.estimation.factors import Layout, Prior, SharedPrior
from onboard.estimation.ground_motion import GroundMotion
from onboard.estimation.keyframe import Ids, Keyframe

AS_KNOWN = (1.0, 1.0, 1.0)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Solved:
    """A solved window: poses of its keyframes, its points by id, and everything the covariances need."""

    layout: Layout
    solution: Solution
    point_ids: Ids  # sorted
    good: Mask  # (P,) points seen in two views or more after outliers were left out
    plane: Array  # height at the ENU origin (m), slope east, slope north
    pixel_sigma_px: float
    reprojection_px: float
    keyframes: tuple[Keyframe, ...]
    shared: SharedErrors  # `by_nuisance` (D, NUISANCES) of the camera side, no span
    ground_motion: GroundMotion  # what the ground's own motion may have done to it
    camera: Camera  # with its own states as solved
    readout_s: float = 0.0  # likewise
    variance_factor: float = 1.0  # on every variance that is published of it, (16.4)
    mount_sigmas: tuple[float, float, float] = AS_KNOWN  # times what was known of the mount, (16.13)
    priors: tuple[Prior, ...] = ()  # that the solution was weighted by: where its errors come from, (20.1)

    @property
    def known(self) -> SharedPrior:
        """The prior of what all pictures share, as the solution was weighted by."""
        return next(p for p in self.priors if isinstance(p, SharedPrior))

    @property
    def frames(self) -> tuple[int, ...]:
        return tuple(k.frame for k in self.keyframes)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last exposure, s on the session's clock."""
        first, last = self.keyframes[0].nav.stamp_ns, self.keyframes[-1].nav.stamp_ns
        return first / 1e9, last / 1e9

    def nearest(self, stamp_ns: int) -> int:
        """The index of the keyframe taken nearest to a moment."""
        return int(np.argmin([abs(k.nav.stamp_ns - stamp_ns) for k in self.keyframes]))

    def covariance_at(self, stamp_ns: int) -> Array:
        """The camera side's covariance (D, D) for a picture of that time. (6.10)"""
        return self.solution.covariance + self.ground_motion.covariance(stamp_ns)

    def rows(self, ids: Ids) -> tuple[NDArray[np.intp], Mask]:
        """Row of each id among the points, and whether it is there and good."""
        at = np.minimum(np.searchsorted(self.point_ids, ids), len(self.point_ids) - 1)
        return at, (self.point_ids[at] == ids) & self.good[at]

    def common(self, other: Solved) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows of the good points that both windows have, here and in the other."""
        ids = np.intersect1d(self.point_ids[self.good], other.point_ids[other.good], assume_unique=True)
        return self.rows(ids)[0], other.rows(ids)[0]
