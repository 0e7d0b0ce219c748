"""The shares of places' errors that a picture's have in common, and a session's. (25.12), (27.7)"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.answer import Fix
from contract.feature_set import FeatureSet
from contract.rotations import skew
from onboard.spots.second_camera import STATES

Array = NDArray[np.float64]


def shares(fixes: list[Fix], its_set: FeatureSet, pointed_m: list[Array]) -> tuple[float, float]:
    """Return the shares of the fixes' horizontal variance that the picture's have in common, and the session's.

    (25.12), (27.7). `pointed_m`: for each fix the root (2, k) of what a second camera adds, first the columns that last
    a session.
    """
    if not fixes:
        return 0.0, 0.0
    offset = np.mean([fix.offset_enu_m for fix in fixes], axis=0)
    ray = its_set.R_enu_cam.T @ offset
    J = np.concatenate([np.eye(3), -skew(offset), -np.outer(offset, [1.0, ray[0] / ray[2], ray[1] / ray[2]])], axis=1)
    total = float(np.mean([np.trace(fix.covariance_enu_m2[:2, :2]) for fix in fixes]))
    common = float(np.trace((J @ its_set.common_cov @ J.T)[:2, :2]))
    session = float(np.sum((J @ its_set.shared.by_nuisance)[:2] ** 2))
    common += float(np.mean([np.sum(root**2) for root in pointed_m]))
    session += float(np.mean([np.sum(root[:, :STATES] ** 2) for root in pointed_m]))
    if total <= 0.0:
        return 0.0, 0.0
    picture = min(common / total, 1.0)
    return picture, min(session / total, picture)
