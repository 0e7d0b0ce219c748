"""The parts of a log that a person or the configuration states, because its format does not."""

from __future__ import annotations

from dataclasses import dataclass

from onboard.clocks.boot_clock import Mode
from onboard.telemetry.srt_axis_order import Order


@dataclass(frozen=True)
class ReadOptions:
    """Statements about a log. `clock` maps boot time (.tlog, .bin, .ulg); `home_amsl_m` is the take-off's height above
    sea level, for a log that only holds heights above it; `gps_order` which number of `GPS(a, b)` in subtitles is the
    latitude; `boot_unix_s` Unix time at the boot, for a .ulg that has none; `gimbal` as `mount.gimbal_component`,
    `system` as `telemetry.system`, of a .tlog; `undulation_m` as `gps.undulation_m`, for heights above the ellipsoid.
    """

    clock: Mode = "auto"
    home_amsl_m: float | None = None
    gps_order: Order | None = None
    boot_unix_s: float | None = None
    gimbal: int = 0
    system: int = 0
    undulation_m: float | None = None
