"""Whitened residuals with analytic Jacobians, one plain function each. Equations: docs/mathematics.md, section 5.

The unknowns are laid out by `Layout`: six columns a keyframe (rotation `d`, R_cam_enu <- exp([d]x) R_cam_enu, rad; then
centre, ENU metres), then what is estimated of the platform and of its camera (`platform_states`), the ground plane
(height m at the reference point, slope east, slope north), and each picture's own image states (`image_blocks`),
picture by picture. Points are eliminated and have no column here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from contract.rotations import exp_so3, log_so3, right_jacobian_inverse, skew
from onboard.estimation import sensor_table
from onboard.estimation.platform_states import BORESIGHT, DELAY, HEADING, OFFSET, PLANE, STATES, VELOCITY_DELAY
from onboard.geometry.terrain_grid import Terrain

Array = NDArray[np.float64]
# The covariance of one sensor's errors by axis: each maps a part's name to its (n, n), as the window weighs it.
Parts = tuple[Mapping[str, Array], ...]

# A picture's own image states, by block: what its angular rate is off by (rad/s, camera axes), the cosines and sines
# that its rows swing by (rad), how far its frame is shifted (focal lengths), by what logarithms its lens is longer and
# the picture wider, and how much longer its rows are read (s).
RATES, WAVES, SHIFT, ZOOM, STRETCH, READ = "rates", "waves", "shift", "zoom", "stretch", "read"
OWN_STATES = {RATES: 3, WAVES: 6, SHIFT: 2, ZOOM: 1, STRETCH: 1, READ: 1}
MAX_LEAP = 0.5  # a step takes a point to twice its distance at most


@dataclass(frozen=True)
class Layout:
    """Columns of the reduced system for K keyframes, with so many of the camera's own (`camera_states`)."""

    keyframes: int
    camera_states: int = 0
    blocks: tuple[str, ...] = ()  # of each picture's own image states: keys of `OWN_STATES`

    @property
    def shared(self) -> slice:
        """Columns shared by all pictures: the platform's and the camera's (`platform_states`), and the plane's."""
        first = 6 * self.keyframes
        return slice(first, first + STATES + self.camera_states + PLANE)

    @property
    def platform(self) -> slice:
        """The platform's and the camera's states, in the order of `platform_states`."""
        return slice(self.shared.start, self.shared.stop - PLANE)

    @property
    def camera(self) -> slice:
        """The camera's own; none where the camera is taken as it is."""
        return slice(self.platform.start + STATES, self.platform.stop)

    @property
    def plane(self) -> slice:
        """Three columns: height (m), slope east, slope north."""
        return slice(self.platform.stop, self.shared.stop)

    @property
    def size(self) -> int:
        return self.keyframes * (6 + self.own) + STATES + self.camera_states + PLANE

    @property
    def own(self) -> int:
        return sum(OWN_STATES[name] for name in self.blocks)

    @property
    def by_picture(self) -> NDArray[np.intp]:
        """Column numbers (K, M) of the pictures' own image states."""
        return np.arange(self.shared.stop, self.size).reshape(self.keyframes, self.own)

    def part(self, block: str) -> slice:
        """The slice of a picture's own image states that is this block's; empty if there is no such block."""
        if block not in self.blocks:
            return slice(0, 0)
        first = sum(OWN_STATES[name] for name in self.blocks[: self.blocks.index(block)])
        return slice(first, first + OWN_STATES[block])

    def with_block(self, block: str) -> Layout:
        """The same with one more block, after the others."""
        return replace(self, blocks=(*self.blocks, block))

    def centre(self, keyframe: int) -> slice:
        """Three columns, m."""
        return slice(6 * keyframe + 3, 6 * keyframe + 6)

    def rotations(self) -> NDArray[np.intp]:
        """Column numbers (K, 3) of all rotations."""
        return 6 * np.arange(self.keyframes)[:, None] + np.arange(3)

    def centres(self) -> NDArray[np.intp]:
        """Column numbers (K, 3) of all centres."""
        return 6 * np.arange(self.keyframes)[:, None] + np.arange(3, 6)


@dataclass(frozen=True, eq=False)
class State:
    """The unknowns of one window: K keyframes, P points, and what all of them share."""

    R_cam_enu: Array  # (K, 3, 3)
    centres_enu_m: Array  # (K, 3)
    points_enu_m: Array  # (P, 3)
    platform: Array  # (8 + camera states,) in the order of `platform_states`
    plane: Array  # (3,) height m, slope east, slope north, about the reference point
    own: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (K, M) image states, see `Layout.by_picture`

    @property
    def camera(self) -> Array:
        """Deviations from the camera file, see `camera_states`."""
        return self.platform[STATES:]

    @property
    def depths_m(self) -> Array:
        """The depth (K, P) of every point along every view's axis."""
        offset_m = self.points_enu_m - self.centres_enu_m[:, None]
        out: Array = np.einsum("kj,kpj->kp", self.R_cam_enu[:, 2], offset_m)
        return out

    def retract(self, dc: Array, dp: Array) -> State:
        """Apply a step: dc (Layout.size,), dp (P, 3), which is what points move by to first order. Section 6."""
        K, shared = len(self.R_cam_enu), len(self.platform)
        pose, platform, plane, own = np.split(dc, np.cumsum([6 * K, shared, PLANE]))
        pose = pose.reshape(K, 6)
        # Points turn with the views about their middle, and go the rest of the step in their inverse distances.
        turn = -np.einsum("kji,kj->i", self.R_cam_enu, pose[:, :3]) / K
        middle = self.centres_enu_m.mean(axis=0)
        rays = self.points_enu_m - middle
        rest = dp - rays @ skew(turn).T
        along = np.einsum("pi,pi->p", rays, rest) / np.maximum(np.einsum("pi,pi->p", rays, rays), 1e-12)
        moved = rays + rest - along[:, None] * rays
        moved /= (1.0 - np.minimum(along, MAX_LEAP))[:, None]
        return State(
            exp_so3(pose[:, :3]) @ self.R_cam_enu,
            self.centres_enu_m + pose[:, 3:],
            middle + moved @ exp_so3(turn).T,
            self.platform + platform,
            self.plane + plane,
            self.own + own.reshape(self.own.shape),
        )

    def with_block(self, layout: Layout, block: str) -> State:
        """The same with a block's states at zero; `layout` has the block last."""
        others = self.own[:, : layout.own - OWN_STATES[block]]
        return replace(self, own=np.pad(others, ((0, 0), (0, OWN_STATES[block]))))

    def antennas_enu_m(self, lever_cam_m: Array) -> tuple[Array, Array]:
        """The autopilot's reference points (K, 3), and their derivative by the views' rotations (K, 3, 3).

        `lever_cam_m` (3,) leads from that point to the camera, camera axes. (5.14)
        """
        R_enu_cam = self.R_cam_enu.transpose(0, 2, 1)
        return self.centres_enu_m - R_enu_cam @ lever_cam_m, -R_enu_cam @ skew(lever_cam_m)


def reprojection(R_cam_enu: Array, centres_enu_m: Array, points_enu_m: Array, xy: Array) -> tuple[Array, Array, Array]:
    """Image residuals of every point in every view, (5.1), in normalised image coordinates; points last, for speed.

    `R_cam_enu` (K, 3, 3), `centres_enu_m` (K, 3), `points_enu_m` (P, 3), measured `xy` (K, 2, P). Returns residuals
    (K, 2, P) predicted minus measured, predicted xy (K, 2, P), and depth (K, P); depth at or below zero marks a point
    behind the camera, whose residual is finite but meaningless.
    """
    p = R_cam_enu @ points_enu_m.T
    p -= R_cam_enu @ centres_enu_m[:, :, None]
    depth = p[:, 2]
    predicted = p[:, :2] / np.maximum(depth, 1e-6)[:, None]
    return predicted - xy, predicted, depth


def reprojection_jacobians(R_cam_enu: Array, predicted: Array, depth: Array, scale: Array) -> tuple[Array, Array]:
    """Derivatives of (5.1), times `scale` (K, P): by the view's rotation and by the point, both (K, 3, 2, P).

    (5.2), (5.3). The derivative by the view's centre is minus that by the point.
    """
    x, y = predicted[:, 0], predicted[:, 1]
    by_point = R_cam_enu[:, 2, :, None, None] * predicted[:, None]
    np.subtract(R_cam_enu[:, :2, :].transpose(0, 2, 1)[..., None], by_point, out=by_point)
    by_point *= (scale / np.maximum(depth, 1e-6))[:, None, None]
    by_rotation = np.empty_like(by_point)
    sx, sy = scale * x, scale * y
    np.multiply(sx, y, out=by_rotation[:, 1, 1])
    np.negative(by_rotation[:, 1, 1], out=by_rotation[:, 0, 0])
    np.add(scale, sx * x, out=by_rotation[:, 1, 0])
    np.subtract(-scale, sy * y, out=by_rotation[:, 0, 1])
    np.negative(sy, out=by_rotation[:, 2, 0])
    by_rotation[:, 2, 1] = sx
    return by_rotation, by_point


def gauss_markov_sqrt_information(
    stamps_s: Array, sigma_white: float, sigma_gauss_markov: float | Array, time_constant_s: float
) -> Array:
    """Lower-triangular whitener of K errors with a white and a Gauss-Markov part, (5.5); shapes as the latter's."""
    slow = gauss_markov_covariance(stamps_s, sigma_gauss_markov, time_constant_s)
    return whitener_of(slow + sigma_white**2 * np.eye(len(stamps_s)))


def gauss_markov_covariance(stamps_s: Array, sigma: float | Array, time_constant_s: float) -> Array:
    """Covariance (K, K) of a first-order Gauss-Markov error at `stamps_s` (K,); (A, K, K) if `sigma` is (A, 1, 1)."""
    lag = np.abs(stamps_s[:, None] - stamps_s[None, :])
    return sigma**2 * np.exp(-lag / time_constant_s)


def whitener_of(covariance: Array) -> Array:
    """The lower-triangular matrices (..., K, K) that whiten errors of these covariances."""
    return np.linalg.inv(np.linalg.cholesky(covariance))


def persistent_sigma(stamps_s: Array, sigma_gauss_markov: Array, time_constant_s: float) -> Array:
    """One sigma of the largest constant that Gauss-Markov errors at `stamps_s` (K,), in order, contain, (9.11)."""
    parts = np.tanh(np.diff(stamps_s) / (2.0 * time_constant_s))
    out: Array = sigma_gauss_markov / np.sqrt(1.0 + parts.sum())
    return out


@dataclass(frozen=True, eq=False)
class SensorPrior(ABC):
    """One sensor's n measurements: residuals (3n,), axis by axis, each axis whitened by itself."""

    sensors: ClassVar[tuple[str, str, str]]  # the row of `sensor_table` that each axis belongs to
    layout: Layout
    measured: Array  # (n, 3) ENU metres; of an attitude (n, 3, 3), R_enu_cam by vehicle and nominal mount
    rate: Array  # (n, 3) at which it changes with time offset and delay: m/s; the vehicle's in camera axes, rad/s
    whitener: Array  # (3, n, n): along or about east, north, up
    offset_s: Array  # (n,) time offset (plus delay) at which each was taken
    persistent: Array = field(default_factory=lambda: np.zeros(3))  # one sigma (m or rad) of what all share, (9.11)
    parts: Parts = ()  # of the covariance that `whitener` whitens; none where nothing was measured, see (5.10)

    @abstractmethod
    def by_axis(self, state: State) -> tuple[Array, Array]:
        """Residual (3, n), Jacobian (3, n, D)."""

    def constant_errors(self, axes: NDArray[np.bool_]) -> Array:
        """Return the whitened residuals (m n, m) of a constant error of each of the m chosen axes; `axes` (3,)."""
        out: Array = block_diag(*self.whitener[axes].sum(axis=2, keepdims=True))
        return out

    def evaluate(self, state: State) -> tuple[Array, Array]:
        """The same as (3n,) and (3n, D)."""
        residual, J = self.by_axis(state)
        return residual.reshape(-1), J.reshape(residual.size, -1)


@dataclass(frozen=True, eq=False)
class PathPrior(SensorPrior):
    """Differences between the K places where the autopilot's reference point is, or the places themselves."""

    lever_cam_m: Array = field(default_factory=lambda: np.zeros(3))  # from the autopilot's reference point
    order: ClassVar[int]  # of the differences
    delay: ClassVar[int]  # which of the platform's states they are late by

    def by_axis(self, state: State) -> tuple[Array, Array]:
        """Residual (3, n), Jacobian (3, n, D)."""
        at, by_rotation = state.antennas_enu_m(self.lever_cam_m)
        moved_s = state.platform[OFFSET] + state.platform[self.delay] - self.offset_s
        error = np.diff(at, self.order, axis=0) - self.measured - self.rate * moved_s[:, None]
        J = self._jacobian
        if self.lever_cam_m.any():  # else nothing is added, and this is the inner loop
            J = J.copy()
            J[:, :, self.layout.rotations()] += self._by_place[..., None] * by_rotation.transpose(1, 0, 2)[:, None]
        return (self.whitener @ error.T[:, :, None])[..., 0], J

    @cached_property
    def _by_place(self) -> Array:
        """(3, n, K) of whitened rows, by each place's own axis."""
        return self.whitener @ np.diff(np.eye(self.layout.keyframes), self.order, axis=0)

    @cached_property
    def _jacobian(self) -> Array:
        """(3, n, D) without the lever arm's part."""
        J = np.zeros((*self.rate.T.shape, self.layout.size))
        np.put_along_axis(J, self.layout.centres().T[:, None], self._by_place, axis=2)
        J[:, :, self.layout.platform][:, :, [OFFSET, self.delay]] = -self.whitener @ self.rate.T[:, :, None]
        return J


class PositionPrior(PathPrior):
    """Positions with Gauss-Markov and white error, moved along the velocity by time offset and delay. (5.4)"""

    sensors = (sensor_table.POSITION,) * 3
    order, delay = 0, DELAY


class VelocityPrior(PathPrior):
    """Displacements between consecutive keyframes from integrated velocity, with a delay of its own. (5.6), (5.15)"""

    sensors = (sensor_table.VELOCITY,) * 3
    order, delay = 1, VELOCITY_DELAY


@dataclass(frozen=True, eq=False)
class AttitudePrior(SensorPrior):
    """The autopilot's attitude through mount and boresight; Gauss-Markov and white error in ENU axes. (5.7), (5.17)"""

    sensors = (sensor_table.TILT, sensor_table.TILT, sensor_table.HEADING)
    # (K, 2) cosine and sine of each heading; zeros: no error depends on it
    by_heading: Array = field(default_factory=lambda: np.zeros((1, 2)))

    def by_axis(self, state: State) -> tuple[Array, Array]:
        """Residual (3, K), Jacobian (3, K, D)."""
        K, platform = self.layout.keyframes, state.platform
        boresight_rad = platform[None, BORESIGHT]
        turned = self.rate * (platform[OFFSET] - self.offset_s)[:, None]
        about_up = -(self.by_heading @ platform[HEADING])[:, None] * np.array([0.0, 0.0, 1.0])
        turns = exp_so3(np.concatenate([turned, boresight_rad, about_up]))  # one call: this is the inner loop
        turn, tilt, yaw = turns[:K], turns[K], turns[K + 1 :]
        R_enu_cam = yaw @ (self.measured @ turn @ tilt)
        # In camera axes: log(R_cam_enu R_enu_cam). Its derivatives: Jl^-1 = Jr^-1(-e) on the left, Jr^-1 on the right.
        error_cam = log_so3(state.R_cam_enu @ R_enu_cam)
        inverses = right_jacobian_inverse(np.concatenate([error_cam, boresight_rad]))
        by_rotation = self.measured @ inverses[:-1].transpose(0, 2, 1)
        inner = self.measured @ inverses[:-1]
        by_boresight = inner @ np.linalg.inv(inverses[-1])
        # exp(w t) on the inner side of exp(b): d exp(w t) = exp(w t) [w dt]x, carried through exp(b).
        by_offset = inner @ (self.rate @ tilt)[:, :, None]
        by_yaw = -inner @ R_enu_cam[:, 2, :, None] * self.by_heading[:, None, :]
        by_platform = np.concatenate([by_boresight, by_offset, by_yaw], axis=2)
        error = self.measured @ error_cam[:, :, None]
        J = np.zeros((3, K, self.layout.size))
        J[:, :, self.layout.rotations()] = self.whitener[..., None] * by_rotation.transpose(1, 0, 2)[:, None]
        columns = self.layout.platform.start + np.r_[BORESIGHT, OFFSET, HEADING]
        J[:, :, columns] = self.whitener @ by_platform.transpose(1, 0, 2)
        return (self.whitener @ error.transpose(1, 0, 2))[..., 0], J


@dataclass(frozen=True, eq=False)
class SharedPrior:
    """Prior of what all pictures of the window share, (5.8), in the layout's order: mean (S,), whitener (S, S)."""

    layout: Layout
    mean: Array
    whitener: Array

    @cached_property
    def covariance(self) -> Array:
        """(S, S)."""
        return np.asarray(np.linalg.inv(self.whitener.T @ self.whitener), np.float64)

    def evaluate(self, state: State) -> tuple[Array, Array]:
        """Residual (S,), Jacobian (S, D)."""
        value = np.concatenate([state.platform, state.plane])
        return self.whitener @ (value - self.mean), self._jacobian

    @cached_property
    def _jacobian(self) -> Array:
        J = np.zeros((len(self.mean), self.layout.size))
        J[:, self.layout.shared] = self.whitener
        return J


def ground_plane(
    points_enu_m: Array, reference_enu_m: Array, plane: Array, terrain: Terrain | None = None
) -> tuple[Array, Array, Array]:
    """Height of points (P, 3) over the plane about a reference point, (5.9); over terrain plus plane if there is one.

    Returns residual (P,) in metres, Jacobian by the point (P, 3) and by the plane (P, 3).
    """
    offset = points_enu_m[:, :2] - reference_enu_m[:2]
    residual = points_enu_m[:, 2] - reference_enu_m[2] - plane[0] - offset @ plane[1:]
    by_point = np.tile([-plane[1], -plane[2], 1.0], (len(offset), 1))
    if terrain is not None:
        # Heights only: a model's slopes are mostly its noise. With them 40 % of clicks were inside their 90 % ellipse.
        residual = residual - terrain.height_and_slope(points_enu_m[:, :2])[0]
    by_plane = -np.column_stack([np.ones(len(offset)), offset])
    return residual, by_point, by_plane


@dataclass(frozen=True, eq=False)
class RangePrior:
    """The end of a range finder's beam lies on the ground plane (over the terrain, if known). Equation (5.12)."""

    layout: Layout
    keyframe: NDArray[np.intp]  # (N,) whose view each belongs to
    vector_enu_m: Array  # (N, 3) from the camera to the ground
    sigma_m: Array  # (N,) of the height there, ground roughness included
    reference_enu_m: Array  # (3,) the plane's reference point
    terrain: Terrain | None = None

    def evaluate(self, state: State) -> tuple[Array, Array]:
        """Residual (N,), Jacobian (N, D)."""
        ends = state.centres_enu_m[self.keyframe] + self.vector_enu_m
        residual, by_end, by_plane = ground_plane(ends, self.reference_enu_m, state.plane, self.terrain)
        J = np.zeros((len(ends), self.layout.size))
        J[np.arange(len(ends))[:, None], self.layout.centres()[self.keyframe]] = by_end / self.sigma_m[:, None]
        J[:, self.layout.plane] = by_plane / self.sigma_m[:, None]
        return residual / self.sigma_m, J


Prior = SensorPrior | SharedPrior | RangePrior


def of_sensors(priors: Iterable[Prior]) -> list[SensorPrior]:
    """The priors that stem from a sensor's measurements, without the path that stands in for an attitude."""
    return [p for p in priors if isinstance(p, SensorPrior) and p.parts]
