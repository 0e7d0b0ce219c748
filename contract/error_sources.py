"""The sources of a click's error in words: which one, and what would make it smaller. docs/mathematics-budget.md.

The aircraft computes the shares and sends the codes of the largest ones (docs/wire-format.md, section 10); both sides
print them from this table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

LEAST_SHARE = 0.15  # of a click's variance, from which on a source is worth an advice
MOST = 0.5  # from which on it is more than all others together


class Cause(StrEnum):
    """A source of error by its code, as it stands on the wire."""

    MOUNT = "mount"
    STAMPS = "stamps"
    DELAYS = "delays"
    COMPASS = "compass"
    LENS = "lens"
    SLOPE = "slope"
    DATUM = "datum"
    RELIEF = "relief"
    PIXELS = "pixels"
    GPS_SLOW = "gps"
    GPS_WHITE = "gpsnoise"
    SPEED = "speed"
    ATTITUDE_SLOW = "attitude"
    ATTITUDE_WHITE = "attnoise"
    HEADING_NOISE = "heading"
    PATH = "path"
    RANGE = "range"
    WATER = "water"
    WINDOWS = "windows"
    FEATURES = "features"
    BETWEEN = "between"


@dataclass(frozen=True)
class About:
    """A source's name in tables, what an operator calls it, one thing to do against it, and why or what else."""

    name: str
    words: str
    advice: str
    more: str = ""

    @property
    def in_full(self) -> str:
        return f"{self.advice}{self.more}"


# A source is known by what observes it: turns show mount, stamps, delays and compass; what no turn shows needs a better
# sensor or known ground.
ABOUT: Mapping[Cause, About] = {
    Cause.MOUNT: About(
        "mount", "the camera's mount", "fly one circle", ": banking both ways shows how the camera is mounted"
    ),
    Cause.STAMPS: About(
        "camera stamps",
        "the camera's time offset",
        "roll briskly left and right a few times",
        ": that shows the camera's time offset",
    ),
    Cause.DELAYS: About(
        "delays", "the GPS's delay", "fly one circle at constant speed", ", or set gps.latency_s if it is known"
    ),
    Cause.COMPASS: About(
        "compass", "the compass", "fly one full circle", ": every heading shows the compass's error there"
    ),
    Cause.LENS: About("focal length and lens", "the lens", "calibrate the camera", " (pc-onboard calibrate)"),
    Cause.SLOPE: About(
        "ground slope",
        "the ground's slope",
        "fly a second leg across the first",
        ", or load an elevation model (terrain.path)",
    ),
    Cause.DATUM: About(
        "terrain model",
        "the elevation model",
        "load a better elevation model",
        ", or set terrain.sigma_datum_m if it is better than that",
    ),
    Cause.RELIEF: About(
        "terrain roughness", "the ground's roughness", "fly lower", ", or load an elevation model (terrain.path)"
    ),
    Cause.PIXELS: About("pixel noise", "the pixels", "fly lower", ", or use a longer lens or a larger picture"),
    Cause.GPS_SLOW: About(
        "GPS, correlated",
        "the GPS",
        "click the same thing again minutes later",
        ", or set gps.sigma_correlated_horizontal_m if positions are known to be better than that",
    ),
    Cause.GPS_WHITE: About(
        "GPS, white",
        "the noise of the GPS",
        "fly straight on for half a minute",
        ": that gives the window longer",
    ),
    Cause.SPEED: About(
        "velocity", "the measured speed", "fly straight on for some seconds", ", or use a receiver with better velocity"
    ),
    Cause.ATTITUDE_SLOW: About(
        "attitude, correlated",
        "the autopilot's attitude",
        "click the same thing again from the opposite heading",
        ", or calibrate the autopilot's level",
    ),
    Cause.ATTITUDE_WHITE: About(
        "attitude, white", "the noise of the attitude", "fly calmer", ", or send attitude at 50 Hz"
    ),
    Cause.HEADING_NOISE: About("heading", "the heading", "calibrate the compass", ", or use a dual-antenna heading"),
    Cause.PATH: About(
        "no attitude: coordinated turn",
        "the missing attitude",
        "send the autopilot's attitude",
        " (solve.attitude)",
    ),
    Cause.RANGE: About(
        "range finder",
        "the range finder",
        "use a better range finder",
        ", or set its sigma if it is better than stated",
    ),
    Cause.WATER: About(
        "ground that moves", "ground that moves", "click something that stands on land", ": the ground seems to move"
    ),
    Cause.WINDOWS: About(
        "beyond the covariance",
        "errors that no sensor explains",
        "calibrate the camera",
        "; without attitude, send it: windows disagree, or hardly show the heading",
    ),
    Cause.FEATURES: About(
        "features' depth", "the depth of the features", "click on textured ground", ", or raise tracking.features"
    ),
    Cause.BETWEEN: About(
        "ground between features",
        "the ground between the features",
        "click nearer to a tracked feature",
        ", or load an elevation model (terrain.path)",
    ),
}


def in_a_line(shares: Mapping[str, float]) -> str:
    """The main source, for an operator: "mostly the camera's mount (60 %): fly one circle". Empty without shares.

    `shares` of a click's variance by code, the largest first. A code of a later version is printed as it is.
    """
    if not shares:
        return ""
    code, share = next(iter(shares.items()))
    percent = f"{100.0 * share:.0f} %"
    if share < LEAST_SHARE:
        return f"many small causes, none above {percent}"
    about = ABOUT.get(Cause(code)) if code in Cause.__members__.values() else None
    how = "mostly" if share >= MOST else "mainly"
    if about is None:
        return f"{how} {code} ({percent})"
    return f"{how} {about.words} ({percent}): {about.advice}"
