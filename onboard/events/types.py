"""Events that enter the pipeline: immutable, each with its `stamp_ns` on one clock (Unix nanoseconds of host or log).

`stamp_ns` is when the thing was true (mid-exposure, the autopilot's own stamp mapped by `clock`), not when it arrived.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture, grey (H, W) uint8. `index` counts pictures in capture order from 0; `image` None: undecodable.

    `stamp_sigma_s`: one sigma of the stamp beyond what the configuration states, where the source sees that its
    stamps have changed; an error common to all pictures that have it. `colour`: the same in colour, blue first
    (H, W, 3), where a recording is to show it; nothing is measured in it. `counts`: a thermal camera's own (H, W),
    of which `image` is made; None of any other camera, and wherever `image` is None.
    """

    stamp_ns: int
    index: int
    image: NDArray[np.uint8] | None
    name: str = ""
    stamp_sigma_s: float = 0.0
    colour: NDArray[np.uint8] | None = None
    counts: NDArray[np.uint16] | None = None


@dataclass(frozen=True)
class PositionFix:
    """The navigation filter's position: degrees, metres above mean sea level, velocity north-east-down if known."""

    stamp_ns: int
    lat_deg: float
    lon_deg: float
    height_amsl_m: float
    velocity_ned_m_s: tuple[float, float, float] | None = None
    height_above_home_m: float | None = None


@dataclass(frozen=True)
class GpsQuality:
    """The receiver's report on itself; None where it has no value. `undulation_m` = ellipsoidal minus AMSL height.

    `sigma_datum_m`: one sigma of the origin of a log's heights, one error that all of them share. `fix`: the receiver's
    own position and velocity, in which the autopilot's filter has no part, where this report brings a new one.
    """

    stamp_ns: int
    fix_type: int  # MAVLink GPS_FIX_TYPE: 0-1 none, 2 two-dimensional, 3 and up usable
    satellites: int | None = None
    sigma_horizontal_m: float | None = None
    sigma_vertical_m: float | None = None
    sigma_velocity_m_s: float | None = None
    undulation_m: float | None = None
    sigma_datum_m: float | None = None
    fix: PositionFix | None = None

    @property
    def has_fix(self) -> bool:
        return self.fix_type > 2


@dataclass(frozen=True)
class Attitude:
    """The vehicle's attitude: quaternion w, x, y, z of R_ned_body (body FRD), and its rate in body axes if known."""

    stamp_ns: int
    q_ned_body: tuple[float, float, float, float]
    rate_body_rad_s: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class FilterStatus:
    """The report of the autopilot's navigation filter on itself (EKF_STATUS_REPORT, ESTIMATOR_STATUS)."""

    stamp_ns: int
    has_position: bool  # horizontal position is absolute by its own estimate
    is_glitching: bool  # the filter calls the GPS a glitch
    is_at_rest: bool = False  # it holds the position constant, believing position and velocity: standing on the ground
    sigma_velocity_m_s: float | None = None  # of its velocity, the larger of horizontal and vertical, where it has one


@dataclass(frozen=True)
class GimbalAttitude:
    """A stabilised camera's attitude: quaternion w, x, y, z of R_ref_gimbal, gimbal axes forward-right-down.

    `reference` "vehicle": roll and pitch against the horizon, yaw against the nose; "earth": all three against
    north-east-down. It replaces the fixed mount while it comes. `is_of_camera`: it was written by the very camera that
    took the pictures, so that nothing is open about what carries it.
    """

    stamp_ns: int
    q_ref_gimbal: tuple[float, float, float, float]
    reference: Literal["vehicle", "earth"]
    is_of_camera: bool = False


@dataclass(frozen=True)
class RangeFinder:
    """A distance measured along a unit direction in body axes (FRD), metres; its one sigma if the sensor gives it."""

    stamp_ns: int
    distance_m: float
    direction_body: tuple[float, float, float]
    sigma_m: float | None = None


@dataclass(frozen=True)
class Home:
    """The place that the autopilot's heights above home count from, where it was armed: degrees, m above sea level."""

    stamp_ns: int
    lat_deg: float
    lon_deg: float
    height_amsl_m: float


ZoomUnit = Literal["focal_px", "times", "percent", "hfov_deg"]  # the better first


@dataclass(frozen=True)
class Zoom:
    """The reported zoom of the lens, in one of several units.

    "times": the enlargement of the widest view; "percent": of the way from the widest to the longest; or the focal
    length of the full picture in pixels, or its horizontal field of view. `step`: the smallest difference that can be
    reported. `is_of_picture`: the stamp is a picture's, on the camera's clock.
    """

    stamp_ns: int
    value: float
    unit: ZoomUnit
    step: float = 0.0
    is_of_picture: bool = False


NavEvent = PositionFix | GpsQuality | Attitude | FilterStatus | GimbalAttitude | RangeFinder | Zoom | Home
Event = Frame | NavEvent
