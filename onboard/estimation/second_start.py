"""A second hypothesis: the same window from other starting orientations, and which of two solutions is to be believed.

Least squares find the minimum next to their start. Without attitude, or in a steep turn, there may be another one (the
scene's mirror image, a turned-over aircraft), and a window that starts from the one before inherits its minimum. A
second solve costs as much as the first, so it is made only where the first was refused, or where nothing has confirmed
it yet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.rotations import exp_so3
from onboard.estimation.boresight import BORESIGHT, HEADING, Belief
from onboard.estimation.factors import AttitudePrior, PositionPrior, Prior, State, VelocityPrior
from onboard.estimation.keyframe import Keyframe, have_attitude, turned
from onboard.estimation.reobservation import agreement
from onboard.estimation.sensor_factors import coordinated_turn, cosine_sine_of_heading
from onboard.estimation.solved_window import Solved
from onboard.geometry.robust import robust_cost
from onboard.navigation.navigator import NavState

Array = NDArray[np.float64]

STEEP_COSINE = float(np.cos(np.radians(30.0)))  # of the bank, above which a solution is checked from a second start
CLEAR_COST = float(np.log(1000.0))  # by which one of two solutions is the likelier, a thousand to one
COST_SCALE = 3.0  # of the loss (6.5) in sigmas, as in the first of a window's two solves
CONFIRMING = 18.5  # of chi-square with 7 degrees of freedom: 99 %
SAME_SIGMAS = 3.0  # of the points' own places, within which two solutions are the same


def by_attitude(nav: NavState, belief: Belief, R_body_cam: Array) -> Array | None:
    """R_cam_enu from the autopilot through mount and boresight, or None without attitude."""
    if nav.R_enu_body is None:
        return None
    yaw = float(cosine_sine_of_heading(nav.R_enu_body) @ belief.mean[HEADING])
    R_enu_body = exp_so3(np.array([0.0, 0.0, -yaw])) @ nav.R_enu_body
    out: Array = (R_enu_body @ R_body_cam @ exp_so3(belief.mean[BORESIGHT])).T
    return out


def is_steep(keyframes: tuple[Keyframe, ...], R_body_cam: Array) -> bool:
    """Whether the aircraft banks by more than 30 degrees: by attitude, else as its path says. True if unknown."""
    attitudes = [k.nav.R_enu_body for k in keyframes if k.nav.R_enu_body is not None]
    if len(attitudes) == len(keyframes):
        down = np.stack(attitudes)[:, 2, 2]
    else:
        path = coordinated_turn(R_body_cam, list(keyframes))
        if path is None:
            return True
        down = (path @ R_body_cam.T)[:, 2, 2]
    return bool(np.min(-down) < STEEP_COSINE)


def by_sensors(keyframes: tuple[Keyframe, ...], belief: Belief, R_body_cam: Array) -> tuple[Keyframe, ...] | None:
    """Keyframes oriented by the autopilot, or where it gives no attitude by a coordinated turn along the path."""
    attitudes = [by_attitude(k.nav, belief, R_body_cam) for k in keyframes]
    known = [R for R in attitudes if R is not None]
    if len(known) == len(keyframes):
        return turned(keyframes, np.stack(known))
    path = coordinated_turn(R_body_cam, list(keyframes))
    return None if path is None else turned(keyframes, path.transpose(0, 2, 1))


def confirms(previous: Solved | None, solved: Solved) -> bool:
    """Whether the last published window has the same points in the same places, (16.3).

    Pictures that both rest on are counted as if they were independent: that is too lenient to refuse by, not to
    confirm by, since another minimum lies far outside of what a window states.
    """
    agreed = None if previous is None else agreement(previous, solved)
    return agreed is not None and agreed.chi2 < CONFIRMING


def verdict(one: Solved, two: Solved, costs: tuple[float, float]) -> tuple[Solved | None, str]:
    """Which of two accepted solutions to believe: the first if both are about the same, else the likelier, (16.8).

    Least squares from both starts that end in one minimum agree to a hundredth of a sigma. What they differ by is added
    to the variance. None and the reason where they fit alike and differ. `costs`: of each, by `comparable_cost`.
    """
    at1, at2 = one.common(two)
    miss_m = np.linalg.norm(one.solution.state.points_enu_m[at1] - two.solution.state.points_enu_m[at2], axis=1)
    gain = one.solution.point_gain[at1]
    covariance = gain @ one.covariance_at(one.keyframes[-1].nav.stamp_ns) @ gain.transpose(0, 2, 1)
    sigma_m = np.sqrt(np.trace(covariance + one.solution.point_covariance[at1], axis1=1, axis2=2))
    sigmas = float(np.median(miss_m / sigma_m)) if len(at1) else np.inf
    if sigmas < SAME_SIGMAS:
        return replace(one, variance_factor=one.variance_factor * (1.0 + sigmas**2)), ""
    apart = costs[0] - costs[1]
    if abs(apart) > CLEAR_COST:
        return (two if apart > 0.0 else one), ""
    return None, f"two solutions fit alike: {np.median(miss_m) if len(at1) else np.inf:.0f} m apart"


def comparable_cost(residual_sigmas: Array, sensors: Sequence[Prior], state: State) -> float:
    """(6.1) of one solution without the ground, whose weights depend on where a solve started.

    `residual_sigmas` (K, P): of all measurements, later outliers too; `sensors` as earlier windows weighted them.
    """
    measured = np.square(residual_sigmas[np.isfinite(residual_sigmas)])
    image, _ = robust_cost(measured, COST_SCALE)
    said = [p.evaluate(state)[0] for p in sensors if isinstance(p, PositionPrior | VelocityPrior | AttitudePrior)]
    return 0.5 * float(np.sum(image)) + 0.5 * float(sum(r @ r for r in said))


def is_worth_another(status: Status, keyframes: tuple[Keyframe, ...], R_body_cam: Array, is_confirmed: bool) -> bool:
    """Whether a window with this result is solved again from a second start."""
    if status is Status.POOR_FIT:
        return True
    if status is not Status.OK or is_confirmed:
        return False
    return not have_attitude(keyframes) or is_steep(keyframes, R_body_cam)
