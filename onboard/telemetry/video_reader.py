"""Telemetry that lies in a video itself -> events: a track of subtitles, GoPro's GPMF or Parrot's, or what ArduPilot's
camera application writes into each picture. Others are named.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

from contract.errors import InputError
from onboard.telemetry import exiftool_reader, gpmf, parrot, picture_telemetry
from onboard.telemetry.field_of_view import focal_lengths
from onboard.telemetry.mp4_container import Track, creation_ns, tracks_of
from onboard.telemetry.own_video import extent_s
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.row_events import SIGMA_GEOID_M, log_of_rows, with_heights
from onboard.telemetry.srt_reader import log_of_subtitles
from onboard.telemetry.telemetry_log import NS_PER_S, SIGMA_BEGAN_S, TelemetryLog, epoch_of

SUBTITLES = ("tx3g", "text")
# Kinds of tracks that only exiftool reads: by four characters and, of a general kind, what describes it.
OTHERS = (
    ("mett", b"parrot", "a Parrot's telemetry, of another version than 3"),
    ("djmd", b"", "DJI's own data (djmd): the .SRT of the video, or AirData's table of the flight, has more"),
    ("camm", b"", "Google's camera motion (camm)"),
    ("rtmd", b"", "Sony's metadata (rtmd)"),
)


def has_telemetry(path: Path) -> bool:
    """Return whether there is anything in a video that `read_video` reads."""
    is_in_track = any(track.kind in (gpmf.KIND, *SUBTITLES) or parrot.is_read(track) for track in tracks_of(path))
    return is_in_track or picture_telemetry.is_in(path) or (exiftool_reader.is_there() and bool(_other(path)))


def other_telemetry(path: Path) -> str:
    """Return what telemetry is in a video that is not read, and what to do; empty where there is none that is known."""
    what = _other(path)
    if not what or exiftool_reader.is_there():
        return what
    return f"{what}; exiftool reads some of it: install {exiftool_reader.PACKAGE}"


def _other(path: Path) -> str:
    for track in tracks_of(path):
        for kind, described, what in OTHERS:
            if track.kind == kind and described in track.description.lower():
                return what
    return ""


def read_video(path: Path, options: ReadOptions) -> TelemetryLog:
    """Read the telemetry in a video. Raises InputError, without the file's name, for one without, or without
    positions in it.
    """
    tracks = tracks_of(path)
    for track in tracks:
        if track.kind == gpmf.KIND:
            return _gopro(track, options)
        if parrot.is_read(track):
            return _parrot(track, creation_ns(path))
    for track in tracks:
        if track.kind in SUBTITLES:
            return log_of_subtitles(_texts(track), options.home_amsl_m, options.gps_order)
    if picture_telemetry.is_in(path):
        return picture_telemetry.read(path)
    what = other_telemetry(path)
    if not what:
        raise InputError("no telemetry that is known is in it: give the flight's log")
    if not exiftool_reader.is_there():
        raise InputError(f"in it is {what}")
    try:
        return exiftool_reader.read(path)
    except InputError as error:
        raise InputError(f"in it is {what}: {error}") from error


def _texts(track: Track) -> list[tuple[int, str]]:
    """Subtitles as a video has them: two bytes of length, then text."""
    out = []
    for time_s, sample in zip(track.times_s, track.samples, strict=True):
        if len(sample) > 2:
            (length,) = struct.unpack_from(">H", sample)
            out.append((round(time_s * NS_PER_S), sample[2 : 2 + length].decode("utf-8", "replace")))
    return out


def _gopro(track: Track, options: ReadOptions) -> TelemetryLog:
    rows, began_ns, written = gpmf.positions_of(track)
    if not written:
        raise InputError("its GPMF track has no position (GPS5, GPS9): the camera has no GPS, or it was off")
    if not rows or began_ns is None:
        raise InputError(f"none of the {written} positions in its GPMF track has a fix of three dimensions")
    notes = (
        [f"{written - len(rows)} of {written} positions have no fix and are not used"] if len(rows) < written else []
    )
    placed, of_heights = with_heights(rows, None, options.undulation_m, SIGMA_GEOID_M)
    log = log_of_rows(placed, [*notes, *of_heights], is_repeated=True)
    return replace(log, video_began=(began_ns, SIGMA_BEGAN_S))


def _parrot(track: Track, created_ns: int | None) -> TelemetryLog:
    """The log of a track whose samples have the pictures' own times; `created_ns`: when the video began, to 1 s."""
    began_ns, utc_sigma_s = epoch_of(created_ns)
    flight = parrot.flight_of(track, began_ns)
    if not flight.rows or flight.without == len(flight.rows):
        raise InputError(f"none of the {len(track.samples)} samples of its Parrot track has a position: no fix")
    notes = [f"{flight.without} of {len(flight.rows)} samples have no position"] if flight.without else []
    log = log_of_rows(flight.rows, notes, utc_sigma_s, is_repeated=True)
    return replace(
        log, video_epoch_ns=began_ns, video_s=extent_s(track.times_s), focal_mm=focal_lengths(flight.widths_deg)
    )
