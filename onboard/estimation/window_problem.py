"""A window as the solver needs it: the problem, which stays while weights are found, a first solve, the outcome."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from onboard.config.schema import Config
from onboard.estimation import window_start
from onboard.estimation.bundle_adjustment import Problem, Solution, parallax_of, solve
from onboard.estimation.factors import RATES, READ, WAVES, Layout, Prior, State, ground_plane
from onboard.estimation.image_blocks import OPEN
from onboard.estimation.keyframe import Ids, Keyframe
from onboard.estimation.reobservation import Agreement
from onboard.estimation.rolling_shutter import Sweep
from onboard.estimation.row_waves import Waves
from onboard.estimation.sensor_factors import Sensors, range_prior
from onboard.estimation.solved_window import Solved
from onboard.estimation.window_acceptance import MIN_POINTS
from onboard.estimation.window_request import Noise, Request
from onboard.geometry.plane_fit import fit_plane

Array = NDArray[np.float64]

MIN_KEYFRAMES = 3
FIRST_SCALE = 3.0  # of the loss (6.5) in sigmas, in the first of the two solves
MIN_DEVIATION_M = 0.3  # least sigma of the ground about its plane, by the points themselves


def approximate(problem: Problem, state: State, tolerance: float = 3e-4) -> Solution:
    """The first of the two solves: robust, by default only as exact as finding outliers needs."""
    return solve(problem, state, scale=FIRST_SCALE, tolerance=tolerance)


@dataclass(frozen=True, eq=False)
class WindowProblem:
    """A window of K keyframes and P points: measurements, the ground, and where the adjustment starts."""

    request: Request
    keyframes: tuple[Keyframe, ...]
    ids: Ids  # (P,)
    unweighed: Problem  # by the flight's pixel sigma; of the priors only the range finder's, where there is one
    state: State

    @property
    def layout(self) -> Layout:
        return self.unweighed.layout

    def problem(self, noise: Noise) -> Problem:
        """The problem to minimise, weighted by this noise."""
        request, unweighed = self.request, self.unweighed
        sensors = Sensors(
            request.config, request.R_body_cam, self.keyframes, self.layout, noise.factors, noise.jitter_s
        )
        platform = request.platform.with_mount_sigmas(noise.mount_sigmas)
        priors = sensors.priors(platform, unweighed.terrain is not None, request.slope)
        return replace(unweighed, weight=unweighed.weight / noise.noise_inflation, priors=[*priors, *unweighed.priors])

    def weighed(self, noise: Noise, state: State) -> Weighed:
        """The first solve, weighted by this noise, from a state."""
        problem = self.problem(noise)
        return Weighed(self, noise, problem, approximate(problem, state))

    def with_block(self, block: str) -> WindowProblem:
        """The same with a block of image states that start at zero; as it is where it has the block."""
        if block in self.layout.blocks:
            return self
        layout = self.layout.with_block(block)
        priors = [replace(prior, layout=layout) for prior in self.unweighed.priors]
        unweighed = replace(self.unweighed, layout=layout, priors=priors)
        return replace(self, unweighed=unweighed, state=self.state.with_block(layout, block))

    def with_problem(self, **changes: Any) -> WindowProblem:
        """The same with other fields of `unweighed`."""
        return replace(self, unweighed=replace(self.unweighed, **changes))

    def with_rows_in_turn(self) -> WindowProblem:
        """The same with rows read one after the other in pictures that turn as nothing measures. (18.4)"""
        rows = self.unweighed.sweep
        if rows is None:
            still = np.zeros((len(self.keyframes), 3))
            rows = Sweep(0.0, window_start.grid(self.request, self.ids)[3], still, still, scale_s=1.0)
        return self.with_block(RATES).with_problem(sweep=replace(rows, sigma_rate_rad_s=OPEN / rows.scale_s))

    def with_readout(self) -> WindowProblem:
        """The same with rows read one after the other, in a time of each picture's own."""
        request, rows = self.request, self.unweighed.sweep
        if rows is None:
            share = window_start.grid(request, self.ids)[3]
            velocity = np.stack([k.nav.motion_enu_m_s for k in self.keyframes])
            rows = Sweep(0.0, share, window_start.turning(request, self.keyframes), velocity)
        return self.with_problem(sweep=rows).with_block(READ)

    def vibrating(self, waves: Waves) -> WindowProblem:
        """The same with so much vibration in the pictures' rows, which must be read one after the other."""
        rows = self.unweighed.sweep
        assert rows is not None
        rows = replace(rows, cycles=waves.cycles, sigma_wave_rad=waves.sigma_rad)
        return self.with_block(WAVES).with_problem(sweep=rows)


@dataclass(frozen=True, eq=False)
class Weighed:
    """The first solve of a window: the window, the noise that weighted it, its problem, and its solution."""

    window: WindowProblem
    noise: Noise
    problem: Problem
    solution: Solution

    def again(self, noise: Noise) -> Weighed:
        """Solve the window weighted by another noise, from where this solve ended."""
        return self.window.weighed(noise, self.solution.state)

    def without_known_ground(self, steps: int = 1) -> Solution:
        """The solution over ground of which nothing were known: its covariance, and after so many steps. (6.14)"""
        window, state = self.window, self.solution.state
        plane, _ = fit_plane(state.points_enu_m)
        reference = window.unweighed.reference_enu_m.copy()
        reference[2] = plane[0] + plane[1:] @ reference[:2]
        tilted = np.array([0.0, plane[1], plane[2]])
        free = window.with_problem(
            priors=[],
            reference_enu_m=reference,
            ground_weight=_as_declared(window.request.config),
            terrain=None,
            parallax=parallax_of(state.centres_enu_m, reference, tilted),
        )
        return solve(free.problem(self.noise), replace(state, plane=tilted), max_iterations=steps)


@dataclass(frozen=True, eq=False)
class Outcome:
    """The result of a request: OK and `solved`, or the reason why there is none; and the noise as estimated again."""

    status: Status
    keyframes: tuple[Keyframe, ...]
    noise: Noise
    solved: Solved | None = None
    reason: str = ""  # why not, in words
    weighed: Weighed | None = None  # its first solve, which others are compared with
    rejected: Solved | None = None  # a solution that only earlier windows speak against
    agreed: Agreement | None = None  # with an earlier window that shares points and no picture
    terrain_doubt: str = ""  # how far the terrain model is off the ground that the window shows without it
    is_minimum: bool = True  # the adjustment reached one
    lens_moved: float = 0.0  # by about so much of the focal length's logarithm within the window
    is_mirrored: bool | None = None  # it shows its pictures to be mirror images, or not to be; None: neither
    is_stretched: bool | None = None  # and to be stretched along one side against the camera file


def _as_declared(config: Config) -> float:
    """1 / sigma (1/m) of ground of which nothing is known but its roughness."""
    return 1.0 / max(config.solve.ground_roughness_sigma_m, 1e-3)


def from_request(request: Request) -> WindowProblem | Outcome:
    """The window as requested; an outcome that states why there is none."""
    keyframes, noise, config = request.keyframes, request.noise, request.config
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
    terrain = request.terrain
    if terrain is not None and np.all(np.isfinite(terrain.height_and_slope(points[:, :2])[0])):
        reference[2], plane, parallax = 0.0, np.zeros(3), None
        hold, deviates_m = 1.0 / config.terrain.sigma_m, config.terrain.sigma_m
    else:
        above, _, _ = ground_plane(points, reference, plane)
        measured_m = 1.4826 * float(np.median(np.abs(above - np.median(above))))
        terrain, parallax, hold = None, parallax_of(C, reference, plane), _as_declared(config)
        deviates_m = max(min(measured_m, config.solve.ground_roughness_sigma_m), MIN_DEVIATION_M)
    ranged = range_prior(list(keyframes), layout, reference, plane, deviates_m, terrain)
    if ranged is not None:  # what it measures is the plane: the points must be held to that as closely as they lie
        hold = 1.0 / deviates_m
    priors: list[Prior] = [] if ranged is None else [ranged]
    camera = request.camera if layout.camera_states else None
    ground = reference, hold, terrain, parallax
    unweighed = Problem(layout, raw, weight, priors, *ground, camera, request.camera_taken, rows, request.camera)
    state = State(R, C, points, request.platform.mean, plane, np.zeros(layout.by_picture.shape))
    return WindowProblem(request, keyframes, ids, unweighed, state)
