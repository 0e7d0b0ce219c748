"""A click and a feature set -> a position with its error, or a refusal with its reason. No I/O.

A pixel's ray at unit depth is (x, y, 1); with r = R_enu_cam (x, y, 1) and inverse depth w its point is X = C + r / w.
To first order, with the nine common states of contract/feature_set.py and the click's own relative error e of w,

    dX = dC + dtheta x (r / w) - (r / w) (m0 + m1 x + m2 y + e)  =  J(x, y) s - (r / w) e,
    J = [ I,  -[r / w]x,  -(r / w) (1, x, y) ]                                              (3 x 9)

so that cov X = J S J' + (r / w)(r / w)' var e; towards the horizon terms of higher order widen it, (9.17). Between two
clicks the common states cancel through J1 - J2, (9.10), and kriging gives the covariance of e1 with e2. Between two
sets: ground/two_sets.py. Section 9 of docs/mathematics.md. Where a set states what one clicked pixel was measured at,
that and its own error stand for kriging's at this pixel, and nowhere else: (29.17).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contract.answer import CHI2_2, Answer, Ellipse, Fix, Refusal
from contract.feature_set import COMMON_STATES, DepthSource, FeatureSet, HeightDatum, Measured, Status
from contract.geodesy import LocalFrame
from contract.kriging import MIN_PLANE_SHARE, Kriging, distances_outside, hull_area, stretch
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
STATUSES = tuple(Status)
OK, OUTSIDE, ABOVE_HORIZON = Status.OK.code, Status.OUTSIDE.code, Status.ABOVE_HORIZON.code
SHUTTER_STEPS = 2  # of the place that a pixel of another row than the middle has: the second moves it by microns


@dataclass(frozen=True, eq=False)
class _Clicks:
    """M clicks: why each has no place (M,), as places in STATUSES, and of those that are OK how they met the ground.

    Unit-depth coordinates `xy` (M, 2), the offset from the camera (M, 3), d ln w / d r of kriging's prediction (M,),
    its variance (M,), and d offset (m) / d readout (s) of the picture (M, 3).
    """

    status: NDArray[np.int_]
    xy: Array
    offset_enu_m: Array
    relative: Array
    variance: Array
    by_readout: Array
    is_beyond: NDArray[np.bool_]  # the features' hull
    is_measured: NDArray[np.bool_]


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
        self._newest: tuple[tuple[float, float], _Clicks] | None = None

    def locate(self, uv_px: ArrayLike, pixel_root: ArrayLike | None = None) -> Answer:
        """A pixel (2,) -> Fix or Refusal. `pixel_root` (2, k): a root of the pixel's own covariance, where it is not
        exact.
        """
        uv = np.asarray(uv_px, float)
        click = self._click(uv)
        if isinstance(click, Status):
            return self._refusal(click)
        covariance = self._covariances(click)
        if pixel_root is not None:
            moved = self._by_pixel(uv[None], 1.0 / click.relative) @ np.asarray(pixel_root, float)
            covariance = covariance + moved @ np.swapaxes(moved, -1, -2)
        if not self._is_certain(covariance)[0]:
            return self._refusal(Status.UNCERTAIN)
        (covariance,), (offset_enu_m,) = covariance, click.offset_enu_m
        s = self.feature_set
        lat, lon, height = (float(c) for c in self.frame.to_geodetic(offset_enu_m))
        height -= self._datum_shift_m
        n = self._undulation_m
        other = None if n is None else height - n if self._is_ellipsoidal else height + n
        return Fix(
            lat_deg=lat,
            lon_deg=lon,
            height_ellipsoid_m=height if self._is_ellipsoidal else other,
            height_amsl_m=other if self._is_ellipsoidal else height,
            ellipse=Ellipse.from_covariance(covariance[:2, :2]),
            sigma_height_m=math.sqrt(max(float(covariance[2, 2]), 0.0)),
            method=self._method(click).value,
            frame=s.frame,
            capture_unix_ns=s.capture_unix_ns,
            vehicle=s.vehicle,
            offset_enu_m=offset_enu_m,
            covariance_enu_m2=covariance,
            above_ground_m=None if (above := self._above_ground(click)) is None else above[0],
            sigma_above_ground_m=None if above is None else above[1],
            unmeasured=self._unmeasured(uv),
        )

    def offset(self, uv_px: ArrayLike) -> Array | Status:
        """The way (3,) from the camera to a pixel's place, east, north, up, m, without its error; or why there is none.

        Two thirds of the time that `locate` takes.
        """
        click = self._click(np.asarray(uv_px, float))
        return click if isinstance(click, Status) else np.asarray(click.offset_enu_m[0], np.float64)

    def offsets(self, uv_px: ArrayLike) -> list[Array | Status]:
        """The `offset` of each of several pixels (M, 2), found at once; the first is kept as the newest click."""
        uv = np.asarray(uv_px, float)
        found = self._found(uv)
        self._newest = (float(uv[0, 0]), float(uv[0, 1])), _Clicks(*(part[:1] for part in vars(found).values()))
        ways = zip(found.status, found.offset_enu_m, strict=True)
        return [np.asarray(way, np.float64) if status == OK else STATUSES[status] for status, way in ways]

    def difference_covariance(
        self, uv1_px: ArrayLike, uv2_px: ArrayLike, *, second: Locator | None = None
    ) -> Array | None:
        """Covariance (3, 3), m^2, of the vector between two clicks of this set; None if one has no answer.

        `second` answers the second click: of the same set, with another pixel measured.
        """
        one, two = (np.asarray(uv_px, float)[None] for uv_px in (uv1_px, uv2_px))
        clicks = _joined(self._found(one), (second or self)._found(two))
        if np.any(clicks.status != OK):
            return None
        joint = self._covariances(clicks, 2)[0]
        out: Array = joint[:3, :3] + joint[3:, 3:] - joint[:3, 3:] - joint[3:, :3]
        return out

    def error_parts(self, uv_px: ArrayLike) -> ErrorParts | None:
        """The parts of a click's error that are its own; None if it has no answer."""
        uv = np.asarray(uv_px, float)
        click = self._click(uv)
        if isinstance(click, Status):
            return None
        own = 0.0, float(click.variance[0])
        ground, noise = own if click.is_measured[0] else self.own_variances(click.xy[0])
        by_pixel, relative = self._by_pixel(uv[None], 1.0 / click.relative)[0], float(click.relative[0])
        return ErrorParts(relative * math.sqrt(ground), relative * math.sqrt(noise), by_pixel)

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

    def met_from(self, from_enu_m: Array, rays_enu: Array) -> Array:
        """The points (K, 3) at which rays (K, 3) of unit depth that begin elsewhere (K, 3) meet the ground of this
        picture, all from its camera, east, north, up, m; nan towards the horizon. Beyond the features the plane stands
        for it. (31.6)
        """
        s = self.feature_set
        normal = s.R_enu_cam @ s.plane_per_m[[1, 2, 0]]
        below = rays_enu @ normal
        is_met, relative = below > self._plane_floor, np.ones(len(rays_enu))
        met = np.full((len(rays_enu), 3), np.nan)
        for _ in range(GROUND_STEPS):
            share = (1.0 / relative - from_enu_m @ normal) / np.where(is_met, below, 1.0)
            met = from_enu_m + share[:, None] * rays_enu
            at = met @ s.R_enu_cam
            is_ahead = at[:, 2] > 0.0
            xy = at[:, :2] / np.where(is_ahead, at[:, 2], 1.0)[:, None]
            is_known = is_met & is_ahead & (distances_outside(self._hull, xy) <= self._max_outside)
            relative = np.where(is_known, np.maximum(1.0 + self._kriging.values(xy), MIN_PLANE_SHARE), 1.0)
        met[~(is_met & (share > 0.0))] = np.nan
        return met

    def answers(self, uv_px: ArrayLike) -> Answers:
        """Many pixels (M, 2) at once, each by itself."""
        uv = np.asarray(uv_px, float)
        clicks = self._found(uv)
        offset, covariance, by_pixel = (np.full((len(uv), 3, *rest), np.nan) for rest in ((), (3,), (2,)))
        answered = clicks.status == OK
        if np.any(answered):
            found = self._covariances(clicks)
            answered &= self._is_certain(found)
            offset[answered], covariance[answered] = clicks.offset_enu_m[answered], found[answered]
            by_pixel[answered] = self._by_pixel(uv, 1.0 / clicks.relative)[answered]
        return Answers(offset, covariance, by_pixel, answered)

    def _is_certain(self, covariance: Array) -> NDArray[np.bool_]:
        """Return which positions' covariances (M, 3, 3) leave a place that is still an answer. (9.18)"""
        longest = np.sqrt(CHI2_2 * np.maximum(np.linalg.eigvalsh(covariance[:, :2, :2])[:, 1], 0.0))
        return np.asarray(longest <= MAX_ELLIPSE_SHARE * self._height_m, np.bool_)

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

    def _refusal(self, status: Status) -> Refusal:
        s = self.feature_set
        return Refusal(status, s.frame, s.capture_unix_ns, s.vehicle)

    def _click(self, uv_px: Array) -> _Clicks | Status:
        """Find one, the newest once: a pin asks for its answer and then for the parts of its error."""
        key, newest = (float(uv_px[0]), float(uv_px[1])), self._newest
        if newest is None or newest[0] != key:
            newest = self._newest = key, self._found(uv_px[None])
        found = newest[1]
        return found if found.status[0] == OK else STATUSES[found.status[0]]

    def _found(self, uv_px: Array) -> _Clicks:
        """Find where pixels (M, 2) meet the ground."""
        s = self.feature_set
        rays, valid = s.camera.unproject(uv_px)
        status = np.where(valid, OK, np.where(s.camera.contains(uv_px), Status.OUTSIDE_CALIBRATION.code, OUTSIDE))
        if not s.is_ok:
            status[:] = s.status.code
        elif not self._has_ground:
            status[valid] = Status.POOR_FIT.code
        if not np.any(status == OK):
            nothing = np.full((len(status), 3), np.nan)
            never = np.zeros(len(status), bool)
            return _Clicks(status, nothing[:, :2], nothing, nothing[:, 0], nothing[:, 0], nothing, never, never)
        xy, late = self._at_middle_row(rays[:, :2], uv_px[:, 1])
        plane = s.plane_per_m[0] + xy @ s.plane_per_m[1:]
        outside = distances_outside(self._hull, xy)
        r, variance = self._kriging.predict_each(xy)
        is_measured = self._is_clicked(uv_px)
        if s.clicked is None or not s.clicked.is_measured:
            is_measured[:] = False
        elif np.any(is_measured):
            r[is_measured] = s.clicked.inverse_depth_per_m / plane[is_measured] - 1.0
            variance[is_measured] = (s.clicked.sigma_per_m / plane[is_measured]) ** 2
        relative = 1.0 + r
        is_near = relative > MIN_INVERSE_DEPTH_SIGMAS * np.sqrt(np.maximum(variance, 0.0))
        # Of several reasons the last one below is given.
        is_open = status == OK
        status[is_open & ~is_near] = ABOVE_HORIZON
        if s.depth_source is not DepthSource.PLANE:
            status[is_open & (outside > self._max_outside)] = OUTSIDE
        status[is_open & (plane <= self._plane_floor)] = ABOVE_HORIZON
        is_placed = status == OK
        plane, relative = np.where(is_placed, plane, 1.0), np.where(is_placed, relative, 1.0)
        w = (plane * relative)[:, None]
        offset = _with_one(xy) @ s.R_enu_cam.T / w
        steeper = (late @ s.plane_per_m[1:]) / plane
        by_readout = late @ s.R_enu_cam[:, :2].T / w - offset * steeper[:, None]
        return _Clicks(status, xy, offset, 1.0 / relative, variance, by_readout, outside > 0.0, is_measured)

    def _method(self, click: _Clicks) -> Measured | DepthSource:
        if click.is_measured[0]:
            return Measured.MEASURED
        return DepthSource.PLANE if click.is_beyond[0] else self.feature_set.depth_source

    def _is_clicked(self, uv_px: Array) -> NDArray[np.bool_]:
        """Return which of pixels (M, 2) are the one that was asked for."""
        c = self.feature_set.clicked
        if c is None:
            return np.zeros(len(uv_px), bool)
        return np.asarray(np.abs(uv_px - (c.u_px, c.v_px)).max(axis=1) < SAME_PX, np.bool_)

    def _unmeasured(self, uv_px: Array) -> str:
        """Return why the pixel that was asked for was not measured; empty for any other, and if it was."""
        c = self.feature_set.clicked
        return "" if c is None or c.is_measured or not self._is_clicked(uv_px[None])[0] else c.measured.value

    def _above_ground(self, click: _Clicks) -> tuple[float, float] | None:
        """Height above the ground between the features at the same place, and its one sigma, of what was measured.

        (29.18)
        """
        if not click.is_measured[0]:
            return None
        s, below, ground = self.feature_set, click.offset_enu_m.copy(), click
        for _ in range(GROUND_STEPS):
            at = below @ s.R_enu_cam
            xy = at[:, :2] / at[:, 2:]
            plane = s.plane_per_m[0] + xy @ s.plane_per_m[1:]
            if at[0, 2] <= 0.0 or plane[0] <= self._plane_floor:
                return None
            r, variance = self._kriging.predict_each(xy)
            relative = 1.0 + r
            if relative[0] <= 0.0:
                return None
            met = _with_one(xy) @ s.R_enu_cam.T / (plane * relative)[:, None]
            never, still = np.zeros(1, bool), np.zeros((1, 3))
            ground = _Clicks(click.status, xy, met, 1.0 / relative, variance, still, never, never)
            # The ray meets the ground at another place than below the thing: the ground is level between both.
            below = np.concatenate([click.offset_enu_m[:, :2], met[:, 2:]], axis=1)
        joint = self._covariances(_joined(click, ground), 2)[0]
        height_m = float(click.offset_enu_m[0, 2] - ground.offset_enu_m[0, 2])
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
            w = plane * np.maximum(1.0 + self._kriging.values(out), 0.0)
            moved = -share * s.shutter.image_velocity(out, w)
            out = xy + s.shutter.readout_s * moved
        return out, moved

    def _covariances(self, clicks: _Clicks, size: int = 1) -> Array:
        """Joint covariances (M / size, 3 size, 3 size) of the positions of every `size` clicks after one another."""
        groups = len(clicks.xy) // size, size
        own = clicks.variance[:, None, None] if size == 1 else self._own_covariance(clicks, groups)
        J = _jacobian(clicks.offset_enu_m, clicks.xy).reshape(-1, 3 * size, COMMON_STATES)
        by_own = -(clicks.offset_enu_m * clicks.relative[:, None]).reshape(*groups, 3, 1) * np.eye(size)[:, None]
        by_cause = np.concatenate([J, by_own.reshape(-1, 3 * size, size)], axis=2)
        by_depth = np.zeros((*groups, COMMON_STATES + size))
        by_depth[..., 6:COMMON_STATES] = _with_one(clicks.xy)[:, [2, 0, 1]].reshape(*groups, 3)
        by_depth[..., COMMON_STATES:] = clicks.relative.reshape(*groups, 1) * np.eye(size)
        causes = np.zeros((groups[0], COMMON_STATES + size, COMMON_STATES + size))
        causes[:, :COMMON_STATES, :COMMON_STATES] = self.feature_set.common_cov
        causes[:, COMMON_STATES:, COMMON_STATES:] = own
        out: Array = by_cause @ causes @ by_cause.transpose(0, 2, 1) + _curvature(by_cause, by_depth, causes)
        if self.feature_set.shutter is not None:
            moved = clicks.by_readout.reshape(-1, 3 * size) * self.feature_set.shutter.sigma_readout_s
            out = out + moved[:, :, None] * moved[:, None]
        return out

    def _own_covariance(self, clicks: _Clicks, groups: tuple[int, int]) -> Array:
        """The covariance (G, N, N) of r in G groups of N clicks: kriging's; a measured pixel shares nothing with it,
        nor with another that was measured. However often it is clicked, it is the same error.
        """
        xy, measured = clicks.xy.reshape(*groups, 2), clicks.is_measured.reshape(groups)
        own, variance = self._kriging.predict(xy)[1], clicks.variance.reshape(groups)
        one, other = measured[:, :, None], measured[:, None]
        is_same = (
            one
            & other
            & (np.abs(xy[:, :, None] - xy[:, None]).max(axis=-1) < 10.0 * SAME_PX / self.feature_set.camera.focal_px)
        )
        same = np.maximum(variance[:, :, None], variance[:, None])
        return np.where(is_same, same, np.where(one | other, 0.0, own))


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


def _joined(one: _Clicks, two: _Clicks) -> _Clicks:
    return _Clicks(*(np.concatenate(pair) for pair in zip(vars(one).values(), vars(two).values(), strict=True)))


def _with_one(xy: Array) -> Array:
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
    uv = s.camera.pixels(xy)
    if s.shutter is not None:
        for _ in range(SHUTTER_STEPS):  # (18.5), from place to pixel
            late_s = s.shutter.readout_s * np.asarray(row_share(uv[:, 1], s.camera.height_px))[:, None]
            uv = s.camera.pixels(xy + late_s * s.shutter.image_velocity(xy, w))
    return uv, usable
