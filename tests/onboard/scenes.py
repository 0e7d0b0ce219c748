"""A synthetic flight with truth whose measurements carry exactly the errors that the configuration declares.

No picture is drawn: features are points of the ground, their pixels projected and given white noise. Everything random
comes from the generator that is handed in.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, exp_so3, log_so3, matrix_from_euler, mount_rotation
from onboard.config.schema import Config, parse_config
from onboard.estimation import camera_states
from onboard.estimation.bundle_adjustment import Problem
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
from onboard.estimation.keyframe import Observation, observation
from onboard.estimation.platform_states import BORESIGHT, DELAY, HEADING, OFFSET, STATES, VELOCITY_DELAY
from onboard.estimation.sensor_factors import cosine_sine_of_heading
from onboard.estimation.sliding_window import Window
from onboard.geometry.triangulation import triangulate
from onboard.navigation.navigator import NavState
from onboard.navigation.position_interpolation import Displacement

Array = NDArray[np.float64]

CAMERA = Camera.from_field_of_view(640, 480, 40.0)
FRAME = LocalFrame(-43.38, 172.40, 350.0)
T0_NS = 1_795_217_000_000_000_000
FULL = parse_config("")
SEED_SENSORS = parse_config('[solve]\nattitude = "none"\nvelocity = false')


@dataclass(frozen=True)
class SceneSpec:
    """A straight flight at a height above ground that has a slope and roughness."""

    keyframes: int = 10
    between: int = 1  # pictures between keyframes
    step_s: float = 1.0  # between keyframes
    speed_m_s: float = 20.0
    climb_m_s: float = 0.0
    height_m: float = 250.0
    heading_deg: float = 30.0
    crab_deg: float = 0.0
    wobble_deg: float = 1.0
    points: int = 160
    relief_sigma_m: float = 0.0
    relief_wavelength_m: float = 150.0
    pixel_sigma_px: float = 0.3
    error_scale: float = 1.0  # of every sensor but the picture


class Ground:
    """z = slope . (x, y) + a Gaussian-looking sum of waves."""

    def __init__(self, rng: np.random.Generator, slope: Array, sigma_m: float, wavelength_m: float) -> None:
        bearing = rng.uniform(0.0, 2.0 * np.pi, 12)
        length = wavelength_m * rng.uniform(0.6, 1.6, 12)
        self._wave = 2.0 * np.pi / length[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, 12)
        self._amplitude = sigma_m * np.sqrt(2.0 / 12)
        self.slope = slope

    def height_m(self, xy: Array) -> Array:
        return xy @ self.slope + self._amplitude * np.sin(xy @ self._wave.T + self._phase).sum(axis=-1)

    def meet(self, centre: Array, rays_enu: Array) -> Array:
        """Where rays (N, 3) from centres (3,) or (N, 3) meet the ground, (N, 3); for ground seen from well above."""
        depth = -centre[..., 2] / rays_enu[:, 2]
        for _ in range(25):
            points = centre + rays_enu * depth[:, None]
            depth -= 0.7 * (points[:, 2] - self.height_m(points[:, :2])) / rays_enu[:, 2]
        return centre + rays_enu * depth[:, None]


class Path:
    def __init__(self, rng: np.random.Generator, spec: SceneSpec, length_s: float) -> None:
        heading = np.radians(spec.heading_deg)
        self._course = np.array([np.sin(heading), np.cos(heading), 0.0])
        self._spec, self._length_s = spec, length_s
        self._rate = 2.0 * np.pi / rng.uniform(2.0, 9.0, (3, 3))
        self._phase = rng.uniform(0.0, 2.0 * np.pi, (3, 3))

    def position_enu_m(self, t: float) -> Array:
        out: Array = self._course * self._spec.speed_m_s * (t - 0.5 * self._length_s)
        climbed_m = self._spec.climb_m_s * (t - 0.5 * self._length_s)
        return out + [0.0, 0.0, self._spec.height_m + climbed_m + np.sin(0.3 * t)]

    def velocity_enu_m_s(self, t: float) -> Array:
        return self._course * self._spec.speed_m_s + [0.0, 0.0, self._spec.climb_m_s + 0.3 * np.cos(0.3 * t)]

    def R_enu_body(self, t: float) -> Array:
        shake = (
            np.radians(self._spec.wobble_deg) * np.sqrt(2.0 / 3.0) * np.sin(self._rate * t + self._phase).sum(axis=1)
        )
        yaw = np.radians(self._spec.heading_deg + self._spec.crab_deg) + shake[2]
        return R_ENU_NED @ matrix_from_euler(shake[0], shake[1], yaw)

    def body_rate_rad_s(self, t: float) -> Array:
        h = 0.005
        return log_so3(self.R_enu_body(t - h).T @ self.R_enu_body(t + h)) / (2.0 * h)


@dataclass(frozen=True, eq=False)
class Scene:
    """Truth and measurements of F pictures; `is_key` says which are the K keyframes. All in FRAME's ENU axes."""

    config: Config
    camera: Camera
    ground: Ground
    times_s: Array  # (F,) true exposures
    is_key: NDArray[np.bool_]
    R_cam_enu: Array  # (F, 3, 3)
    centres_enu_m: Array  # (F, 3)
    points_enu_m: Array  # (P, 3)
    boresight_rad: Array
    offset_s: float
    delay_s: float  # of the position, and of the velocity, beyond what is configured
    velocity_delay_s: float
    heading_rad: Array  # (2,) heading error by cosine and sine of the heading
    observations: list[Observation]
    navs: list[NavState]
    rates: list[Array]
    flown: list[Displacement | None]  # since the keyframe before, of keyframes

    @property
    def keys(self) -> NDArray[np.intp]:
        return np.flatnonzero(self.is_key)

    def window(self) -> Window:
        window = Window(self.config, self.camera)
        for k in self.keys:
            window.add(int(k), self.observations[k], self.navs[k], (0.0, 0.0), self.rates[k], self.flown[k])
        return window


def gauss_markov(
    rng: np.random.Generator, stamps_s: Array, white: float, sigma: float, time_constant_s: float
) -> NDArray[np.float64]:
    """A sample (N,) of white plus Gauss-Markov error: the model of residuals (5.5)."""
    lag = np.abs(stamps_s[:, None] - stamps_s[None, :])
    covariance = sigma**2 * np.exp(-lag / time_constant_s) + (white**2 + 1e-18) * np.eye(len(stamps_s))
    return np.linalg.cholesky(covariance) @ rng.standard_normal(len(stamps_s))


def draw(
    rng: np.random.Generator, config: Config = FULL, spec: SceneSpec | None = None, camera: Camera = CAMERA
) -> Scene:
    """One flight, its errors drawn from the priors that the window takes from `config`."""
    spec = spec or SceneSpec()
    gps, solve, mount = config.gps, config.solve, config.mount
    e = spec.error_scale
    F = (spec.keyframes - 1) * (spec.between + 1) + 1
    times = np.arange(F) * (spec.step_s / (spec.between + 1))
    is_key = np.arange(F) % (spec.between + 1) == 0
    path = Path(rng, spec, float(times[-1]))
    boresight = e * np.radians(mount.sigma_deg) * rng.standard_normal(3)
    offset = e * config.camera.sigma_latency_s * float(rng.standard_normal())
    (also,) = rng.spawn(1)  # so that what was drawn before these existed is still drawn
    delay, velocity_delay = (e * gps.sigma_latency_s * also.standard_normal(2)).tolist()
    heading = e * np.radians(solve.heading_sigma_deg) * also.standard_normal(2)
    R_body_cam = mount_rotation(mount.roll_deg, mount.pitch_deg, mount.yaw_deg)
    R_enu_cam = np.stack([path.R_enu_body(t) @ R_body_cam @ exp_so3(boresight) for t in times])
    R_cam_enu = R_enu_cam.transpose(0, 2, 1)
    centres = np.stack([path.position_enu_m(t) for t in times])
    slope = e * np.tan(np.radians(solve.level_ground_sigma_deg)) * rng.standard_normal(2)
    ground = Ground(rng, slope, spec.relief_sigma_m, spec.relief_wavelength_m)

    # A point is where a random pixel of a random picture looks: the ground that is seen, evenly.
    uv = rng.uniform([5.0, 5.0], [camera.width_px - 6.0, camera.height_px - 6.0], (spec.points, 2))
    which = rng.integers(0, F, spec.points)
    rays, _ = camera.unproject(uv)
    points = ground.meet(centres[which], np.einsum("nij,nj->ni", R_enu_cam[which], rays))
    observations = []
    for f in range(F):
        pixels, inside = camera.project((points - centres[f]) @ R_enu_cam[f])
        pixels = pixels + spec.pixel_sigma_px * rng.standard_normal(pixels.shape)
        inside &= camera.contains(pixels)
        observations.append(observation(camera, np.flatnonzero(inside).astype(np.int64), pixels[inside]))

    stamps = times - offset
    white = e * gps.sigma_white_m
    position_error = np.stack(
        [
            gauss_markov(rng, times, white * grow, e * sigma, gps.correlation_time_s)
            for sigma, grow in (
                (gps.sigma_correlated_horizontal_m, 1.0),
                (gps.sigma_correlated_horizontal_m, 1.0),
                (gps.sigma_correlated_vertical_m, 1.5),
            )
        ],
        axis=1,
    )
    tilt = np.stack(
        [
            gauss_markov(
                rng,
                times,
                e * np.radians(solve.attitude_white_sigma_deg),
                e * np.radians(sigma_deg),
                solve.attitude_correlation_time_s,
            )
            for sigma_deg in (solve.attitude_sigma_deg, solve.attitude_sigma_deg, solve.heading_sigma_deg)
        ],
        axis=1,
    )
    navs, rates, flown = [], [], []
    before: float | None = None
    for f, stamp in enumerate(stamps):
        has_attitude = solve.attitude == "autopilot"
        R_enu_body = path.R_enu_body(stamp)
        yaw = float(cosine_sine_of_heading(R_enu_body) @ heading)
        navs.append(
            NavState(
                T0_NS + round(times[f] * 1e9),
                path.position_enu_m(stamp - delay) - position_error[f],
                path.velocity_enu_m_s(stamp - velocity_delay),
                exp_so3(tilt[f] + [0.0, 0.0, yaw]) @ R_enu_body if has_attitude else None,
                gps.sigma_correlated_horizontal_m,
                gps.sigma_correlated_vertical_m,
                gps.sigma_white_m,
                11.0,
                None,
            )
        )
        rates.append(path.body_rate_rad_s(stamp))
        moved = None
        if is_key[f]:
            if before is not None:
                late = stamp - velocity_delay
                sigma = e * gps.sigma_velocity_m_s * (late - before)
                moved = path.position_enu_m(late) - path.position_enu_m(before) + sigma * rng.standard_normal(3)
            before = stamp - velocity_delay
        flown.append(None if moved is None else Displacement(moved))
    return Scene(
        config, camera, ground, times, is_key, R_cam_enu, centres, points, boresight, offset,
        delay, velocity_delay, heading, observations, navs, rates, flown,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Drawn:
    """A bundle problem whose every residual was drawn from its own prior, and the truth it should find."""

    problem: Problem
    truth: State


def bundle_problem(
    rng: np.random.Generator,
    keyframes: int = 6,
    points: int = 50,
    *,
    noise: float = 1.0,
    attitude: bool = True,
    lever_cam_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    lens: Camera | None = None,
) -> Drawn:
    """A strip seen straight down from 250 m; `noise` scales every error, 1 being what the priors state.

    Of `points`, those that two views or more see are kept. Errors of position and attitude have a Gauss-Markov and a
    white part, point heights vary about a sloping plane. Velocities and headings differ from view to view, so that
    every shared state has something to show. `lever_cam_m` leads from the point of the positions to the camera. With
    a `lens`, whose sigmas say how wrong it may be, the camera's own states are drawn too.
    """
    sigma_lens = np.array([] if lens is None else lens.sigma)
    K, P, layout = keyframes, points, Layout(keyframes, len(sigma_lens))
    stamps = np.arange(K) * 1.5
    velocity = np.array([14.0, 9.0, -0.5])
    centres = velocity * (stamps - stamps.mean())[:, None] + [0.0, 0.0, 250.0]
    base = R_ENU_NED @ mount_rotation(0.0, -90.0, 25.0)
    R_cam_enu = exp_so3(0.05 * rng.standard_normal((K, 3))) @ base.T
    rates = 0.1 * rng.standard_normal((K, 3))
    sigma_shared = np.array([0.02, 0.02, 0.02, 0.05, 0.04, 0.06, 0.02, 0.02, *sigma_lens, 30.0, 0.04, 0.04])
    shared = noise * sigma_shared * rng.standard_normal(len(sigma_shared))
    plane = shared[-3:]
    reference = np.array([4.0, -7.0, 3.0])
    xy_ground = rng.uniform([-150.0, -120.0], [150.0, 120.0], (P, 2))
    ground_m = 10.0
    z = reference[2] + plane[0] + (xy_ground - reference[:2]) @ plane[1:] + noise * ground_m * rng.standard_normal(P)
    ground = np.column_stack([xy_ground, z])
    p = np.einsum("kij,kpj->kpi", R_cam_enu, ground[None] - centres[:, None])
    xy = p[..., :2] / p[..., 2:]
    seen = (np.abs(xy[..., 0]) < 0.45) & (np.abs(xy[..., 1]) < 0.4)
    often = np.count_nonzero(seen, axis=0) >= 2
    xy, seen, ground, P = xy[:, often], seen[:, often], ground[often], int(np.count_nonzero(often))
    truth = State(R_cam_enu, centres, ground, shared[:-3], plane)
    sigma = 0.3 / 900.0
    if lens is not None:  # what the lens as filed makes of pixels that the true one took
        true_lens = camera_states.corrected(lens, truth.camera)
        uv = true_lens.distort(xy) * (true_lens.fx_px, true_lens.fy_px) + (true_lens.cx_px, true_lens.cy_px)
        xy = lens.unproject(uv)[0][..., :2]
    xy = xy + noise * sigma * rng.standard_normal(xy.shape)

    white, slow, tau = 0.3, 1.5, 60.0
    error = np.stack([gauss_markov(rng, stamps, white, slow, tau) for _ in range(3)], axis=1) * noise
    velocities = velocity + 2.0 * rng.standard_normal((K, 3))
    gained = np.diff(velocities, axis=0)
    antennas, _ = truth.antennas_enu_m(np.array(lever_cam_m))
    priors: list[Prior] = [
        PositionPrior(
            layout,
            antennas - velocities * (truth.platform[OFFSET] + truth.platform[DELAY]) - error,
            velocities,
            np.stack([gauss_markov_sqrt_information(stamps, white, slow, tau)] * 3),
            np.zeros(K),
            lever_cam_m=np.array(lever_cam_m),
        ),
        VelocityPrior(
            layout,
            np.diff(antennas, axis=0)
            - gained * truth.platform[VELOCITY_DELAY]
            + noise * 0.15 * rng.standard_normal((K - 1, 3)),
            gained,
            np.stack([np.eye(K - 1) / 0.15] * 3),
            np.full(K - 1, truth.platform[OFFSET]),
            lever_cam_m=np.array(lever_cam_m),
        ),
        SharedPrior(layout, np.zeros(len(sigma_shared)), np.diag(1.0 / sigma_shared)),
    ]
    if attitude:
        white, slow = 0.004, 0.017
        tilt = np.stack([gauss_markov(rng, stamps, white, slow, tau) for _ in range(3)], axis=1) * noise
        turn = exp_so3(rates * truth.platform[OFFSET]) @ exp_so3(truth.platform[BORESIGHT])
        bearing = rng.uniform(0.0, 2.0 * np.pi, K)
        by_heading = np.column_stack([np.cos(bearing), np.sin(bearing)])
        about_up = (by_heading @ truth.platform[HEADING])[:, None] * [0.0, 0.0, 1.0]
        measured = exp_so3(about_up) @ exp_so3(tilt) @ R_cam_enu.transpose(0, 2, 1) @ turn.transpose(0, 2, 1)
        priors.append(
            AttitudePrior(
                layout,
                measured,
                rates,
                np.stack([gauss_markov_sqrt_information(stamps, white, slow, tau)] * 3),
                np.zeros(K),
                by_heading=by_heading,
            )
        )
    weight = np.where(seen, 1.0 / sigma, 0.0)
    problem = Problem(layout, xy, weight, priors, reference, 1.0 / ground_m)
    return Drawn(replace(problem, camera=lens, camera_taken=np.zeros_like(sigma_lens)), truth)


def first_guess(drawn: Drawn, R_cam_enu: Array, centres_enu_m: Array) -> State:
    """A state to start from: given poses, points where their rays meet, everything shared at zero."""
    problem = drawn.problem
    points = triangulate(R_cam_enu, centres_enu_m, problem.xy, problem.weight > 0).points_enu_m
    lens = np.zeros(problem.layout.camera_states)
    return State(R_cam_enu, centres_enu_m, points, np.append(np.zeros(STATES), lens), np.zeros(3))


def error_of(state: State, truth: State) -> Array:
    """The step (Layout.size,) of the camera side that takes `truth` to `state`."""
    K = len(truth.R_cam_enu)
    turn = log_so3(state.R_cam_enu @ truth.R_cam_enu.transpose(0, 2, 1))
    pose = np.concatenate([turn, state.centres_enu_m - truth.centres_enu_m], axis=1).reshape(6 * K)
    return np.concatenate([pose, state.platform - truth.platform, state.plane - truth.plane])
