"""A window's adjustment as the solver needs it: everything that does not change while its weights are found."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from onboard.estimation import ground_weight, window_start
from onboard.estimation.bundle_adjustment import Problem, Solution, parallax_of, solve
from onboard.estimation.factors import RATES, WAVES, Layout, Prior, RangePrior, State
from onboard.estimation.image_blocks import OPEN
from onboard.estimation.keyframe import Ids, Keyframe
from onboard.estimation.rolling_shutter import Sweep
from onboard.estimation.row_waves import Waves
from onboard.estimation.sensor_factors import Sensors, range_prior
from onboard.estimation.window_acceptance import MIN_POINTS
from onboard.estimation.window_request import Noise, Outcome, Request, Weighed
from onboard.geometry.plane_fit import fit_plane
from onboard.geometry.terrain_grid import Terrain

Array = NDArray[np.float64]

MIN_KEYFRAMES = 3
FIRST_SCALE = 3.0  # of the loss (6.5) in sigmas, in the first of the two solves


def approximate(problem: Problem, state: State) -> Solution:
    """The first of the two solves: robust, only as exact as finding outliers needs."""
    return solve(problem, state, scale=FIRST_SCALE, tolerance=3e-4)


@dataclass(frozen=True, eq=False)
class WindowProblem:
    """A window of K keyframes and P points: measurements, the ground, and where the adjustment starts."""

    request: Request
    keyframes: tuple[Keyframe, ...]
    ids: Ids
    layout: Layout
    rows: Sweep | None
    raw: Array  # (K, P, 2) as the rows saw them
    weight: Array  # (K, P) by the flight's pixel sigma
    state: State
    reference_enu_m: Array  # (3,) of the ground plane
    hold: Array  # (P,) 1 / sigma of the ground under each point, 1/m
    terrain: Terrain | None
    parallax: float | None  # of a metre of height where the adjustment starts, 1/m; None over a terrain model
    ranged: RangePrior | None

    @property
    def start_ns(self) -> int:
        """Stamp of the first keyframe."""
        return self.keyframes[0].nav.stamp_ns

    def sensors(self, noise: Noise) -> list[Prior]:
        """The sensors' residuals, weighted by this noise."""
        request = self.request
        sensors = Sensors(
            request.config, request.R_body_cam, self.keyframes, self.layout, noise.factors, noise.jitter_s
        )
        found = sensors.priors(request.platform, self.terrain is not None, request.slope)
        return found if self.ranged is None else [*found, self.ranged]

    def problem(self, noise: Noise) -> Problem:
        """What is minimised, weighted by this noise."""
        request = self.request
        return Problem(
            self.layout,
            self.raw,
            self.weight / noise.noise_inflation,
            self.sensors(noise),
            self.reference_enu_m,
            self.hold,
            self.terrain,
            self.parallax,
            request.camera if self.layout.camera_states else None,
            request.camera_taken,
            self.rows,
        )

    def weighed(self, noise: Noise, state: State) -> Weighed:
        """The first solve, weighted by this noise, from a state."""
        problem = self.problem(noise)
        return Weighed(noise, problem, problem.priors, approximate(problem, state))

    def with_block(self, block: str) -> WindowProblem:
        """The same with a block of image states that start at zero."""
        layout = self.layout.with_block(block)
        ranged = None if self.ranged is None else replace(self.ranged, layout=layout)
        return replace(self, layout=layout, ranged=ranged, state=self.state.with_block(layout, block))

    def with_rows_in_turn(self) -> WindowProblem:
        """The same with rows read one after the other in pictures that turn as nothing measures. (18.4)"""
        window = self if RATES in self.layout.blocks else self.with_block(RATES)
        rows = self.rows
        if rows is None:
            still = np.zeros((len(self.keyframes), 3))
            rows = Sweep(0.0, window_start.grid(self.request, self.ids)[3], still, still, scale_s=1.0)
        return replace(window, rows=replace(rows, sigma_rate_rad_s=OPEN / rows.scale_s))

    def without_known_ground(self, weighed: Weighed) -> Solution:
        """The weighed solution with the covariance that it had over ground of which nothing were known. (6.14)"""
        state, request = weighed.solution.state, self.request
        plane, _ = fit_plane(state.points_enu_m)
        reference = self.reference_enu_m.copy()
        reference[2] = plane[0] + plane[1:] @ reference[:2]
        tilted = np.array([0.0, plane[1], plane[2]])
        hold = np.full(len(state.points_enu_m), ground_weight.as_declared(request.config))
        free = replace(self, terrain=None, ranged=None)
        problem = replace(
            weighed.problem,
            priors=free.sensors(weighed.noise),
            reference_enu_m=reference,
            ground_weight=hold,
            terrain=None,
            parallax=parallax_of(state.centres_enu_m, reference, tilted),
        )
        return solve(problem, replace(state, plane=tilted), max_iterations=1)

    def vibrating(self, waves: Waves) -> WindowProblem:
        """The same with so much vibration in the pictures' rows, which must be read one after the other."""
        assert self.rows is not None
        window = self if WAVES in self.layout.blocks else self.with_block(WAVES)
        return replace(window, rows=replace(self.rows, cycles=waves.cycles, sigma_wave_rad=waves.sigma_rad))


def from_request(request: Request) -> WindowProblem | Outcome:
    """The window as requested; an outcome that says why there is none."""
    keyframes, noise = request.keyframes, request.noise
    if len(keyframes) < MIN_KEYFRAMES:
        return Outcome(Status.STARTING, keyframes, noise)
    ids, counts = np.unique(np.concatenate([k.observation.ids for k in keyframes]), return_counts=True)
    ids = ids[counts >= 2]
    if len(ids) < MIN_POINTS:
        return Outcome(Status.FEATURELESS, keyframes, noise)
    xy, raw, weight, share = window_start.grid(request, ids)
    start = window_start.oriented(request, xy, weight > 0)
    if start is None:
        status = Status.POOR_FIT if window_start.has_baseline(keyframes) else Status.LOW_PARALLAX
        return Outcome(status, keyframes, noise, reason="no camera orientation fits the pictures")
    keyframes = start
    rows = window_start.sweep(request, keyframes, share)
    layout = window_start.layout_of(request, keyframes, rows)
    R = np.stack([k.R_cam_enu for k in keyframes])
    C = np.stack([k.centre_enu_m for k in keyframes])
    points, reference, plane = window_start.starting_points(request, ids, R, C, xy, weight > 0)
    off = np.zeros(layout.by_picture.shape)
    state = State(R, C, points, request.platform.mean, plane, off)
    hold, terrain = ground_weight.weight_and_terrain(request, points)
    if terrain is not None:
        reference[2] = 0.0
        state = replace(state, plane=np.zeros(3))
    parallax = None if terrain is not None else parallax_of(C, reference, plane)
    strays_m = ground_weight.strays_m(request, points - reference, state.plane, terrain)
    ranged = range_prior(list(keyframes), layout, reference, state.plane, strays_m, terrain)
    if ranged is not None:  # what it measures is the plane: the points must be held to that as closely as they lie
        hold = np.full(len(points), 1.0 / strays_m)
    return WindowProblem(
        request, keyframes, ids, layout, rows, raw, weight, state, reference, hold, terrain, parallax, ranged
    )
