"""DJI's timestamp file (.MRK): when each photograph of a flight was exposed, by the receiver."""

from __future__ import annotations

import re
from pathlib import Path

from contract.errors import InputError
from onboard.telemetry.gps_time import unix_ns_of_gps

# Number, seconds of the GPS week, [week], then the lever arm and the position.
_LINE = re.compile(r"\s*\d+\s+(\d{1,6}\.\d+)\s+\[(\d{3,4})\]")


def read_mrk(path: Path) -> tuple[int, ...]:
    """Exposures in the file's order, Unix ns. Raises InputError, one line, for a file without any."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise InputError(f"timestamps {path}: {error.strerror}") from error
    found = [match for line in lines if (match := _LINE.match(line)) is not None]
    if not found:
        raise InputError(f"timestamps {path}: no line of a photograph (number, GPS seconds, [week]) in it")
    return tuple(unix_ns_of_gps(int(match[2]), 0) + round(float(match[1]) * 1e9) for match in found)
