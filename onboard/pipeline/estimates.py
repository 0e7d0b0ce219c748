"""What a flight has found of its own platform and sensors, each with a name, a unit and its sigma, for people."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from onboard.config.schema import Config
from onboard.estimation import boresight
from onboard.estimation.boresight import Belief
from onboard.estimation.reobservation import RelativeVariance
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
RELATIVE_VARIANCE = "relative_variance_factor"
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


def relative_variance_of(relative: RelativeVariance) -> tuple[Estimate, ...]:
    """By what factor the variances of relative positions were found too small, and published larger; 1: as stated.

    Empty before points have been seen again.
    """
    if not relative.expected:
        return ()
    return (Estimate(RELATIVE_VARIANCE, "ratio", (relative.factor,), (relative.sigma,)),)


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


def as_rows(estimates: Iterable[Estimate], errors: Iterable[SensorError]) -> list[tuple[str, str]]:
    """The same as rows of a summary: a name and a text each, angles in degrees."""
    rows = [(_ROW_NAMES[e.name], _text(e)) for e in estimates]
    larger = larger_than_declared(errors)
    return [*rows, ("sensor errors", larger)] if larger else rows


_ROW_NAMES = {
    BORESIGHT: "boresight",
    TIME_OFFSET: "time offset",
    POSITION_DELAY: "position delay",
    VELOCITY_DELAY: "velocity delay",
    HEADING_ERROR: "heading error",
    RELATIVE_VARIANCE: "relative errors",
}


def _text(estimate: Estimate) -> str:
    pairs = list(zip(estimate.values, estimate.sigmas, strict=True))
    if estimate.name == RELATIVE_VARIANCE:
        return f"variance {pairs[0][0]:.2f} +-{pairs[0][1]:.2f} of what was stated, by points seen again"
    degrees = [f"{math.degrees(m):+.2f} +-{math.degrees(s):.2f}" for m, s in pairs]
    if estimate.name == BORESIGHT:
        return f"x {degrees[0]}, y {degrees[1]}, z {degrees[2]} deg, camera axes"
    if estimate.name == HEADING_ERROR:
        return f"{degrees[0]} deg times cos heading, {degrees[1]} deg times sin heading"
    seconds = f"{pairs[0][0]:+.3f} +-{pairs[0][1]:.3f} s"
    return f"{seconds}, camera to autopilot" if estimate.name == TIME_OFFSET else f"{seconds} beside gps.latency_s"
