"""The sources of a window's errors: its covariance as a sum over priors and measurements. Section 20.

The optimum of least squares moves linearly with every measurement's error, so its covariance is a sum of one term a
source, (20.1): exact, and for any linear function of the window's camera side. Errors that one prior holds together
(mount, clock, compass) are distinguished by the square root that is nearest to the states themselves, (20.3).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from contract.error_sources import Cause
from onboard.estimation.factors import Prior, RangePrior, SharedPrior
from onboard.estimation.platform_states import PLANE, present
from onboard.estimation.sensor_table import HEADING, POSITION, TILT, VELOCITY
from onboard.estimation.solved_window import Solved

Array = NDArray[np.float64]

# The names of a sensor's Gauss-Markov part and of all the rest of its covariance.
CAUSES = {
    POSITION: (Cause.GPS_SLOW, Cause.GPS_WHITE),
    VELOCITY: (Cause.SPEED, Cause.SPEED),
    TILT: (Cause.ATTITUDE_SLOW, Cause.ATTITUDE_WHITE),
    HEADING: (Cause.HEADING_NOISE, Cause.HEADING_NOISE),
}


def sources(solved: Solved, gain: Array) -> dict[str, Array]:
    """Covariance (m, m) of `gain` (m, D) times the window's camera side, by source; their sum is all of it.

    Without what the ground's own motion and the disagreement between windows add: see `georeferencing.click_budget`.
    What rolling rows' own rates and vibration leave is counted with the pixels.
    """
    solution = solved.solution
    moved = gain @ solution.covariance  # by the right side of the reduced system, (20.1)
    by_ground = moved @ solution.ground_pull
    terms = [term for p in solved.priors for term in _terms(p, moved @ p.evaluate(solution.state)[1].T)]
    terms.append((Cause.RELIEF, by_ground @ by_ground.T))
    left = moved @ gain.T - sum(term for _, term in terms)
    out: dict[str, Array] = {}
    for name, term in (*terms, (Cause.PIXELS, 0.5 * (left + left.T))):
        out[name] = out.get(name, np.zeros_like(term)) + term
    return out


def _terms(prior: Prior, by_noise: Array) -> Iterator[tuple[Cause, Array]]:
    """The terms of one prior, (20.2), from the effect (m, n) of its whitened residuals' errors."""
    if isinstance(prior, SharedPrior):
        held = present(len(prior.mean) - PLANE)
        names = [*(q.source for q, _ in held for _ in range(q.components)), Cause.DATUM, Cause.SLOPE, Cause.SLOPE]
        columns = (by_noise @ prior.whitener @ nearest_root(prior.whitener)).T
        yield from ((name, np.outer(column, column)) for name, column in zip(names, columns, strict=True))
    elif isinstance(prior, RangePrior) or not prior.parts:
        yield Cause.RANGE if isinstance(prior, RangePrior) else Cause.PATH, by_noise @ by_noise.T
    else:
        n = prior.whitener.shape[1]
        for axis, (sensor, W, parts) in enumerate(zip(prior.sensors, prior.whitener, prior.parts, strict=True)):
            by_axis = by_noise[:, axis * n : (axis + 1) * n]
            by_part = by_axis @ W
            slow = by_part @ parts.get(sensor, np.zeros((n, n))) @ by_part.T  # none known while the sensor fails
            yield from zip(CAUSES[sensor], (slow, by_axis @ by_axis.T - slow), strict=True)


def nearest_root(whitener: Array) -> Array:
    """The root F (n, n) of the covariance C = F F' that `whitener` whitens, each column nearest to one state. (20.3)

    Of all roots it has the largest correlation between each state and its own column (Kessy, Lewin, Strimmer 2018).
    """
    covariance = np.linalg.inv(whitener.T @ whitener)
    sigma = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(sigma, sigma))
    out: Array = sigma[:, None] * ((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
    return out
