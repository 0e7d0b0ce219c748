"""What a flight has found of its own platform and sensors, each with a name, a unit and its sigma, for people."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from onboard.config.schema import Config
from onboard.estimation import boresight
from onboard.estimation.boresight import Belief
from onboard.estimation.sensor_groups import FORGOTTEN, Failing
from onboard.estimation.variance_components import (
    HEADING,
    HEADING_WHITE,
    NAMES,
    POSITION,
    TILT,
    TILT_WHITE,
    VELOCITY,
    VarianceFactors,
)

BORESIGHT, TIME_OFFSET = "boresight", "camera_time_offset"
POSITION_DELAY, VELOCITY_DELAY = "position_delay", "velocity_delay"
HEADING_ERROR = "heading_error_by_heading"
STATES = (
    (BORESIGHT, "radians", boresight.BORESIGHT),
    (TIME_OFFSET, "seconds", boresight.OFFSET),
    (POSITION_DELAY, "seconds", boresight.DELAY),
    (VELOCITY_DELAY, "seconds", boresight.VELOCITY_DELAY),
    (HEADING_ERROR, "radians", boresight.HEADING),
)
SHOWN = 1.1  # times the declared sigma: less is not worth a line


@dataclass(frozen=True)
class Estimate:
    """One quantity that is estimated in flight: a name, its unit, and as many values as it has components."""

    name: str
    unit: str  # as Prometheus writes it: radians, seconds, meters, ...
    values: tuple[float, ...]
    sigmas: tuple[float, ...]


@dataclass(frozen=True)
class SensorError:
    """One sigma of one part of the sensors' errors: as estimated in flight, and as configured, which is the least."""

    name: str  # one of `variance_components.NAMES`
    unit: str  # deg, m/s, m
    sigma: float
    declared: float

    def __str__(self) -> str:
        return f"{self.name.replace('_', ' ')} {self.sigma:.2g} {self.unit}, declared {self.declared:g}"


@dataclass(frozen=True)
class Contradiction:
    """A sensor that contradicts all others, or did: how it counts, and since when it does so without a pause."""

    name: str  # position, velocity, tilt or heading
    sigma_times: float  # what its sigma counts as many times of; 1 once it agrees again
    lasting_s: float  # from the first to the last window of its newest failure
    windows: int  # in which it failed since the start

    @property
    def is_now(self) -> bool:
        """Whether it is held to be wrong now."""
        return self.sigma_times**2 > FORGOTTEN

    def __str__(self) -> str:
        if self.is_now:
            for_s = f" for {self.lasting_s:.0f} s" if self.lasting_s >= 1.0 else ""
            times = f"{self.sigma_times:.2g} times its sigma"
            return f"{self.name} contradicts the other sensors{for_s} and counts with {times}"
        return f"{self.name} contradicted the other sensors in {self.windows} windows"


def contradictions_of(failing: Failing, now_ns: int) -> tuple[Contradiction, ...]:
    """Sensors that fail or have failed since the start, by name."""
    out = []
    for name in sorted(failing.windows):
        failure = failing.failures.get(name)
        times = 1.0 if failure is None else math.sqrt(failure.at(now_ns))
        lasting_s = 0.0 if failure is None else (failure.last_ns - failure.since_ns) / 1e9
        out.append(Contradiction(name, times, lasting_s, failing.windows[name]))
    return tuple(out)


def said_of(contradictions: Iterable[Contradiction]) -> str:
    """Those of now in one line; empty if there are none."""
    return "; ".join(str(c) for c in contradictions if c.is_now)


def estimates_of(belief: Belief | None) -> tuple[Estimate, ...]:
    """What is estimated of mount, clock, delays and compass; empty before the first estimate.

    Delays are what positions and velocities are older than their stamps beyond `gps.latency_s`; the heading read
    is too small by the first component times the cosine of the heading plus the second times its sine.
    """
    if belief is None:
        return ()
    mean, sigma = belief.mean, belief.sigma
    return tuple(
        Estimate(name, unit, tuple(np.atleast_1d(mean[at]).tolist()), tuple(np.atleast_1d(sigma[at]).tolist()))
        for name, unit, at in STATES
    )


def sensor_errors(config: Config, factors: VarianceFactors) -> tuple[SensorError, ...]:
    """Every part in the order of NAMES."""
    solve, gps = config.solve, config.gps
    declared = {
        TILT: (solve.attitude_sigma_deg, "deg"),
        HEADING: (solve.heading_sigma_deg, "deg"),
        TILT_WHITE: (solve.attitude_white_sigma_deg, "deg"),
        HEADING_WHITE: (solve.heading_white_sigma_deg, "deg"),
        VELOCITY: (gps.sigma_velocity_m_s, "m/s"),
        POSITION: (gps.sigma_wander_horizontal_m, "m"),
    }
    return tuple(SensorError(n, declared[n][1], declared[n][0] * factors.sigma(n), declared[n][0]) for n in NAMES)


def larger_than_declared(errors: Iterable[SensorError]) -> str:
    """Those that the flight showed to be larger than configured: `heading 3.8 deg, declared 2`; empty if none."""
    return "; ".join(str(e) for e in errors if e.sigma > SHOWN * e.declared)


def as_rows(
    estimates: Iterable[Estimate], errors: Iterable[SensorError], contradictions: Iterable[Contradiction] = ()
) -> list[tuple[str, str]]:
    """The same as rows of a summary: a name and a text each, angles in degrees."""
    rows = [(_ROW_NAMES[e.name], _text(e)) for e in estimates]
    larger = larger_than_declared(errors)
    if larger:
        rows.append(("sensor errors", larger))
    against = "; ".join(str(c) for c in contradictions)
    return [*rows, ("contradictions", against)] if against else rows


_ROW_NAMES = {
    BORESIGHT: "boresight",
    TIME_OFFSET: "time offset",
    POSITION_DELAY: "position delay",
    VELOCITY_DELAY: "velocity delay",
    HEADING_ERROR: "heading error",
}


def _text(estimate: Estimate) -> str:
    pairs = list(zip(estimate.values, estimate.sigmas, strict=True))
    degrees = [f"{math.degrees(m):+.2f} +-{math.degrees(s):.2f}" for m, s in pairs]
    if estimate.name == BORESIGHT:
        return f"x {degrees[0]}, y {degrees[1]}, z {degrees[2]} deg, camera axes"
    if estimate.name == HEADING_ERROR:
        return f"{degrees[0]} deg times cos heading, {degrees[1]} deg times sin heading"
    seconds = f"{pairs[0][0]:+.3f} +-{pairs[0][1]:.3f} s"
    return f"{seconds}, camera to autopilot" if estimate.name == TIME_OFFSET else f"{seconds} beside gps.latency_s"
