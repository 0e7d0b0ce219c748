"""Before take-off: one line for each thing that a good flight needs, from a report of the daemon's shape.

The same lines whether a running daemon was asked or `doctor_command` looked for itself. No line is good for want of
knowing: what nobody can tell is said to be unknown, and counts as bad where a flight depends on it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from contract.camera import Camera
from onboard.config.schema import Config

Report = dict[str, Any]

RATE_SHARE = 0.8  # of the rate asked for
MIN_ATTITUDE_HZ = 10.0
MIN_POSITION_HZ = 2.0
MAX_CLOCK_SIGMA_MS = 20.0  # 20 m/s over 20 ms are 0.4 m
MAX_ROUND_TRIP_MS = 100.0
MAX_GPS_SIGMA_M = 5.0
BORESIGHT_SIGMAS = 3.0
MAX_CLIPPED = 0.3
DARK, BRIGHT = 25.0, 230.0
HOT_C = 80.0


@dataclass(frozen=True)
class Line:
    """What was looked at, whether it is well, and what was seen."""

    name: str
    is_good: bool
    text: str


@dataclass(frozen=True)
class Surroundings:
    """What is known without the report."""

    camera: Camera | str  # the camera file, or what is wrong with it
    link: str  # what is wrong with the link; empty if nothing
    free_mb: float | None
    temperature_c: float | None


def diagnose(config: Config, report: Report, around: Surroundings) -> list[Line]:
    """All lines, in the order in which one would look."""
    return [
        _camera(report),
        _rate(config, report),
        _exposure(config, report),
        _telemetry(report),
        _rates(report),
        _time_sync(config, report),
        _gps(report),
        _mount(config, report),
        _calibration(around.camera),
        Line("link", not around.link, around.link or f"open, {', '.join((*config.link.listen, *config.link.connect))}"),
        _disk(config, around.free_mb),
        _processor(around.temperature_c),
    ]


def _camera(report: Report) -> Line:
    health = report["camera"]
    return Line("camera", health["state"] == "ok", _state(health))


def _rate(config: Config, report: Report) -> Line:
    rate_hz, asked_hz = report["camera"]["figures"].get("rate_hz", 0.0), config.camera.rate_hz
    lost = report["camera"]["figures"].get("lost", 0.0)
    text = f"{rate_hz:.1f} of {asked_hz:g} pictures a second" + (f", {lost:.0f} lost" if lost else "")
    return Line("rate", rate_hz >= RATE_SHARE * asked_hz, text)


def _exposure(config: Config, report: Report) -> Line:
    how = "automatic" if config.camera.exposure_us is None else f"fixed at {config.camera.exposure_us:g} us"
    picture = report.get("picture")
    if picture is None:
        return Line("exposure", False, f"{how}; no picture to judge it by")
    for share, what in ((picture["black"], "black"), (picture["white"], "white")):
        if share > MAX_CLIPPED:
            return Line("exposure", False, f"{how}; {100 * share:.0f} % of the picture is {what}")
    mean = picture["mean"]
    good = DARK < mean < BRIGHT
    return Line(
        "exposure",
        good,
        f"{how}, mean grey {mean:.0f} of 255" + ("" if good else ": too dark" if mean <= DARK else ": too bright"),
    )


def _telemetry(report: Report) -> Line:
    health = report["telemetry"]
    return Line("telemetry", health["state"] in ("ok", "degraded"), _state(health))


def _rates(report: Report) -> Line:
    figures = report["telemetry"]["figures"]
    attitude, position = figures.get("attitude_hz"), figures.get("position_hz")
    reported = [
        f"{name} {rate:.0f} Hz" for name, rate in (("attitude", attitude), ("position", position)) if rate is not None
    ]
    if position is None:
        return Line("rates", False, "no position rate is known")
    good = position >= MIN_POSITION_HZ and (attitude is None or attitude >= MIN_ATTITUDE_HZ)
    return Line("rates", good, ", ".join(reported))


def _time_sync(config: Config, report: Report) -> Line:
    figures = report["telemetry"]["figures"]
    sigma_ms, trip_ms = figures.get("clock_sigma_ms"), figures.get("round_trip_ms")
    if config.telemetry.url.startswith(("tlog:", "nmea:")):
        return Line("time sync", True, "by arrival: this kind of telemetry answers no TIMESYNC")
    if sigma_ms is None or not math.isfinite(sigma_ms):
        return Line("time sync", False, "the autopilot's clock is not known yet")
    text = f"+-{sigma_ms:.1f} ms" + ("" if trip_ms is None else f", round trip {trip_ms:.1f} ms")
    good = sigma_ms <= MAX_CLOCK_SIGMA_MS and (trip_ms is None or trip_ms <= MAX_ROUND_TRIP_MS)
    return Line("time sync", good, text)


def _gps(report: Report) -> Line:
    gps = report.get("gps")
    if gps is None:
        return Line("gps", False, "the receiver has said nothing")
    seen = "" if gps["satellites"] is None else f", {gps['satellites']} satellites"
    sigma_m = gps["sigma_horizontal_m"]
    claim = "" if sigma_m is None else f", +-{sigma_m:.1f} m"
    good = gps["fix_type"] >= 3 and gps["age_s"] < 3.0 and (sigma_m is None or sigma_m <= MAX_GPS_SIGMA_M)
    old = f", {gps['age_s']:.0f} s old" if gps["age_s"] >= 3.0 else ""
    return Line("gps", good, f"fix type {gps['fix_type']}{seen}{claim}{old}")


def _mount(config: Config, report: Report) -> Line:
    mount = config.mount
    how = f"roll {mount.roll_deg:g}, pitch {mount.pitch_deg:g}, yaw {mount.yaw_deg:g} deg"
    learned = report.get("learned")
    if learned is None:
        return Line("mount", True, f"{how} +-{mount.sigma_deg:g}; nothing learned yet")
    off_deg = math.degrees(math.hypot(*learned["boresight_rad"]))
    sigma_deg = math.degrees(max(learned["sigma_boresight_rad"]))
    good = off_deg <= BORESIGHT_SIGMAS * math.hypot(mount.sigma_deg, sigma_deg)
    return Line("mount", good, f"{how}; learned in flight: {off_deg:.1f} +-{sigma_deg:.1f} deg beside that")


def _calibration(camera: Camera | str) -> Line:
    if isinstance(camera, str):
        return Line("calibration", False, camera)
    width, height = camera.size_px
    field_deg = math.degrees(2.0 * math.atan(0.5 * width / camera.focal_px))
    return Line("calibration", True, f"{width} x {height}, {field_deg:.0f} deg wide")


def _disk(config: Config, free_mb: float | None) -> Line:
    if not config.recording.enabled:
        return Line("disk", True, "recording is off")
    if free_mb is None:
        return Line("disk", False, "room unknown")
    return Line(
        "disk",
        free_mb > config.recording.keep_free_mb,
        f"{free_mb / 1000.0:.1f} GB free, {config.recording.keep_free_mb / 1000.0:.1f} kept free",
    )


def _processor(temperature_c: float | None) -> Line:
    if temperature_c is None:
        return Line("processor", True, "tells no temperature")
    return Line("processor", temperature_c < HOT_C, f"{temperature_c:.0f} deg C")


def _state(health: dict[str, Any]) -> str:
    return f"{health['state']}: {health['detail']}" if health["detail"] else str(health["state"])
