"""A camera pose that rests on sensors alone, with its errors by the nuisance parameters that they come from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import GROUND, SharedErrors

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SensorPose:
    """A pose from sensors alone; seven states err: centre (ENU m), rotation (ENU axes, rad), ground height (m)."""

    R_cam_enu: Array
    centre_enu_m: Array
    white: Array  # (7, 7) covariance of what is this picture's own
    shared: SharedErrors  # `by_nuisance` (7, NUISANCES)

    @property
    def covariance(self) -> Array:
        """(7, 7) of everything."""
        out: Array = self.white + self.shared.by_nuisance @ self.shared.by_nuisance.T
        return out

    def over_ground(self, sigma_m: float) -> SensorPose:
        """The same over a ground whose height as a whole is known to one sigma."""
        by_nuisance = self.shared.by_nuisance.copy()
        by_nuisance[6, GROUND.start] = sigma_m
        return replace(self, shared=replace(self.shared, by_nuisance=by_nuisance))

    def over_ranged_ground(self, sigma_m: float) -> SensorPose:
        """The same over a ground measured from the camera, to one sigma: where the camera's height is off, so is it."""
        white, by_nuisance = self.white.copy(), self.shared.by_nuisance.copy()
        white[6], white[:, 6] = white[2], white[:, 2]
        white[6, 6] = white[2, 2] + sigma_m**2
        by_nuisance[6] = by_nuisance[2]
        return replace(self, white=white, shared=replace(self.shared, by_nuisance=by_nuisance))
