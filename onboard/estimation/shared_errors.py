"""The errors that a window, or a pose by sensors alone, has in common with others of the flight. (9.11), (9.12)

Every slow error in a window's priors is one nuisance parameter that persists: the Gauss-Markov errors of positions and
of attitudes, the mount, the clock, the ground's slope. The columns below give how far one sigma of each moves the
camera side; from them follows which part of the errors of two sets is the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import ALIGNMENT, ATTITUDE, GROUND, NUISANCES, POSITION, SharedErrors
from onboard.config.schema import Config
from onboard.estimation.boresight import PlatformEstimate
from onboard.estimation.factors import AttitudePrior, PositionPrior, Prior, SharedPrior, State
from onboard.estimation.platform_states import BORESIGHT, DELAY, HEADING, OFFSET, PLANE, VELOCITY_DELAY
from onboard.estimation.sensor_factors import attitude_sigma_rad, cosine_sine_of_heading
from onboard.estimation.sensor_table import BY_NAME, declared
from onboard.estimation.variance_components import VarianceFactors
from onboard.navigation.navigator import NavState

Array = NDArray[np.float64]


def shared_errors(config: Config, priors: list[Prior], state: State, covariance: Array) -> SharedErrors:
    """The displacement of a window's camera side by one sigma of each nuisance parameter: `by_nuisance` (D, NUISANCES).

    `covariance` (D, D) is the camera side's own. A measurement error of v whitened sigmas moves the optimum by
    covariance @ J' v, (9.12).
    """
    gains = np.zeros((len(covariance), NUISANCES))
    alignment_sigma = np.zeros(OFFSET + 1)
    for prior in priors:
        if isinstance(prior, PositionPrior | AttitudePrior):
            where, sign = (POSITION, 1.0) if isinstance(prior, PositionPrior) else (ATTITUDE, -1.0)
            _, J = prior.by_axis(state)
            error = prior.whitener.sum(axis=2) * (sign * prior.persistent[:, None])  # (3, K) one sigma on every picture
            gains[:, where] = covariance @ np.einsum("akd,ak->da", J, error)
        elif isinstance(prior, SharedPrior):
            _, J = prior.evaluate(state)
            by_prior = covariance @ J.T
            by_time = _one_of(by_prior[:, OFFSET : VELOCITY_DELAY + 1], prior.layout.centres()[:, :2])
            gains[:, ALIGNMENT] = np.column_stack([by_prior[:, BORESIGHT], by_time])
            turns = np.column_stack([gains[:, ATTITUDE.stop - 1], by_prior[:, HEADING]])
            gains[:, ATTITUDE.stop - 1] = _one_of(turns, prior.layout.rotations())
            gains[:, GROUND] = by_prior[:, -PLANE:]
            alignment_sigma = 1.0 / np.diag(prior.whitener)[: OFFSET + 1]
    attitude_time_s = config.solve.attitude_correlation_time_s
    return SharedErrors(gains, config.gps.correlation_time_s, attitude_time_s, alignment_sigma)


def _one_of(errors: Array, moved: NDArray[np.intp]) -> Array:
    """Combine independent errors (D, n) of the same effect into the part that sets share, the wire's column (D,).

    Errors of time all move positions along the track, errors of heading all turn the views about the vertical. The
    combination that moves the states `moved` (K, m) most, on average over the K keyframes, is what sets share; the
    others stay in each set's own covariance.
    """
    _, _, basis = np.linalg.svd(errors[moved].mean(axis=0))
    along = basis[0] * np.sign(basis[0][np.argmax(np.abs(basis[0]))])
    out: Array = errors @ along
    return out


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
        return self.white + self.shared.by_nuisance @ self.shared.by_nuisance.T

    def over_ground(self, sigma_m: float) -> SensorPose:
        """The same over a ground whose height as a whole is known to one sigma."""
        by_nuisance = self.shared.by_nuisance.copy()
        by_nuisance[6, GROUND.start] = sigma_m
        return replace(self, shared=replace(self.shared, by_nuisance=by_nuisance))

    def over_ranged_ground(self, sigma_m: float) -> SensorPose:
        """The same over a ground measured from the camera, to one sigma: where the camera's height is off, so is it."""
        follows = np.eye(7)
        follows[6] = follows[2]
        white = follows @ self.white @ follows.T
        white[6, 6] += sigma_m**2
        return replace(self, white=white, shared=replace(self.shared, by_nuisance=follows @ self.shared.by_nuisance))


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
    speed = nav.motion_enu_m_s
    attitude = attitude_sigma_rad(config, factors)
    factor = np.linalg.cholesky(platform.covariance)
    if nav.R_enu_body is not None:
        by_heading = cosine_sine_of_heading(nav.R_enu_body) @ factor[HEADING]
        attitude[2] = np.linalg.norm([attitude[2], *by_heading, nav.yaw_sigma_rad])
    vertical_m = np.hypot(nav.sigma_vertical_m, nav.sigma_datum_m)
    by_nuisance = np.zeros((7, NUISANCES))
    by_nuisance[:3, POSITION] = np.diag([nav.sigma_horizontal_m, nav.sigma_horizontal_m, vertical_m])
    by_nuisance[3:6, ATTITUDE] = np.diag(attitude)
    late_s = np.linalg.norm([*(factor[OFFSET] + factor[DELAY]), gps.sigma_latency_s])
    by_nuisance[3:6, ALIGNMENT.start : ALIGNMENT.stop - 1] = R_cam_enu.T @ factor[BORESIGHT, BORESIGHT]
    by_nuisance[:3, ALIGNMENT.stop - 1] = speed * late_s
    jitter_s, rate_rad_s = stamp_error
    position_m = nav.sigma_white_m * np.array([1.0, 1.0, 1.5])
    white_rad = [declared(config, w) * factors.sigma(w) for w in (BY_NAME[n].white for n in AttitudePrior.sensors)]
    own = np.diag(np.square([*position_m, *np.hypot(white_rad, rate_rad_s * jitter_s), 0.0]))
    own[:3, :3] += jitter_s**2 * np.outer(speed, speed)  # (5.11)
    shared = SharedErrors(
        by_nuisance, gps.correlation_time_s, solve.attitude_correlation_time_s, np.diag(factor)[: OFFSET + 1].copy()
    )
    centre = nav.position_enu_m + R_cam_enu.T @ lever_cam_m
    return SensorPose(R_cam_enu, centre, own, shared)
