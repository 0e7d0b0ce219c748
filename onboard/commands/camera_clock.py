"""The clock of a camera whose pictures are imported: by how much it and the log's differ, or one line that it is not
known. Nothing ties such a clock to UTC unless it is stated.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.errors import InputError
from onboard.commands.imported_flight import Row
from onboard.config.schema import Config
from onboard.events.types import PositionFix
from onboard.foreign_clock.clock_search import Clock, Evidence, Stated, Unknown, search
from onboard.foreign_clock.log_track import log_track
from onboard.foreign_clock.motion_cost import MotionNoise
from onboard.foreign_clock.picture_pairs import Pairs, chosen_pairs, measure
from onboard.replay.photo_steps import SMALL_PX
from onboard.replay.runner import check_overlap
from onboard.telemetry.log_clocks import REACH_S
from onboard.telemetry.telemetry_log import NS_PER_S, TelemetryLog
from onboard.telemetry.two_logs import loosened

Picture = NDArray[np.uint8]

APART_S = 1.5  # between two pictures of a pair, about
# One sigma of the height over the ground as a share, of a match, of the ground's relief (of the height), of a position
# against the next.
SIGMA_HEIGHT, SIGMA_MATCH_RAD, RELIEF, PLACE_M = 0.3, 0.003, 0.05, 0.5
# An attitude that only the path shows may be off by any of these between two pictures, by a gimbal or in a bank.
BY_PATH_DEG = (0.5, 2.0, 6.0)
# A log that begins in the air does not show how high: any of these, to a factor of two.
BASES_M, SIGMA_BASE = (30.0, 80.0, 200.0), 0.6
SEEK_FRAMES = 90  # a frame farther on is sought, not decoded up to
ADVICE = (
    "GPS time in EXIF would tie it, and so would a picture of a GPS clock; where you know it, give --clock-offset S "
    "(the camera's clock is S seconds ahead of UTC, to as many digits as you know)"
)
LOCAL_ADVICE = (
    "The log's times are local, of no stated zone: where you know it, give --clock-offset S (the camera's clock is S "
    "seconds ahead of the log's, to as many digits as you know)"
)


def clock_of(
    log: TelemetryLog,
    config: Config,
    camera: Camera,
    moments_ns: Sequence[int],
    stamp_sigma_s: float,
    picture: Callable[[int], Picture | None],
    stated: Stated | None,
    advice: str = "",
) -> Clock:
    """The clock of pictures at these moments. Raises InputError, one line that begins with "clock:"."""
    (begin_ns, end_ns), reach_ns = log.span_ns, round(REACH_S * NS_PER_S)
    if max(moments_ns) < begin_ns - reach_ns or min(moments_ns) > end_ns + reach_ns:
        check_overlap(moments_ns, log)  # of another day, which no zone explains
    log = _within(log, min(moments_ns) - reach_ns, max(moments_ns) + reach_ns)
    pairs = measure(camera, moments_ns, chosen_pairs(moments_ns), picture)
    found = search(evidence_of(log, config, camera, moments_ns, stamp_sigma_s, pairs), stated)
    if isinstance(found, Unknown):
        if found.advice:
            raise InputError(f"clock: {found.reason}. {found.advice}")
        if others := _of_another_flight(moments_ns, end_ns - begin_ns):
            raise InputError(f"clock: {others}")
        hint = LOCAL_ADVICE if log.utc_sigma_s is None else ADVICE
        raise InputError(f"clock: {found.reason}: by how much the camera's is off is not known. {hint}{advice}")
    return found


def _of_another_flight(moments_ns: Sequence[int], log_ns: int) -> str:
    """Words for pictures that are farther from the others than the log is long; empty where there are none."""
    ordered = sorted(moments_ns)
    gaps_ns = [after - before for before, after in itertools.pairwise(ordered)]
    widest = max(range(len(gaps_ns)), key=lambda k: gaps_ns[k], default=-1)
    if widest < 0 or gaps_ns[widest] <= log_ns:
        return ""
    before = widest + 1
    return (
        f"{before} of {len(ordered)} pictures were taken {gaps_ns[widest] / 3.6e12:.1f} h before the others, and the "
        f"log is {log_ns / 6e10:.0f} min long: they are of another flight, or the clock was set. Import each alone"
    )


def evidence_of(
    log: TelemetryLog, config: Config, camera: Camera, moments_ns: Sequence[int], stamp_sigma_s: float, pairs: Pairs
) -> Evidence:
    """Return what a log and the pictures' motion show of the clock, with the errors that both may have."""
    track, solve = log_track(log, config), config.solve
    time_s = solve.attitude_correlation_time_s
    tilt_deg = _between_deg(solve.attitude_white_sigma_deg, solve.attitude_sigma_deg, time_s)
    attitudes_deg = [(tilt_deg, _between_deg(solve.heading_white_sigma_deg, solve.heading_sigma_deg, time_s))]
    if not track.has_attitude:
        attitudes_deg = [(deg, deg) for deg in BY_PATH_DEG]
    bases = [(0.0, SIGMA_HEIGHT)] if track.has_take_off else [(base_m, SIGMA_BASE) for base_m in BASES_M]
    noises = [
        MotionNoise(
            math.radians(tilt), math.radians(heading), PLACE_M, RELIEF, stamp_sigma_s, SIGMA_MATCH_RAD,
            math.radians(config.mount.sigma_deg), height, max(camera.sigma[0], 0.01), base_m,
        )
        for tilt, heading in attitudes_deg
        for base_m, height in bases
    ]  # fmt: skip
    age_sigma_s = loosened(config, log).gps.sigma_latency_s
    return Evidence(track, moments_ns, stamp_sigma_s, pairs, noises, log.shots_ns, age_sigma_s)


def _within(log: TelemetryLog, first_ns: int, last_ns: int) -> TelemetryLog:
    """Return the log between two moments: one row with the date of another year would make a track of all years
    between. Raises InputError where no position is left.
    """
    kept = [pair for pair in zip(log.arrival_ns, log.events, strict=True) if first_ns <= pair[1].stamp_ns <= last_ns]
    if not any(isinstance(event, PositionFix) for _, event in kept):
        raise InputError(f"clock: the log has no position within {REACH_S / 3600:.0f} hours of the pictures")
    return replace(log, events=[event for _, event in kept], arrival_ns=[moment_ns for moment_ns, _ in kept])


def against_log(stated: Stated | None, log: TelemetryLog, is_given: bool) -> Stated | None:
    """Return what a statement about the camera's clock against UTC is against the log's: as much less certain as that
    is; nothing of a log whose times are local, but where `is_given`: then a person stated it of the log's times.
    """
    if stated is None or log.utc_sigma_s is None:
        return stated if is_given else None
    return replace(stated, sigma_s=math.hypot(stated.sigma_s, log.utc_sigma_s))


def clock_row(clock: Clock) -> Row:
    return (
        "clock",
        f"the camera's is {-clock.offset_s:+.2f} +-{clock.sigma_s:.2f} s ahead of the log's, by {clock.text}",
    )


def _between_deg(white_deg: float, slow_deg: float, time_s: float) -> float:
    """One sigma of the turn between two attitudes, by the white and the Gauss-Markov part of each. (5.5)"""
    return math.sqrt(2.0 * (white_deg**2 + slow_deg**2 * (1.0 - math.exp(-APART_S / time_s))))


def frames(video: Path, times_s: Sequence[float]) -> Callable[[int], Picture | None]:
    """Small grey copies of a video's frames, asked for in order; None where it does not hand that frame out."""
    capture = cv2.VideoCapture(str(video))
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    half_s = 0.5 * float(np.median(np.diff(times_s))) if len(times_s) > 1 else 1.0
    due = 0

    def small(index: int) -> Picture | None:
        nonlocal due
        if index - due > SEEK_FRAMES:
            capture.set(cv2.CAP_PROP_POS_MSEC, 1e3 * times_s[index])
        shown_s = -math.inf
        while shown_s < times_s[index] - half_s:
            if not capture.grab():
                return None
            shown_s = float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1e3
        due = bisect.bisect_left(times_s, shown_s - half_s) + 1
        got, picture = capture.retrieve()
        if not got or picture is None or abs(shown_s - times_s[index]) > half_s:
            return None
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture
        height, width = grey.shape[:2]
        size = (SMALL_PX, max(SMALL_PX * height // width, 1)) if width > SMALL_PX else (width, height)
        return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)

    return small
