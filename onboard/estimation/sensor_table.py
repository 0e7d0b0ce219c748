"""One table of the sensors' errors: whose, about which axes, how correlated, how large, and which sensor may fail.

Every sensor's error has a Gauss-Markov part and a white part, (5.5). The configuration gives one sigma of each, where
`variance_components` begins to estimate them from the flight's own residuals. What a receiver or filter claims of its
errors is the least. Section 13 of docs/mathematics.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.config.schema import Config
from onboard.estimation.factors import AttitudePrior, PositionPrior, VelocityPrior

POSITION, VELOCITY, TILT, HEADING = "position", "velocity", "tilt", "heading"


@dataclass(frozen=True)
class Sensor:
    """One row: `sigma`, `white_sigma` and `time` are the keys of the Gauss-Markov part, the white part, and its time.

    `axes` are those of the residual's three that it measures. Where `may_fail`, a window may leave it out
    (`sensor_groups`); sigmas are in `unit`, as configured and reported. Of a sensor that `has_claim` the
    Gauss-Markov sigma is the receiver's or the filter's own, or what is configured in its place.
    """

    name: str
    residual: type[PositionPrior | VelocityPrior | AttitudePrior]
    axes: slice
    unit: str
    sigma: str
    white_sigma: str
    time: str
    may_fail: bool = False
    has_claim: bool = False

    @property
    def white(self) -> str:
        """The name of the white part; the Gauss-Markov part has the sensor's own."""
        return f"{self.name}_white"

    def time_s(self, config: Config) -> float:
        """Correlation time of the Gauss-Markov part."""
        return configured(config, self.time)


SENSORS = (
    Sensor(
        POSITION, PositionPrior, slice(0, 3), "m",
        "gps.sigma_correlated_horizontal_m", "gps.sigma_white_m", "gps.correlation_time_s",
        has_claim=True,
    ),
    Sensor(
        VELOCITY, VelocityPrior, slice(0, 3), "m/s",
        "gps.sigma_velocity_correlated_m_s", "gps.sigma_velocity_m_s", "gps.velocity_correlation_time_s",
        has_claim=True,
    ),
    Sensor(
        TILT, AttitudePrior, slice(0, 2), "deg",
        "solve.attitude_sigma_deg", "solve.attitude_white_sigma_deg", "solve.attitude_correlation_time_s", True,
    ),
    Sensor(
        HEADING, AttitudePrior, slice(2, 3), "deg",
        "solve.heading_sigma_deg", "solve.heading_white_sigma_deg", "solve.attitude_correlation_time_s", True,
    ),
)  # fmt: skip
BY_NAME = {s.name: s for s in SENSORS}
# The parts whose variances are estimated, each by its name: where it is configured, and in which unit.
PARTS = {name: (key, s.unit) for s in SENSORS for name, key in ((s.name, s.sigma), (s.white, s.white_sigma))}
CLAIMED = frozenset(s.name for s in SENSORS if s.has_claim)  # parts that count for no less than declared


def configured(config: Config, key: str) -> float:
    """The value of `section.key`, in its own unit."""
    section, name = key.split(".")
    return float(getattr(getattr(config, section), name))


def declared(config: Config, part: str) -> float:
    """One sigma of a part as configured: m, m/s or rad."""
    key, unit = PARTS[part]
    value = configured(config, key)
    return float(np.radians(value)) if unit == "deg" else value
