"""Tests of an adjusted window's acceptance: each by itself, in sigmas, with its reason in words.

`by_itself` looks at one window: its depths, sensors, the known ground. `by_memory` compares it with what earlier
windows of the flight found of the same points, (16.3). A window that fails is refused as a poor fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from onboard.config.schema import Config
from onboard.estimation.bundle_adjustment import Solution
from onboard.estimation.factors import AttitudePrior, Layout, Prior, SharedPrior, State
from onboard.estimation.keyframe import Keyframe, with_attitude
from onboard.estimation.platform_states import BORESIGHT, PLANE, STATES
from onboard.estimation.reobservation import Agreement, RelativeVariance, agreement
from onboard.estimation.sensor_factors import between_covariance, velocity_sigma_m_s
from onboard.estimation.solved_window import Solved
from onboard.geometry.robust import IMPOSSIBLE_SIGMAS
from onboard.geometry.terrain_grid import Terrain
from onboard.navigation.limits import SURE_SIGMAS
from onboard.navigation.navigator import NavState

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MIN_POINTS = 12
MAX_FIT_SIGMAS = 4.0  # median residual, in configured pixel sigmas, above which the fit is refused
MAX_DEPTH_SIGMA = 0.15  # relative; above it the scene has too little parallax
MAX_PRIOR_SIGMAS = 3.5  # root mean square of a sensor's whitened residuals that a true solution may show
MAX_GROUND_SLOPE = 1.0
MAX_ROTATION_SIGMA_DEG = 20.0  # above it a turn's second order, which no covariance has, is a fifth of its first
MIN_AHEAD = 0.9  # of the measurements: of points below the camera and in front of it
MIN_DEPTH_SHARE = 0.05  # of the median depth: a point nearer than this is as good as behind the camera
# Slow error of a velocity that no residual of the window uses: recorded autopilots in turns.
CORRELATED_VELOCITY_M_S = 1.5
# Chi-square with 7 degrees of freedom exceeds this once in 1e5 comparisons.
MAX_AGREEMENT = 35.0
REMEMBERED = 14  # windows: a few more than the keyframes of one, so that one without a common picture is among them


@dataclass(frozen=True, eq=False)
class Memory:
    """The newest published windows, which the next is judged by, and the factor on their relative variances."""

    windows: tuple[Solved, ...] = ()
    relative: RelativeVariance = field(default_factory=RelativeVariance)

    def without_windows(self) -> Memory:
        """The memory after a new start: no point of earlier windows is seen again."""
        return Memory((), self.relative)

    def compared(self, solved: Solved) -> Agreement | None:
        """The window against the newest that has no picture in common with it."""
        start_ns = solved.keyframes[0].nav.stamp_ns
        apart = (w for w in reversed(self.windows) if w.keyframes[-1].nav.stamp_ns < start_ns)
        earlier = next(apart, None)
        return None if earlier is None else agreement(earlier, solved)

    def after(self, solved: Solved, agreed: Agreement | None, is_accepted: bool) -> Memory:
        """The memory with one more window; of one that is not accepted only the disagreement is kept."""
        stamp_ns, share = solved.keyframes[-1].nav.stamp_ns, 1.0 / len(solved.keyframes)
        relative = self.relative if agreed is None else self.relative.with_agreement(agreed, stamp_ns, share)
        if not is_accepted:
            return Memory(self.windows, relative)
        solved = replace(solved, variance_factor=solved.variance_factor * relative.factor)
        return Memory((*self.windows, solved)[-REMEMBERED:], relative)


def share_below(state: State, seen: Mask) -> float:
    """The share of measurements, `seen` (K, P), whose point is below its view."""
    below = state.points_enu_m[:, 2] < state.centres_enu_m[:, None, 2]
    return float(np.count_nonzero(below & seen)) / max(float(np.count_nonzero(seen)), 1.0)


def heading_unknown(turn_deg: float) -> str:
    """The reason for refusing a window whose rotation has so large a sigma, and what to do."""
    known = f"to {min(turn_deg, 180.0):.0f} degrees only"
    return f"heading hardly known: {known}, fly a straight leg, or send the attitude"


def by_itself(
    config: Config,
    keyframes: Sequence[Keyframe],
    terrain: Terrain | None,
    s: Solution,
    layout: Layout,
    kept: Array,
    good: Mask,
    before: Sequence[Prior],
) -> str | None:
    """The reason for refusing a solution; None if there is none.

    `kept` (K, P): weights. `good` (P,): points. `before`: the sensors as weighted by earlier windows.
    """
    depth, used = s.state.depths_m, kept > 0
    least_m = MIN_DEPTH_SHARE * float(np.median(np.abs(depth[used])))
    if share_below(s.state, used) < MIN_AHEAD:
        return "the ground lies above the aircraft"
    if np.count_nonzero((depth > least_m) & used) < MIN_AHEAD * np.count_nonzero(used):
        return "points lie behind the camera or at it"
    if np.abs(s.state.plane[1:]).max() > MAX_GROUND_SLOPE:
        return "the ground is a wall"
    if np.linalg.eigvalsh(s.covariance)[0] <= 0.0:
        return "the solution has no covariance"
    for prior in before:
        r = prior.evaluate(s.state)[0]
        # No shared state (mount, delay) may be far from its prior: a moving scene is often explained that way.
        # A lens may: what a camera file without sigmas is off by is assumed of lenses, and hardly depends on the scene.
        # And the mount, which `attitude_misfit` judges, for a window may have widened what was known of it.
        if isinstance(prior, SharedPrior):
            r = np.delete(r, BORESIGHT)
            most = float(np.abs(np.delete(r, np.s_[STATES - BORESIGHT.stop : -PLANE])).max())
            if most > IMPOSSIBLE_SIGMAS:
                return f"clock, compass or ground far from what was known: {most:.1f} sigmas"
        rms = float(np.sqrt(np.mean(r * r)))
        if rms > MAX_PRIOR_SIGMAS:
            what = f"{type(prior).__name__.removesuffix('Prior').lower()} contradicts the pictures"
            if isinstance(prior, AttitudePrior) and not with_attitude(keyframes).any():
                what = "no aircraft flies this path so tilted"
            return f"{what}: {rms:.1f} sigmas rms"
    return off_terrain(config, terrain, s, good) or _by_distance(config, keyframes, s, layout)


def off_terrain(config: Config, terrain: Terrain | None, s: Solution, good: Mask) -> str | None:
    """Return by how much points lie off a terrain model, where it is known; None if they do not. (16.5), (16.6)"""
    if terrain is None:
        return None
    points = s.state.points_enu_m[good]
    known, _ = terrain.height_and_slope(points[:, :2])
    seen = np.isfinite(known)
    if np.count_nonzero(seen) < MIN_POINTS:
        return None
    above_m = float(np.median((points[:, 2] - known)[seen]))
    mean = -s.point_gain[good][seen][:, 2].mean(axis=0)
    sigma_m = float(np.sqrt(mean @ s.covariance @ mean + config.terrain.sigma_datum_m**2 + config.terrain.sigma_m**2))
    if abs(above_m) > IMPOSSIBLE_SIGMAS * sigma_m:
        return f"ground off the terrain model: {above_m:+.0f} m, sigma {sigma_m:.0f}"
    return None


def off_take_off(config: Config, terrain: Terrain, nav: NavState) -> str | None:
    """Return by how much the ground that an aircraft stands on, or stood on by what its autopilot states, is off a
    terrain model: empty if not; None where neither is known. (16.17)
    """
    stood = _stands_on(config, nav)
    stood = nav.home_enu_m if stood is None else stood
    known_m = float("nan") if stood is None else float(terrain.height_and_slope(stood[None, :2])[0][0])
    if stood is None or not np.isfinite(known_m):
        return None
    below_m = float(stood[2]) - known_m
    sigmas_m = (nav.sigma_vertical_m, nav.sigma_datum_m, config.terrain.sigma_datum_m, config.terrain.sigma_m)
    sigma_m = float(np.linalg.norm(sigmas_m))
    if abs(below_m) <= IMPOSSIBLE_SIGMAS * sigma_m:
        return ""
    return f"ground off the terrain model: {below_m:+.0f} m at the take-off, sigma {sigma_m:.0f}"


def _stands_on(config: Config, nav: NavState) -> Array | None:
    """The ground (3,) below an aircraft that stands at the height of home; None where it flies, or nothing is known."""
    gps, velocity, above_m = config.gps, nav.velocity_enu_m_s, nav.height_above_home_m
    if above_m is None or velocity is None:
        return None
    if np.linalg.norm(np.nan_to_num(velocity)) > SURE_SIGMAS * gps.sigma_velocity_m_s:
        return None
    if abs(above_m) > SURE_SIGMAS * gps.sigma_correlated_vertical_m:
        return None
    return np.asarray(nav.position_enu_m - np.array([0.0, 0.0, above_m]), float)


def _by_distance(config: Config, keyframes: Sequence[Keyframe], s: Solution, layout: Layout) -> str | None:
    """The distance between the window's ends against the velocity's integral: the scene's scale. Equation (16.7)."""
    displacement = [k.displacement for k in keyframes[1:] if k.displacement is not None]
    if len(displacement) < len(keyframes) - 1:
        return None
    by_velocity = np.sum([f.enu_m for f in displacement], axis=0)
    by_pictures = s.state.centres_enu_m[-1] - s.state.centres_enu_m[0]
    seconds = (keyframes[-1].nav.stamp_ns - keyframes[0].nav.stamp_ns) / 1e9
    first, *_, last = layout.centres()
    ends = np.eye(layout.size)[last] - np.eye(layout.size)[first]
    correlated_m = max(CORRELATED_VELOCITY_M_S, velocity_sigma_m_s(config, keyframes)) * seconds
    between_m2 = between_covariance(displacement).sum(axis=(1, 2))
    covariance = ends @ s.covariance @ ends.T + np.eye(3) * correlated_m**2 + np.diag(between_m2)
    miss = by_pictures - by_velocity
    chi2 = float(miss @ np.linalg.solve(covariance, miss))
    if chi2 > IMPOSSIBLE_SIGMAS**2:
        return (
            f"scale contradicts velocity: {np.linalg.norm(by_pictures):.0f} m from the first picture to the last, "
            f"{np.linalg.norm(by_velocity):.0f} by velocity"
        )
    return None


def by_memory(memory: Memory, agreed: Agreement | None) -> str | None:
    """The contradiction of this window with an earlier one, in words; None if there is none."""
    most = MAX_AGREEMENT * memory.relative.factor
    if agreed is not None and agreed.chi2 > most:
        return (
            f"points seen again are elsewhere: {agreed.points} of them by {agreed.shift_m:.1f} m, "
            f"chi-square {agreed.chi2:.0f}, at most {most:.0f}"
        )
    return None
