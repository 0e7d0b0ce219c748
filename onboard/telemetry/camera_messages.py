"""What the camera looks at, as MAVLink tells it: the ground in the picture's middle, and a target."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

UNKNOWN = 2**31 - 1


@dataclass(frozen=True)
class View:
    """The camera and the ground point in the middle of its picture: degrees, metres above mean sea level.

    `q_ned_camera`: quaternion w, x, y, z of the camera's forward-right-down axes. `ground` None: sky, or not known.
    """

    stamp_ns: int
    camera: tuple[float, float, float]  # latitude, longitude, height
    ground: tuple[float, float, float] | None
    q_ned_camera: tuple[float, float, float, float]
    field_of_view_deg: tuple[float, float]  # horizontal, vertical


@dataclass(frozen=True)
class Target:
    """A located target: degrees, metres above mean sea level, one sigma of each."""

    lat_deg: float
    lon_deg: float
    height_amsl_m: float
    sigma_horizontal_m: float
    sigma_vertical_m: float


def fov_status(view: View) -> Any:
    """CAMERA_FOV_STATUS."""
    return mavlink.MAVLink_camera_fov_status_message(
        (view.stamp_ns // 1_000_000) % 2**32,
        *_place(view.camera),
        *(_place(view.ground) if view.ground is not None else (UNKNOWN, UNKNOWN, UNKNOWN)),
        list(view.q_ned_camera),
        *view.field_of_view_deg,
    )


def tracking_status(target: Target) -> Any:
    """CAMERA_TRACKING_GEO_STATUS of a target that does not move."""
    return mavlink.MAVLink_camera_tracking_geo_status_message(
        mavlink.CAMERA_TRACKING_STATUS_FLAGS_ACTIVE,
        round(target.lat_deg * 1e7),
        round(target.lon_deg * 1e7),
        target.height_amsl_m,
        target.sigma_horizontal_m,
        target.sigma_vertical_m,
        0.0,
        0.0,
        0.0,
        math.nan,
        math.nan,
        math.nan,
        math.nan,
    )


def _place(place: tuple[float, float, float]) -> tuple[int, int, int]:
    lat_deg, lon_deg, height_m = place
    return round(lat_deg * 1e7), round(lon_deg * 1e7), round(height_m * 1000.0)
