"""Every named mechanism of the estimator, and how the benchmark switches it off: by its neutral value, from outside.

The product has no such switch. Each entry replaces one or two functions by what they give where the mechanism has
no effect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Any
from unittest import mock

import numpy as np

from onboard.estimation import (
    boresight,
    camera_states,
    ground_roughness,
    ground_slope,
    judge,
    moved_optics,
    refined_window,
    row_waves,
    second_solve,
    sliding_window,
    variance_components,
    weighing,
    window_acceptance,
    window_solver,
)
from onboard.navigation import gps_integrity, position_jumps, position_slip
from onboard.pipeline import mount_selection, pipeline

Replacement = tuple[Any, str, Any]  # module or class, name, neutral value


@dataclass(frozen=True)
class Mechanism:
    """Its name, what it is replaced by, in words, and the replacements."""

    name: str
    neutral: str
    replacements: tuple[Replacement, ...]

    @contextmanager
    def off(self) -> Iterator[None]:
        """While it lasts the estimator runs without it."""
        with ExitStack() as stack:
            for owner, name, value in self.replacements:
                stack.enter_context(mock.patch.object(owner, name, value))
            yield


def gives(value: Any) -> Callable[..., Any]:
    """A function of anything that gives this."""
    return lambda *_args, **_kwargs: value


def _held(found: Any, solve: Any, held: Any) -> tuple[dict[str, float], set[str]]:
    return dict(held), set()


def _untouched(self: Any, evidence: Any, stamp_ns: int, weight: float = 1.0) -> Any:
    return replace(self, stamp_ns=stamp_ns)


def _as_it_is(estimate: Any, first: Any) -> Any:
    return estimate


def _as_claimed(self: Any, before: Any, mean: Any, covariance: Any) -> Any:
    return mean, covariance


def _level(self: Any, start_ns: int, place_enu_m: Any) -> ground_slope.SlopePrior:
    return ground_slope.SlopePrior(np.zeros(2), self.sigma**2 * np.eye(2))


def _one_range(places: Any, relative: Any, variance: Any, spread: float) -> float:
    return max(spread * spread, ground_roughness.MIN_ROUGHNESS)


def _declared(problem: Any, first: Any, ground_weight: Any) -> Any:
    return ground_weight


def _as_weighed(weighed: Any) -> tuple[Any, bool]:
    return weighed.noise, False


def _as_used(weighed: Any, before: Any, used: Any) -> tuple[Any, bool]:
    return used, False


def _no_profile(keyframes: Any, found: Any) -> tuple[Any, None]:
    return found, None


def _no_zoom(weighed: Any) -> moved_optics.Signs:
    nothing = judge.excess_of(0.0, weighed.solution, 1)
    return replace(SIGNS_OF(weighed), zoom=nothing, focal_length=nothing)


SIGNS_OF = moved_optics.signs_of  # as it is without a mechanism left out

MECHANISMS = (
    Mechanism(
        "clock profile",
        "no time offset but the one used is compared with, (10.5)",
        ((pipeline, "profile_of", gives(None)),),
    ),
    Mechanism("row waves", "no vibration is looked for in rolling rows", ((row_waves, "seen", gives(None)),)),
    Mechanism("camera states", "the camera file is exact", ((camera_states, "first_sigmas", gives(())),)),
    Mechanism(
        "variance components",
        "sensors' variances stay as configured",
        ((variance_components.VarianceFactors, "with_evidence", _untouched),),
    ),
    Mechanism(
        "stamp jitter",
        "stamps are off by what is declared, and pixels by what they show, (6.7)",
        ((weighing, "_reweighed", _as_weighed),),
    ),
    Mechanism(
        "second weighing",
        "a window is weighted by what earlier ones found, not by its own residuals, (13.2)",
        ((weighing, "_with_own_evidence", _as_used),),
    ),
    Mechanism(
        "re-estimated prior",
        "the first prior of mount, clock and lens keeps its declared sigma, (6.12)",
        ((boresight, "_with_prior_reweighed", _as_it_is),),
    ),
    Mechanism(
        "disagreeing windows",
        "a window counts for what its covariance claims, (6.13)",
        ((boresight.Alignment, "_agreed", _as_claimed),),
    ),
    Mechanism("sensor groups", "no sensor is found to fail", ((weighing, "failing_groups", _held),)),
    Mechanism(
        "wrong tracks", "of a track with many outliers the rest is kept", ((second_solve, "MIN_TRACK_INLIERS", 0.0),)
    ),
    Mechanism(
        "ground slope",
        "level ground of the configured sigma everywhere",
        ((ground_slope.GroundSlope, "prior_for", _level),),
    ),
    Mechanism(
        "slope variogram",
        "slopes vary as declared, whatever the heights along the track show, (14.3)",
        ((sliding_window, "slope_variance", gives(0.0)),),
    ),
    Mechanism(
        "ground roughness",
        "correlated over one camera height, always",
        ((ground_roughness, "_roughness", _one_range),),
    ),
    Mechanism(
        "ground weight", "points are held to the ground as configured", ((ground_roughness, "correlated", _declared),)
    ),
    Mechanism("second start", "every window is solved from one start", ((window_solver, "other_starts", gives(())),)),
    Mechanism(
        "headings all round",
        "a heading is as well known as its covariance claims, (16.10)",
        ((window_solver, "by_profile", _no_profile),),
    ),
    Mechanism(
        "reobservation",
        "windows are not compared by points seen again",
        ((window_acceptance.Memory, "compared", gives(None)),),
    ),
    Mechanism("ground motion", "the ground stands still", ((refined_window, "ground_sigma_m_s", gives(0.0)),)),
    Mechanism(
        "zoom",
        "no zoom is looked for",
        ((moved_optics, "signs_of", _no_zoom),),
    ),
    Mechanism(
        "moved optics",
        "neither stabilisation nor zoom is looked for",
        ((moved_optics, "found", gives(None)),),
    ),
    Mechanism(
        "mount trial",
        "pictures alone tell gimbal and mount",
        ((mount_selection.MountSelection, "begin_trials", gives(None)),),
    ),
    Mechanism("position doubt", "a jump leaves no doubt", ((position_jumps.PositionJumps, "at", gives(np.zeros(2))),)),
    Mechanism(
        "slip test",
        "position is not held against velocity",
        tuple((module, "slip_at", gives(position_slip.Slip())) for module in (gps_integrity, position_jumps)),
    ),
)
