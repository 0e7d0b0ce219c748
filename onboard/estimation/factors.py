"""Whitened residuals with analytic Jacobians, one plain function each. Equations: docs/mathematics.md, section 5.

The unknowns are laid out by `Layout`: six columns a keyframe (rotation `d`, R_cam_enu <- exp([d]x) R_cam_enu, rad; then
centre, ENU metres), then what is estimated of the platform (boresight in camera axes, rad; the camera's time offset and
the delays of position and velocity, s; the heading's error that depends on heading, rad), of the camera itself
(`camera_states`), the ground plane (height m at the reference point, slope east, slope north), and, where rows are read
one after the other and nothing measures it, what each picture's angular rate is off by (rad/s, camera axes). Points are
eliminated and have no column here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from contract.rotations import exp_so3, log_so3, right_jacobian_inverse, skew

if TYPE_CHECKING:
    from onboard.estimation.variance_components import Parts

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Layout:
    """Columns of the reduced system for K keyframes, with so many of the camera's own (`camera_states`)."""

    keyframes: int
    camera_states: int = 0
    has_rates: bool = False  # of the pictures: `Layout.rates`
    has_waves: bool = False  # likewise: `Layout.waves`

    @property
    def boresight(self) -> slice:
        """Three columns, rad, camera axes."""
        return slice(6 * self.keyframes, 6 * self.keyframes + 3)

    @property
    def offset(self) -> int:
        """One column, s: the camera's stamps are early by this much."""
        return 6 * self.keyframes + 3

    @property
    def delay(self) -> int:
        """One column, s: the position is older than its stamp by this much more than configured."""
        return 6 * self.keyframes + 4

    @property
    def velocity_delay(self) -> int:
        """One column, s: the same of the velocity."""
        return 6 * self.keyframes + 5

    @property
    def heading(self) -> slice:
        """Two columns, rad: the heading's error is their product with the cosine and the sine of the heading."""
        return slice(6 * self.keyframes + 6, 6 * self.keyframes + 8)

    @property
    def camera(self) -> slice:
        """The camera's own, in the order of `camera_states.NAMES`; none where the camera is taken as it is."""
        return slice(6 * self.keyframes + 8, 6 * self.keyframes + 8 + self.camera_states)

    @property
    def shared(self) -> slice:
        """Boresight, time offset, delays, heading error, camera and plane."""
        return slice(6 * self.keyframes, 6 * self.keyframes + 11 + self.camera_states)

    @property
    def plane(self) -> slice:
        """Three columns: height (m), slope east, slope north."""
        first = 6 * self.keyframes + 8 + self.camera_states
        return slice(first, first + 3)

    @property
    def size(self) -> int:
        """All columns."""
        each = 6 + 3 * self.has_rates + 6 * self.has_waves
        return each * self.keyframes + 11 + self.camera_states

    @property
    def rates(self) -> NDArray[np.intp]:
        """Column numbers (K, 3) of what the pictures' rates are off by, rad/s; (0, 3) where they are measured."""
        first = self.shared.stop
        return np.arange(first, first + 3 * self.keyframes * self.has_rates).reshape(-1, 3)

    @property
    def waves(self) -> NDArray[np.intp]:
        """Column numbers (K, 6) of what the pictures' rows swing by, rad; (0, 6) where they are not seen to."""
        return np.arange(self.size - 6 * self.keyframes * self.has_waves, self.size).reshape(-1, 6)

    @property
    def by_picture(self) -> NDArray[np.intp]:
        """Column numbers (K, M) of rates and waves together; (0, 0) without either."""
        found = [c for c in (self.rates, self.waves) if len(c)]
        return np.concatenate(found, axis=1) if found else np.zeros((0, 0), np.intp)

    def rotation(self, keyframe: int) -> slice:
        """Three columns, rad."""
        return slice(6 * keyframe, 6 * keyframe + 3)

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
    boresight_rad: Array  # (3,)
    offset_s: float
    plane: Array  # (3,) height m, slope east, slope north, about the reference point
    delay_s: float = 0.0  # the position is older than its stamp by this much more than configured
    velocity_delay_s: float = 0.0  # the same of the velocity
    heading_rad: Array = field(default_factory=lambda: np.zeros(2))  # (2,) see `Layout.heading`
    camera: Array = field(default_factory=lambda: np.zeros(0))  # deviations from the camera file, see `Layout.camera`
    rates_rad_s: Array = field(default_factory=lambda: np.zeros((0, 3)))  # (K, 3) or (0, 3), see `Layout.rates`
    waves_rad: Array = field(default_factory=lambda: np.zeros((0, 6)))  # (K, 6) or (0, 6), see `Layout.waves`

    def retract(self, dc: Array, dp: Array) -> State:
        """Apply a step: dc (Layout.size,), dp (P, 3)."""
        K = len(self.R_cam_enu)
        pose = dc[: 6 * K].reshape(K, 6)
        end = 11 + len(self.camera)
        shared, rates, waves = np.split(dc[6 * K :], [end, end + self.rates_rad_s.size])
        return State(
            exp_so3(pose[:, :3]) @ self.R_cam_enu,
            self.centres_enu_m + pose[:, 3:],
            self.points_enu_m + dp,
            self.boresight_rad + shared[:3],
            self.offset_s + float(shared[3]),
            self.plane + shared[-3:],
            self.delay_s + float(shared[4]),
            self.velocity_delay_s + float(shared[5]),
            self.heading_rad + shared[6:8],
            self.camera + shared[8:-3],
            self.rates_rad_s + rates.reshape(-1, 3),
            self.waves_rad + waves.reshape(-1, 6),
        )

    @property
    def platform(self) -> Array:
        """(8 + camera states,) what is estimated of the platform, in the order of `boresight.STATES`."""
        times_s = [self.offset_s, self.delay_s, self.velocity_delay_s]
        return np.concatenate([self.boresight_rad, times_s, self.heading_rad, self.camera])

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


def lasting_sigma(stamps_s: Array, sigma_gauss_markov: float, time_constant_s: float) -> float:
    """One sigma of the largest constant that a Gauss-Markov error at `stamps_s` (K,), in order, contains, (9.11)."""
    parts = np.tanh(np.diff(stamps_s) / (2.0 * time_constant_s))
    return float(sigma_gauss_markov / np.sqrt(1.0 + parts.sum()))


@dataclass(frozen=True, eq=False)
class PositionPrior:
    """Positions with Gauss-Markov and white error, moved along the velocity by time offset and delay. (5.4)"""

    layout: Layout
    measured_enu_m: Array  # (K, 3)
    velocity_enu_m_s: Array  # (K, 3)
    whitener: Array  # (3, K, K): east, north, up
    offset_s: Array  # (K,) time offset plus delay at which each was taken
    lasting: Array = field(default_factory=lambda: np.zeros(3))  # one sigma (m) of what all K share, (9.11)
    lever_cam_m: Array = field(default_factory=lambda: np.zeros(3))  # from the autopilot's reference point
    parts: Parts | None = None  # of the covariance that `whitener` whitens

    def evaluate(self, state: State) -> tuple[Array, Array]:
        """Residual (3K,), Jacobian (3K, D)."""
        at, by_rotation = state.antennas_enu_m(self.lever_cam_m)
        moved_s = state.offset_s + state.delay_s - self.offset_s
        error = at - self.measured_enu_m - self.velocity_enu_m_s * moved_s[:, None]
        J = self._jacobian
        if self.lever_cam_m.any():
            J = J.copy()
            for axis in range(3):
                columns = self.layout.rotations()
                J.reshape(3, len(error), -1)[axis][:, columns] += (
                    self.whitener[axis][:, :, None] * by_rotation[None, :, axis]
                )
        return np.matmul(self.whitener, error.T[:, :, None]).reshape(-1), J

    @cached_property
    def _jacobian(self) -> Array:
        K = self.layout.keyframes
        J = np.zeros((3, K, self.layout.size))
        columns = self.layout.centres()
        for axis in range(3):
            J[axis][:, columns[:, axis]] = self.whitener[axis]
            by_time = -self.whitener[axis] @ self.velocity_enu_m_s[:, axis]
            J[axis][:, self.layout.offset] = J[axis][:, self.layout.delay] = by_time
        return J.reshape(3 * K, -1)


@dataclass(frozen=True, eq=False)
class VelocityPrior:
    """Displacements between consecutive keyframes from integrated velocity. Equation (5.6).

    Its error is a white part, a Gauss-Markov part and a delay of the velocity's own: a navigation filter that is told
    a wrong GPS delay has its position behind by all of it and its velocity by a part. In a turn the displacement
    changes when the interval moves by time offset and delay.
    """

    layout: Layout
    displacement_enu_m: Array  # (K - 1, 3)
    whitener: Array  # (3, K - 1, K - 1): east, north, up
    gained_m_s: Array  # (K - 1, 3) velocity at the interval's end less that at its beginning
    offset_s: Array  # (K - 1,) time offset plus the velocity's delay at which each was taken
    lever_cam_m: Array = field(default_factory=lambda: np.zeros(3))  # from the autopilot's reference point
    parts: Parts | None = None  # of the covariance that `whitener` whitens

    def evaluate(self, state: State) -> tuple[Array, Array]:
        """Residual (3 (K - 1),), Jacobian (3 (K - 1), D)."""
        at, by_rotation = state.antennas_enu_m(self.lever_cam_m)
        later = self.gained_m_s * (state.offset_s + state.velocity_delay_s - self.offset_s)[:, None]
        error = at[1:] - at[:-1] - self.displacement_enu_m - later
        J = self._jacobian
        if self.lever_cam_m.any():
            J = J.copy()
            rows = J.reshape(3, len(error), -1)
            columns = self.layout.rotations()
            for axis in range(3):
                w = self.whitener[axis][:, :, None]
                rows[axis][:, columns[1:]] += w * by_rotation[None, 1:, axis]
                rows[axis][:, columns[:-1]] -= w * by_rotation[None, :-1, axis]
        return np.matmul(self.whitener, error.T[:, :, None]).reshape(-1), J

    @cached_property
    def _jacobian(self) -> Array:
        n = self.layout.keyframes - 1
        J = np.zeros((3, n, self.layout.size))
        columns = self.layout.centres()
        for axis in range(3):
            J[axis][:, columns[1:, axis]] += self.whitener[axis]
            J[axis][:, columns[:-1, axis]] -= self.whitener[axis]
            by_time = -self.whitener[axis] @ self.gained_m_s[:, axis]
            J[axis][:, self.layout.offset] = J[axis][:, self.layout.velocity_delay] = by_time
        return J.reshape(3 * n, -1)


@dataclass(frozen=True, eq=False)
class AttitudePrior:
    """The autopilot's attitude through mount and boresight; Gauss-Markov and white error in ENU axes. (5.7), (5.17)"""

    layout: Layout
    R_enu_cam_measured: Array  # (K, 3, 3) vehicle attitude times nominal mount
    body_rate_cam_rad_s: Array  # (K, 3) vehicle rate in camera axes, for the time offset
    whitener: Array  # (3, K, K): about east, north, up
    offset_s: Array  # (K,) time offset at which each was taken
    lasting: Array = field(default_factory=lambda: np.zeros(3))  # one sigma (rad) of what all K share, (9.11)
    by_heading: Array | None = None  # (K, 2) cosine and sine of each heading; None: no error depends on it
    parts: Parts | None = None  # of the covariance that `whitener` whitens

    def evaluate(self, state: State) -> tuple[Array, Array]:
        """Residual (3K,), Jacobian (3K, D)."""
        K = self.layout.keyframes
        turned = self.body_rate_cam_rad_s * (state.offset_s - self.offset_s)[:, None]
        both = exp_so3(np.concatenate([turned, state.boresight_rad[None]]))  # one call: this is the inner loop
        turn, tilt = both[:-1], both[-1]
        R_enu_cam = self.R_enu_cam_measured @ turn @ tilt
        if self.by_heading is not None:
            about_up = -(self.by_heading @ state.heading_rad)[:, None] * np.array([0.0, 0.0, 1.0])
            R_enu_cam = exp_so3(about_up) @ R_enu_cam
        # In camera axes: log(R_cam_enu R_enu_cam). Its derivatives: Jl^-1 = Jr^-1(-e) on the left, Jr^-1 on the right.
        error_cam = log_so3(state.R_cam_enu @ R_enu_cam)
        inverses = right_jacobian_inverse(np.concatenate([error_cam, state.boresight_rad[None]]))
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
        J[:, :, self.layout.boresight] = self.whitener @ by_boresight.transpose(1, 0, 2)
        J[:, :, self.layout.offset] = (self.whitener @ by_offset.transpose(1, 0, 2))[..., 0]
        if self.by_heading is not None:
            by_yaw = -inner @ R_enu_cam[:, 2, :, None] * self.by_heading[:, None, :]
            J[:, :, self.layout.heading] = self.whitener @ by_yaw.transpose(1, 0, 2)
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
