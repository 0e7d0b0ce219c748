"""Whitened residuals with analytic Jacobians, one plain function each. Equations: docs/mathematics.md, section 5.

The unknowns are laid out by `Layout`: six columns a keyframe (rotation `d`, R_cam_enu <- exp([d]x) R_cam_enu, rad; then
centre, ENU metres), then what is estimated of the platform and of its camera (`platform_states`), the ground plane
(height m at the reference point, slope east, slope north), and each picture's own image states (`image_blocks`),
picture by picture. Points are eliminated and have no column here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from contract.rotations import exp_so3, log_so3, right_jacobian_inverse, skew
from onboard.estimation.platform_states import BORESIGHT, DELAY, HEADING, OFFSET, PLANE, STATES, VELOCITY_DELAY

Array = NDArray[np.float64]
# The covariance of one sensor's errors by axis: each maps a part's name to its (n, n), as the window weighs it.
Parts = tuple[Mapping[str, Array], Mapping[str, Array], Mapping[str, Array]]

# A picture's own image states, by block: what its angular rate is off by (rad/s, camera axes), the cosines and sines
# that its rows swing by (rad), how far its frame is shifted (focal lengths), by what logarithm its lens is longer.
RATES, WAVES, SHIFT, ZOOM = "rates", "waves", "shift", "zoom"
OWN_STATES = {RATES: 3, WAVES: 6, SHIFT: 2, ZOOM: 1}


@dataclass(frozen=True)
class Layout:
    """Columns of the reduced system for K keyframes, with so many of the camera's own (`camera_states`)."""

    keyframes: int
    camera_states: int = 0
    blocks: tuple[str, ...] = ()  # of each picture's own image states: keys of `OWN_STATES`

    @property
    def shared(self) -> slice:
        """What all pictures share: the platform's and the camera's states (`platform_states`), and the plane's."""
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
        """All columns."""
        shared: int = self.shared.stop
        return shared + self.keyframes * self.own

    @property
    def own(self) -> int:
        """How many image states each picture has."""
        return sum(OWN_STATES[name] for name in self.blocks)

    @property
    def by_picture(self) -> NDArray[np.intp]:
        """Column numbers (K, M) of the pictures' own image states."""
        return np.arange(self.shared.stop, self.size).reshape(self.keyframes, self.own)

    def part(self, block: str) -> slice:
        """Which of a picture's own image states are a block's; an empty slice where there is no such block."""
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

    def retract(self, dc: Array, dp: Array) -> State:
        """Apply a step: dc (Layout.size,), dp (P, 3)."""
        K, shared = len(self.R_cam_enu), len(self.platform)
        pose, platform, plane, own = np.split(dc, np.cumsum([6 * K, shared, PLANE]))
        pose = pose.reshape(K, 6)
        return State(
            exp_so3(pose[:, :3]) @ self.R_cam_enu,
            self.centres_enu_m + pose[:, 3:],
            self.points_enu_m + dp,
            self.platform + platform,
            self.plane + plane,
            self.own + own.reshape(self.own.shape),
        )

    def with_block(self, layout: Layout, block: str) -> State:
        """The same with a block's states at zero; `layout` has the block last."""
        others = self.own[:, : layout.own - OWN_STATES[block]]
        return replace(self, own=np.pad(others, ((0, 0), (0, OWN_STATES[block]))))

    def antennas_enu_m(self, lever_cam_m: Array) -> tuple[Array, Array]:
        """Where the autopilot's reference points are (K, 3), and their derivative by the views' rotation (K, 3, 3).

        `lever_cam_m` (3,) leads from that point to the camera, camera axes. Equation (5.14).
        """
        R_enu_cam = self.R_cam_enu.transpose(0, 2, 1)
        return self.centres_enu_m - R_enu_cam @ lever_cam_m, -R_enu_cam @ skew(lever_cam_m)


def reprojection(R_cam_enu: Array, centres_enu_m: Array, points_enu_m: Array, xy: Array) -> tuple[Array, Array, Array]:
    """Image residuals of every point in every view, (5.1), in normalised image coordinates.

    Points run along the last axis, for speed.

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
    """Of (5.1), times `scale` (K, P): by the view's rotation and by the point, both (K, 3, 2, P). (5.2), (5.3).

    By the view's centre it is minus that by the point.
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
    stamps_s: Array, sigma_white: float | Array, sigma_gauss_markov: float, time_constant_s: float
) -> Array:
    """Lower-triangular whitener (K, K) of an error with a white and a first-order Gauss-Markov part, (5.5).

    One axis of K measurements at `stamps_s` (s): covariance sigma_gauss_markov^2 exp(-|dt| / tau) + sigma_white^2 I;
    `sigma_white` may differ from measurement to measurement, (K,).
    """
    slow = gauss_markov_covariance(stamps_s, sigma_gauss_markov, time_constant_s)
    return whitener_of(slow + np.square(sigma_white) * np.eye(len(stamps_s)))


def gauss_markov_covariance(stamps_s: Array, sigma: float, time_constant_s: float) -> Array:
    """Covariance (K, K) of a first-order Gauss-Markov error at `stamps_s` (K,)."""
    lag = np.abs(stamps_s[:, None] - stamps_s[None, :])
    out: Array = sigma**2 * np.exp(-lag / time_constant_s)
    return out


def whitener_of(covariance: Array) -> Array:
    """The lower-triangular matrix (K, K) that whitens errors of this covariance."""
    inverse: Array = np.linalg.inv(np.linalg.cholesky(covariance))
    return inverse


def persistent_sigma(stamps_s: Array, sigma_gauss_markov: float, time_constant_s: float) -> float:
    """One sigma of the largest constant that a Gauss-Markov error at `stamps_s` (K,), in order, contains, (9.11)."""
    parts = np.tanh(np.diff(stamps_s) / (2.0 * time_constant_s))
    return float(sigma_gauss_markov / np.sqrt(1.0 + parts.sum()))


@dataclass(frozen=True, eq=False)
class PathPrior(ABC):
    """What telemetry measures of the path: n linear functions of the K places where the autopilot's reference point is.

    They move by `moved_m_s` with time offset and delay.
    """

    layout: Layout
    measured_enu_m: Array  # (n, 3)
    moved_m_s: Array  # (n, 3)
    whitener: Array  # (3, n, n): east, north, up
    offset_s: Array  # (n,) time offset plus delay at which each was taken
    persistent: Array = field(default_factory=lambda: np.zeros(3))  # one sigma (m) of what all share, (9.11)
    lever_cam_m: Array = field(default_factory=lambda: np.zeros(3))  # from the autopilot's reference point
    parts: Parts | None = None  # of the covariance that `whitener` whitens
    delay: ClassVar[int]  # which of the platform's states it is late by

    @staticmethod
    @abstractmethod
    def of_places(places: Array) -> Array:
        """What it measures (n, ...) of places (K, ...)."""

    def evaluate(self, state: State) -> tuple[Array, Array]:
        """Residual (3n,), Jacobian (3n, D)."""
        at, by_rotation = state.antennas_enu_m(self.lever_cam_m)
        moved_s = state.platform[OFFSET] + state.platform[self.delay] - self.offset_s
        error = self.of_places(at) - self.measured_enu_m - self.moved_m_s * moved_s[:, None]
        J = self._jacobian
        if self.lever_cam_m.any():
            J = J.copy()
            columns = self.layout.rotations()
            for axis, rows in enumerate(J.reshape(3, len(error), -1)):
                rows[:, columns] += self._by_place[axis][:, :, None] * by_rotation[None, :, axis]
        return np.matmul(self.whitener, error.T[:, :, None]).reshape(-1), J

    @cached_property
    def _by_place(self) -> Array:
        """(3, n, K) of whitened rows, by each place's own axis."""
        out: Array = self.whitener @ self.of_places(np.eye(self.layout.keyframes))
        return out

    @cached_property
    def _jacobian(self) -> Array:
        J = np.zeros((3, len(self.measured_enu_m), self.layout.size))
        columns = self.layout.centres()
        for axis in range(3):
            J[axis][:, columns[:, axis]] = self._by_place[axis]
            by_time = -self.whitener[axis] @ self.moved_m_s[:, axis]
            J[axis][:, self.layout.platform][:, [OFFSET, self.delay]] = by_time[:, None]
        return J.reshape(-1, self.layout.size)


class PositionPrior(PathPrior):
    """Positions with Gauss-Markov and white error, moved along the velocity by time offset and delay. (5.4)"""

    delay = DELAY

    @staticmethod
    def of_places(places: Array) -> Array:
        """The places themselves."""
        return places


class VelocityPrior(PathPrior):
    """Displacements between consecutive keyframes from integrated velocity. Equation (5.6).

    Its error is a white part, a Gauss-Markov part and a delay of the velocity's own: a navigation filter that is given
    a wrong GPS delay has its position behind by all of it and its velocity by a part. In a turn the displacement
    changes when the interval moves by time offset and delay: by the velocity that it gains.
    """

    delay = VELOCITY_DELAY

    @staticmethod
    def of_places(places: Array) -> Array:
        """From each to the next."""
        return np.diff(places, axis=0)


@dataclass(frozen=True, eq=False)
class AttitudePrior:
    """The autopilot's attitude through mount and boresight; Gauss-Markov and white error in ENU axes. (5.7), (5.17)"""

    layout: Layout
    R_enu_cam_measured: Array  # (K, 3, 3) vehicle attitude times nominal mount
    body_rate_cam_rad_s: Array  # (K, 3) vehicle rate in camera axes, for the time offset
    whitener: Array  # (3, K, K): about east, north, up
    offset_s: Array  # (K,) time offset at which each was taken
    persistent: Array = field(default_factory=lambda: np.zeros(3))  # one sigma (rad) of what all K share, (9.11)
    by_heading: Array | None = None  # (K, 2) cosine and sine of each heading; None: no error depends on it
    parts: Parts | None = None  # of the covariance that `whitener` whitens

    def evaluate(self, state: State) -> tuple[Array, Array]:
        """Residual (3K,), Jacobian (3K, D)."""
        K = self.layout.keyframes
        boresight_rad = state.platform[None, BORESIGHT]
        turned = self.body_rate_cam_rad_s * (state.platform[OFFSET] - self.offset_s)[:, None]
        both = exp_so3(np.concatenate([turned, boresight_rad]))  # one call: this is the inner loop
        turn, tilt = both[:-1], both[-1]
        R_enu_cam = self.R_enu_cam_measured @ turn @ tilt
        if self.by_heading is not None:
            about_up = -(self.by_heading @ state.platform[HEADING])[:, None] * np.array([0.0, 0.0, 1.0])
            R_enu_cam = exp_so3(about_up) @ R_enu_cam
        # In camera axes: log(R_cam_enu R_enu_cam). Its derivatives: Jl^-1 = Jr^-1(-e) on the left, Jr^-1 on the right.
        error_cam = log_so3(state.R_cam_enu @ R_enu_cam)
        inverses = right_jacobian_inverse(np.concatenate([error_cam, boresight_rad]))
        right = inverses[:-1]
        R_out = self.R_enu_cam_measured
        inner = R_out @ right
        by_rotation = R_out @ right.transpose(0, 2, 1)
        by_boresight = inner @ np.linalg.inv(inverses[-1])
        # exp(w t) on the inner side of exp(b): d exp(w t) = exp(w t) [w dt]x, carried through exp(b).
        by_offset = inner @ (self.body_rate_cam_rad_s @ tilt)[:, :, None]
        error = R_out @ error_cam[:, :, None]
        residual = np.matmul(self.whitener, error.transpose(1, 0, 2))
        J = np.zeros((3, K, self.layout.size))
        by_view = J[:, :, : 6 * K].reshape(3, K, K, 6)
        by_view[..., :3] = self.whitener[..., None] * by_rotation.transpose(1, 0, 2)[:, None]
        by_platform = J[:, :, self.layout.platform]
        by_platform[:, :, BORESIGHT] = self.whitener @ by_boresight.transpose(1, 0, 2)
        by_platform[:, :, OFFSET] = (self.whitener @ by_offset.transpose(1, 0, 2))[..., 0]
        if self.by_heading is not None:
            by_yaw = -inner @ R_enu_cam[:, 2, :, None] * self.by_heading[:, None, :]
            by_platform[:, :, HEADING] = self.whitener @ by_yaw.transpose(1, 0, 2)
        return residual.reshape(-1), J.reshape(3 * K, -1)


@dataclass(frozen=True, eq=False)
class SharedPrior:
    """Prior of what all pictures of the window share, (5.8), in the layout's order: mean (S,), whitener (S, S)."""

    layout: Layout
    mean: Array
    whitener: Array

    def evaluate(self, state: State) -> tuple[Array, Array]:
        """Residual (S,), Jacobian (S, D)."""
        value = np.concatenate([state.platform, state.plane])
        return self.whitener @ (value - self.mean), self._jacobian

    @cached_property
    def _jacobian(self) -> Array:
        J = np.zeros((len(self.mean), self.layout.size))
        J[:, self.layout.shared] = self.whitener
        return J


class HeightModel(Protocol):
    """A ground known beforehand, in the window's frame."""

    def height_and_slope(self, xy_enu_m: Array) -> tuple[Array, Array]:
        """Heights (P,) m and slopes east, north (P, 2) at places (P, 2)."""


def ground_plane(
    points_enu_m: Array, reference_enu_m: Array, plane: Array, terrain: HeightModel | None = None
) -> tuple[Array, Array, Array]:
    """Height of points (P, 3) over the plane about a reference point, (5.9); over terrain plus plane if there is one.

    Returns residual (P,) in metres, Jacobian by the point (P, 3) and by the plane (P, 3).
    """
    offset = points_enu_m[:, :2] - reference_enu_m[:2]
    residual = points_enu_m[:, 2] - reference_enu_m[2] - plane[0] - offset @ plane[1:]
    by_point = np.tile([-plane[1], -plane[2], 1.0], (len(offset), 1))
    if terrain is not None:
        # Heights only. The slopes of an elevation model are mostly its own noise, and as derivatives they would tie
        # points sideways to bumps that are not there: 40 % of clicks were then inside their 90 % ellipse.
        height, _ = terrain.height_and_slope(points_enu_m[:, :2])
        residual = residual - height
    by_plane = np.concatenate([-np.ones((len(offset), 1)), -offset], axis=1)
    return residual, by_point, by_plane


@dataclass(frozen=True, eq=False)
class RangePrior:
    """The end of a range finder's beam lies on the ground plane (over the terrain, if known). Equation (5.12)."""

    layout: Layout
    keyframe: NDArray[np.intp]  # (N,) whose view each belongs to
    vector_enu_m: Array  # (N, 3) from the camera to the ground
    sigma_m: Array  # (N,) of the height there, ground roughness included
    reference_enu_m: Array  # (3,) the plane's reference point
    terrain: HeightModel | None = None

    def evaluate(self, state: State) -> tuple[Array, Array]:
        """Residual (N,), Jacobian (N, D)."""
        ends = state.centres_enu_m[self.keyframe] + self.vector_enu_m
        residual, by_end, by_plane = ground_plane(ends, self.reference_enu_m, state.plane, self.terrain)
        J = np.zeros((len(ends), self.layout.size))
        J[np.arange(len(ends))[:, None], self.layout.centres()[self.keyframe]] = by_end / self.sigma_m[:, None]
        J[:, self.layout.plane] = by_plane / self.sigma_m[:, None]
        return residual / self.sigma_m, J


Prior = PositionPrior | VelocityPrior | AttitudePrior | SharedPrior | RangePrior
