"""One table of the sensors' errors: whose, how large, and which sensor may fail.

Every sensor's error has a Gauss-Markov part and a white part, (5.5). The configuration gives one sigma of each, where
`variance_components` begins to estimate them from the flight's own residuals. What a receiver or filter claims of its
errors is the least. Section 13 of docs/mathematics.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from onboard.config.schema import Config

POSITION, VELOCITY, TILT, HEADING = "position", "velocity", "tilt", "heading"


@dataclass(frozen=True)
class Sensor:
    """One row: `sigma` and `white_sigma` are the keys of the Gauss-Markov part and of the white part, in `unit`.

    Where `may_fail`, a window may leave it out (`sensor_groups`). Of a sensor that `has_claim` the Gauss-Markov sigma
    is the receiver's or the filter's own, or what is configured in its place.
    """

    name: str
    unit: str  # as configured and reported
    sigma: str
    white_sigma: str
    may_fail: bool = False
    has_claim: bool = False

    @property
    def white(self) -> str:
        """The name of the white part; the Gauss-Markov part has the sensor's own."""
        return f"{self.name}_white"


SENSORS = (
    Sensor(POSITION, "m", "gps.sigma_correlated_horizontal_m", "gps.sigma_white_m", has_claim=True),
    Sensor(VELOCITY, "m/s", "gps.sigma_velocity_correlated_m_s", "gps.sigma_velocity_m_s", has_claim=True),
    Sensor(TILT, "deg", "solve.attitude_sigma_deg", "solve.attitude_white_sigma_deg", may_fail=True),
    Sensor(HEADING, "deg", "solve.heading_sigma_deg", "solve.heading_white_sigma_deg", may_fail=True),
)
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
