"""The result of every reader of a recorded log: events and when they arrived."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from contract.rotations import matrix_from_euler, quaternion_from_matrix
from onboard.events.types import Attitude, FilterStatus, GimbalAttitude, GpsQuality, NavEvent, PositionFix

Array = NDArray[np.float64]
Euler = tuple[float, float, float]

NS_PER_S = 1_000_000_000
# Reports on positions that stand in a file come this often: enough for `gps.quality_timeout_s` at its least.
REPORT_NS = 400_000_000
STANDING_NS = 1_000_000_000  # a position that stands still is taken again this often
EMPTY_EPOCH_NS = 946_684_800_000_000_000  # of a log without any date: 2000-01-01
SIGMA_CREATED_S = 1.0  # of a file's creation time, whole seconds of its camera's clock
# Of when a video began, by the positions that lie in it: they come with the pictures of their moment or some time after
# it, by how much no file states.
SIGMA_BEGAN_S = 0.5
MAX_INTERPOLATED_S = 0.3  # over which velocities and rates of an autopilot's log are interpolated
MAX_GAP_S = 10.0  # positions farther apart are joined by no configuration


@dataclass(frozen=True)
class Tied:
    """The errors that a log made of two adds to those of its stamps: `sigma_s`, one sigma of their clocks' tie.

    `are_angles_moved`: attitudes come from the log whose clock was moved; `is_mixed`: positions come from the other.
    """

    are_angles_moved: bool = False
    is_mixed: bool = False
    sigma_s: float = 0.0


@dataclass(frozen=True, eq=False)
class TelemetryLog:
    """Events in order of arrival, each with its arrival time (ns, same length).

    `system` is the vehicle's MAVLink system number, 0 where the format has none; `boot_segments` how often its clock
    began. `video_epoch_ns`: when the video began that the log was written with, if it was written with one; `video_s`:
    on its own time, when the last of what was written begins, and how far these usually are apart (s).
    `digital_zoom`: from which moment on the camera enlarged its pictures, and how often; `focal_mm` from when on it had
    which focal length, equivalent to 35 mm film. `notes`: what the operator
    should know of how the log was read, one line each. `shots_ns`: when a camera's shutter was triggered or reported.
    `video_began`: when the video began that the log lies in (ns), by a receiver whose delay is not known, and one sigma
    of that (s). `utc_sigma_s`: one sigma of the stamps against UTC, 0 of a receiver's or of a clock that the
    configuration states; None where they are local times of no stated zone, which nothing ties to UTC.
    `position_sigma_s`: one sigma of which moment a position is of, where what states it lasts. `correlation_time_s`:
    for how long positions share their error, where that is known to be longer than configured. `tied`: of two logs that
    were joined.
    """

    events: list[NavEvent]
    arrival_ns: list[int]
    system: int = 0
    boot_segments: int = 1
    video_epoch_ns: int | None = None
    digital_zoom: tuple[tuple[int, float], ...] = ()
    focal_mm: tuple[tuple[int, float], ...] = ()
    notes: tuple[str, ...] = ()
    shots_ns: tuple[int, ...] = ()
    utc_sigma_s: float | None = 0.0
    video_began: tuple[int, float] | None = None
    tied: Tied = Tied()
    video_s: tuple[float, float] | None = None
    position_sigma_s: float = 0.0
    correlation_time_s: float = 0.0

    @classmethod
    def by_stamp(cls, events: Iterable[NavEvent], boot_segments: int = 1) -> TelemetryLog:
        """Return a log that no link has delayed: each value arrives when it is true. Events of one moment keep their
        order.
        """
        ordered = sorted(events, key=lambda event: event.stamp_ns)
        return cls(ordered, [event.stamp_ns for event in ordered], boot_segments=boot_segments)

    def with_events(self, events: Iterable[NavEvent], notes: tuple[str, ...]) -> TelemetryLog:
        """Return the same with events of its own clock besides, which arrive when they are true, and notes on them."""
        arrivals = [*zip(self.arrival_ns, self.events, strict=True), *((event.stamp_ns, event) for event in events)]
        arrivals.sort(key=lambda pair: pair[0])
        ordered = [event for _, event in arrivals]
        return replace(self, events=ordered, arrival_ns=[t for t, _ in arrivals], notes=(*self.notes, *notes))

    @property
    def span_ns(self) -> tuple[int, int]:
        """Capture times of the first and the last position."""
        stamps = [event.stamp_ns for event in self.events if isinstance(event, PositionFix)]
        return min(stamps), max(stamps)


def epoch_of(created_ns: int | None) -> tuple[int, float | None]:
    """Return when a video's own time begins (Unix ns) and its sigma against UTC (s, None: of no date), by when its file
    states that it was created.
    """
    return (EMPTY_EPOCH_NS, None) if created_ns is None else (created_ns, SIGMA_CREATED_S)


def vouched(positions: list[PositionFix], claims: list[GpsQuality]) -> list[NavEvent]:
    """Positions (in order of time) of a file that has no receiver's and no filter's reports, with such as it implies.

    A position in the file means that there was a fix then. `claims` are what the file states about its accuracy, one a
    position, with any stamp; each is repeated until the next position, as a receiver would, but not across a gap, where
    a row with a wrong date would make a month of reports.
    """
    first_ns = positions[0].stamp_ns
    out: list[NavEvent] = [FilterStatus(first_ns - REPORT_NS, has_position=True, is_glitching=False), *positions]
    stamps_ns = np.array([fix.stamp_ns for fix in positions])
    ends = [*np.flatnonzero(np.diff(stamps_ns) > MAX_GAP_S * NS_PER_S).tolist(), len(positions) - 1]
    first = 0
    for last in ends:
        moments_ns = np.arange(stamps_ns[first] - REPORT_NS, stamps_ns[last] + NS_PER_S, REPORT_NS)
        newest = np.maximum(np.searchsorted(stamps_ns, moments_ns, side="right") - 1, first)
        pairs = zip(newest.tolist(), moments_ns.tolist(), strict=True)
        out += [replace(claims[at], stamp_ns=moment_ns) for at, moment_ns in pairs]
        first = last + 1
    return out


def with_news(positions: list[PositionFix]) -> list[int]:
    """Return which of positions that are repeated until there is a new one bring one: only these have its time.

    One that hovers is repeated every `STANDING_NS`; stamps of the result increase.
    """
    out: list[int] = []
    for at, fix in enumerate(positions):
        if out:
            last = positions[out[-1]]
            is_same = (fix.lat_deg, fix.lon_deg) == (last.lat_deg, last.lon_deg)
            if fix.stamp_ns <= last.stamp_ns or (is_same and fix.stamp_ns - last.stamp_ns < STANDING_NS):
                continue
        out.append(at)
    return out


def interpolated(boot_us: NDArray[np.int64], values: Array, at_us: NDArray[np.int64]) -> Array:
    """Values (N, F) of boot times (N,), us, at other ones (M,): (M, F); nan past the ends and within gaps."""
    out = np.full((len(at_us), values.shape[1]), np.nan)
    if len(boot_us) < 2:
        return out
    right = np.clip(np.searchsorted(boot_us, at_us), 1, len(boot_us) - 1)
    near = (boot_us[right] - boot_us[right - 1]) * 1e-6 <= MAX_INTERPOLATED_S
    near &= (at_us >= boot_us[0]) & (at_us <= boot_us[-1])
    for i, column in enumerate(values.T):
        out[near, i] = np.interp(at_us[near], boot_us, column)
    return out


def quaternions(euler_deg: Array) -> Array:
    """Roll, pitch, yaw (N, 3) in degrees -> unit quaternions w, x, y, z (N, 4); nan where any angle is not finite."""
    out = np.full((len(euler_deg), 4), np.nan)
    known = np.isfinite(euler_deg).all(axis=1)
    if known.any():
        out[known] = quaternion_from_matrix(matrix_from_euler(*np.radians(euler_deg[known]).T))
    return out


def attitudes(angles: Sequence[tuple[int, Euler]], rates: Sequence[Euler | None] = ()) -> list[NavEvent]:
    """A vehicle's attitudes at stamps (ns), of roll, pitch, yaw in degrees, and their rates in body axes, rad/s."""
    found = zip(angles, _unit_quaternions(angles), rates or [None] * len(angles), strict=True)
    return [Attitude(stamp_ns, q, rate) for (stamp_ns, _), q, rate in found]


def gimbal_attitudes(
    angles: Sequence[tuple[int, Euler]], reference: Literal["vehicle", "earth"] = "earth"
) -> list[NavEvent]:
    """A camera's attitudes, as its own aircraft wrote them: roll and pitch in degrees against the horizon, yaw against
    north, or against the vehicle's nose.
    """
    found = zip(angles, _unit_quaternions(angles), strict=True)
    return [GimbalAttitude(stamp_ns, q, reference, is_of_camera=True) for (stamp_ns, _), q in found]


def _unit_quaternions(angles: Sequence[tuple[int, Euler]]) -> list[tuple[float, float, float, float]]:
    """All at once: of a long log one by one cost three times what the rest of it does."""
    euler_deg = np.array([of_one for _, of_one in angles]).reshape(-1, 3)
    return [(w, x, y, z) for w, x, y, z in quaternions(euler_deg).tolist()]


def quaternion(euler_deg: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """Roll, pitch, yaw in degrees -> w, x, y, z."""
    w, x, y, z = quaternion_from_matrix(matrix_from_euler(*(math.radians(angle) for angle in euler_deg))).tolist()
    return w, x, y, z
