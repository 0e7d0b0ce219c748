"""The computer itself: temperature and free space on the disk."""

from __future__ import annotations

import shutil
from pathlib import Path

THERMAL = Path("/sys/class/thermal")


def cpu_temperature_c(thermal: Path = THERMAL) -> float | None:
    """The hottest of the kernel's thermal zones, deg C; None where there is none that can be read."""
    found = []
    for zone in sorted(thermal.glob("thermal_zone*/temp")):
        try:
            found.append(int(zone.read_text().strip()) / 1000.0)
        except (OSError, ValueError):
            continue
    sane = [value for value in found if -60.0 < value < 150.0]
    return max(sane, default=None)


def free_mb(folder: Path) -> float | None:
    """Free space on the disk of a folder, or of the nearest parent that exists, MB; None if it is not known."""
    for place in (folder, *folder.parents):
        try:
            return shutil.disk_usage(place).free / 1e6
        except OSError:
            continue
    return None
