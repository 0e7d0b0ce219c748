"""Telemetry in a video that only exiftool reads, where that program is installed -> events: positions alone.

It is a program of its own (Debian: libimage-exiftool-perl), started with the video's name and given a time to end.
"""

from __future__ import annotations

import math
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np

from contract.errors import InputError
from onboard.telemetry.mp4_container import creation_ns, shown_since_first_picture_s
from onboard.telemetry.row_events import SIGMA_GEOID_M, Row, Rows, log_of_rows, with_heights
from onboard.telemetry.telemetry_log import NS_PER_S, SIGMA_BEGAN_S, TelemetryLog, epoch_of

PROGRAM, PACKAGE = "exiftool", "libimage-exiftool-perl"
# One line for each sample of the video's tracks, its time on the video's own; minor damage is passed over.
FORMAT = "$SampleTime;$GPSLatitude;$GPSLongitude;$GPSAltitude"
ARGUMENTS = ("-q", "-q", "-m", "-n", "-ee", "-api", "LargeFileSupport=1", "-p", FORMAT)
TIMEOUT_S = 600.0  # of a video of an hour on a slow disk


def is_there() -> bool:
    return shutil.which(PROGRAM) is not None


def read(path: Path) -> TelemetryLog:
    """Read the positions in a video. Raises InputError, without the file's name, for one without any."""
    began_ns, utc_sigma_s = epoch_of(creation_ns(path))
    found = [one for line in _printed(path).splitlines() if (one := _row(line)) is not None]
    if not found:
        raise InputError("exiftool finds no positions with a time in it")
    try:  # its SampleTime passes over edit lists
        times_s = shown_since_first_picture_s(path, np.array([time_s for time_s, _ in found]))
    except ValueError as error:
        raise InputError("its tracks of telemetry are shown at different times: cut all tracks at one place") from error
    rows: Rows = [
        (began_ns + round(time_s * NS_PER_S), row)
        for time_s, (_, row) in zip(times_s.tolist(), found, strict=True)
        if math.isfinite(time_s)
    ]
    if not rows:
        raise InputError("all positions that exiftool finds are of parts that were cut off")
    placed, notes = with_heights(rows, None, None, SIGMA_GEOID_M)
    log = log_of_rows(placed, ["positions as exiftool reads them", *notes], utc_sigma_s, is_repeated=True)
    return replace(log, video_began=(began_ns, SIGMA_BEGAN_S))


def _printed(path: Path) -> str:
    command = [PROGRAM, *ARGUMENTS, str(path.resolve())]
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", timeout=TIMEOUT_S,
            check=False,
        )  # fmt: skip
    except OSError as error:
        raise InputError(f"exiftool: {error.strerror}") from error
    except subprocess.TimeoutExpired as error:
        raise InputError(f"exiftool did not end within {TIMEOUT_S:.0f} s") from error
    return done.stdout


def _row(line: str) -> tuple[float, Row] | None:
    """The time, s on the video's own, and the row of a line; None for one without a position, or beyond the Earth."""
    try:
        time_s, lat, lon, height = (float(text) for text in line.split(";"))
    except ValueError:
        return None
    if not (0.0 <= time_s < math.inf and abs(lat) <= 90.0 and abs(lon) <= 180.0 and math.isfinite(height)):
        return None
    return time_s, {"lat_deg": lat, "lon_deg": lon, "height_amsl_m": height}
