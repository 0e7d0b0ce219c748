"""A click and a feature set -> a position with its error, or a refusal with its reason. No I/O.

A pixel's ray at unit depth is (x, y, 1); with r = R_enu_cam (x, y, 1) and inverse depth w its point is X = C + r / w.
To first order, with the nine common states of contract/feature_set.py and the click's own relative error e of w,

    dX = dC + dtheta x (r / w) - (r / w) (m0 + m1 x + m2 y + e)  =  J(x, y) s - (r / w) e,
    J = [ I,  -[r / w]x,  -(r / w) (1, x, y) ]                                              (3 x 9)

so that cov X = J S J' + (r / w)(r / w)' var e; towards the horizon terms of higher order widen it, (9.17). Between two
clicks the common states cancel through J1 - J2, (9.10), and kriging gives the covariance of e1 with e2. Between two
sets: ground/two_sets.py. Section 9 of docs/mathematics.md. Where a set states what one clicked pixel was measured at,
that and its own error stand for kriging's at this pixel, and nowhere else: (29.13).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contract.answer import CHI2_2, Answer, Ellipse, Fix, Refusal
from contract.feature_set import COMMON_STATES, DepthSource, FeatureSet, HeightDatum, Measured, Status
from contract.geodesy import LocalFrame
from contract.kriging import MIN_PLANE_SHARE, Kriging, distance_outside, distances_outside, hull_area, stretch
from contract.rolling_shutter import row_share
from contract.rotations import skew

Array = NDArray[np.float64]

# How far beyond the features' hull the plane is followed, as a share of the hull's size (the root of its area).
MAX_OUTSIDE = 0.35
MIN_FEATURES = 3
# A click whose inverse depth is less than this many sigmas from zero may as well be infinitely far.
MIN_INVERSE_DEPTH_SIGMAS = 3.0
# The longest semi-major axis (90 %) that is still an answer, as a share of the height above ground: (9.18).
MAX_ELLIPSE_SHARE = 0.3
SAME_PX = 1e-3  # a pixel and the same on the wire
GROUND_STEPS = 4  # to the ground below what was measured: each gains two digits
SHUTTER_STEPS = 2  # of the place that a pixel of another row than the middle has: the second moves it by microns


@dataclass(frozen=True, eq=False)
class _Located:
    """A click that met the ground: its unit-depth coordinates (2,), offset from the camera (m) and how it was found."""

    xy: Array
    offset_enu_m: Array
    relative: float  # d ln w / d r of kriging's prediction
    variance: Array  # of r (1, 1)
    method: str
    by_readout: Array = field(default_factory=lambda: np.zeros(3))  # d offset (m) / d readout (s) of the picture


@dataclass(frozen=True, eq=False)
class ErrorParts:
    """The parts of a click's error that are its own, to compare it with clicks of the spot in other pictures. (17.1)

    One sigma each of the relative inverse depth: the ground between the features, the features' noise. `by_pixel_m`
    (3, 2): how far the answer moves, east, north, up, for a pixel of u and of v.
    """

    between_features: float
    feature_noise: float
    by_pixel_m: Array


@dataclass(frozen=True, eq=False)
class Answers:
    """The answers of M pixels, each by itself: the numbers of M calls of `locate`, without its words.

    `offset_enu_m` (M, 3) is from the camera, `covariance_enu_m2` (M, 3, 3) its error's. `by_pixel_m` (M, 3, 2): how far
    the answer moves for a pixel of u and of v, on ground that slopes as the plane does. All of them are nan where
    `is_answered` (M,) is False.
    """

    offset_enu_m: Array
    covariance_enu_m2: Array
    by_pixel_m: Array
    is_answered: NDArray[np.bool_]


class Locator:
    """Answers clicks on one feature set. What does not depend on the click is solved once."""

    def __init__(self, feature_set: FeatureSet) -> None:
        self.feature_set = s = feature_set
        rays, valid = s.camera.unproject(s.uv_px)
        xy = rays[:, :2]
        plane = s.plane_per_m[0] + xy @ s.plane_per_m[1:]
        reach = max(float(np.max(plane, initial=0.0)), float(s.plane_per_m[0]))
        self._plane_floor = MIN_PLANE_SHARE * reach
        # Of the camera above the ground plane p'(X, Y, Z) = 1, at right angles to it: also over a mountainside.
        self._height_m = 1.0 / max(float(np.linalg.norm(s.plane_per_m)), 1e-9)
        usable = valid & (plane > self._plane_floor) & (s.sigma_inverse_depth_per_m > 0.0)
        xy, plane = xy[usable], plane[usable]
        self._has_ground = reach > 0.0 and (
            s.depth_source is DepthSource.PLANE or int(np.count_nonzero(usable)) >= MIN_FEATURES
        )
        self._kriging = Kriging(
            xy,
            s.inverse_depth_per_m[usable] / plane - 1.0,
            (s.sigma_inverse_depth_per_m[usable] / plane) ** 2,
            s.plane_per_m,
            s.roughness / stretch(xy, s.plane_per_m),
            s.plane_sigma_relative,
            is_surface=s.depth_source is not DepthSource.PARALLAX,
        )
        self._hull = self._kriging.hull
        self._max_outside = MAX_OUTSIDE * math.sqrt(hull_area(self._hull))
        known = not math.isnan(s.undulation_m)
        self._is_ellipsoidal = s.height_datum is HeightDatum.ELLIPSOID
        self._undulation_m = s.undulation_m if known else None
        shift = s.undulation_m if known and not self._is_ellipsoidal else 0.0
        # At the camera; its height is above the ellipsoid where that is known.
        self.frame = LocalFrame(s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m + shift)
        self._datum_shift_m = shift
        self._newest: tuple[tuple[float, float], _Located | Status] | None = None

    def locate(self, uv_px: ArrayLike, pixel_root: ArrayLike | None = None) -> Answer:
        """A pixel (2,) -> Fix or Refusal. `pixel_root` (2, k): a root of the pixel's own covariance, where it is not
        exact.
        """
        uv = np.asarray(uv_px, float)
        located = self._located(uv)
        if isinstance(located, Status):
            return self._refusal(located)
        covariance = self._covariance([located])
        if pixel_root is not None:
            moved = self._by_pixel(uv[None], np.array([1.0 / located.relative]))[0] @ np.asarray(pixel_root, float)
            covariance = covariance + moved @ moved.T
        ellipse = Ellipse.from_covariance(covariance[:2, :2])
        if not ellipse.semi_major_m <= MAX_ELLIPSE_SHARE * self._height_m:
            return self._refusal(Status.UNCERTAIN)
        s = self.feature_set
        lat, lon, height = (float(c) for c in self.frame.to_geodetic(located.offset_enu_m))
        height -= self._datum_shift_m
        n = self._undulation_m
        other = None if n is None else height - n if self._is_ellipsoidal else height + n
        return Fix(
            lat_deg=lat,
            lon_deg=lon,
            height_ellipsoid_m=height if self._is_ellipsoidal else other,
            height_amsl_m=other if self._is_ellipsoidal else height,
            ellipse=ellipse,
            sigma_height_m=math.sqrt(max(float(covariance[2, 2]), 0.0)),
            method=located.method,
            frame=s.frame,
            capture_unix_ns=s.capture_unix_ns,
            vehicle=s.vehicle,
            offset_enu_m=located.offset_enu_m,
            covariance_enu_m2=covariance,
            above_ground_m=None if (above := self._above_ground(located)) is None else above[0],
            sigma_above_ground_m=None if above is None else above[1],
            unmeasured=self._unmeasured(uv),
        )

    def offset(self, uv_px: ArrayLike) -> Array | Status:
        """The way (3,) from the camera to a pixel's place, east, north, up, m, without its error; or why there is none.

        Two thirds of the time that `locate` takes.
        """
        located = self._located(np.asarray(uv_px, float))
        return located if isinstance(located, Status) else located.offset_enu_m

    def difference_covariance(self, uv1_px: ArrayLike, uv2_px: ArrayLike) -> Array | None:
        """Covariance (3, 3), m^2, of the vector between two clicks of this set; None if one has no answer."""
        one, two = self._located(np.asarray(uv1_px, float)), self._located(np.asarray(uv2_px, float))
        if isinstance(one, Status) or isinstance(two, Status):
            return None
        joint = self._covariance([one, two])
        return joint[:3, :3] + joint[3:, 3:] - joint[:3, 3:] - joint[3:, :3]

    def error_parts(self, uv_px: ArrayLike) -> ErrorParts | None:
        """The parts of a click's error that are its own; None if it has no answer."""
        uv = np.asarray(uv_px, float)
        located = self._located(uv)
        if isinstance(located, Status):
            return None
        measured = located.method == Measured.MEASURED.value
        ground, noise = (0.0, float(located.variance[0, 0])) if measured else self.own_variances(located.xy)
        by_pixel = self._by_pixel(uv[None], np.array([1.0 / located.relative]))[0]
        return ErrorParts(located.relative * math.sqrt(ground), located.relative * math.sqrt(noise), by_pixel)

    def own_variances(self, xy: Array) -> tuple[float, float]:
        """Variances of a click's own inverse depth over the plane's, at unit-depth coordinates (2,): from the ground
        between the features, from the features' noise.
        """
        own = float(self._kriging.predict_each(xy[None])[1][0])
        noise = min(float(self._kriging.measured_variance(xy[None])[0]), own)
        return own - noise, noise

    def between_features(self, xy: Array) -> tuple[float, float]:
        """The ground's inverse depth at unit-depth coordinates (2,) over the plane's, less one, and its one sigma."""
        r, variance = self._kriging.predict_each(xy[None])
        return float(r[0]), math.sqrt(max(float(variance[0]), 0.0))

    def answers(self, uv_px: ArrayLike) -> Answers:
        """Many pixels (M, 2) at once, each by itself."""
        s, uv = self.feature_set, np.asarray(uv_px, float)
        rays, answered = s.camera.unproject(uv)
        nothing = np.full((len(uv), 3, 5), np.nan)
        if not (s.is_ok and self._has_ground):
            return Answers(nothing[:, :, 0], nothing[:, :, :3], nothing[:, :, :2], np.zeros(len(uv), bool))
        xy, late = self._at_middle_row(rays[:, :2], uv[:, 1])
        plane = s.plane_per_m[0] + xy @ s.plane_per_m[1:]
        answered &= plane > self._plane_floor
        if s.depth_source is not DepthSource.PLANE:
            answered &= distances_outside(self._hull, xy) <= self._max_outside
        r, variance = self._kriging.predict_each(xy)
        relative, variance = 1.0 + r, np.maximum(variance, 0.0)
        answered &= relative > MIN_INVERSE_DEPTH_SIGMAS * np.sqrt(variance)
        plane, relative = np.where(answered, plane, 1.0), np.where(answered, relative, 1.0)
        offset = _with_one(xy) @ s.R_enu_cam.T / (plane * relative)[:, None]
        covariance = self._covariances(xy, offset, relative, variance)
        if s.shutter is not None:
            steeper = (late @ s.plane_per_m[1:]) / plane
            moved = late @ s.R_enu_cam[:, :2].T / (plane * relative)[:, None] - offset * steeper[:, None]
            covariance = covariance + (moved[:, :, None] * moved[:, None]) * s.shutter.sigma_readout_s**2
        longest = np.sqrt(CHI2_2 * np.maximum(np.linalg.eigvalsh(covariance[:, :2, :2])[:, 1], 0.0))
        answered &= longest <= MAX_ELLIPSE_SHARE * self._height_m
        by_pixel = self._by_pixel(uv, relative)
        for found in (offset, covariance, by_pixel):
            found[~answered] = np.nan
        return Answers(offset, covariance, by_pixel, answered)

    def _by_pixel(self, uv_px: Array, relative: Array) -> Array:
        """The displacement (M, 3, 2), east, north, up, of the answers of pixels (M, 2) for a pixel of u and of v.

        The ground about each as the plane slopes, at the height that was found: `relative` (M,) is w / w_plane there.
        """
        s = self.feature_set
        steps = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
        rays, _ = s.camera.unproject(uv_px[:, None] + steps)
        w = (s.plane_per_m[0] + rays[..., :2] @ s.plane_per_m[1:]) * relative[:, None]
        about = (rays / np.maximum(w, self._plane_floor)[..., None]) @ s.R_enu_cam.T
        return np.stack([about[:, 0] - about[:, 1], about[:, 2] - about[:, 3]], axis=-1)

    def _covariances(self, xy: Array, offset: Array, relative: Array, variance: Array) -> Array:
        """Each click's own covariance (M, 3, 3), as `_covariance` has it of one; `variance` (M,) is kriging's."""
        count = len(xy)
        by_cause = np.concatenate([_jacobian(offset, xy), -(offset / relative[:, None])[:, :, None]], axis=2)
        by_depth = np.zeros((count, 1, COMMON_STATES + 1))
        by_depth[:, 0, 6:COMMON_STATES] = _with_one(xy)[:, [2, 0, 1]]
        by_depth[:, 0, COMMON_STATES] = 1.0 / relative
        causes = np.zeros((count, COMMON_STATES + 1, COMMON_STATES + 1))
        causes[:, :COMMON_STATES, :COMMON_STATES] = self.feature_set.common_cov
        causes[:, COMMON_STATES, COMMON_STATES] = variance
        out: Array = by_cause @ causes @ by_cause.transpose(0, 2, 1) + _curvature(by_cause, by_depth, causes)
        return out

    def _refusal(self, status: Status) -> Refusal:
        s = self.feature_set
        return Refusal(status, s.frame, s.capture_unix_ns, s.vehicle)

    def _located(self, uv_px: Array) -> _Located | Status:
        """A click's, and of the newest click once: a pin asks for its answer and then for the parts of its error."""
        key, newest = (float(uv_px[0]), float(uv_px[1])), self._newest
        if newest is None or newest[0] != key:
            newest = self._newest = key, self._found(uv_px)
        return newest[1]

    def _found(self, uv_px: Array) -> _Located | Status:
        s = self.feature_set
        if not s.is_ok:
            return s.status
        if not s.camera.contains(uv_px):
            return Status.OUTSIDE
        ray, valid = s.camera.unproject(uv_px)
        if not valid:
            return Status.OUTSIDE_CALIBRATION
        if not self._has_ground:
            return Status.POOR_FIT
        xy, late = (found[0] for found in self._at_middle_row(ray[None, :2], uv_px[None, 1]))
        plane = float(s.plane_per_m[0] + xy @ s.plane_per_m[1:])
        outside = distance_outside(self._hull, xy)
        method = s.depth_source.value
        if outside > 0.0:
            if s.depth_source is not DepthSource.PLANE and outside > self._max_outside:
                return Status.ABOVE_HORIZON if plane <= self._plane_floor else Status.OUTSIDE
            method = DepthSource.PLANE.value
        if plane <= self._plane_floor:
            return Status.ABOVE_HORIZON
        if (known := self._measured(uv_px)) is not None:
            r, variance, method = np.array([known[0] / plane - 1.0]), np.array([[(known[1] / plane) ** 2]]), known[2]
        else:
            r, variance = self._kriging.predict(xy[None])
        relative = 1.0 + float(r[0])
        if not relative > MIN_INVERSE_DEPTH_SIGMAS * math.sqrt(max(float(variance[0, 0]), 0.0)):
            return Status.ABOVE_HORIZON
        offset = s.R_enu_cam @ np.array([*xy, 1.0]) / (plane * relative)
        steeper = float(late @ s.plane_per_m[1:]) / plane
        by_readout = s.R_enu_cam[:, :2] @ late / (plane * relative) - offset * steeper
        return _Located(xy, offset, 1.0 / relative, variance, method, by_readout)

    def _measured(self, uv_px: Array) -> tuple[float, float, str] | None:
        """Inverse depth, sigma (1/m) and method of the pixel that was measured, if that is the one."""
        c = self.feature_set.clicked
        if c is None or not c.is_measured or not self._is_clicked(uv_px):
            return None
        return c.inverse_depth_per_m, c.sigma_per_m, c.measured.value

    def _is_clicked(self, uv_px: Array) -> bool:
        c = self.feature_set.clicked
        return c is not None and bool(np.abs(uv_px - (c.u_px, c.v_px)).max() < SAME_PX)

    def _unmeasured(self, uv_px: Array) -> str:
        """Return why the pixel that was asked for was not measured; empty for any other, and if it was."""
        c = self.feature_set.clicked
        return "" if c is None or c.is_measured or not self._is_clicked(uv_px) else c.measured.value

    def _above_ground(self, located: _Located) -> tuple[float, float] | None:
        """Height above the ground between the features at the same place, and its one sigma, of what was measured.

        (29.14)
        """
        if located.method != Measured.MEASURED.value:
            return None
        s, below = self.feature_set, located.offset_enu_m.copy()
        ground = located
        for _ in range(GROUND_STEPS):
            at = below @ s.R_enu_cam
            xy = at[:2] / at[2]
            plane = float(s.plane_per_m[0] + xy @ s.plane_per_m[1:])
            if at[2] <= 0.0 or plane <= self._plane_floor:
                return None
            r, variance = self._kriging.predict(xy[None])
            relative = 1.0 + float(r[0])
            if relative <= 0.0:
                return None
            met = s.R_enu_cam @ np.array([*xy, 1.0]) / (plane * relative)
            ground = _Located(xy, met, 1.0 / relative, variance, s.depth_source.value)
            # The ray meets the ground at another place than below the thing: the ground is level between both.
            below = np.array([*located.offset_enu_m[:2], met[2]])
        joint = self._covariance([located, ground])
        height_m = float(located.offset_enu_m[2] - ground.offset_enu_m[2])
        return height_m, math.sqrt(max(float(joint[2, 2] + joint[5, 5] - 2.0 * joint[2, 5]), 0.0))

    def _at_middle_row(self, xy: Array, v_px: Array) -> tuple[Array, Array]:
        """Move what pixels (M, 2) of these rows (M,) saw to the picture's moment; also return the derivative (M, 2) of
        that by the readout. (18.5)
        """
        s, out, moved = self.feature_set, xy, np.zeros_like(xy)
        if s.shutter is None:
            return out, moved
        share = np.asarray(row_share(v_px, s.camera.height_px))[:, None]
        for _ in range(SHUTTER_STEPS):
            plane = np.maximum(s.plane_per_m[0] + out @ s.plane_per_m[1:], self._plane_floor)
            r, _ = self._kriging.predict_each(out)
            moved = -share * s.shutter.image_velocity(out, plane * np.maximum(1.0 + r, 0.0))
            out = xy + s.shutter.readout_s * moved
        return out, moved

    def _covariance(self, clicks: list[_Located]) -> Array:
        """Joint covariance (3 M, 3 M) of the clicks' positions."""
        offset, xy = (
            np.array([located.offset_enu_m for located in clicks]),
            np.array([located.xy for located in clicks]),
        )
        J = _jacobian(offset, xy).reshape(-1, COMMON_STATES)
        own = clicks[0].variance if len(clicks) == 1 else self._own_covariance(clicks, xy)
        spread = np.zeros((3 * len(clicks), len(clicks)))
        by_depth = np.zeros((len(clicks), COMMON_STATES + len(clicks)))
        for i, click in enumerate(clicks):
            spread[3 * i : 3 * i + 3, i] = -click.offset_enu_m * click.relative
            by_depth[i, 6:COMMON_STATES] = [1.0, *click.xy]
            by_depth[i, COMMON_STATES + i] = click.relative
        causes = np.zeros((by_depth.shape[1], by_depth.shape[1]))
        causes[:COMMON_STATES, :COMMON_STATES] = self.feature_set.common_cov
        causes[COMMON_STATES:, COMMON_STATES:] = own
        by_cause = np.concatenate([J, spread], axis=1)
        out: Array = by_cause @ causes @ by_cause.T + _curvature(by_cause, by_depth, causes)
        if self.feature_set.shutter is not None:
            moved = np.concatenate([click.by_readout for click in clicks]) * self.feature_set.shutter.sigma_readout_s
            out = out + np.outer(moved, moved)
        return out

    def _own_covariance(self, clicks: list[_Located], xy: Array) -> Array:
        """Return the covariance (M, M) of several clicks' r: kriging's; a measured pixel shares nothing with it."""
        own = self._kriging.predict(xy)[1]
        measured = np.array([click.method == Measured.MEASURED.value for click in clicks])
        own[measured, :] = own[:, measured] = 0.0
        if measured.any():  # there is one measured pixel: however often it is clicked, it is the same error
            own[np.ix_(measured, measured)] = max(
                float(click.variance[0, 0]) for click in clicks if click.method == Measured.MEASURED.value
            )
        return own


def _curvature(by_cause: Array, by_depth: Array, causes: Array) -> Array:
    """The terms (..., 3 M, 3 M) that a linear covariance of M clicks lacks where ln w is not known well. (9.16), (9.17)

    `by_cause` (..., 3 M, N) moves the positions, `by_depth` (..., M, N) u = d ln w; `causes` (..., N, N) is the
    covariance of both. Never negative: an answer is not made surer.
    """
    turned = by_cause.copy()
    turned[..., :3] = 0.0  # dC is not divided by anything
    u = np.repeat(by_depth, 3, axis=-2)  # each click's u for each of its coordinates
    by_u, by_turned = causes @ np.swapaxes(u, -1, -2), causes @ np.swapaxes(turned, -1, -2)
    uu, vu, vv = u @ by_u, turned @ by_u, turned @ by_turned
    own = np.diagonal(uu, axis1=-2, axis2=-1)[..., None, :]  # var u
    vu_own = np.diagonal(vu, axis1=-2, axis2=-1)[..., None, :]  # cov(v, u) of the same click
    au = by_cause @ by_u
    third = by_cause @ by_turned * own + 2.0 * au * vu_own
    total = uu * vv + np.swapaxes(vu_own, -1, -2) * vu_own + vu * np.swapaxes(vu, -1, -2)
    total = total + third + np.swapaxes(third, -1, -2)
    values, vectors = np.linalg.eigh(total)
    out: Array = (vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return out


def _with_one(xy: Array) -> Array:
    """(x, y, 1) of each (x, y), (M, 3)."""
    return np.concatenate([xy, np.ones((len(xy), 1))], axis=1)


def _jacobian(offset: Array, xy: Array) -> Array:
    """d X / d common states of clicks at offsets (M, 3) and x, y (M, 2), (M, 3, 9)."""
    ones = np.broadcast_to(np.eye(3), (len(xy), 3, 3))
    return np.concatenate([ones, -skew(offset), -offset[:, :, None] * _with_one(xy)[:, None, [2, 0, 1]]], axis=2)


def locate(feature_set: FeatureSet, uv_px: ArrayLike) -> Answer:
    """One click on one set. For several clicks keep a `Locator`."""
    return Locator(feature_set).locate(uv_px)


def pixels_of(feature_set: FeatureSet, offset_enu_m: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Pixels (N, 2) of places (N, 3) from the camera, ENU, m; and which are ahead and where the lens is calibrated.

    A pixel may be off the picture.
    """
    s = feature_set
    X = offset_enu_m @ np.asarray(s.R_enu_cam, float)
    usable = X[:, 2] > 1e-6
    w = 1.0 / np.where(usable, X[:, 2], 1.0)
    xy = X[:, :2] * w[:, None]
    usable &= np.hypot(*xy.T) <= s.camera.max_radius
    xy = np.where(usable[:, None], xy, 0.0)
    scale, shift = (s.camera.fx_px, s.camera.fy_px), (s.camera.cx_px, s.camera.cy_px)
    uv: Array = s.camera.distort(xy) * scale + shift
    if s.shutter is not None:
        for _ in range(SHUTTER_STEPS):  # (18.5), from place to pixel
            late_s = s.shutter.readout_s * np.asarray(row_share(uv[:, 1], s.camera.height_px))[:, None]
            uv = s.camera.distort(xy + late_s * s.shutter.image_velocity(xy, w)) * scale + shift
    return uv, usable
