"""A recorded log of any known kind -> its events. The kind is determined by the file's content, not by its name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from contract.errors import InputError
from onboard.telemetry import csv_reader, ulog_reader
from onboard.telemetry.log_formats import POSITIONS_ALONE, READ, SUFFIXES, LogFormat, read_as, recognised
from onboard.telemetry.read_options import ReadOptions
from onboard.telemetry.telemetry_log import TelemetryLog
from onboard.telemetry.two_logs import joined

HEAD_BYTES = 4096
KNOWN = ", ".join(f"{each.name} ({each.suffix})" for each in READ)


def read_log(path: Path | str, options: ReadOptions | None = None) -> TelemetryLog:
    """Read a whole log, with what is stated about it.

    Raises InputError, one line, for a file that is missing, empty, of no known kind, damaged or without positions.
    """
    path, options = Path(path), options or ReadOptions()
    head = _head(path)
    if options.boot_unix_s is not None and not head.startswith(ulog_reader.MAGIC):
        raise InputError(f"telemetry {path}: its moments are known; --time-offset is for a PX4 .ulg without UTC")
    form = recognised(head)
    if form is None:
        advice = ""
        if csv_reader.is_table(head):
            advice = f"; of another table rename the columns: {','.join(csv_reader.NEEDED)} and more (docs/logs.md)"
        raise InputError(f"telemetry {path}: text of no known kind; known are {KNOWN}{advice}")
    try:
        return read_as(form, path, options)
    except InputError as error:
        if "not a MAVLink telemetry log" in str(error):
            raise InputError(f"telemetry {path}: not a log of a known kind; known are {KNOWN}") from error
        raise


def read_logs(paths: Sequence[Path | str], options: ReadOptions | None = None) -> TelemetryLog:
    """Read the log of a flight, or its two as one. Raises InputError as `read_log` does, and where they are not of one
    flight.
    """
    options = options or ReadOptions()
    if len(paths) == 1:
        return read_log(paths[0], options)
    if len(paths) != 2:
        raise InputError(f"--telemetry: one log of a flight, or two, not {len(paths)}")
    first, second = Path(paths[0]), Path(paths[1])
    if first.resolve() == second.resolve():
        raise InputError(f"telemetry {first}: named twice")
    # A PX4 log's own clock alone may have to be stated.
    has_ulg = any(_head(path).startswith(ulog_reader.MAGIC) for path in (first, second))
    others = replace(options, boot_unix_s=None) if has_ulg else options
    logs = [
        read_log(path, options if _head(path).startswith(ulog_reader.MAGIC) else others) for path in (first, second)
    ]
    return joined(logs[0], logs[1], (first, second))


def logs_among(paths: list[Path]) -> list[Path]:
    """Return those of files that were not named which may be logs of a flight: of aircraft, else positions alone."""
    found = [path for path in paths if path.suffix.lower() in SUFFIXES and _may_be_log(path)]
    return [path for path in found if path.suffix.lower() not in POSITIONS_ALONE] or found


def format_of(path: Path) -> LogFormat | None:
    """Return the format of a file, which may be one that is not read. Raises InputError for one that has none."""
    return recognised(_head(path))


def _may_be_log(path: Path) -> bool:
    """Return whether a file with a log's suffix is one: a table may be of something else."""
    try:
        head = _head(path)
    except InputError:
        return False
    if path.suffix.lower() not in POSITIONS_ALONE | {".csv"}:
        return True  # what is wrong with it is then stated
    form = recognised(head)
    return form is not None and form.read is not None and (form.key != "csv" or csv_reader.has_positions(head))


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
    except OSError as error:
        raise InputError(f"telemetry {path}: {error.strerror}") from error
    if not head:
        raise InputError(f"telemetry {path}: the file is empty")
    return head
