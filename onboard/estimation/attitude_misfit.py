"""The constant error of a window's attitude: by how much mount and tilt are off what was known of them. Section 16.

In level flight mount, attitude and the ground's slope share such an error, each within its own sigmas, and nothing but
the size of their residuals shows it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from onboard.estimation.bundle_adjustment import Solution
from onboard.estimation.factors import AttitudePrior, Prior, SharedPrior, State
from onboard.estimation.platform_states import BORESIGHT
from onboard.estimation.sensor_groups import LEAST_REDUNDANCY
from onboard.estimation.sensor_table import TILT
from onboard.geometry.robust import IMPOSSIBLE_SIGMAS

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AttitudeMisfit:
    """The misfit of a solution's mount (3,) and tilt to what was known of them, in sigmas of such residuals.

    Equations (16.12), (16.14). `tilt_variance`: times the tilt's variance, so that attitude and mount leave as much of
    the camera's tilt unknown as it is off, (16.15).
    """

    mount: Array = field(default_factory=lambda: np.zeros(3))
    tilt: float = 0.0
    tilt_variance: float = 1.0

    def reason_against(self) -> str | None:
        """Return the reason against a window that is so far off; None if that is possible."""
        most = max(float(self.mount.max()), self.tilt)
        return f"attitude or mount is off by more than can be: {most:.1f} sigmas" if most > IMPOSSIBLE_SIGMAS else None


def attitude_misfit(s: Solution, used: Sequence[Prior], before: Sequence[Prior]) -> AttitudeMisfit:
    """Return by how much a solution's mount and tilt are off.

    `used` and `before`: the sensors as weighted in the solution and by earlier windows.
    """
    shared = next((prior for prior in before if isinstance(prior, SharedPrior)), None)
    if shared is None:
        return AttitudeMisfit()
    S, right = s.reduced.S, np.zeros(len(s.reduced.S))
    for sign, priors in ((-1.0, used), (1.0, before)) if used is not before else ():
        for r, J in (prior.evaluate(s.state) for prior in priors):
            S, right = S + sign * J.T @ J, right + sign * J.T @ r
    r, J = (part[BORESIGHT] for part in shared.evaluate(s.state))
    left, redundancy = _left(S, right, r, J)
    shows = np.diag(redundancy) > LEAST_REDUNDANCY
    mount: Array = np.where(shows, np.abs(left) / np.sqrt(np.where(shows, np.diag(redundancy), 1.0)), 0.0)
    attitude = next((prior for prior in before if isinstance(prior, AttitudePrior) and prior.parts), None)
    if attitude is None:
        return AttitudeMisfit(mount)
    tilt, own_rad2 = _tilt(attitude, s.state, S, right)
    wider = np.maximum(mount, 1.0)
    known = shared.covariance[BORESIGHT, BORESIGHT]
    known_rad2, widened_rad2 = (
        _about_level_axes_rad2(s.state.R_cam_enu, covariance) for covariance in (known, known * np.outer(wider, wider))
    )
    lacking_rad2 = max(tilt, 1.0) ** 2 * (own_rad2 + known_rad2) - widened_rad2 - own_rad2
    return AttitudeMisfit(mount, tilt, 1.0 + max(lacking_rad2, 0.0) / own_rad2)


def _tilt(attitude: AttitudePrior, state: State, S: Array, right: Array) -> tuple[float, float]:
    """The misfit of a constant error of the tilt, (16.14), and the variance of one about a level axis, rad²."""
    is_tilt = np.array(attitude.sensors) == TILT
    rows, jacobians = attitude.by_axis(state)
    constant = attitude.constant_errors(is_tilt)
    left, redundancy = _left(S, right, rows[is_tilt].ravel(), jacobians[is_tilt].reshape(len(constant), -1))
    pull = constant.T @ left
    found = np.linalg.lstsq(constant.T @ redundancy @ constant, pull, rcond=LEAST_REDUNDANCY)[0]
    misfit = float(np.sqrt(max(float(pull @ found) - 1.0, 0.0)))
    return misfit, len(pull) / float(np.sum(constant**2))


def _left(S: Array, right: Array, r: Array, J: Array) -> tuple[Array, Array]:
    """Residuals (n,) one step of Gauss-Newton further, and the share (n, n) of their variance that the fit leaves."""
    step = np.linalg.solve(S, np.column_stack([right, J.T]))
    return r - J @ step[:, 0], np.eye(len(r)) - J @ step[:, 1:]


def _about_level_axes_rad2(R_cam_enu: Array, covariance: Array) -> float:
    """The largest variance about a level axis of small turns in camera axes with that covariance (3, 3)."""
    level_cam = R_cam_enu.mean(axis=0)[:, :2]
    return float(np.linalg.eigvalsh(level_cam.T @ covariance @ level_cam)[-1])
