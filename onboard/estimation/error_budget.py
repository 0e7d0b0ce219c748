"""Which source a window's errors come from: its covariance as a sum over priors and measurements. Section 20.

The optimum of least squares moves linearly with every measurement's error, so its covariance is a sum of one term a
source, (20.1): exact, and for any linear function of the window's camera side. Errors that one prior holds together
(mount, clock, compass) are distinguished by the square root that is nearest to the states themselves, (20.3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contract.error_sources import Cause
from onboard.estimation.factors import AttitudePrior, PositionPrior, Prior, RangePrior, SharedPrior, VelocityPrior
from onboard.estimation.platform_states import PLANE, present
from onboard.estimation.sensor_table import BY_NAME, POSITION, TILT, VELOCITY
from onboard.estimation.sensor_table import HEADING as HEADING_SLOW
from onboard.estimation.solved_window import Solved

Array = NDArray[np.float64]

# What a part of a sensor's covariance is called, and what is left of the sensor's beyond its parts.
PARTS = {
    POSITION: Cause.GPS_SLOW,
    BY_NAME[POSITION].white: Cause.GPS_WHITE,
    VELOCITY: Cause.SPEED,
    BY_NAME[VELOCITY].white: Cause.SPEED,
    TILT: Cause.ATTITUDE_SLOW,
    BY_NAME[TILT].white: Cause.ATTITUDE_WHITE,
    HEADING_SLOW: Cause.HEADING_NOISE,
    BY_NAME[HEADING_SLOW].white: Cause.HEADING_NOISE,
}
BEYOND_PARTS: dict[type[Prior], str] = {
    PositionPrior: Cause.GPS_WHITE,
    VelocityPrior: Cause.SPEED,
    AttitudePrior: Cause.ATTITUDE_WHITE,
    RangePrior: Cause.RANGE,
}


def sources(solved: Solved, gain: Array) -> dict[str, Array]:
    """Covariance (m, m) of `gain` (m, D) times the window's camera side, by source; their sum is all of it.

    Without what the ground's own motion and the disagreement between windows add: see `georeferencing.click_budget`.
    What rolling rows' own rates and vibration leave is counted with the pixels.
    """
    solution = solved.solution
    moved = gain @ solution.covariance  # by the right side of the reduced system, (20.1)
    out: dict[str, Array] = {}
    for prior in solved.priors:
        _, J = prior.evaluate(solution.state)
        _add(out, prior, moved @ J.T)
    by_ground = moved @ solution.ground_pull
    _put(out, Cause.RELIEF, by_ground @ by_ground.T)
    left = moved @ gain.T - sum(out.values(), np.zeros((len(gain), len(gain))))
    _put(out, Cause.PIXELS, 0.5 * (left + left.T))
    return out


def _put(out: dict[str, Array], name: str, term: Array) -> None:
    out[name] = out.get(name, np.zeros_like(term)) + term


def _add(out: dict[str, Array], prior: Prior, by_noise: Array) -> None:
    """The terms of one prior, (20.2), from how far its whitened residuals' errors move things: (m, n)."""
    if isinstance(prior, SharedPrior):
        held, factor = present(len(prior.mean) - PLANE), nearest_root(prior.whitener)
        names = [*(q.source for q, _ in held for _ in range(q.components)), Cause.DATUM, Cause.SLOPE, Cause.SLOPE]
        for column, name in zip((by_noise @ prior.whitener @ factor).T, names, strict=True):
            _put(out, name, np.outer(column, column))
        return
    if isinstance(prior, RangePrior) or prior.parts is None:
        _put(out, Cause.PATH if isinstance(prior, AttitudePrior) else BEYOND_PARTS[type(prior)], by_noise @ by_noise.T)
        return
    n = prior.whitener.shape[1]
    for axis, (W, parts) in enumerate(zip(prior.whitener, prior.parts, strict=True)):
        by_axis = by_noise[:, axis * n : (axis + 1) * n]
        left = by_axis @ by_axis.T
        for part, Q in parts.items():
            by_part = by_axis @ W
            term = by_part @ Q @ by_part.T
            _put(out, PARTS[part], term)
            left = left - term
        is_heading = isinstance(prior, AttitudePrior) and axis == 2
        _put(out, Cause.HEADING_NOISE if is_heading else BEYOND_PARTS[type(prior)], left)


def nearest_root(whitener: Array) -> Array:
    """The root F (n, n) of the covariance C = F F' that `whitener` whitens, each column nearest to one state. (20.3)

    Of all roots it has the largest correlation between each state and its own column (Kessy, Lewin, Strimmer 2018).
    """
    covariance = np.linalg.inv(whitener.T @ whitener)
    sigma = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    out: Array = sigma[:, None] * ((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
    return out
