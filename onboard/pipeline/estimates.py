"""What a flight has found of its own platform and sensors, each with a name, a unit and its sigma, for people."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from onboard.config.schema import Config
from onboard.estimation import boresight
from onboard.estimation.boresight import Belief, Unconfirmed
from onboard.estimation.camera_states import READOUT as READOUT_AT
from onboard.estimation.reobservation import RelativeVariance
from onboard.estimation.sensor_groups import FORGOTTEN, Failing
from onboard.estimation.sliding_window import Window
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
FOCAL_LENGTH, PRINCIPAL_POINT, DISTORTION = "focal_length_error", "principal_point_error", "radial_distortion_error"
READOUT = "readout_error"
STATES: tuple[tuple[str, str, slice | int], ...] = (
    (BORESIGHT, "radians", boresight.BORESIGHT),
    (TIME_OFFSET, "seconds", boresight.OFFSET),
    (POSITION_DELAY, "seconds", boresight.DELAY),
    (VELOCITY_DELAY, "seconds", boresight.VELOCITY_DELAY),
    (HEADING_ERROR, "radians", boresight.HEADING),
)
# The camera's own, where its file says that it may be wrong; ratios are in focal lengths.
CAMERA_STATES = (
    (FOCAL_LENGTH, "ratio", slice(boresight.STATES, boresight.STATES + 1)),
    (PRINCIPAL_POINT, "ratio", slice(boresight.STATES + 1, boresight.STATES + 3)),
    (DISTORTION, "ratio", slice(boresight.STATES + 3, boresight.STATES + 5)),
)
READOUT_STATE = ((READOUT, "seconds", boresight.STATES + READOUT_AT),)  # where `camera.readout_s` is unsure
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
    """What is estimated of mount, clock, delays, compass and camera; empty before the first estimate.

    Delays are what positions and velocities are older than their stamps beyond `gps.latency_s`; the heading read
    is too small by the first component times the cosine of the heading plus the second times its sine.
    """
    if belief is None:
        return ()
    mean, sigma = belief.mean, belief.sigma
    return tuple(
        Estimate(name, unit, tuple(np.atleast_1d(mean[at]).tolist()), tuple(np.atleast_1d(sigma[at]).tolist()))
        for name, unit, at in _states_of(len(mean))
    )


def _states_of(count: int) -> tuple[tuple[str, str, slice | int], ...]:
    """The states of a belief of so many numbers."""
    has_lens, has_readout = count > boresight.STATES, count > boresight.STATES + READOUT_AT
    return *STATES, *(CAMERA_STATES if has_lens else ()), *(READOUT_STATE if has_readout else ())


def unconfirmed_of(found: Unconfirmed | None) -> tuple[Estimate, ...]:
    """What was found too far from what was believed to be adopted before anything confirms it; empty if nothing was."""
    if found is None:
        return ()
    every = estimates_of(Belief(found.end_ns, found.mean, np.diag(np.square(found.sigma))))
    outside = [bool(np.any(found.outside[at])) for _, _, at in _states_of(len(found.mean))]
    return tuple(e for e, is_outside in zip(every, outside, strict=True) if is_outside)


def not_adopted(unconfirmed: Iterable[Estimate]) -> str:
    """The same in words: `time offset +0.810 +-0.120 s, camera to autopilot`; empty if nothing was."""
    return "; ".join(f"{_ROW_NAMES[e.name]} {_text(e)}" for e in unconfirmed)


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


def found_in_flight(
    config: Config, window: Window, now_ns: int
) -> tuple[tuple[Estimate, ...], tuple[SensorError, ...], tuple[Estimate, ...], tuple[Contradiction, ...]]:
    """Estimates, sensor errors, what is not confirmed, and contradictions, as of now."""
    belief = window.belief if window.alignment.updates else None
    return (
        estimates_of(belief) + relative_variance_of(window.memory.relative),
        sensor_errors(config, window.noise.factors),
        unconfirmed_of(window.alignment.unconfirmed),
        contradictions_of(window.noise.failing, now_ns),
    )


def as_rows(
    estimates: Iterable[Estimate],
    errors: Iterable[SensorError],
    unconfirmed: Iterable[Estimate] = (),
    contradictions: Iterable[Contradiction] = (),
) -> list[tuple[str, str]]:
    """The same as rows of a summary: a name and a text each, angles in degrees."""
    rows = [(_ROW_NAMES[e.name], _text(e)) for e in estimates]
    others = [
        ("sensor errors", larger_than_declared(errors)),
        ("not confirmed", not_adopted(unconfirmed)),
        ("contradictions", "; ".join(str(c) for c in contradictions)),
    ]
    return [*rows, *((name, text) for name, text in others if text)]


_ROW_NAMES = {
    BORESIGHT: "boresight",
    TIME_OFFSET: "time offset",
    POSITION_DELAY: "position delay",
    VELOCITY_DELAY: "velocity delay",
    HEADING_ERROR: "heading error",
    FOCAL_LENGTH: "focal length",
    PRINCIPAL_POINT: "principal point",
    DISTORTION: "distortion",
    READOUT: "readout",
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
    if estimate.name == FOCAL_LENGTH:
        return f"{100 * pairs[0][0]:+.2f} +-{100 * pairs[0][1]:.2f} % beside the camera file"
    if estimate.name == PRINCIPAL_POINT:
        x, y = (f"{100 * m:+.2f} +-{100 * s:.2f}" for m, s in pairs)
        return f"x {x}, y {y} % of the focal length beside the camera file"
    if estimate.name == DISTORTION:
        k1, k2 = (f"{m:+.3f} +-{s:.3f}" for m, s in pairs)
        return f"k1 {k1}, k2 {k2} beside the camera file"
    if estimate.name == READOUT:
        return f"{1e3 * pairs[0][0]:+.1f} +-{1e3 * pairs[0][1]:.1f} ms beside camera.readout_s"
    seconds = f"{pairs[0][0]:+.3f} +-{pairs[0][1]:.3f} s"
    return f"{seconds}, camera to autopilot" if estimate.name == TIME_OFFSET else f"{seconds} beside gps.latency_s"
