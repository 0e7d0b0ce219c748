"""The error budget of a click: which source its ellipse comes from, and what would make it smaller. Section 20."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.error_sources import ABOUT, LEAST_SHARE, Cause
from contract.locate import Locator
from contract.rotations import skew
from contract.vehicle_status import MAX_SHARES
from onboard.estimation.error_budget import sources
from onboard.georeferencing.feature_sets import Placed

Array = NDArray[np.float64]

CHI2_90 = -2.0 * np.log(0.1)


@dataclass(frozen=True)
class Budget:
    """One click's error: semi-major axis of its 90 % ellipse (m), and each source's share of its horizontal variance.

    `shares` by the codes of `contract.error_sources`; they add up to 1, the largest first.
    """

    semi_major_m: float
    shares: Mapping[str, float]

    @property
    def percent(self) -> dict[str, int]:
        """The largest shares in whole per cent, those that are worth an advice; at least the largest one."""
        first, *others = self.shares.items()
        worth = [first, *(item for item in others if item[1] >= LEAST_SHARE)][:MAX_SHARES]
        return {str(code): min(round(100.0 * share), 100) for code, share in worth}

    @property
    def advice(self) -> str:
        """One line: the two largest sources, what to do against the first, and what that is worth."""
        largest = list(self.shares.items())[:2]
        named = ", ".join(f"{ABOUT[Cause(code)].name} {100.0 * share:.0f} %" for code, share in largest)
        code, share = largest[0]
        if share < LEAST_SHARE:
            return f"{named}: no single source dominates"
        left_m = self.semi_major_m * np.sqrt(1.0 - min(share, 1.0))
        return f"{named}: {ABOUT[Cause(code)].in_full} (without it {left_m:.1f} m)"


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
