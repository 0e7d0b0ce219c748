"""A click on a video whose picture is not known, only about when it was taken: a position whose error has that too.

The sets of the pictures around that moment each place the pixel; how far its place moves in a second is what the
moment's error costs. Section 31 of docs/mathematics-clock.md. NumPy only.
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
from contract.locate import Locator

Array = NDArray[np.float64]

REACH_SIGMAS = 2.5  # of the moment, within which pictures are asked
MOST_SETS = 9
NEAR_S = 0.5  # farther from the moment, or two of its sigmas, no picture stands for it
MOST_GAP_S = 3.0  # from the moment to a picture that is asked because there are too few others
LEAST_WEIGHT = 1e-3  # of a picture far from the moment
FEW = "too few pictures around the click: how far its place moves with the video's delay is not known"


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
    weights = np.maximum(np.exp(-0.5 * (late_s / max(sigma_s, 1e-3)) ** 2), LEAST_WEIGHT)
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
    """The sets that are asked, in order of capture; none where no picture was taken near the moment."""
    by_distance = sorted(sets, key=lambda s: abs(s.capture_unix_ns - moment_unix_ns))
    distances_s = [abs(s.capture_unix_ns - moment_unix_ns) / 1e9 for s in by_distance]
    if not sets or distances_s[0] > max(NEAR_S, 2.0 * sigma_s):
        return []
    inside = sum(d <= REACH_SIGMAS * sigma_s for d in distances_s)
    count = max(inside, sum(d <= MOST_GAP_S for d in distances_s[:3]))
    near = sorted(by_distance[:count], key=lambda s: s.capture_unix_ns)
    if len(near) <= MOST_SETS:
        return near
    return [near[round(k)] for k in np.linspace(0, len(near) - 1, MOST_SETS)]


def pixel_at(camera: Camera, share: tuple[float, float]) -> tuple[float, float]:
    """Return the pixel at shares of a picture's width and height, 0 to 1 from its left and its top edge."""
    return share[0] * camera.width_px - 0.5, share[1] * camera.height_px - 0.5


def _joined(fixes: list[Fix], late_s: Array, weights: Array, sigma_s: float) -> UntimedClick:
    """The place at the moment, by a straight line through those of the pictures around it. (31.1) to (31.4)"""
    nearest = fixes[int(np.argmin(np.abs(late_s)))]
    frame = LocalFrame(nearest.lat_deg, nearest.lon_deg, _height_m(nearest))
    places = np.array([frame.to_enu(fix.lat_deg, fix.lon_deg, _height_m(fix)) for fix in fixes])
    line = np.stack([np.ones(len(fixes)), late_s], axis=1)[:, : min(len(fixes), 2)]
    information = line.T @ (weights[:, None] * line)
    by_line = np.linalg.solve(information, line.T @ (weights[:, None] * places))
    left = places - line @ by_line
    freedom = len(fixes) - line.shape[1]
    scatter = np.zeros((3, 3))
    if freedom > 0:
        scatter = (weights[:, None] * left).T @ left / float(np.sum(weights)) * (len(fixes) / freedom)
    moved = by_line[1] * sigma_s if len(by_line) > 1 else np.zeros(3)
    by_delay = np.outer(moved, moved) + scatter * (1.0 + float(np.linalg.inv(information)[0, 0]))
    own = np.average([fix.covariance_enu_m2 for fix in fixes], axis=0, weights=weights)
    covariance = own + by_delay
    lat, lon, height_m = (float(c) for c in frame.to_geodetic(by_line[0]))
    higher_m = height_m - _height_m(nearest)
    answer = replace(
        nearest,
        lat_deg=lat,
        lon_deg=lon,
        height_ellipsoid_m=None if nearest.height_ellipsoid_m is None else nearest.height_ellipsoid_m + higher_m,
        height_amsl_m=None if nearest.height_amsl_m is None else nearest.height_amsl_m + higher_m,
        ellipse=Ellipse.from_covariance(covariance[:2, :2]),
        sigma_height_m=math.sqrt(max(float(covariance[2, 2]), 0.0)),
        offset_enu_m=nearest.offset_enu_m + by_line[0],
        covariance_enu_m2=covariance,
    )
    return UntimedClick(answer, by_delay)


def _height_m(fix: Fix) -> float:
    """The height above the ellipsoid, above sea level where that is not known."""
    known = fix.height_amsl_m if fix.height_ellipsoid_m is None else fix.height_ellipsoid_m
    return 0.0 if known is None else known
