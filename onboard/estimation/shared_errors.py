"""Which part of a window's errors other windows of the flight have too. Equations (9.11) and (9.12).

Every slow error in a window's priors is one nuisance parameter that lasts: the Gauss-Markov errors of positions and of
attitudes, the mount, the clock, the ground's slope. The columns below say how far one sigma of each moves the window's
camera side; from them follows which part of the errors of two sets is the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import ALIGNMENT, ATTITUDE, GROUND, NUISANCES, POSITION, SharedErrors
from onboard.config.schema import Config
from onboard.estimation import sensor_table
from onboard.estimation.boresight import PlatformEstimate
from onboard.estimation.factors import AttitudePrior, PositionPrior, Prior, SharedPrior, State
from onboard.estimation.platform_states import BORESIGHT, DELAY, HEADING, OFFSET, PLANE, VELOCITY_DELAY
from onboard.estimation.sensor_factors import attitude_sigma, cosine_sine_of_heading
from onboard.estimation.sensor_pose import SensorPose
from onboard.estimation.sensor_table import BY_NAME, TILT, declared
from onboard.estimation.variance_components import VarianceFactors
from onboard.navigation.navigator import NavState

Array = NDArray[np.float64]


def shared_errors(config: Config, priors: list[Prior], state: State, covariance: Array) -> SharedErrors:
    """How far one sigma of each nuisance parameter moves a window's camera side: `by_nuisance` (D, NUISANCES).

    `covariance` (D, D) is the camera side's own. A measurement error of v whitened sigmas moves the optimum by
    covariance @ J' v, (9.12).
    """
    gains = np.zeros((len(covariance), NUISANCES))
    alignment_sigma = np.zeros(OFFSET + 1)
    for prior in priors:
        if isinstance(prior, PositionPrior | AttitudePrior):
            where, sign = (POSITION, 1.0) if isinstance(prior, PositionPrior) else (ATTITUDE, -1.0)
            _, J = prior.evaluate(state)
            per_axis = J.reshape(3, -1, J.shape[1])
            error = prior.whitener.sum(axis=2) * (sign * prior.persistent[:, None])  # (3, K) one sigma on every picture
            gains[:, where] = covariance @ np.einsum("akd,ak->da", per_axis, error)
        elif isinstance(prior, SharedPrior):
            _, J = prior.evaluate(state)
            by_prior = covariance @ J.T
            centres = prior.layout.centres()
            times = by_prior[:, OFFSET : VELOCITY_DELAY + 1]
            moved = np.stack([times[centres[:, axis]].mean(axis=0) for axis in (0, 1)])
            gains[:, ALIGNMENT] = np.column_stack([by_prior[:, BORESIGHT], _one_of(times, moved)])
            turns = np.column_stack([gains[:, ATTITUDE.stop - 1], by_prior[:, HEADING]])
            rotations = prior.layout.rotations()
            turned = np.stack([turns[rotations[:, axis]].mean(axis=0) for axis in range(3)])
            gains[:, ATTITUDE.stop - 1] = _one_of(turns, turned)
            gains[:, GROUND] = by_prior[:, -PLANE:]
            alignment_sigma = 1.0 / np.diag(prior.whitener)[: OFFSET + 1]
    attitude_time_s = config.solve.attitude_correlation_time_s
    return SharedErrors(gains, config.gps.correlation_time_s, attitude_time_s, alignment_sigma)


def _one_of(errors: Array, moved: Array) -> Array:
    """Of several independent errors (D, n) with the same effect, that which sets share: the wire's single column (D,).

    Errors of time all move positions along the track, errors of heading all turn the views about the vertical. The
    combination that does so most, by `moved` (m, n), is what sets share; the others stay in each set's own covariance.
    """
    _, _, basis = np.linalg.svd(moved)
    along = basis[0] * np.sign(basis[0][np.argmax(np.abs(basis[0]))])
    out: Array = errors @ along
    return out


def make_sensor_pose(
    config: Config,
    nav: NavState,
    platform: PlatformEstimate,
    R_cam_enu: Array,
    factors: VarianceFactors,
    lever_cam_m: Array,
    stamp_error: tuple[float, float] = (0.0, 0.0),
) -> SensorPose:
    """The camera's pose by sensors alone, its errors by nuisance parameter, and what is the picture's own.

    `stamp_error`: one sigma of the picture's own stamp (s), and how fast the vehicle turns (rad/s).
    """
    solve, gps = config.solve, config.gps
    speed = np.zeros(3) if nav.velocity_enu_m_s is None else nav.velocity_enu_m_s
    tilt, heading = (attitude_sigma(config, factors, name) for name in (TILT, sensor_table.HEADING))
    factor = np.linalg.cholesky(platform.covariance)
    if nav.R_enu_body is not None:
        by_heading = float(np.linalg.norm(cosine_sine_of_heading(nav.R_enu_body) @ factor[HEADING]))
        heading = float(np.hypot(np.hypot(heading, by_heading), nav.yaw_sigma_rad))
    by_nuisance = np.zeros((7, NUISANCES))
    vertical_m = float(np.hypot(nav.sigma_vertical_m, nav.sigma_datum_m))
    by_nuisance[:3, POSITION] = np.diag([nav.sigma_horizontal_m, nav.sigma_horizontal_m, vertical_m])
    by_nuisance[3:6, ATTITUDE] = np.diag([tilt, tilt, heading])
    late_s = float(np.linalg.norm(np.append(factor[OFFSET] + factor[DELAY], gps.sigma_latency_s)))
    by_nuisance[3:6, ALIGNMENT.start : ALIGNMENT.stop - 1] = R_cam_enu.T @ factor[BORESIGHT, BORESIGHT]
    by_nuisance[:3, ALIGNMENT.stop - 1] = speed * late_s
    jitter_s, rate_rad_s = stamp_error
    white = np.zeros(7)
    white[:3] = nav.sigma_white_m * np.array([1.0, 1.0, 1.5])
    whites = [BY_NAME[name].white for name in (TILT, TILT, sensor_table.HEADING)]
    white[3:6] = [declared(config, w) * factors.sigma(w) for w in whites]
    white[3:6] = np.hypot(white[3:6], rate_rad_s * jitter_s)
    own = np.diag(white**2)
    own[:3, :3] += jitter_s**2 * np.outer(speed, speed)  # (5.11)
    shared = SharedErrors(
        by_nuisance, gps.correlation_time_s, solve.attitude_correlation_time_s, np.diag(factor)[: OFFSET + 1].copy()
    )
    centre = nav.position_enu_m + R_cam_enu.T @ lever_cam_m
    return SensorPose(R_cam_enu, centre, own, shared)
