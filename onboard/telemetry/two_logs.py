"""Two logs of one flight -> one: each sensor from the better log, on one clock.

As a camera's subtitles, which have the video's own time, and a flight record, which has yaw and gimbal. Positions go
together with what their receiver and filter state about them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError
from contract.geodesy import LocalFrame
from contract.rotations import log_so3, matrix_from_quaternion
from onboard.config.schema import Config
from onboard.events.types import (
    Attitude,
    FilterStatus,
    GimbalAttitude,
    GpsQuality,
    Home,
    NavEvent,
    PositionFix,
    RangeFinder,
    Zoom,
)
from onboard.telemetry.log_clocks import Tie, Untied, claimed, tie
from onboard.telemetry.telemetry_log import NS_PER_S, TelemetryLog, Tied

Array = NDArray[np.float64]

COVERS = 0.9  # of what the other has of a sensor, that one has to cover to be taken for it
MOST = 4000  # of a sensor's values that are judged
UNSTATED_M = 2.0  # one sigma of a position whose log claims nothing
STILL_RAD = 1e-6  # angles that never change were not measured
MOST_POSITIONS_S, MOST_CAMERA_S = 5.0, 2.0  # of the configuration's keys
# What is taken from one log together; each with its name for people.
SENSORS: tuple[tuple[str, tuple[type[NavEvent], ...]], ...] = (
    ("positions", (PositionFix, GpsQuality, FilterStatus, Home)),
    ("attitude", (Attitude,)),
    ("gimbal", (GimbalAttitude,)),
    ("range", (RangeFinder,)),
    ("zoom", (Zoom,)),
)


def joined(one: TelemetryLog, other: TelemetryLog, paths: tuple[Path, Path]) -> TelemetryLog:
    """Return both as one log, on the clock of that which the pictures are likelier timed by.

    That is a video's own; else one that is tied to UTC, else the first. Raises InputError for logs of two flights, and
    where their clocks cannot be tied.
    """
    if _clock_rank(other) < _clock_rank(one):
        one, other, paths = other, one, paths[::-1]
    found = tie(one, other)
    if isinstance(found, Untied):
        raise InputError(
            f"telemetry {paths[0]} and {paths[1]}: not two logs of one flight, or not known to be: {found.reason}; "
            "give one of them"
        )
    other = _shifted(other, round(found.offset_s * NS_PER_S))
    taken = {name: _better(kinds, one, other) for name, kinds in SENSORS}
    arrivals: list[tuple[int, NavEvent]] = []
    for log in (one, other):
        kinds = tuple(kind for name, kinds in SENSORS if taken[name] is log for kind in kinds)
        arrivals += [p for p in zip(log.arrival_ns, log.events, strict=True) if isinstance(p[1], kinds)]
    arrivals.sort(key=lambda pair: pair[0])
    return replace(
        one,
        events=[event for _, event in arrivals],
        arrival_ns=[arrival_ns for arrival_ns, _ in arrivals],
        video_began=one.video_began or other.video_began,
        digital_zoom=one.digital_zoom or other.digital_zoom,
        focal_mm=one.focal_mm or other.focal_mm,
        shots_ns=one.shots_ns or other.shots_ns,
        notes=(*one.notes, *other.notes, _words(found, taken, one, paths)),
        tied=_tied(found, taken, other),
        position_sigma_s=0.0 if (placed := taken["positions"]) is None else placed.position_sigma_s,
    )


def loosened(config: Config, log: TelemetryLog) -> Config:
    """Return the configuration with what a log's texts and the tie of two logs add to its delays' sigmas, (32.6), and
    for how long its positions share their error.

    Positions tie the clocks, and each log's are late by its own amount.
    """
    tied, gps, camera = log.tied, config.gps, config.camera
    if tied.is_mixed or log.position_sigma_s:
        tie_s = tied.sigma_s if tied.is_mixed else 0.0
        sigma_s = min(math.hypot(gps.sigma_latency_s, tie_s, log.position_sigma_s), MOST_POSITIONS_S)
        config = config.model_copy(update={"gps": gps.model_copy(update={"sigma_latency_s": sigma_s})})
    if log.correlation_time_s > config.gps.correlation_time_s:
        slower = config.gps.model_copy(update={"correlation_time_s": log.correlation_time_s})
        config = config.model_copy(update={"gps": slower})
    if tied.are_angles_moved:
        sigma_s = math.hypot(camera.sigma_latency_s, tied.sigma_s, gps.sigma_latency_s, gps.sigma_latency_s)
        moved = camera.model_copy(update={"sigma_latency_s": min(sigma_s, MOST_CAMERA_S)})
        config = config.model_copy(update={"camera": moved})
    return config


def _clock_rank(log: TelemetryLog) -> tuple[bool, float]:
    return log.video_epoch_ns is None, float("inf") if log.utc_sigma_s is None else log.utc_sigma_s


def _shifted(log: TelemetryLog, by_ns: int) -> TelemetryLog:
    return replace(
        log,
        events=[_event_shifted(event, by_ns) for event in log.events],
        arrival_ns=[moment_ns + by_ns for moment_ns in log.arrival_ns],
        video_began=None if log.video_began is None else (log.video_began[0] + by_ns, log.video_began[1]),
        digital_zoom=tuple((moment_ns + by_ns, value) for moment_ns, value in log.digital_zoom),
        focal_mm=tuple((moment_ns + by_ns, value) for moment_ns, value in log.focal_mm),
        shots_ns=tuple(moment_ns + by_ns for moment_ns in log.shots_ns),
    )


def _event_shifted(event: NavEvent, by_ns: int) -> NavEvent:
    if isinstance(event, GpsQuality) and event.fix is not None:
        event = replace(event, fix=replace(event.fix, stamp_ns=event.fix.stamp_ns + by_ns))
    return replace(event, stamp_ns=event.stamp_ns + by_ns)


def _better(kinds: tuple[type[NavEvent], ...], one: TelemetryLog, other: TelemetryLog) -> TelemetryLog | None:
    """The log to take these from: with the smaller error, of those that cover the time; None where neither has any."""
    found = [(log, [e for e in log.events if isinstance(e, kinds[0])]) for log in (one, other)]
    found = [(log, events) for log, events in found if events]
    spans_ns = [max(e.stamp_ns for e in events) - min(e.stamp_ns for e in events) for _, events in found]
    within_ns = min(_span_ns(one), _span_ns(other))  # a video's log is shorter than the flight's
    least_ns = COVERS * min(max(spans_ns, default=0), within_ns)
    covering = [pair for pair, span_ns in zip(found, spans_ns, strict=True) if span_ns >= least_ns]
    if not covering:
        return None
    error = _ERRORS.get(kinds[0], _spacing_s)
    return min(covering, key=lambda pair: error(pair[0], pair[1]))[0]


def _span_ns(log: TelemetryLog) -> int:
    first_ns, last_ns = log.span_ns
    return last_ns - first_ns


def _spacing_s(log: TelemetryLog, events: list[NavEvent]) -> float:
    stamps_ns = [event.stamp_ns for event in events]
    return (max(stamps_ns) - min(stamps_ns)) / NS_PER_S / len(stamps_ns)


def _position_error_m(log: TelemetryLog, events: list[NavEvent]) -> float:
    """One sigma of a position between two: what the log claims, where heights count from, and the interpolation's."""
    stated = (
        claimed(log, lambda c: c.sigma_horizontal_m, UNSTATED_M),
        claimed(log, lambda c: c.sigma_vertical_m, UNSTATED_M),
        claimed(log, lambda c: c.sigma_datum_m, 0.0),
    )
    fixes = [e for e in _some(events) if isinstance(e, PositionFix)]
    middle = fixes[len(fixes) // 2]
    geodetic = np.array([(f.lat_deg, f.lon_deg, f.height_amsl_m) for f in fixes])
    places_m = LocalFrame(middle.lat_deg, middle.lon_deg, middle.height_amsl_m).to_enu(*geodetic.T)
    stamps_s = np.array([f.stamp_ns - fixes[0].stamp_ns for f in fixes]) / NS_PER_S
    return float(np.linalg.norm([*stated, _missed(stamps_s, places_m)]))


def _angle_error_rad(log: TelemetryLog, events: list[NavEvent]) -> float:
    """The angle of an attitude from the turn between its neighbours, which its noise, steps and rarity all are in."""
    some = [e for e in _some(events) if isinstance(e, Attitude | GimbalAttitude)]
    R = np.stack([_rotation(e) for e in some])
    turned = log_so3(np.swapaxes(R[:1], -1, -2) @ R)
    if np.ptp(turned, axis=0).max() < STILL_RAD:
        return float("inf")
    between = log_so3(np.swapaxes(R[:-2], -1, -2) @ R[2:])
    own = log_so3(np.swapaxes(R[:-2], -1, -2) @ R[1:-1])
    stamps_s = np.array([e.stamp_ns - some[0].stamp_ns for e in some]) / NS_PER_S
    left = own - _share(stamps_s) * between
    return float(np.sqrt(np.mean(np.square(left).sum(axis=1)))) if len(some) > 2 else np.pi


def _rotation(event: Attitude | GimbalAttitude) -> Array:
    return matrix_from_quaternion(event.q_ned_body if isinstance(event, Attitude) else event.q_ref_gimbal)


_ERRORS: dict[type[NavEvent], Callable[[TelemetryLog, list[NavEvent]], float]] = {
    PositionFix: _position_error_m,
    Attitude: _angle_error_rad,
    GimbalAttitude: _angle_error_rad,
}


def _some(events: list[NavEvent]) -> list[NavEvent]:
    """A stretch in the middle, of a long log, by stamps."""
    ordered = sorted(events, key=lambda event: event.stamp_ns)
    first = max((len(ordered) - MOST) // 2, 0)
    return ordered[first : first + MOST]


def _share(stamps_s: Array) -> Array:
    """The part (N - 2, 1) of the way between its two neighbours that each moment but the first and last has done."""
    return ((stamps_s[1:-1] - stamps_s[:-2]) / np.maximum(stamps_s[2:] - stamps_s[:-2], 1e-6))[:, None]


def _missed(stamps_s: Array, places_m: Array) -> float:
    """The error within a gap (m): a quarter of a position's median distance from the line between its neighbours."""
    if len(stamps_s) < 3:
        return 0.0
    share = _share(stamps_s)
    line_m = (1.0 - share) * places_m[:-2] + share * places_m[2:]
    return float(np.median(np.linalg.norm(places_m[1:-1] - line_m, axis=1))) / 4.0


def _tied(found: Tie, taken: dict[str, TelemetryLog | None], other: TelemetryLog) -> Tied:
    """What the tie adds to the errors of stamps: those of angles against the clock, and positions against angles."""
    has_positions_of_other = taken["positions"] is other
    angles = [taken[name] is other for name in ("attitude", "gimbal") if taken[name] is not None]
    are_moved = any(angles or [has_positions_of_other])
    return Tied(are_moved, any(of_other != has_positions_of_other for of_other in angles), found.sigma_s)


def _words(found: Tie, taken: dict[str, TelemetryLog | None], one: TelemetryLog, paths: tuple[Path, Path]) -> str:
    by_log = [
        (path, [name for name, log in taken.items() if log is not None and (log is one) == is_first])
        for path, is_first in zip(paths, (True, False), strict=True)
    ]
    sources = "; ".join(f"{', '.join(names) or 'the clock alone'} from {path.name}" for path, names in by_log)
    return (
        f"two logs of one flight: {sources}; clock of {paths[1].name} moved by {found.offset_s:+.2f} "
        f"+-{found.sigma_s:.2f} s, by the positions of {found.common_s:.0f} s"
    )
