"""The error budget of a click: which source its ellipse comes from, and what would make it smaller. Section 20."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.error_sources import Cause
from contract.locate import Locator
from contract.rotations import skew
from onboard.estimation.error_budget import sources
from onboard.georeferencing.budget import Budget
from onboard.georeferencing.feature_sets import Placed

Array = NDArray[np.float64]

CHI2_90 = -2.0 * np.log(0.1)


def click_budget(placed: Placed, xy: tuple[float, float] = (0.0, 0.0)) -> Budget:
    """The budget of a click at unit-depth coordinates `xy` of a picture that the window's points have placed."""
    terms = click_terms(placed, xy)
    horizontal = {name: float(np.trace(term[:2, :2])) for name, term in terms.items()}
    total = sum(horizontal.values())
    shares = {n: v / total for n, v in sorted(horizontal.items(), key=lambda item: -item[1]) if v != 0.0}
    largest = float(np.linalg.eigvalsh(sum(terms.values(), np.zeros((3, 3)))[:2, :2])[1])
    return Budget(float(np.sqrt(CHI2_90 * largest)), shares)


def click_terms(placed: Placed, xy: tuple[float, float]) -> dict[str, Array]:
    """Covariance (3, 3) of a click's position by source, m^2, axes of the picture's own place. (20.5)"""
    s, solved = placed.feature_set, placed.solved
    ray = np.array([*xy, 1.0])
    offset = s.R_enu_cam @ ray / float(s.plane_per_m @ [1.0, *xy])
    J = np.concatenate([np.eye(3), -skew(offset), -np.outer(offset, [1.0, *xy])], axis=1)
    R_local_session = s.R_enu_cam @ placed.pose.R_cam_enu
    J[:, :6] = J[:, :6] @ np.kron(np.eye(2), R_local_session)
    gain = J @ placed.by_state
    terms = sources(solved, gain)
    # The resection of a picture between keyframes is by its own pixels.
    factor = solved.variance_factor
    lift = np.eye(9)
    lift[:3, :3] = lift[3:6, 3:6] = R_local_session
    common = J @ (lift.T @ s.common_cov @ lift) @ J.T
    by_motion = gain @ solved.ground_motion.covariance(s.capture_unix_ns) @ gain.T
    terms[Cause.PIXELS] = common / factor - by_motion - sum(t for n, t in terms.items() if n != Cause.PIXELS)
    terms[Cause.WATER] = by_motion
    terms[Cause.WINDOWS] = (1.0 - 1.0 / factor) * common
    along = np.outer(offset, offset)
    ground, noise = Locator(s).own_variances(ray[:2])
    return {**terms, Cause.FEATURES: noise * along, Cause.BETWEEN: ground * along}
