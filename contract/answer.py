"""The answer to a click: a position with its error, or a refusal with its reason; and how both are written."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status

Array = NDArray[np.float64]

CONFIDENCE = 0.9
CHI2_2 = -2.0 * math.log(1.0 - CONFIDENCE)  # quantile of chi-square with two degrees of freedom: 4.605

ROUNDED_SHARE = 0.2  # of its 90 % radius by which rounding may move a place: the radius grows by less than a hundredth
DEGREES = 111_700.0, 7  # metres that a degree is at most, and the most decimals of it that are written

# Refusals in a sentence: what is wrong, and what may help.
EXPLANATIONS: dict[Status, str] = {
    Status.OK: "answered",
    Status.STARTING: "the aircraft has no solved picture yet",
    Status.LOW_PARALLAX: "the aircraft has hardly moved sideways, so depth cannot be measured",
    Status.OUTSIDE: "the pixel is off the picture or too far from every measured feature",
    Status.ABOVE_HORIZON: "the pixel shows no ground that can be measured: at or above the horizon",
    Status.STALE: "the newest picture is too old",
    Status.UNSYNCHRONISED: "picture and autopilot time do not agree",
    Status.TURNING: "the aircraft was turning too fast",
    Status.NO_GPS: "there was no usable GPS position",
    Status.FEATURELESS: "the ground showed too little texture to track",
    Status.POOR_FIT: "the measurements of this picture contradict each other",
    Status.UNCERTAIN: "the position would be too uncertain to be of use",
    Status.CAMERA_LOST: "the camera has stopped",
    Status.UNKNOWN_FRAME: "there is no such picture",
    Status.BAD_PICTURE: "the picture could not be read",
    Status.OUTSIDE_CALIBRATION: "the lens calibration does not hold at this pixel",
    Status.REPETITIVE: "the ground repeats itself (rows, tiles): what was matched may be a whole row off",
    Status.STABILISED: "the camera's electronic stabilisation shifts the picture: switch it off",
    Status.ZOOMED: "the lens has zoomed or refocused since it was calibrated: set it back",
    Status.MIRRORED: "the picture is a mirror image: switch off the camera's flip (or mirror)",
    Status.STRETCHED: "the picture is stretched along one side against its calibration: calibrate at this picture size",
}


def decimals(unit_m: float, most: int, radius_m: float) -> int:
    """The decimals of a coordinate for people, one unit of which is at most `unit_m`: as few as move a place by at most
    ROUNDED_SHARE of its 90 % radius.
    """
    allowed_m = ROUNDED_SHARE * radius_m
    return next((count for count in range(most) if math.sqrt(0.5) * unit_m * 10.0**-count <= allowed_m), most)


@dataclass(frozen=True)
class Ellipse:
    """Horizontal error ellipse at `CONFIDENCE`; azimuth of the major axis clockwise from north, in [0, 180)."""

    semi_major_m: float
    semi_minor_m: float
    azimuth_deg: float

    @classmethod
    def from_covariance(cls, covariance_en_m2: Array) -> Ellipse:
        """The 90 % ellipse of a 2 x 2 covariance in east, north."""
        values, vectors = np.linalg.eigh(covariance_en_m2)
        minor, major = np.sqrt(CHI2_2 * np.maximum(values, 0.0))
        azimuth = math.degrees(math.atan2(vectors[0, 1], vectors[1, 1])) % 180.0
        return cls(float(major), float(minor), azimuth if azimuth < 180.0 else 0.0)

    @property
    def covariance_en_m2(self) -> Array:
        """(2, 2) east, north, never quite singular: a millimetre is added along each axis."""
        axes = self.axes_en
        variances_m2 = np.array([self.semi_major_m, self.semi_minor_m]) ** 2 / CHI2_2
        return axes.T @ np.diag(variances_m2) @ axes + 1e-6 * np.eye(2)

    def rounded(self, lat_deg: float, lon_deg: float) -> str:
        """Latitude and longitude of what it is about, for people: to as many digits as it gives meaning to."""
        digits = decimals(*DEGREES, self.semi_major_m)
        return f"{lat_deg:.{digits}f} {lon_deg:.{digits}f}"

    @property
    def axes_en(self) -> Array:
        """Unit vectors (2, 2) of the major and the minor axis, rows, in east, north."""
        azimuth = math.radians(self.azimuth_deg)
        east, north = math.sin(azimuth), math.cos(azimuth)
        return np.array([[east, north], [-north, east]])


@dataclass(frozen=True)
class Place:
    """A position: degrees, metres above mean sea level or the ellipsoid (None: not known), its 90 % ellipse."""

    lat_deg: float
    lon_deg: float
    height_amsl_m: float | None
    height_ellipsoid_m: float | None
    ellipse: Ellipse
    sigma_height_m: float

    def to_dict(self) -> dict[str, object]:
        """Return the JSON object; latitude and longitude with nine decimals, lengths in mm."""
        e = self.ellipse
        return {
            "lat_deg": round(self.lat_deg, 9), "lon_deg": round(self.lon_deg, 9),
            "height_amsl_m": rounded(self.height_amsl_m), "height_ellipsoid_m": rounded(self.height_ellipsoid_m),
            "ellipse": {
                "confidence": CONFIDENCE, "semi_major_m": rounded(e.semi_major_m),
                "semi_minor_m": rounded(e.semi_minor_m), "azimuth_deg": round(e.azimuth_deg, 2),
            },
            "sigma_height_m": rounded(self.sigma_height_m),
        }  # fmt: skip


def rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


@dataclass(frozen=True, eq=False)
class Fix:
    """An answered click. Heights are None where the datum's undulation is unknown, the picture's age where that is."""

    lat_deg: float
    lon_deg: float
    height_ellipsoid_m: float | None
    height_amsl_m: float | None
    ellipse: Ellipse
    sigma_height_m: float
    method: str
    frame: int
    capture_unix_ns: int
    vehicle: str
    offset_enu_m: Array  # from the camera, in its east-north-up axes
    covariance_enu_m2: Array  # (3, 3)
    age_s: float | None = None  # of the picture when the answer came; in a recording, against its newest picture
    above_ground_m: float | None = None  # of what was measured, and its one sigma
    sigma_above_ground_m: float | None = None
    unmeasured: str = ""  # why it was not, where that was asked for
    is_recorded: bool = False  # the age is that before the end of a recording, and not before now

    @property
    def status(self) -> Status:
        return Status.OK

    @property
    def place(self) -> Place:
        """The position alone, without method, set or time."""
        heights = self.height_amsl_m, self.height_ellipsoid_m
        return Place(self.lat_deg, self.lon_deg, *heights, self.ellipse, self.sigma_height_m)

    def to_json(self) -> str:
        """One line; latitude and longitude with nine decimals (0.1 mm)."""
        heights = (f"{h:.3f}" if h is not None else "null" for h in (self.height_ellipsoid_m, self.height_amsl_m))
        ellipsoid, amsl = heights
        e = self.ellipse
        return (
            f'{{"status": "ok", "lat_deg": {self.lat_deg:.9f}, "lon_deg": {self.lon_deg:.9f}, '
            f'"height_ellipsoid_m": {ellipsoid}, "height_amsl_m": {amsl}, '
            f'"ellipse": {{"confidence": {CONFIDENCE}, "semi_major_m": {e.semi_major_m:.3f}, '
            f'"semi_minor_m": {e.semi_minor_m:.3f}, "azimuth_deg": {e.azimuth_deg:.2f}}}, '
            f'"sigma_height_m": {self.sigma_height_m:.3f}, "method": {json.dumps(self.method)}, '
            f'"frame": {self.frame}, "time_utc": "{time_utc(self.capture_unix_ns)}", '
            f'"age_s": {"null" if self.age_s is None else f"{self.age_s:.3f}"}, '
            f'"vehicle": {json.dumps(self.vehicle)}{self._measured_json()}}}'
        )

    def _measured_json(self) -> str:
        """Return the fields that an answer gains if its pixel was asked to be measured."""
        if self.unmeasured:
            return f', "unmeasured": {json.dumps(self.unmeasured)}'
        if self.above_ground_m is None:
            return ""
        return f', "above_ground_m": {self.above_ground_m:.3f}, "sigma_above_ground_m": {self.sigma_above_ground_m:.3f}'

    @property
    def method_text(self) -> str:
        """The method for people: with the height above the ground of what was measured, or why it was not."""
        if self.unmeasured:
            return f"{self.method} (not measured: {self.unmeasured})"
        if self.above_ground_m is None:
            return self.method
        return f"{self.method}, {self.above_ground_m:.1f} +-{self.sigma_above_ground_m:.1f} m above the ground"

    def to_text(self) -> str:
        """One line for people."""
        amsl, ellipsoid = self.height_amsl_m, self.height_ellipsoid_m
        height = f"{amsl:.1f} m AMSL" if amsl is not None else f"{ellipsoid:.1f} m above the ellipsoid"
        e = self.ellipse
        return (
            f"{e.rounded(self.lat_deg, self.lon_deg)}  {height} +-{self.sigma_height_m:.1f} m  "
            f"{CONFIDENCE:.0%} ellipse {e.semi_major_m:.1f} x {e.semi_minor_m:.1f} m at {e.azimuth_deg:.0f} deg  "
            f"{self.method_text}  frame {self.frame} of {self.vehicle} at {time_utc(self.capture_unix_ns)}, "
            f"{age_text(self.age_s, self.is_recorded)}"
        )


@dataclass(frozen=True)
class Refusal:
    """A click without an answer, and why. Frame, time and vehicle are None where no set was found."""

    status: Status
    frame: int | None = None
    capture_unix_ns: int | None = None
    vehicle: str | None = None
    detail: str = ""
    age_s: float | None = None
    is_recorded: bool = False

    def to_json(self) -> str:
        """One line."""
        when = None if self.capture_unix_ns is None else time_utc(self.capture_unix_ns)
        return json.dumps(
            {
                "status": self.status.value,
                "reason": self.reason,
                "frame": self.frame,
                "time_utc": when,
                "age_s": None if self.age_s is None else round(self.age_s, 3),
                "vehicle": self.vehicle,
            }
        )

    @property
    def reason(self) -> str:
        return self.detail or EXPLANATIONS[self.status]

    def to_text(self) -> str:
        """One line for people."""
        age = "" if self.capture_unix_ns is None else f", {age_text(self.age_s, self.is_recorded)}"
        where = "" if self.frame is None else f" (frame {self.frame}{age})"
        return f"{self.status.value}: {self.reason}{where}"


Answer = Fix | Refusal


def age_text(age_s: float | None, is_recorded: bool = False) -> str:
    """The age of a picture for people; that of a recorded one is no age by now."""
    if age_s is None:
        return "of unknown age"
    return f"{age_s:.1f} s before the recording's end" if is_recorded else f"{age_s:.1f} s old"


def time_utc(unix_ns: int) -> str:
    """ISO 8601 with microseconds, as in 2018-05-02T01:23:45.678901Z."""
    seconds, rest = divmod(unix_ns, 1_000_000_000)
    try:
        moment = datetime.fromtimestamp(seconds, UTC)
    except (OverflowError, ValueError, OSError):
        return f"unix {unix_ns / 1e9:.6f}"
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{rest // 1000:06d}Z"
