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

Array = NDArray[np.float64]

REACH_SIGMAS = 2.5  # of the moment, within which pictures are asked
MOST_SETS = 9
NEAR_S = 0.5  # farther from the moment, or two of its sigmas, no picture stands for it
MOST_GAP_S = 8.0  # from the moment to a picture that is asked because there are too few others
# The time over which an aircraft's swinging stays correlated: planes of recorded autopilots nod at 0.85 Hz most, where
# this process's spectrum has fallen to a quarter. Sets a second apart cannot show it.
SWING_S = 0.3
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
    answers = [Locator(s).locate(pixel_at(s.camera, share)) for s in near]
    answered = np.array([isinstance(answer, Fix) for answer in answers])
    middle = answers[int(np.argmin(np.abs(late_s)))]
    if float(np.sum(weights[answered])) <= 0.5 * float(np.sum(weights)):
        refusals = [k for k, answer in enumerate(answers) if isinstance(answer, Refusal)]
        nearest = min(refusals, key=lambda k: abs(late_s[k]))
        return UntimedClick(middle if isinstance(middle, Refusal) else answers[nearest], nothing)
    fixes = [answer for answer in answers if isinstance(answer, Fix)]
    if len(fixes) < 2 and sigma_s > 0.0:
        return UntimedClick(Refusal(Status.STALE, detail=FEW), nothing)
    return _joined(fixes, late_s[answered], weights[answered], sigma_s)


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


def _joined(fixes: list[Fix], late_s: Array, weights: Array, sigma_s: float) -> UntimedClick:
    """The place at the moment, by those of the pictures around it. (31.2) to (31.5)"""
    nearest = fixes[int(np.argmin(np.abs(late_s)))]
    frame = LocalFrame(nearest.lat_deg, nearest.lon_deg, _height_m(nearest))
    places = np.array([frame.to_enu(fix.lat_deg, fix.lon_deg, _height_m(fix)) for fix in fixes])
    moved = _moved(places, late_s, sigma_s)
    if Ellipse.from_covariance(moved.between_m2[:2, :2]).semi_major_m > MAX_ELLIPSE_SHARE * abs(
        nearest.offset_enu_m[2]
    ):
        return UntimedClick(Refusal(Status.UNCERTAIN, detail=SWINGS), np.zeros((3, 3)))
    by_delay = moved.by_moment_m2 + moved.between_m2
    covariance = np.average([fix.covariance_enu_m2 for fix in fixes], axis=0, weights=weights) + by_delay
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
