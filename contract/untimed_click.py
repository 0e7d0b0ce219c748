"""A click on a video whose picture is not known, only about when it was taken: a position whose error has that too.

The sets of the pictures around that moment each place the pixel; how far its place moves in a second is what the
moment's error costs, and how unevenly it moves what lies between two pictures. Section 31 of
docs/mathematics-clock.md. NumPy only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.answer import Answer, Ellipse, Fix, Refusal
from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from contract.geodesy import LocalFrame
from contract.locate import MAX_ELLIPSE_SHARE, Locator
from contract.rolling_shutter import row_share
from contract.rotations import exp_so3

Array = NDArray[np.float64]

REACH_SIGMAS = 2.5  # of the moment, within which pictures are asked
MOST_SETS = 9
NEAR_S = 0.5  # farther from the moment, or two of its sigmas, no picture stands for it
MOST_GAP_S = 8.0  # from the moment to a picture that is asked because there are too few others
# The time over which an aircraft's swinging stays correlated: planes of recorded autopilots nod at 0.85 Hz most, where
# this process's spectrum has fallen to a quarter. Sets a second apart cannot show it.
SWING_S = 0.3
APART_S = 0.1  # nearer to a set, a moment between two would make a motion of the difference of their errors
ROUNDING = 1e-9  # of a correlation
MOMENTS, MOMENT_WEIGHTS = np.polynomial.hermite_e.hermegauss(9)  # of a normal error of one sigma
FEW = "too few pictures around the click: how far its place moves with the video's delay is not known"
SWINGS = "the camera swings, and too much between the pictures around the click"


@dataclass(frozen=True, eq=False)
class UntimedClick:
    """The answer, `frame` that of the picture nearest to the moment. `by_delay_m2` (3, 3), east, north, up, is the part
    of a Fix's covariance that is owed to the moment: whatever is followed from that picture on has it as well.
    """

    answer: Answer
    by_delay_m2: Array


def locate_untimed(
    sets: Sequence[FeatureSet], share: tuple[float, float], moment_unix_ns: int, sigma_s: float
) -> UntimedClick:
    """Locate what was at `share` (0 to 1 from the left and from the top edge) of the picture that was shown.

    `sets`: of the pictures around the moment when that was taken, which is known to `sigma_s`.
    """
    nothing = np.zeros((3, 3))
    near = _around(sets, moment_unix_ns, sigma_s)
    if not near:
        return UntimedClick(Refusal(Status.STALE, detail="no picture was placed at the time of the click"), nothing)
    late_s = np.array([(s.capture_unix_ns - moment_unix_ns) / 1e9 for s in near])
    scale_s = max(sigma_s, float(np.min(np.abs(late_s))), 1e-3)
    weights = np.exp(-0.5 * (late_s / scale_s) ** 2)
    locators = [Locator(s) for s in near]
    answers = [locator.locate(pixel_at(locator.feature_set.camera, share)) for locator in locators]
    answered = np.array([isinstance(answer, Fix) for answer in answers])
    middle = answers[int(np.argmin(np.abs(late_s)))]
    if float(np.sum(weights[answered])) <= 0.5 * float(np.sum(weights)):
        refusals = [k for k, answer in enumerate(answers) if isinstance(answer, Refusal)]
        instead = min(refusals, key=lambda k: abs(late_s[k]))
        return UntimedClick(middle if isinstance(middle, Refusal) else answers[instead], nothing)
    fixes = [answer for answer in answers if isinstance(answer, Fix)]
    if len(fixes) < 2 and sigma_s > 0.0:
        return UntimedClick(Refusal(Status.STALE, detail=FEW), nothing)
    late_s, weights = late_s[answered], weights[answered]
    nearest = fixes[int(np.argmin(np.abs(late_s)))]
    frame = LocalFrame(nearest.lat_deg, nearest.lon_deg, _height_m(nearest))
    placed = [locator for locator, is_placed in zip(locators, answered, strict=True) if is_placed]
    at_sets = np.array([frame.to_enu(fix.lat_deg, fix.lon_deg, _height_m(fix)) for fix in fixes])
    between, moments_s = _between(placed, late_s, share, frame)
    moved = _moved(np.concatenate([at_sets, between]), np.concatenate([late_s, moments_s]), sigma_s)
    covariance = np.average([fix.covariance_enu_m2 for fix in fixes], axis=0, weights=weights)
    return _answer(nearest, frame, moved, covariance)


def _around(sets: Sequence[FeatureSet], moment_unix_ns: int, sigma_s: float) -> list[FeatureSet]:
    """The sets that are asked, in order of capture; none where no picture was taken near the moment of (31.1)."""
    by_distance = sorted(sets, key=lambda s: abs(s.capture_unix_ns - moment_unix_ns))
    distances_s = [abs(s.capture_unix_ns - moment_unix_ns) / 1e9 for s in by_distance]
    if not sets or distances_s[0] > max(NEAR_S, 2.0 * sigma_s):
        return []
    inside = sum(d <= REACH_SIGMAS * sigma_s for d in distances_s)
    count = max(inside, sum(d <= MOST_GAP_S for d in distances_s[:MOST_SETS]))
    near = sorted(by_distance[:count], key=lambda s: s.capture_unix_ns)
    if len(near) <= MOST_SETS:
        return near
    return [near[round(k)] for k in np.linspace(0, len(near) - 1, MOST_SETS)]


def pixel_at(camera: Camera, share: tuple[float, float]) -> tuple[float, float]:
    """Return the pixel at shares of a picture's width and height, 0 to 1 from its left and its top edge."""
    return share[0] * camera.width_px - 0.5, share[1] * camera.height_px - 0.5


def _between(
    locators: list[Locator], late_s: Array, share: tuple[float, float], frame: LocalFrame
) -> tuple[Array, Array]:
    """A pixel's places (M, 3) in `frame` at moments (M,) between sets that state how the camera was turned then. (31.6)

    Where the camera was is interpolated between the sets, for an aircraft's path bends little within seconds.
    """
    places, moments_s = [np.zeros((0, 3))], [np.zeros(0)]
    cameras = np.array([frame.to_enu(o.frame.lat_deg, o.frame.lon_deg, o.frame.height_m) for o in locators])
    gaps_s = np.diff(late_s)
    if not len(gaps_s) or np.min(gaps_s) <= 0.0:
        return places[0], moments_s[0]
    velocities = np.gradient(cameras, late_s, axis=0)
    for k, gap_s in enumerate(gaps_s):
        s = locators[k + 1].feature_set
        if s.swing is None:
            continue
        is_between = s.swing.before_s < gap_s - APART_S
        before_s, turned = s.swing.before_s[is_between], exp_so3(s.swing.turned_cam_rad[is_between])
        u_v = np.asarray(pixel_at(s.camera, share))
        rays = turned @ s.camera.unproject(u_v[None])[0][0] @ s.R_enu_cam.T
        moved = _cubic(cameras[k : k + 2], velocities[k : k + 2] * gap_s, 1.0 - before_s / gap_s) - cameras[k + 1]
        met = locators[k + 1].met_from(moved, rays)
        # A row's pixel was seen before the picture's moment, or after it: in a picture of another moment.
        row_s = 0.0 if s.shutter is None else s.shutter.readout_s * float(row_share(u_v[1], s.camera.height_px))
        is_met = np.isfinite(met[:, 0])
        places.append(cameras[k + 1] + met[is_met])
        moments_s.append(late_s[k + 1] - before_s[is_met] - row_s)
    return np.concatenate(places), np.concatenate(moments_s)


def _cubic(ends: Array, by_end: Array, shares: Array) -> Array:
    """Places (K, 3) at shares (K,) of the way between two ends (2, 3) of derivatives `by_end` by the share. (31.6)"""
    u = shares[:, None]
    v = 1.0 - u
    from_first = v * v * ((1.0 + 2.0 * u) * ends[0] + u * by_end[0])
    return np.asarray(from_first + u * u * ((1.0 + 2.0 * v) * ends[1] - v * by_end[1]), np.float64)


def _answer(nearest: Fix, frame: LocalFrame, moved: _Moved, of_sets_m2: Array) -> UntimedClick:
    """The place at the moment, with the error (3, 3) of the pictures around it. (31.5)"""
    if Ellipse.from_covariance(moved.between_m2[:2, :2]).semi_major_m > MAX_ELLIPSE_SHARE * abs(
        nearest.offset_enu_m[2]
    ):
        return UntimedClick(Refusal(Status.UNCERTAIN, detail=SWINGS), np.zeros((3, 3)))
    by_delay = moved.by_moment_m2 + moved.between_m2
    covariance = of_sets_m2 + by_delay
    lat, lon, height_m = (float(c) for c in frame.to_geodetic(moved.place_m))
    higher_m = height_m - _height_m(nearest)
    answer = replace(
        nearest,
        lat_deg=lat,
        lon_deg=lon,
        height_ellipsoid_m=None if nearest.height_ellipsoid_m is None else nearest.height_ellipsoid_m + higher_m,
        height_amsl_m=None if nearest.height_amsl_m is None else nearest.height_amsl_m + higher_m,
        ellipse=Ellipse.from_covariance(covariance[:2, :2]),
        sigma_height_m=math.sqrt(max(float(covariance[2, 2]), 0.0)),
        offset_enu_m=nearest.offset_enu_m + moved.place_m,
        covariance_enu_m2=covariance,
    )
    return UntimedClick(answer, by_delay)


@dataclass(frozen=True, eq=False)
class _Moved:
    """A pixel's place (3,) at an uncertain moment, and the covariances (3, 3) by how far it moves meanwhile and by how
    unevenly it moves between pictures.
    """

    place_m: Array
    by_moment_m2: Array
    between_m2: Array


def _moved(places: Array, late_s: Array, sigma_s: float) -> _Moved:
    """Predict the place at moments about the one that is known to `sigma_s`, out of places (N, 3). (31.3), (31.4)"""
    count, trend = len(places), min(len(places) - 1, 2)
    moments_s = sigma_s * MOMENTS if sigma_s > 0.0 else np.zeros(1)
    weights = MOMENT_WEIGHTS / np.sum(MOMENT_WEIGHTS) if sigma_s > 0.0 else np.ones(1)
    if trend < 1:
        return _Moved(places[0], np.zeros((3, 3)), np.zeros((3, 3)))
    line, at = (np.stack([np.ones(len(t)), t], axis=1)[:, :trend] for t in (late_s, moments_s))
    inverse = np.linalg.inv(_correlation(late_s[:, None] - late_s) + ROUNDING * np.eye(count))
    known = _correlation(moments_s[:, None] - late_s)
    cov_line = np.linalg.inv(line.T @ inverse @ line)
    by_line = cov_line @ line.T @ inverse @ places
    left = places - line @ by_line
    swing_m2 = left.T @ inverse @ left / (count - trend)
    predicted = at @ by_line + known @ inverse @ left
    beyond = at - known @ inverse @ line
    variance = 1.0 - np.einsum("ti,ij,tj->t", known, inverse, known)
    variance = np.maximum(variance, 0.0) + np.einsum("ti,ij,tj->t", beyond, cov_line, beyond)
    place_m = weights @ predicted
    apart = predicted - place_m
    between = float(weights @ variance) * _as_normal(count - trend) * swing_m2
    return _Moved(place_m, (weights[:, None] * apart).T @ apart, between)


def _correlation(apart_s: Array) -> Array:
    """The correlation of swings some time apart: that of a process whose rate is continuous (Matern, 3/2). (31.2)"""
    share = math.sqrt(3.0) / SWING_S * np.abs(apart_s)
    return np.asarray((1.0 + share) * np.exp(-share), np.float64)


def _as_normal(freedom: int) -> float:
    """The factor on a variance that is estimated by so few, for the 90 % ellipse to hold as often: that of Student's t
    in two dimensions over the normal one's. (31.5)
    """
    return freedom * math.expm1(2.0 * math.log(10.0) / freedom) / (2.0 * math.log(10.0))


def _height_m(fix: Fix) -> float:
    """The height above the ellipsoid, above sea level where that is not known."""
    known = fix.height_amsl_m if fix.height_ellipsoid_m is None else fix.height_ellipsoid_m
    return 0.0 if known is None else known
