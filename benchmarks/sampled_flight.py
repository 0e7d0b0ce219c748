"""Flights without pictures: events and feature tracks sampled from the errors that the configuration declares.

Everything of the onboard side runs as it does in the air but for the tracker, which looks up where points of the ground
really are and adds noise. Every error is sampled from the prior that the window has for it, so whatever the stated
covariances miss comes from the estimator and not from the simulation. Only what acceleration does to a filter follows
(5.15), of which the window's prior (5.16) is an upper bound: apart, position and velocity would contradict each other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, exp_so3, log_so3, mount_rotation, quaternion_from_matrix
from onboard.config.schema import Config
from onboard.estimation.sensor_factors import TERRAIN_SLOPE_SIGMA, cosine_sine_of_heading
from onboard.events.types import Attitude, Event, Frame, GpsQuality, PositionFix
from onboard.geometry.plane_homography import fit_homography
from onboard.geometry.terrain_grid import Terrain
from onboard.navigation.position_slip import DYNAMIC_TIME_S
from onboard.pipeline.pipeline import Pipeline
from onboard.vision.klt_tracker import CROWDED, Tracker, Tracks
from simulation.moved_optics import stabilised, zoomed
from simulation.paths import PathSpec, fly_path
from simulation.rows import RowsOf
from simulation.trajectory import Trajectory

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

EPOCH_NS = 1_795_217_000_000_000_000
PLACE = LocalFrame(-43.38, 172.40, 0.0)
LEAD_S = 4.0
# Errors called white are given this short a memory, so that what is interpolated between two messages has the same
# size as at the messages, and neighbouring keyframes, a second apart, still share nothing.
WHITE_TIME_S = 0.2
# Measured against truth in recorded flights: 0.1 m/s, displacement errors 0.07 m in 1 s and 0.35 m in 10 s.
VELOCITY_TIME_S = 0.5
FILTER_STEP_S = 0.02
POSITION_HZ, ATTITUDE_HZ, QUALITY_HZ = 10.0, 20.0, 2.0
WAVES = 16
HILLS_LENGTH_M, HILLS_M = 1000.0, 12.0
COUNTRY_LENGTHS_M, COUNTRY_POWER, COUNTRY_M, COUNTRY_WAVES = (20.0, 2000.0), 0.8, 25.0, 200
GRAZING = 0.7  # slope of a ray, below which one hill may hide another
FARTHEST, STEPS = 13.0, 130  # heights above ground as far as rays are followed; steps in which their ground is found
TERRAIN_NODE_M = 20.0
GYRO_STEP_S = 0.01
LEAST_SEEN = 6  # features, below which no motion can be determined


@dataclass(frozen=True)
class SampledSpec:
    """One kind of flight. `errors` scales every sensor's error against the configuration; `pixel_sigma_px` is true."""

    config: Config
    path: PathSpec = field(default_factory=PathSpec)
    seconds: float = 16.0
    rate_hz: float = 3.0
    relief_sigma_m: float = 3.0
    relief_wavelength_m: float = 200.0
    pixel_sigma_px: float = 0.3
    errors: float = 1.0
    outlier_share: float = 0.0
    has_terrain: bool = False
    boresight_deg: tuple[float, float, float] | None = None  # as it is; None: sampled from the configured prior
    offset_s: float | None = None
    jitter_s: float | None = None  # one sigma of each picture's own stamp
    delay_s: float | None = None  # of position and velocity beyond `gps.latency_s`
    filter_late_s: float | None = None  # by which the filter's positions are later than it assumes
    heading_error_deg: tuple[float, float] = (0.0, 0.0)  # times the cosine and the sine of the heading
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # as it is, whatever is configured
    camera: Camera = field(default_factory=lambda: Camera.from_field_of_view(640, 480, 40.0))
    camera_file: Camera | None = None  # what is passed to the pipeline; None: the truth
    readout_s: float = 0.0  # of the rows, as it is, whatever is configured
    gyro_sigma_deg_s: float | None = None  # of the rates sent with attitudes; None: attitudes come without
    stabilised_s: float | None = None  # over which electronic stabilisation smooths rotation; None: there is none
    margin: float = 0.1  # by which that may shift a frame either way, of the picture's width
    zoom: tuple[float, float, float, float] | None = None  # factor, from and until (s), for how long each ramp (s)


class Ground:
    """Waves on a slope about height 0, as high as asked in one sigma."""

    def __init__(self, rng: np.random.Generator, slope: Array, sigma_m: float, wavelength_m: float) -> None:
        bearing = rng.uniform(0.0, 2.0 * np.pi, WAVES)
        length = wavelength_m * rng.uniform(0.5, 1.5, WAVES)
        self._wave = _wave_numbers(length, bearing)
        self._phase = rng.uniform(0.0, 2.0 * np.pi, WAVES)
        self._amplitude = sigma_m * np.sqrt(2.0 / WAVES)
        self.slope = slope

    def height_m(self, xy: Array) -> Array:
        """Heights of places (..., 2)."""
        waves = np.sin(xy @ self._wave.T + self._phase).sum(axis=-1)
        out: Array = xy @ self.slope + self._amplitude * waves
        return out

    def meet(self, centre: Array, rays: Array) -> Array:
        """Points (N, 3) where rays (N, 3), ENU axes, from a centre (3,) or (N, 3) above the ground meet it first.

        Downward rays, and as far as `FARTHEST` heights above ground: those that meet none before end there.
        """
        depth = -centre[..., 2] / rays[:, 2]
        for _ in range(60):
            points = centre + rays * depth[:, None]
            depth = depth - 0.6 * (points[:, 2] - self.height_m(points[:, :2])) / rays[:, 2]
        grazing = np.flatnonzero(-rays[:, 2] < GRAZING * np.hypot(rays[:, 0], rays[:, 1]))
        if len(grazing):
            first = self._first(np.broadcast_to(centre, rays.shape)[grazing], rays[grazing])
            clearance_m = np.abs(self._clearance_m(centre, rays, depth)[grazing])
            wrong = (clearance_m > 0.01) | (first < 0.99 * depth[grazing])
            depth[grazing[wrong]] = first[wrong]
        return np.asarray(centre + rays * depth[:, None], float)

    def _clearance_m(self, centre: Array, rays: Array, depth: Array) -> Array:
        """Heights (...) above the ground of rays (..., 3) at some depths (...)."""
        points = centre + rays * depth[..., None]
        out: Array = points[..., 2] - self.height_m(points[..., :2])
        return out

    def _first(self, centres: Array, rays: Array) -> Array:
        """The depth (N,) at which rays (N, 3) meet the ground first, whatever hides behind it."""
        height_m = centres[:, 2] - self.height_m(centres[:, :2])
        most = FARTHEST * height_m / np.linalg.norm(rays, axis=1)
        depths = most[:, None] * np.linspace(0.0, 1.0, STEPS + 1)
        under = self._clearance_m(centres[:, None], rays[:, None], depths) < 0.0
        step = np.where(under.any(axis=1), np.argmax(under, axis=1), STEPS + 1) - 1
        low = most / STEPS * np.minimum(step, STEPS)
        high = np.minimum(low + most / STEPS, most)
        for _ in range(24):
            half = 0.5 * (low + high)
            is_over = self._clearance_m(centres, rays, half) > 0.0
            low, high = np.where(is_over, half, low), np.where(is_over, high, half)
        return np.asarray(low, float)


class Hills(Ground):
    """The same over hills of HILLS_LENGTH_M, far longer than a picture; the origin stays at its height.

    East and north they slope by one sigma of 3.5 degrees each, which is what `solve.level_ground_sigma_deg` declares.
    """

    def __init__(self, rng: np.random.Generator, slope: Array, sigma_m: float, wavelength_m: float) -> None:
        super().__init__(rng, slope, sigma_m, wavelength_m)
        self._hills = Ground(rng, np.zeros(2), HILLS_M, HILLS_LENGTH_M)
        self._home_m = self._hills.height_m(np.zeros(2))

    def height_m(self, xy: Array) -> Array:
        """Heights of places (..., 2)."""
        out: Array = super().height_m(xy) + self._hills.height_m(xy) - self._home_m
        return out


class HillCountry(Ground):
    """Waves of all lengths from 20 m to 2 km, as high as the 0.8th power of their length; the origin is at height 0.

    Over 100 m it slopes by one sigma of 8 degrees east and north, over 300 m by 5: more than twice what
    `solve.level_ground_sigma_deg` declares. Such powers, of 0.7 to 0.9, are what terrain has at these lengths.
    """

    def __init__(self, rng: np.random.Generator, slope: Array, sigma_m: float, wavelength_m: float) -> None:
        super().__init__(rng, slope, sigma_m, wavelength_m)
        shortest, longest = np.log(COUNTRY_LENGTHS_M)
        length = np.exp(rng.uniform(shortest, longest, COUNTRY_WAVES))
        bearing = rng.uniform(0.0, 2.0 * np.pi, COUNTRY_WAVES)
        self._hills = _wave_numbers(length, bearing)
        self._hills_phase = rng.uniform(0.0, 2.0 * np.pi, COUNTRY_WAVES)
        height = length**COUNTRY_POWER
        self._hills_m = COUNTRY_M * height / np.sqrt(0.5 * np.sum(height**2))
        self._home_m = np.sin(self._hills_phase) @ self._hills_m

    def height_m(self, xy: Array) -> Array:
        """Heights of places (..., 2)."""
        hills = np.sin(xy @ self._hills.T + self._hills_phase) @ self._hills_m
        out: Array = super().height_m(xy) + hills - self._home_m
        return out


class Valley(Ground):
    """The same on both sides of a valley through the origin; `slope` (2,) is that of the side where it is uphill."""

    def height_m(self, xy: Array) -> Array:
        """Heights of places (..., 2); the valley's floor is rounded over a hundred metres."""
        rise = xy @ self.slope
        rounded_m = 50.0 * float(np.hypot(*self.slope))
        return super().height_m(xy) - rise + np.hypot(rise, rounded_m) - rounded_m


def _wave_numbers(length_m: Array, bearing_rad: Array) -> Array:
    """Wave numbers (N, 2), rad/m, of waves of these lengths (N,) along these directions (N,)."""
    out: Array = 2.0 * np.pi / length_m[:, None] * np.stack([np.cos(bearing_rad), np.sin(bearing_rad)], axis=1)
    return out


class SampledFlight:
    """The truth of one flight and the events that report it."""

    def __init__(self, spec: SampledSpec, seed: int) -> None:
        self.spec = spec
        self.seed = seed
        self.rng = rng = np.random.default_rng([seed, 909])
        config, e = spec.config, spec.errors
        self.trajectory: Trajectory = fly_path(spec.path, spec.seconds, seed)
        tilt = np.tan(np.radians(config.solve.level_ground_sigma_deg))
        self.ground = Ground(rng, e * tilt * rng.standard_normal(2), spec.relief_sigma_m, spec.relief_wavelength_m)
        self.boresight_rad = e * np.radians(config.mount.sigma_deg) * rng.standard_normal(3)
        self.offset_s = e * config.camera.sigma_latency_s * float(rng.standard_normal())
        self.delay_s = e * config.gps.sigma_latency_s * float(rng.standard_normal())
        if spec.boresight_deg is not None:
            self.boresight_rad = np.radians(spec.boresight_deg)
        if spec.offset_s is not None:
            self.offset_s = spec.offset_s
        if spec.delay_s is not None:
            self.delay_s = spec.delay_s
        mount = config.mount
        R_body_cam = mount_rotation(mount.roll_deg, mount.pitch_deg, mount.yaw_deg) @ exp_so3(self.boresight_rad)
        self.times_s = np.arange(round(spec.seconds * spec.rate_hz)) / spec.rate_hz
        self._rows = RowsOf(self.trajectory, R_body_cam, spec.readout_s, np.array(spec.lever_arm_m))
        self.cameras = self._cameras(R_body_cam)
        poses = [self.trajectory.camera_pose(float(t), R_body_cam) for t in self.times_s]
        self.R_enu_cam = np.stack([p.R_enu_cam for p in poses])
        R_enu_body = self.trajectory.R_enu_body(self.times_s)
        self.place, self.bank_deg = PLACE, np.degrees(np.arccos(np.clip(-R_enu_body[:, 2, 2], -1.0, 1.0)))
        lever_enu_m = R_enu_body @ np.array(spec.lever_arm_m)
        self.centres_enu_m = np.stack([p.centre_m for p in poses]) + lever_enu_m
        self.terrain_error_m = e * config.terrain.sigma_datum_m * float(rng.standard_normal())
        self.terrain_tilt = e * TERRAIN_SLOPE_SIGMA * rng.standard_normal(2)

    def _cameras(self, R_body_cam: Array) -> list[Camera]:
        """The camera as it is at each picture."""
        spec = self.spec
        if spec.stabilised_s is not None:
            moved = self.trajectory, R_body_cam, self.times_s, spec.stabilised_s, spec.margin
            return stabilised(spec.camera, *moved)
        if spec.zoom is not None:
            return zoomed(spec.camera, self.times_s, *spec.zoom)
        return [spec.camera] * len(self.times_s)

    def ground_points(self, frame: int, uv_px: Array) -> Array:
        """The ground (N, 3) that pixels (N, 2) of a picture show."""
        rays, centres = self._rows.rays(self.cameras[frame], float(self.times_s[frame]), uv_px)
        return self.ground.meet(centres, rays)

    def pixels(self, frame: int, points: Array) -> tuple[Array, Mask]:
        """Pixels (N, 2) of points (N, 3) in a picture, and whether they are on it."""
        return self._rows.pixels(self.cameras[frame], float(self.times_s[frame]), points)

    def events(self) -> Iterator[Event]:
        """Telemetry and pictures, in order of time; a picture's image holds nothing but its own number."""
        spec = self.spec
        jitter_s = spec.errors * spec.config.camera.sigma_jitter_s if spec.jitter_s is None else spec.jitter_s
        stamps_s = self.times_s - self.offset_s + jitter_s * self.rng.standard_normal(len(self.times_s))
        frames = [Frame(_stamp(t), k, np.full((1, 1), k, np.uint16).view(np.uint8)) for k, t in enumerate(stamps_s)]
        everything: list[Event] = [*self._positions(), *self._attitudes(), *frames]
        everything += [GpsQuality(_stamp(t), 4, undulation_m=0.0) for t in self._instants(QUALITY_HZ)]
        yield from sorted(everything, key=lambda event: event.stamp_ns)

    def _instants(self, rate_hz: float) -> Array:
        return np.arange(-LEAD_S, self.spec.seconds + LEAD_S, 1.0 / rate_hz)

    def _error(
        self, time: Array, sigma: float, time_constant_s: float, rng: np.random.Generator | None = None
    ) -> Array:
        """One axis (N,) of an Ornstein-Uhlenbeck error at evenly spaced times."""
        keep = float(np.exp(-(time[1] - time[0]) / time_constant_s))
        draws = (rng or self.rng).standard_normal(len(time))
        out = np.empty(len(time))
        state = draws[0]
        for k, push in enumerate(draws):
            state = push if k == 0 else keep * state + np.sqrt(1.0 - keep * keep) * push
            out[k] = state
        return self.spec.errors * sigma * out

    def _positions(self) -> list[PositionFix]:
        gps, time = self.spec.config.gps, self._instants(POSITION_HZ)
        sigma_m = (
            gps.sigma_correlated_horizontal_m,
            gps.sigma_correlated_horizontal_m,
            gps.sigma_correlated_vertical_m,
        )
        white = (gps.sigma_white_m, gps.sigma_white_m, 1.5 * gps.sigma_white_m)
        error = [
            self._error(time, slow, gps.correlation_time_s) + self._error(time, fast, WHITE_TIME_S)
            for slow, fast in zip(sigma_m, white, strict=True)
        ]
        late = time - self.delay_s
        # Of a generator of its own, so that all other errors of a seed are what they were without this part.
        slow_rng = np.random.default_rng([self.seed, 910])
        velocity = self.trajectory.velocity_enu_m_s(late) + np.stack(
            [
                self._error(time, gps.sigma_velocity_m_s, VELOCITY_TIME_S)
                + self._error(time, gps.sigma_velocity_correlated_m_s, gps.velocity_correlation_time_s, slow_rng)
                for _ in range(3)
            ],
            axis=1,
        )
        moved_m, faster_m_s = self._strayed_in_turns(time)
        velocity += faster_m_s
        geodetic = PLACE.to_geodetic(self.trajectory.position_enu_m(late) + np.stack(error, axis=1) + moved_m)
        ned = velocity @ R_ENU_NED
        above_m = self.trajectory.position_enu_m(time)[:, 2] + error[2] + moved_m[:, 2]
        rows = zip(time, geodetic.tolist(), ned.tolist(), above_m.tolist(), strict=True)
        return [
            PositionFix(_stamp(t + gps.latency_s), lat, lon, height, (v[0], v[1], v[2]), above)
            for t, (lat, lon, height), v, above in rows
        ]

    def _strayed_in_turns(self, time: Array) -> tuple[Array, Array]:
        """The effect of acceleration on a filter whose positions are later than it assumes: u and w of (5.21).

        Of position (N, 3), m, and of velocity (N, 3), m/s, beyond a delay of both.
        """
        # One is needed; the others keep all later errors of a seed what they are in the bounds of tests.
        sampled = float(self.rng.standard_normal((6, len(time)))[0, 0])
        late_s = self.spec.filter_late_s
        if late_s is None:
            late_s = self.spec.errors * self.spec.config.gps.sigma_latency_s * sampled
        steps_s = np.arange(time[0], time[-1] + FILTER_STEP_S, FILTER_STEP_S)
        gained = late_s * np.gradient(self.trajectory.velocity_enu_m_s(steps_s), FILTER_STEP_S, axis=0)
        u, w = np.zeros_like(gained), np.zeros_like(gained)
        for k in range(1, len(steps_s)):
            u[k] = u[k - 1] + FILTER_STEP_S * (w[k - 1] - 2.0 / DYNAMIC_TIME_S * u[k - 1])
            w[k] = w[k - 1] - FILTER_STEP_S / DYNAMIC_TIME_S**2 * u[k - 1] + gained[k] - gained[k - 1]
        moved, faster = (np.stack([np.interp(time, steps_s, axis) for axis in x.T], axis=1) for x in (u, w))
        return moved, faster

    def _attitudes(self) -> list[Attitude]:
        solve, time = self.spec.config.solve, self._instants(ATTITUDE_HZ)
        slow = (solve.attitude_sigma_deg, solve.attitude_sigma_deg, solve.heading_sigma_deg)
        fast = (solve.attitude_white_sigma_deg, solve.attitude_white_sigma_deg, solve.heading_white_sigma_deg)
        error = np.stack(
            [
                self._error(time, np.radians(gauss_markov_deg), solve.attitude_correlation_time_s)
                + self._error(time, np.radians(white), WHITE_TIME_S)
                for gauss_markov_deg, white in zip(slow, fast, strict=True)
            ],
            axis=1,
        )
        R_enu_body = self.trajectory.R_enu_body(time)
        error[:, 2] += cosine_sine_of_heading(R_enu_body) @ np.radians(self.spec.heading_error_deg)
        R_ned_body = R_ENU_NED.T @ exp_so3(error) @ R_enu_body
        quaternions = quaternion_from_matrix(R_ned_body).tolist()
        rates: list[tuple[float, float, float] | None] = [None] * len(time)
        if self.spec.gyro_sigma_deg_s is not None:
            ahead, behind = (self.trajectory.R_enu_body(time + side * GYRO_STEP_S) for side in (0.5, -0.5))
            rate = log_so3(behind.transpose(0, 2, 1) @ ahead) / GYRO_STEP_S
            rate += np.radians(self.spec.gyro_sigma_deg_s) * self.rng.standard_normal(rate.shape)
            rates = [(x, y, z) for x, y, z in rate.tolist()]
        return [
            Attitude(_stamp(t), (q[0], q[1], q[2], q[3]), r) for t, q, r in zip(time, quaternions, rates, strict=True)
        ]

    def terrain(self) -> Terrain:
        """The elevation model of this ground: off and tilted as a whole, and off from node to node."""
        axis = np.arange(-3000.0, 3000.1, TERRAIN_NODE_M)
        east, north = np.meshgrid(axis, axis)
        places = np.stack([east, north], axis=-1)
        height = self.ground.height_m(places) + self.terrain_error_m + places @ self.terrain_tilt
        # Between nodes the mean of four is off less than each: on average over places the variance is as configured.
        node_sigma_m = 1.5 * self.spec.config.terrain.sigma_m
        rough = self.spec.errors * node_sigma_m * self.rng.standard_normal(height.shape)
        return Terrain(float(axis[0]), float(axis[0]), TERRAIN_NODE_M, height + rough)


class Seen(Protocol):
    """The facts of how a flight is seen that a simulated tracker needs."""

    @property
    def config(self) -> Config:
        """The configuration of the flight."""

    @property
    def camera(self) -> Camera:
        """The camera."""

    @property
    def pixel_sigma_px(self) -> float:
        """One sigma of a feature's pixel noise."""

    @property
    def outlier_share(self) -> float:
        """Share of tracks that are wrong."""


class FlightInSight(Protocol):
    """A flight of which a simulated tracker can look up what its pictures show."""

    rng: np.random.Generator

    @property
    def spec(self) -> Seen:
        """The facts of how it is seen."""

    def ground_points(self, frame: int, uv_px: Array) -> Array:
        """The ground (N, 3) that pixels (N, 2) of a picture show."""

    def pixels(self, frame: int, points: Array) -> tuple[Array, Mask]:
        """Pixels (N, 2) of points (N, 3) in a picture, and whether they are on it."""


class SampledTracker(Tracker):
    """Features that are points of the simulated ground, found again wherever visible, with white pixel noise."""

    def __init__(self, flight: FlightInSight) -> None:
        spec = flight.spec
        super().__init__(spec.camera.size_px, spec.config.tracking.features)
        self._flight = flight
        self._points = np.zeros((0, 3))
        self._wrong = np.zeros(0, bool)
        self._frame = -1
        self._key = False

    @property
    def has_keyframe(self) -> bool:
        """True once a picture has been made the keyframe."""
        return self._key

    def track(self, image: NDArray[np.uint8], predicted: Array | None, sigma_px: float | None = None) -> Tracks:
        """Every feature of the keyframe that this picture sees; nothing where too few are visible."""
        self._frame = int(image.view(np.uint16)[0, 0])
        if not self._key or not len(self._ids):
            return self.nothing()
        rng, sigma = self._flight.rng, self._flight.spec.pixel_sigma_px
        uv, seen = self._flight.pixels(self._frame, self._points[self._ids])
        if np.count_nonzero(seen) < LEAST_SEEN:
            return self.nothing()
        uv = uv + sigma * rng.standard_normal(uv.shape)
        uv += np.where(self._wrong[self._ids, None], rng.normal(0.0, 2.5, uv.shape), 0.0)
        seen &= self._inside(uv)
        motion = fit_homography(self._uv[seen], uv[seen], np.ones(np.count_nonzero(seen)))
        return Tracks(self._ids[seen], uv[seen], self._uv[seen], len(self._ids), motion)

    def promote(self, tracks: Tracks) -> tuple[NDArray[np.int64], Array]:
        """The last picture becomes the keyframe; lost and crowded features are replaced where there are none."""
        tracks = tracks.thinned(CROWDED * self.min_distance_px)
        flight, rng = self._flight, self._flight.rng
        wanted = self.features - len(tracks)
        size = np.array(flight.spec.camera.size_px)
        spots = list(tracks.uv_px)
        for spot in rng.uniform(12.0, size - 13.0, (12 * wanted, 2)):
            if len(spots) >= self.features:
                break
            if not spots or np.linalg.norm(np.array(spots) - spot, axis=1).min() > self.min_distance_px:
                spots.append(spot)
        fresh = np.array(spots[len(tracks) :]).reshape(-1, 2)
        ids = len(self._points) + np.arange(len(fresh))
        self._points = np.concatenate([self._points, flight.ground_points(self._frame, fresh)])
        self._wrong = np.concatenate([self._wrong, rng.uniform(size=len(fresh)) < flight.spec.outlier_share])
        noisy = fresh + flight.spec.pixel_sigma_px * rng.standard_normal(fresh.shape)
        self._ids = np.concatenate([tracks.ids, ids]).astype(np.int64)
        self._uv = np.concatenate([tracks.uv_px, noisy])
        self._key = True
        return self._ids, self._uv

    def forget(self) -> None:
        """The next picture starts again."""
        super().forget()
        self._key = False


class _OwnTerrain:
    """The flight's elevation model in the frame that navigation has chosen."""

    def __init__(self, flight: SampledFlight) -> None:
        self._terrain = flight.terrain()

    def around(
        self, frame: LocalFrame, centre_enu_m: Array, radius_m: float, spacing_m: float, undulation_m: float
    ) -> Terrain:
        """All of it."""
        west, south, up = frame.to_enu(PLACE.lat_deg, PLACE.lon_deg, 0.0)
        t = self._terrain
        return Terrain(t.west_m + west, t.south_m + south, t.spacing_m, t.heights_m + up)


def fly(flight: SampledFlight) -> tuple[dict[int, FeatureSet], Pipeline]:
    """The flight through the pipeline: the last feature set of each picture, and the pipeline as it is then."""
    spec = flight.spec
    pipeline = Pipeline(spec.config, spec.camera_file or spec.camera, _OwnTerrain(flight) if spec.has_terrain else None)
    pipeline.tracker = SampledTracker(flight)
    return {out.frame: out for out in every_set(pipeline, flight.events())}, pipeline


def every_set(pipeline: Pipeline, events: Iterable[Event]) -> Iterator[FeatureSet]:
    """Yield each set that a pipeline makes of a whole flight, as they come: of a picture there may be several."""
    for event in events:
        yield from pipeline.handle(event)
    yield from pipeline.finish()


def replace_section(config: Config, section: str, **values: object) -> Config:
    """The configuration with other values in one section."""
    part = getattr(config, section)
    return config.model_copy(update={section: part.model_copy(update=values)})


def _stamp(time_s: float) -> int:
    return EPOCH_NS + round(time_s * 1e9)
