"""Telemetry in a transport stream: MISB's metadata next to the pictures (STANAG 4609) -> events."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from statistics import median

from contract.errors import InputError
from onboard.telemetry.field_of_view import focal_lengths
from onboard.telemetry.misb import Reader, Sample
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.row_events import SIGMA_GEOID_M, log_of_rows, with_heights
from onboard.telemetry.telemetry_log import NS_PER_S, SIGMA_BEGAN_S, TelemetryLog
from onboard.telemetry.transport_stream import metadata_of

# A sender that does not state leap seconds counts UTC, or without those since the time system's beginning.
SIGMA_LEAP_S = 29.0


def read_stream(path: Path, options: ReadOptions) -> TelemetryLog:
    """Read the metadata in a transport stream. Raises InputError, without the file's name, for one without any, or
    without positions in it.
    """
    try:
        timed, damaged = _samples(path)
    except OSError as error:
        raise InputError(f"{error.strerror}") from error
    if not timed:
        raise InputError("no metadata that is known is in it (MISB ST 0601): give the flight's log")
    rows = [(sample.stamp_ns, sample.row()) for _, sample in timed]
    has_sea = any("height_amsl_m" in row for _, row in rows)
    placed, of_heights = with_heights(rows, None, None if has_sea else options.undulation_m, SIGMA_GEOID_M)
    notes = [f"{damaged} of {len(timed) + damaged} sets of metadata are damaged and are not used"] if damaged else []
    sigma_s = 0.0 if all(sample.is_utc for _, sample in timed) else SIGMA_LEAP_S
    log = log_of_rows(placed, [*notes, *of_heights], utc_sigma_s=sigma_s, is_repeated=True)
    began_ns = round(median(sample.stamp_ns - time_s * NS_PER_S for time_s, sample in timed))
    widths = [(sample.stamp_ns, sample.width_deg) for _, sample in timed]
    return replace(log, video_began=(began_ns, SIGMA_BEGAN_S), focal_mm=focal_lengths(widths))


def _samples(path: Path) -> tuple[list[tuple[float, Sample]], int]:
    """The samples of a file, each with its time on the video's own (s), and how many sets are damaged."""
    reader = Reader()
    timed = [(packet.time_s, s) for packet in metadata_of(path) for s in reader.samples(packet.content)]
    return timed, reader.damaged
