"""A report of a followed thing as it is some time later: where it may be by then, and whether it still counts. (24.19)

The one place that ages reports: the aircraft when pictures stop, the ground when reports do.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.answer import Ellipse, Place
from contract.feature_set import Status
from contract.geodesy import LocalFrame
from contract.track import Course, TrackReport, TrackState, Unseen

Array = NDArray[np.float64]

LOST_AFTER_S = 2.0  # without being seen
MOST_AGE_S = 5.0  # of a picture, however long its report was under way
SILENT_S = 1.0  # without anything new, after which it coasts
# One sigma of how people, and what they drive, speed up, brake and turn: at rest, and for each m/s that a thing has.
ACCELERATION_M_S2, TURN_RAD_S = 1.5, 0.15
MOST_COURSE_DEG = 180.0  # one sigma of a course of which nothing is known
UNKNOWN_M_S = 12.0  # one sigma of a speed that is not known yet, of either component


def as_of(report: TrackReport, age_s: float, silent_s: float, why: Unseen) -> TrackReport:
    """A report `age_s` after its picture was taken, where for `silent_s` nothing newer has come.

    Its place moves on with its velocity, its ellipse grows, its time is the later one. It coasts after SILENT_S, for
    the reason `why`, and is lost, without a place, once it has not been seen for LOST_AFTER_S; what a report took on
    its way is in its place and ellipse, and no loss before MOST_AGE_S.
    """
    if age_s <= 0.0:
        return report
    now_ns = report.capture_unix_ns + round(age_s * 1e9)
    aged = replace(report, capture_unix_ns=now_ns, unseen_s=report.unseen_s + age_s)
    if report.state is not TrackState.LOST and silent_s > SILENT_S:
        unseen = report.unseen if report.state is TrackState.COASTING else why
        course = coasting(report.course, report.unseen_s, aged.unseen_s)
        aged = replace(aged, state=TrackState.COASTING, unseen=unseen, course=course)
    if report.state is TrackState.LOST or report.unseen_s + silent_s > LOST_AFTER_S or age_s > MOST_AGE_S:
        unseen = why if aged.unseen is Unseen.NONE else aged.unseen
        return replace(aged, state=TrackState.LOST, unseen=unseen, place=None, course=None, status=Status.UNCERTAIN)
    if report.place is None:
        return aged
    return replace(aged, place=_moved(report.place, report.course, report.unseen_s, age_s))


def manner_m_s2(speed_m_s: float) -> float:
    """One sigma of the acceleration, either way, with which a thing of that speed speeds up, brakes and turns."""
    return ACCELERATION_M_S2 + TURN_RAD_S * speed_m_s


def unforeseen_m2(speed_m_s: float, since_s: float) -> float:
    """Variance, either way, of where a thing of that speed is `since_s` after it was seen, for all that it may do."""
    return 0.25 * manner_m_s2(speed_m_s) ** 2 * since_s**4


def unforeseen_m2_s2(speed_m_s: float, since_s: float) -> float:
    """Variance, either way, of the velocity of a thing of that speed `since_s` after it was seen, likewise."""
    return (manner_m_s2(speed_m_s) * since_s) ** 2


def coasting(course: Course | None, unseen_s: float, until_s: float) -> Course | None:
    """A course `until_s` after the last look, of which its sigmas held `unseen_s` after it: it may have set off, or
    have stopped. (24.27)
    """
    if course is None:
        return None
    added = unforeseen_m2_s2(course.speed_m_s, until_s) - unforeseen_m2_s2(course.speed_m_s, unseen_s)
    sigma_m_s, sigma_deg = math.sqrt(course.sigma_speed_m_s**2 + added), course.sigma_course_deg
    if sigma_deg is not None:
        sideways = math.hypot(course.speed_m_s * math.radians(sigma_deg), math.sqrt(added))
        sigma_deg = min(math.degrees(sideways / max(course.speed_m_s, 1e-3)), MOST_COURSE_DEG)
    return replace(course, sigma_speed_m_s=sigma_m_s, sigma_course_deg=sigma_deg)


def _moved(place: Place, course: Course | None, unseen_s: float, age_s: float) -> Place:
    """(24.19), from `unseen_s` to `unseen_s` + `age_s` after the last look."""
    velocity, cov = _velocity(course)
    lat, lon, _ = LocalFrame(place.lat_deg, place.lon_deg, 0.0).to_geodetic([*(velocity * age_s), 0.0])
    speed, until_s = float(np.hypot(*velocity)), unseen_s + age_s
    unforeseen = unforeseen_m2(speed, until_s) - unforeseen_m2(speed, unseen_s)
    grown = cov * (until_s**2 - unseen_s**2) + unforeseen * np.eye(2)
    ellipse = Ellipse.from_covariance(place.ellipse.covariance_en_m2 + grown)
    return replace(place, lat_deg=float(lat), lon_deg=float(lon), ellipse=ellipse)


def _velocity(course: Course | None) -> tuple[Array, Array]:
    """East and north (2,), m/s, and the covariance (2, 2)."""
    if course is None:
        return np.zeros(2), UNKNOWN_M_S**2 * np.eye(2)
    if course.course_deg is None or course.sigma_course_deg is None:
        return np.zeros(2), course.sigma_speed_m_s**2 * np.eye(2)
    angle = math.radians(course.course_deg)
    along, across = np.array([math.sin(angle), math.cos(angle)]), np.array([math.cos(angle), -math.sin(angle)])
    sideways = course.speed_m_s * math.radians(course.sigma_course_deg)
    cov = course.sigma_speed_m_s**2 * np.outer(along, along) + sideways**2 * np.outer(across, across)
    return course.speed_m_s * along, cov
