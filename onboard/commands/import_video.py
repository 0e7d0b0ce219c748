"""The command `pc-onboard import-video`: a video and the log of its flight become a flight that `replay` reads."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import cv2

from contract.errors import InputError
from onboard.camera.file_stamps import stamp_from_name, stamps_of_frames
from onboard.camera.photo_metadata import Focal
from onboard.camera.video_times import frame_times_s, rate_text
from onboard.commands.camera_clock import against_log, clock_of, clock_row, frames
from onboard.commands.flight_folder import log_in_folder
from onboard.commands.imported_flight import (
    SIGMA_STAMPS_S,
    ImportedFlight,
    check_out,
    config_text,
    log_rows,
    mount_by_log,
    optics_of,
    options_of,
    rolling_shutter,
    settings_of,
)
from onboard.config.schema import parse_config
from onboard.foreign_clock.clock_search import Stated
from onboard.replay.digital_zoom import SIGMA_EQUIVALENT, equivalent_px
from onboard.replay.runner import check_overlap
from onboard.telemetry.log_files import read_logs
from onboard.telemetry.log_formats import SUFFIXES
from onboard.telemetry.mp4_container import creation_ns
from onboard.telemetry.own_video import another_length, began_ns, cut_sigma_s, extent_s
from onboard.telemetry.telemetry_log import NS_PER_S, TelemetryLog
from onboard.telemetry.transport_stream import has_metadata
from onboard.telemetry.video_reader import has_telemetry, other_telemetry

RATE_HZ = 5.0  # pictures taken out of a faster video: enough for the window, and for a person to look through
CUT_S = (0.5, 0.29)  # by which a beginning cut to the second is too early, and one sigma of that
SIGMA_FRAME_S = 0.01  # of a frame's time against the others'
START = ", or when the video began, --start TIME"
CUT = ". Of a video whose first S seconds were cut off: --clock-offset -S"


@dataclass(frozen=True)
class _Beginning:
    """The beginning of the video, the source that states it, and what is known of that clock: against UTC, or against
    the log's own where the log `is_own`.
    """

    unix_ns: int
    source: str
    stated: Stated | None = None
    is_own: bool = False


def run(arguments: argparse.Namespace) -> int:
    """Make the flight and print what was assumed. Everything is read and checked before anything is written."""
    video: Path = arguments.video
    settings = settings_of(arguments.set)
    check_out(arguments.out)
    size_px = _size(video)
    named: list[Path] = arguments.telemetry
    is_own = not named and (has_telemetry(video) or has_metadata(video))
    found = None if named else log_in_folder(video.parent, video.stem) or (video if is_own else None)
    paths = named if found is None else [found]
    if not paths:
        what = other_telemetry(video)
        raise InputError(
            f"{video}: no log of the flight next to it ({', '.join(SUFFIXES)}): name one"
            + f". In the video is {what}" * bool(what)
        )
    log = read_logs(paths, options_of(arguments.home_amsl_m, settings))
    times_s = frame_times_s(video)
    if not times_s:
        raise InputError(f"{video}: no time stamps on its frames: give replay --stamps with index,unix_time_s")
    stamps_ns = None if arguments.stamps is None else stamps_of_frames(arguments.stamps, len(times_s), video.name)
    another = another_length(log, times_s[-1])
    began = (
        _beginning(video, log, began_ns(log, paths, video), another, arguments)
        if stamps_ns is None
        else _by_stamps(stamps_ns, arguments)
    )
    optics = optics_of(size_px, _focal(log, paths, size_px), video.parent, settings)
    sections, mount = mount_by_log(log)
    rows = rolling_shutter(sections)
    moments_ns = stamps_ns or [began.unix_ns + round(time_s * 1e9) for time_s in times_s]
    assumed = [mount, rows]
    config = parse_config(config_text(sections, settings))
    if log.video_epoch_ns is None or another or stamps_ns is not None:
        pictures = frames(video, times_s)
        is_given = arguments.start is None and arguments.clock_offset is not None
        stated = began.stated if began.is_own else against_log(began.stated, log, is_given)
        advice = f"; {another}{CUT}" if another else START if log.utc_sigma_s is not None else ""
        clock = clock_of(
            replace(log, shots_ns=()), config, optics.camera, moments_ns, SIGMA_FRAME_S, pictures, stated, advice
        )
        moments_ns = [moment_ns + round(clock.offset_s * 1e9) for moment_ns in moments_ns]
        sections["camera"] |= {"sigma_latency_s": f"{clock.sigma_s:.3f}"}
        assumed.append(clock_row(clock))
    elif (cut_s := cut_sigma_s(log, sum(extent_s(times_s) or ()))) > SIGMA_FRAME_S:
        sections["camera"] |= {"sigma_latency_s": f"{math.hypot(config.camera.sigma_latency_s, cut_s):.3f}"}
        assumed.append(("clock", f"+-{cut_s:.2f} s: shorter than its log; its beginning may have been cut off"))
    check_overlap(moments_ns, log)
    flight = ImportedFlight(arguments.out, video, tuple(paths), optics, ["index,unix_time_s"], sections)
    flight.stamps += [f"{index},{moment_ns / 1e9:.6f}" for index, moment_ns in enumerate(moments_ns)]
    is_thinned = (len(times_s) - 1) / max(times_s[-1], 1e-3) > 1.1 * RATE_HZ
    source = f"the frames' own, from {_utc(moments_ns[0])}: {began.source}"
    flight.rows = [
        ("video", f"{len(times_s)} frames, {rate_text(times_s)}" + f", {RATE_HZ:g} of them taken" * is_thinned),
        ("times", source if stamps_ns is None else f"{arguments.stamps}, from {_utc(moments_ns[0])}"),
        ("camera", optics.text),
        *log_rows(paths, log),
        *assumed,
    ]
    flight.replay = ["--rate", f"{RATE_HZ:g}"] if is_thinned else []
    if arguments.home_amsl_m is not None:
        flight.replay += ["--home-amsl-m", f"{arguments.home_amsl_m:g}"]
    flight.write(settings)
    flight.print_assumed()
    return 0


def _size(video: Path) -> tuple[int, int]:
    if not video.is_file():
        raise InputError(f"{video}: no such video")
    capture = cv2.VideoCapture(str(video))
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)  # as the sensor has them, whichever way it is to be shown
    try:
        size_px = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
    finally:
        capture.release()
    if min(size_px) < 1:
        raise InputError(f"{video}: not a video that can be decoded")
    return size_px


def _beginning(
    video: Path, log: TelemetryLog, by_log_ns: int | None, another: str, arguments: argparse.Namespace
) -> _Beginning:
    """Return the beginning by the subtitles, else as given, by the name, or by the file; `another`: in words, why the
    subtitles are not this video's, or not the whole of it. Raises InputError.
    """
    if by_log_ns is not None and another:
        return _Beginning(by_log_ns, another, _by_offset(arguments), is_own=True)
    if by_log_ns is not None:
        return _Beginning(by_log_ns, "as its log counts")
    if log.video_began is not None and set(arguments.telemetry) <= {video} and arguments.start is None:
        began_ns, sigma_s = log.video_began
        source = "the times of the telemetry in it"
        return _Beginning(began_ns, source, Stated(0.0, sigma_s, source), is_own=True)
    if arguments.start is not None:
        start_ns, sigma_s = arguments.start
        return _Beginning(start_ns, "as given", Stated(0.0, sigma_s, "--start"))
    offset_ns = round(arguments.utc_offset * 3600e9)
    for found, source in ((stamp_from_name(video.name), "its name"), (creation_ns(video), "the file's creation time")):
        if found is not None:
            late_s, cut_s = CUT_S if found % NS_PER_S == 0 else (0.0, 0.0)
            return _Beginning(found - offset_ns, f"{source} and its clock", _by_offset(arguments, late_s, cut_s))
    raise InputError(f"{video}: nothing states when it began: give --start, in UTC, as 2026-06-12T10:15:23.4Z")


def _by_offset(arguments: argparse.Namespace, late_s: float = 0.0, cut_s: float = 0.0) -> Stated | None:
    """Return the offset that is given of a beginning which is too early by `late_s`, one sigma of that `cut_s`."""
    if arguments.clock_offset is None:
        return None
    ahead_s, sigma_s = arguments.clock_offset
    return Stated(late_s - ahead_s, math.hypot(sigma_s, cut_s), "--clock-offset")


def _by_stamps(stamps_ns: Sequence[int], arguments: argparse.Namespace) -> _Beginning:
    """Return the beginning by a file of every frame's time. Raises InputError where another is given, too."""
    if arguments.start is not None:
        raise InputError("--start and --stamps: both state when the video began; give one")
    source = "as it states"
    return _Beginning(stamps_ns[0], source, Stated(0.0, SIGMA_STAMPS_S, str(arguments.stamps)))


def _focal(log: TelemetryLog, paths: Sequence[Path], size_px: tuple[int, int]) -> Focal | None:
    """The focal length that subtitles name first, equivalent to 35 mm film."""
    if not log.focal_mm:
        return None
    (_, equivalent_mm), *_ = log.focal_mm
    focal_px = equivalent_px(equivalent_mm, size_px)
    source = f"focal_len {equivalent_mm:g} mm in {' or '.join(path.name for path in paths)}"
    return Focal(focal_px, focal_px, SIGMA_EQUIVALENT * focal_px, source)


def _utc(unix_ns: int) -> str:
    return datetime.fromtimestamp(unix_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S.%f")[:-3] + " UTC"
