"""Windows of many views with truth: every error is sampled from exactly the model that the solver's priors state.

The scene is the seed's flight made longer: 250 m over ground that is a plane with roughness, 640x480 over 40 degrees, a
view every 20 m, features that enter and leave the picture. Serves the study's own figures and
`benchmarks/accuracy.py`. Uses onboard's packages: they are what is being measured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.camera import Sigma
from contract.rotations import exp_so3
from onboard.estimation import camera_states
from onboard.estimation.bundle_adjustment import Problem, Solution, parallax_of, solve
from onboard.estimation.factors import (
    AttitudePrior,
    Layout,
    PositionPrior,
    Prior,
    SharedPrior,
    State,
    VelocityPrior,
    gauss_markov_sqrt_information,
)
from onboard.estimation.platform_states import BORESIGHT, DELAY, HEADING, OFFSET, STATES
from onboard.estimation.refined_window import MIN_PIXEL_SIGMA_PX
from onboard.estimation.second_solve import solve_again
from onboard.estimation.sensor_factors import cosine_sine_of_heading
from onboard.estimation.window_problem import approximate
from onboard.estimation.window_start import MIN_PARALLAX_RAD, START_SIGMAS, orient
from onboard.geometry.plane_fit import fit_plane
from onboard.geometry.terrain_grid import Terrain
from onboard.geometry.triangulation import triangulate
from simulation.study_world import CAMERA, HEIGHT_M, R_BODY_CAM, TRAVEL_ENU, nominal, project, turned, unit_depth

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

UNDRAWN_SIGMA = 1e-6  # of delays (s) and of the heading's error by heading (rad) where a setting has none
OUTLIER_KINDS = ("jump", "drift", "moving")


@dataclass(frozen=True)
class Setting:
    """One kind of flight and what its sensors are worth. Sigmas are one sigma; None leaves the sensor out."""

    views: int = 10
    spacing_m: float = 20.0
    speed_m_s: float = 20.0
    features_per_view: int = 95
    pixel_sigma_px: float = 0.3
    gps_white_m: tuple[float, float] = (0.3, 0.45)  # horizontal, vertical
    gps_correlated_m: tuple[float, float] = (1.5, 2.5)
    gps_correlation_time_s: float = 60.0
    attitude_correlated_deg: tuple[float, float] | None = None  # roll and pitch, heading
    attitude_white_deg: float = 0.1
    attitude_correlation_time_s: float = 20.0
    boresight_sigma_deg: float = 1.0
    velocity_sigma_m_s: float | None = None
    slope_sigma_deg: float = 2.0
    relief_sigma_m: float = 10.0
    terrain_sigma_m: tuple[float, float] | None = None  # of a known ground: from place to place, and as a whole
    offset_sigma_s: float = 0.01
    delay_sigma_s: float = 0.0  # of the position
    velocity_delay_sigma_s: float = 0.0
    heading_sigma_deg: float = 0.0  # of an error that depends on the heading, each of its two parts
    lens_sigma: Sigma | None = None  # of what the camera file may be wrong by, as `Camera.sigma`
    outlier_share: float = 0.0
    misaligned: tuple[str, float] | None = None  # axis, rad: the camera turned from the configured mount
    alternating: tuple[str, float] | None = None  # axis, rad: every second view turned


@dataclass(frozen=True, eq=False)
class Flight:
    """A sampled flight: the problem as the solver gets it, the truth, and which tracks (P,) are wrong."""

    setting: Setting
    problem: Problem
    truth: State
    gps_enu_m: Array
    R_enu_cam_measured: Array | None
    is_outlier: Mask

    @property
    def seen(self) -> Mask:
        """(K, P)."""
        return self.problem.weight > 0


def draw(setting: Setting, rng: np.random.Generator) -> Flight:
    """Sample truth and measurements."""
    K = setting.views
    stamps = np.arange(K, dtype=np.float64) * float(setting.spacing_m / setting.speed_m_s)
    (also,) = rng.spawn(1)  # so that what was sampled before these states existed is still the same
    truth, seen, xy = _scene(setting, stamps, rng)
    truth, xy = _with_platform(setting, truth, xy, also)
    P = len(truth.points_enu_m)
    sigma = setting.pixel_sigma_px / CAMERA.focal_px
    is_outlier = rng.random(P) < setting.outlier_share
    xy = xy + sigma * rng.standard_normal(xy.shape)
    xy[:, is_outlier] += _slips(setting, truth, stamps, int(is_outlier.sum()), rng)
    layout = Layout(K, len(truth.camera))
    lens: dict[str, Any] = {}
    if setting.lens_sigma is not None:
        lens = {"camera": CAMERA, "camera_taken": np.zeros(camera_states.COUNT)}
    priors, gps, measured = _sensors(setting, layout, truth, stamps, rng)
    reference = np.array([*(TRAVEL_ENU[:2] * setting.spacing_m * (K - 1) / 2.0), 0.0])
    weight = np.where(seen, 1.0 / sigma, 0.0)
    if setting.terrain_sigma_m is None:
        ground_weight = 1.0 / setting.relief_sigma_m
        parallax = parallax_of(gps, reference, np.zeros(3))
        problem = Problem(layout, xy, weight, priors, reference, ground_weight, parallax=parallax, **lens)
    else:
        ground_weight = 1.0 / setting.terrain_sigma_m[0]
        problem = Problem(layout, xy, weight, priors, reference, ground_weight, terrain=hills(), **lens)
    return Flight(setting, problem, truth, gps, measured, is_outlier)


def _with_platform(setting: Setting, truth: State, xy: Array, rng: np.random.Generator) -> tuple[State, Array]:
    """The truth with what its platform is wrong by, and the coordinates (K, P, 2) that the camera file then gives."""
    lens = np.zeros(0)
    delay_s, velocity_delay_s = setting.delay_sigma_s, setting.velocity_delay_sigma_s
    delay_s, velocity_delay_s = (rng.standard_normal(2) * [delay_s, velocity_delay_s]).tolist()
    heading = np.radians(setting.heading_sigma_deg) * rng.standard_normal(2)
    if setting.lens_sigma is not None:
        lens = np.array(setting.lens_sigma) * rng.standard_normal(camera_states.COUNT)
        true = camera_states.corrected(CAMERA, lens)
        uv = true.distort(xy) * (true.fx_px, true.fy_px) + (true.cx_px, true.cy_px)
        xy = CAMERA.unproject(uv)[0][..., :2]
    platform = [*truth.platform[: OFFSET + 1], delay_s, velocity_delay_s, *heading, *lens]
    made = replace(truth, platform=np.array(platform))
    return made, xy


@cache
def hills() -> Terrain:
    """The known ground of the terrain rows: hills of +-15 m, 300 to 500 m long, on a grid of 5 m."""
    spacing_m, reach_m = 5.0, 800.0
    axis = np.arange(-reach_m, reach_m + spacing_m, spacing_m)
    east, north = np.meshgrid(axis, axis)
    heights = 10.0 * np.sin(east / 60.0 + 0.4) * np.cos(north / 80.0) + 5.0 * np.sin((east + north) / 50.0)
    return Terrain(-reach_m, -reach_m, spacing_m, heights)


def _gauss_markov(
    stamps: Array, white: float, gauss_markov: float, time_constant_s: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """One axis of an error (K,) with an Ornstein-Uhlenbeck and a white part, and the whitener that states it."""
    lag = np.abs(stamps[:, None] - stamps[None, :])
    root = np.linalg.cholesky(gauss_markov**2 * np.exp(-lag / time_constant_s) + 1e-12 * np.eye(len(stamps)))
    error = root @ rng.standard_normal(len(stamps)) + white * rng.standard_normal(len(stamps))
    return error, gauss_markov_sqrt_information(stamps, white, gauss_markov, time_constant_s)


def _scene(setting: Setting, stamps: Array, rng: np.random.Generator) -> tuple[State, Mask, Array]:
    """True state, what is seen (K, P), and noise-free normalised image coordinates (K, P, 2)."""
    K = setting.views
    along = np.arange(K) * setting.spacing_m
    centres = np.array([0.0, 0.0, HEIGHT_M]) + along[:, None] * TRAVEL_ENU
    centres = centres + np.stack([_gauss_markov(stamps, 0.0, 1.0, 5.0, rng)[0] for _ in range(3)], axis=1)
    sway = np.stack([_gauss_markov(stamps, np.radians(0.3), np.radians(2.0), 5.0, rng)[0] for _ in range(3)], axis=1)
    camera = nominal() if setting.misaligned is None else turned(nominal(), *setting.misaligned)
    R = exp_so3(sway) @ camera
    if setting.alternating is not None:
        R[1::2] = turned(R[1::2], *setting.alternating)
    slopes = np.tan(np.radians(setting.slope_sigma_deg)) * rng.standard_normal(2)
    boresight = np.radians(setting.boresight_sigma_deg) * rng.standard_normal(3)
    offset = setting.offset_sigma_s * rng.standard_normal()
    across = np.array([-TRAVEL_ENU[1], TRAVEL_ENU[0], 0.0])
    reach = HEIGHT_M * 0.6  # half a picture and some sway
    footprint = (CAMERA.width_px / CAMERA.fx_px) * (CAMERA.height_px / CAMERA.fy_px) * HEIGHT_M**2
    span = along[-1] + 2 * reach
    count = rng.poisson(setting.features_per_view * span * 2 * reach / footprint)
    s = rng.uniform(-reach, along[-1] + reach, count)
    q = rng.uniform(-reach, reach, count)
    points = s[:, None] * TRAVEL_ENU + q[:, None] * across
    middle = TRAVEL_ENU * along[-1] / 2.0
    level_m = 0.0
    if setting.terrain_sigma_m is None:
        points[:, 2] = (points[:, :2] - middle[:2]) @ slopes + setting.relief_sigma_m * rng.standard_normal(count)
    else:
        place_m, whole_m = setting.terrain_sigma_m
        level_m, slopes = whole_m * rng.standard_normal(), np.zeros(2)
        height, _ = hills().height_and_slope(points[:, :2])
        points[:, 2] = height + level_m + place_m * rng.standard_normal(count)
    uv, inside = project(R, centres, points)
    keep = np.count_nonzero(inside, axis=0) >= 2
    plane = np.array([level_m, *slopes])
    platform = np.array([*boresight, offset, 0.0, 0.0, 0.0, 0.0])
    return State(R, centres, points[keep], platform, plane), inside[:, keep], unit_depth(uv[:, keep])


def _slips(setting: Setting, truth: State, stamps: Array, count: int, rng: np.random.Generator) -> Array:
    """Errors of wrong tracks (K, count, 2): jump to a neighbour, steady drift, a vehicle's motion; a third each."""
    K = len(stamps)
    out = np.zeros((K, count, 2))
    heading = rng.uniform(0.0, 2.0 * np.pi, count)
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    since = rng.uniform(0.0, stamps[-1] * 0.8, count)
    elapsed = np.maximum(stamps[:, None] - since, 0.0)
    for n, kind in enumerate(rng.choice(OUTLIER_KINDS, count)):
        if kind == "jump":
            size = (elapsed[:, n] > 0.0) * rng.uniform(5.0, 40.0) / CAMERA.focal_px
        elif kind == "drift":
            size = elapsed[:, n] * rng.uniform(1.0, 6.0) / CAMERA.focal_px
        else:
            size = (stamps - stamps.mean()) * rng.uniform(1.0, 15.0) / HEIGHT_M
        out[:, n] = size[:, None] * direction[n]
    return out


def _sensors(
    setting: Setting, layout: Layout, truth: State, stamps: Array, rng: np.random.Generator
) -> tuple[list[Prior], Array, Array | None]:
    """Priors with sampled measurements; the GPS positions (K, 3); the measured R_enu_cam (K, 3, 3) or None."""
    K = layout.keyframes
    velocity = np.tile(TRAVEL_ENU * setting.speed_m_s, (K, 1))
    sampled = [
        _gauss_markov(stamps, setting.gps_white_m[v], setting.gps_correlated_m[v], setting.gps_correlation_time_s, rng)
        for v in (0, 0, 1)
    ]
    late_s = truth.platform[OFFSET] + truth.platform[DELAY]
    gps = truth.centres_enu_m - velocity * late_s + np.stack([e for e, _ in sampled], axis=1)
    priors: list[Prior] = [PositionPrior(layout, gps, velocity, np.stack([w for _, w in sampled]), np.zeros(K))]
    if setting.velocity_sigma_m_s is not None:
        sigma = setting.velocity_sigma_m_s * np.diff(stamps)
        displacement = np.diff(truth.centres_enu_m, axis=0) + sigma[:, None] * rng.standard_normal((K - 1, 3))
        whitener = np.stack([np.diag(1.0 / sigma)] * 3)
        priors.append(VelocityPrior(layout, displacement, np.diff(velocity, axis=0), whitener, np.zeros(K - 1)))
    measured = None
    if setting.attitude_correlated_deg is not None:
        tilt, heading = np.radians(setting.attitude_correlated_deg)
        white = np.radians(setting.attitude_white_deg)
        turn = [
            _gauss_markov(stamps, white, w, setting.attitude_correlation_time_s, rng) for w in (tilt, tilt, heading)
        ]
        error_cam = np.einsum("kij,kj->ki", truth.R_cam_enu, np.stack([e for e, _ in turn], axis=1))
        measured = truth.R_cam_enu.transpose(0, 2, 1) @ exp_so3(error_cam) @ exp_so3(-truth.platform[BORESIGHT])
        by_heading = np.zeros((1, 2))
        if setting.heading_sigma_deg:
            by_heading = np.stack([cosine_sine_of_heading(R @ R_BODY_CAM.T) for R in measured])
            yaw = (by_heading @ truth.platform[HEADING])[:, None] * [0.0, 0.0, 1.0]
            measured = exp_so3(yaw) @ measured
        whitener = np.stack([w for _, w in turn])
        priors.append(AttitudePrior(layout, measured, np.zeros((K, 3)), whitener, np.zeros(K), by_heading=by_heading))
    slope = np.tan(np.radians(setting.slope_sigma_deg))
    boresight = max(np.radians(setting.boresight_sigma_deg), 1e-6)
    level = 1e4
    if (
        setting.terrain_sigma_m is not None
    ):  # the plane is then what the known ground is off by, as onboard.estimation.sensor_factors
        slope, level = 1e-4, setting.terrain_sigma_m[1]
    heading = np.radians(setting.heading_sigma_deg)
    platform = [setting.offset_sigma_s, setting.delay_sigma_s, setting.velocity_delay_sigma_s, heading, heading]
    platform = [*(max(float(sigma), UNDRAWN_SIGMA) for sigma in platform), *(setting.lens_sigma or ())]
    sigmas = [boresight] * 3 + [*platform, level, slope, slope]
    priors.append(SharedPrior(layout, np.zeros(len(sigmas)), np.diag(1.0 / np.array(sigmas))))
    return priors, gps, measured


def begin(flight: Flight) -> State | None:
    """The solver's first state, from measurements alone, as in `window_problem`; None if no orientation is found."""
    xy, seen = flight.problem.xy, flight.seen
    if flight.R_enu_cam_measured is not None:
        R = flight.R_enu_cam_measured.transpose(0, 2, 1)
    else:
        tolerance = START_SIGMAS * flight.setting.pixel_sigma_px / CAMERA.focal_px
        found = orient(xy, seen, flight.gps_enu_m, R_BODY_CAM, tolerance)
        if found is None:
            return None
        R = found
    rays = triangulate(R, flight.gps_enu_m, xy, seen)
    sound = rays.is_ahead & (rays.parallax_rad > MIN_PARALLAX_RAD)
    points = rays.points_enu_m.copy()
    plane, _ = fit_plane(points[sound])
    reference = flight.problem.reference_enu_m
    height = float(plane[0] + plane[1:] @ reference[:2])
    loose = np.flatnonzero(~sound)
    view = np.argmax(seen[:, loose], axis=0)
    direction = np.einsum("pi,pij->pj", np.concatenate([xy[view, loose], np.ones((len(loose), 1))], axis=1), R[view])
    centre = flight.gps_enu_m[view]
    points[loose] = centre + direction * ((height - centre[:, 2]) / np.minimum(direction[:, 2], -0.1))[:, None]
    start = np.array([height - reference[2], *plane[1:]])
    if flight.problem.terrain is not None:
        start = np.zeros(3)
    lens = np.zeros(len(flight.truth.camera))
    return State(R, flight.gps_enu_m, points, np.append(np.zeros(STATES), lens), start)


def estimate(flight: Flight, state: State) -> tuple[Solution, Array]:
    """The two solves of `stages`, and the weights (K, P) kept; ValueError if all was cut as outliers."""
    problem = flight.problem
    least = MIN_PIXEL_SIGMA_PX / max(flight.setting.pixel_sigma_px, MIN_PIXEL_SIGMA_PX)
    adjusted = solve_again(problem, approximate(problem, state), least, CAMERA)
    if adjusted is None:
        raise ValueError("nothing of the flight is left to solve")
    return adjusted.solution, adjusted.kept


def bound(flight: Flight) -> Solution:
    """Covariances (the Cramer-Rao bound) at the truth, by one who knows which tracks are wrong."""
    weight = np.where(flight.is_outlier, 0.0, flight.problem.weight)
    return solve(replace(flight.problem, weight=weight), flight.truth, scale=None, max_iterations=0)


def point_covariance(solution: Solution) -> Array:
    """Marginal covariances (P, 3, 3) of the points, m^2."""
    Y = solution.point_gain
    return solution.point_covariance + Y @ solution.covariance @ Y.transpose(0, 2, 1)
