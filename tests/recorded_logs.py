"""The recorded flights' logs: of minutes, and read once by the worker that has the group "recorded logs"."""

from functools import cache
from pathlib import Path
from tempfile import NamedTemporaryFile

from onboard.telemetry.telemetry_log import TelemetryLog
from onboard.telemetry.tlog_reader import read_tlog


@cache
def recorded(path: Path, share: float = 1.0) -> TelemetryLog:
    """The events of the first `share` of a log's bytes, not to be changed."""
    if share == 1.0:
        return read_tlog(path)
    with NamedTemporaryFile(suffix=".tlog") as head:
        content = path.read_bytes()
        head.write(content[: round(share * len(content))])
        head.flush()
        return read_tlog(Path(head.name))
