"""A recorded log of any known kind -> its events. The kind is determined by the file's content, not by its name."""

from __future__ import annotations

from pathlib import Path

from contract.errors import InputError
from onboard.clocks.boot_clock import Mode
from onboard.telemetry import csv_reader, dataflash_reader, srt_reader, ulog_reader
from onboard.telemetry.srt_axis_order import Order
from onboard.telemetry.telemetry_log import TelemetryLog
from onboard.telemetry.tlog_reader import read_tlog

HEAD_BYTES = 4096
KINDS = "MAVLink .tlog, ArduPilot DataFlash .bin, PX4 .ulg, DJI .srt, or .csv (docs/logs.md)"
# Files that people take for a log are known by how they begin; each has a text on what to do.
FOREIGN = (
    (b"FMT, 128", "a DataFlash log as text (.log): give the .bin that the autopilot wrote"),
    (b"\xff\xd8\xff", "a picture: for the pictures' own positions use --telemetry exif"),
    (b"PK\x03\x04", "a zip archive: unpack it first"),
    (b"\x1f\x8b", "compressed (gzip): unpack it first"),
    (b"\x89MCAP", "a recorded session: give it to replay alone, without --telemetry"),
)


def read_log(
    path: Path | str,
    clock: Mode = "auto",
    home_amsl_m: float | None = None,
    gps_order: Order | None = None,
    boot_unix_s: float | None = None,
    gimbal: int = 0,
    system: int = 0,
) -> TelemetryLog:
    """Read a whole log. `clock` maps boot time (.tlog, .bin, .ulg); `home_amsl_m` is the take-off's height above sea
    level, for a log that only holds heights above it (.srt); `gps_order` which number of its `GPS(a, b)` is the
    latitude; `boot_unix_s` Unix time at the boot, for a .ulg that has none; `gimbal` as `mount.gimbal_component`,
    `system` as `telemetry.system`, of a .tlog.

    Raises InputError, one line, for a file that is missing, empty, of no known kind, damaged or without positions.
    """
    head = _head(path)
    if boot_unix_s is not None and not head.startswith(ulog_reader.MAGIC):
        raise InputError(f"telemetry {path}: its moments are known; --time-offset is for a PX4 .ulg without UTC")
    if head.startswith(dataflash_reader.MAGIC):
        return dataflash_reader.read_dataflash(path, clock)
    if head.startswith(ulog_reader.MAGIC):
        return ulog_reader.read_ulog(path, clock, boot_unix_s)
    if csv_reader.looks_like_table(head):
        return csv_reader.read_csv(path)
    if srt_reader.looks_like_subtitles(head):
        return srt_reader.read_srt(path, home_amsl_m, gps_order)
    if _is_text(head):
        raise InputError(f"telemetry {path}: text of no known kind; known are {KINDS}. A table needs a header line")
    try:
        return read_tlog(path, clock, gimbal, system)
    except InputError as error:
        if "not a MAVLink telemetry log" in str(error):
            raise InputError(f"telemetry {path}: not a log of a known kind; known are {KINDS}") from error
        raise


def looks_like_log(path: Path) -> bool:
    """Return whether a file that was not named may be a log; a table without positions and times is none."""
    try:
        head = _head(path)
    except InputError:
        return False
    return path.suffix.lower() != ".csv" or csv_reader.has_positions(head)


def _head(path: Path | str) -> bytes:
    """The file's first bytes, which are not those of something that no log is."""
    try:
        with Path(path).open("rb") as stream:
            head = stream.read(HEAD_BYTES)
    except OSError as error:
        raise InputError(f"telemetry {path}: {error.strerror}") from error
    if not head:
        raise InputError(f"telemetry {path}: the file is empty")
    for start, what in FOREIGN:
        if head.startswith(start):
            raise InputError(f"telemetry {path}: is {what}")
    return head


def _is_text(head: bytes) -> bool:
    try:
        text = head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        text = head[: error.start].decode("utf-8-sig", "replace") if error.start > len(head) - 4 else "\0"
    return "\0" not in text and all(c.isprintable() or c in "\r\n\t" for c in text)
