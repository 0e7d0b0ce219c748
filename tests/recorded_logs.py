"""The recorded flights' logs: of minutes, and read once by the worker that has the group "recorded logs"."""

from functools import cache
from pathlib import Path

from onboard.telemetry.telemetry_log import TelemetryLog
from onboard.telemetry.tlog_reader import read_tlog


@cache
def recorded(path: Path) -> TelemetryLog:
    """What a log holds, not to be changed."""
    return read_tlog(path)
