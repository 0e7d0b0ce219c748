"""A flight's estimates of its own platform and sensors, each with a name, a unit and its sigma, for people."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from onboard.config.schema import Config
from onboard.estimation.boresight import PlatformEstimate, Unconfirmed
from onboard.estimation.platform_states import QUANTITIES, present
from onboard.estimation.reobservation import RelativeVariance
from onboard.estimation.sensor_groups import Failing
from onboard.estimation.sensor_table import PARTS, configured
from onboard.estimation.sliding_window import Window
from onboard.estimation.variance_components import VarianceFactors
from onboard.pipeline.summary import Contradiction, Estimate, SensorError

BORESIGHT, TIME_OFFSET, RELATIVE_VARIANCE = "boresight", "camera_time_offset", "relative_variance_factor"
SHOWN = 1.1  # times the declared sigma: less is not worth a line


def contradictions_of(failing: Failing, now_ns: int) -> tuple[Contradiction, ...]:
    """Sensors that fail or have failed since the start, by name."""
    out = []
    for name in sorted(failing.windows):
        failure = failing.failures.get(name)
        times = 1.0 if failure is None else math.sqrt(failure.at(now_ns))
        duration_s = 0.0 if failure is None else (failure.last_ns - failure.since_ns) / 1e9
        out.append(Contradiction(name, times, duration_s, failing.windows[name]))
    return tuple(out)


def in_words(contradictions: Iterable[Contradiction], terrain_doubt: str = "") -> str:
    """The present contradictions, also of a terrain model that is off, in one line; empty if there are none."""
    terrain = [f"terrain model left out ({terrain_doubt})"] if terrain_doubt else []
    return "; ".join([*(str(c) for c in contradictions if c.is_now), *terrain])


def estimates_of(platform: PlatformEstimate | None) -> tuple[Estimate, ...]:
    """The estimates of mount, clock, delays, compass and camera; empty before the first one.

    Delays: the age of positions and velocities at their stamps, beyond `gps.latency_s`. The measured heading is too
    small by the first component times the cosine of the heading plus the second times its sine.
    """
    if platform is None:
        return ()
    mean, sigma = platform.mean, platform.sigma
    return tuple(
        Estimate(q.name, q.unit, tuple(mean[at].tolist()), tuple(sigma[at].tolist())) for q, at in present(len(mean))
    )


def unconfirmed_of(found: Unconfirmed | None) -> tuple[Estimate, ...]:
    """Estimates too far from the prior to be adopted before another window confirms them; empty if there are none."""
    if found is None:
        return ()
    outside = [q.name for q, at in present(len(found.outside)) if np.any(found.outside[at])]
    return tuple(e for e in estimates_of(found.found) if e.name in outside)


def not_adopted(unconfirmed: Iterable[Estimate]) -> str:
    """The same in words: `time offset +0.810 +-0.120 s, camera to autopilot`; empty if nothing was."""
    return "; ".join(f"{_LABELS[e.name]} {_text(e)}" for e in unconfirmed)


def relative_variance_of(relative: RelativeVariance) -> tuple[Estimate, ...]:
    """The factor by which the variances of relative positions were found too small, and published larger; 1: as stated.

    Empty before points have been seen again.
    """
    if not relative.expected:
        return ()
    return (Estimate(RELATIVE_VARIANCE, "ratio", (relative.factor,), (relative.sigma,)),)


def sensor_errors(config: Config, factors: VarianceFactors) -> tuple[SensorError, ...]:
    """Every part in the order of `sensor_table.PARTS`."""
    declared = [(name, unit, configured(config, key)) for name, (key, unit) in PARTS.items()]
    return tuple(SensorError(name, unit, sigma * factors.sigma(name), sigma) for name, unit, sigma in declared)


def larger_than_declared(errors: Iterable[SensorError]) -> str:
    """The errors that the flight showed to be larger than configured: `heading 3.8 deg, declared 2`; empty if none."""
    return "; ".join(str(e) for e in errors if e.sigma > SHOWN * e.declared)


def found_in_flight(
    config: Config, window: Window, now_ns: int
) -> tuple[tuple[Estimate, ...], tuple[SensorError, ...], tuple[Estimate, ...], tuple[Contradiction, ...]]:
    """Estimates, sensor errors, what is not confirmed, and contradictions, as of now."""
    platform = window.platform if window.alignment.updates else None
    return (
        estimates_of(platform) + relative_variance_of(window.memory.relative),
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
    rows = [(_LABELS[e.name], _text(e)) for e in estimates]
    others = [
        ("sensor errors", larger_than_declared(errors)),
        ("not confirmed", not_adopted(unconfirmed)),
        ("contradictions", "; ".join(str(c) for c in contradictions)),
    ]
    return [*rows, *((name, text) for name, text in others if text)]


_LABELS = {q.name: q.label for q in QUANTITIES} | {RELATIVE_VARIANCE: "relative errors"}
# The form of each in words: a factor, decimals, and the text around its components.
_TEXTS: dict[str, tuple[float, int, str]] = {
    BORESIGHT: (math.degrees(1.0), 2, "x {}, y {}, z {} deg, camera axes"),
    TIME_OFFSET: (1.0, 3, "{} s, camera to autopilot"),
    "position_delay": (1.0, 3, "{} s off gps.latency_s"),
    "velocity_delay": (1.0, 3, "{} s off gps.latency_s"),
    "heading_error_by_heading": (math.degrees(1.0), 2, "{} deg times cos heading, {} deg times sin heading"),
    "focal_length_error": (100.0, 2, "{} % off the camera file"),
    "principal_point_error": (100.0, 2, "x {}, y {} % of the focal length off the camera file"),
    "radial_distortion_error": (1.0, 3, "k1 {}, k2 {} off the camera file"),
    "readout_error": (1e3, 1, "{} ms off camera.readout_s"),
    RELATIVE_VARIANCE: (1.0, 2, "variance {} of what was stated, by points seen again"),
}


def _text(estimate: Estimate) -> str:
    factor, decimals, words = _TEXTS[estimate.name]
    sign, pairs = "" if estimate.name == RELATIVE_VARIANCE else "+", zip(estimate.values, estimate.sigmas, strict=True)
    return words.format(*(f"{factor * m:{sign}.{decimals}f} +-{factor * s:.{decimals}f}" for m, s in pairs))
