"""MAVLink messages -> events, the same for a live link and a telemetry log."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.events.types import (
    Attitude,
    FilterStatus,
    GimbalAttitude,
    GpsQuality,
    Home,
    NavEvent,
    PositionFix,
    RangeFinder,
    Zoom,
)

AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1

# The messages that events are made of, and those that specify sender and time.
WANTED = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
    mavlink.MAVLINK_MSG_ID_ATTITUDE,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
    mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS,
    mavlink.MAVLINK_MSG_ID_MOUNT_ORIENTATION,
    mavlink.MAVLINK_MSG_ID_CAMERA_SETTINGS,
    mavlink.MAVLINK_MSG_ID_CAMERA_FOV_STATUS,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION,
}

# A receiver whose own stamp stands still this long has stopped, whatever fix it still claims.
FROZEN_GPS_NS = 2_000_000_000
REPEATED_NS = 1_000_000_000  # as seldom as a receiver measures, but for one that stands
# GPS_RAW_INT stamps are microseconds since boot or since 1970; no autopilot stays up for three years.
MAX_BOOT_US = 10**14
UNKNOWN_U16 = 65535

GIMBAL_UNFIT = (
    mavlink.GIMBAL_DEVICE_ERROR_FLAGS_ENCODER_ERROR
    | mavlink.GIMBAL_DEVICE_ERROR_FLAGS_COMMS_ERROR
    | mavlink.GIMBAL_DEVICE_ERROR_FLAGS_CALIBRATION_RUNNING
)
ROTATION = "MAV_SENSOR_ROTATION_"
CUSTOM_ROTATION = mavlink.MAV_SENSOR_ROTATION_CUSTOM
UNKNOWN_COVARIANCE = 255
AT_REST = mavlink.ESTIMATOR_VELOCITY_HORIZ | mavlink.ESTIMATOR_POS_HORIZ_ABS | mavlink.ESTIMATOR_PRED_POS_HORIZ_ABS
NO_SIGNAL = 1  # of signal_quality, per cent; 0 is unknown


@dataclass(frozen=True)
class Sources:
    """The message that serves where an autopilot sends two with the same content."""

    position: str = "GLOBAL_POSITION_INT"  # or GPS_RAW_INT
    attitude: str = "ATTITUDE"  # or ATTITUDE_QUATERNION

    @classmethod
    def by_counts(cls, counts: Counter[str]) -> Sources:
        """Return the navigation filter's position if there is one, and the attitude message with the higher rate."""
        quaternion = counts["ATTITUDE_QUATERNION"] > counts["ATTITUDE"]
        return cls(
            "GLOBAL_POSITION_INT" if counts["GLOBAL_POSITION_INT"] else "GPS_RAW_INT",
            "ATTITUDE_QUATERNION" if quaternion else "ATTITUDE",
        )


def boot_ns_of(message: Any) -> int | None:
    """The boot stamp a message carries, or None."""
    boot_ms = getattr(message, "time_boot_ms", None)
    return None if boot_ms is None else int(boot_ms) * 1_000_000


UNSTAMPED = {"GPS_RAW_INT", "EKF_STATUS_REPORT", "ESTIMATOR_STATUS", "HOME_POSITION"}


class MessageToEvent:
    """One autopilot's decoded messages, in order of arrival, -> events stamped on our clock."""

    def __init__(self, sources: Sources) -> None:
        self.sources = sources
        self._latest_boot_ns: int | None = None
        self._newest_boot_ns: dict[str, int] = {}  # of position and attitude
        self._has_velocity = False  # one other than exactly 0 has come: Betaflight and others send that for unknown
        self._place: tuple[float, ...] | None = None  # the newest position
        self._moved_ns: int | None = None  # when that came to be another
        self._passed_on_ns = 0  # when one was passed on without a velocity
        self._gps_stamp_us = 0
        self._gps_moved_ns = 0

    def convert(self, message: Any, arrival_ns: int, to_host_ns: Callable[[int], int]) -> list[NavEvent]:
        """A pymavlink message -> the events it carries, often none. `to_host_ns` maps boot time (ns) to our clock."""
        boot_ns = boot_ns_of(message)
        if boot_ns is not None:
            self._latest_boot_ns = boot_ns
        name = message.get_type()
        event: NavEvent | None = None
        if name in UNSTAMPED:
            # GPS_RAW_INT's stamp stands still with the receiver, and the filters' reports and the home have none to go
            # by, so when they were sent is taken from the boot stamp before them.
            now_ns = arrival_ns if self._latest_boot_ns is None else to_host_ns(self._latest_boot_ns)
            if name == "HOME_POSITION":
                return _home(message, now_ns)
            if name != "GPS_RAW_INT":
                return [_filter_status(message, now_ns)]
            fix = _receiver_position(message, now_ns, to_host_ns)
            # One that is sent again as it was is no other position; a stamp of 0 is none.
            is_repeated = 0 < int(message.time_usec) == self._gps_stamp_us
            quality = self._quality(message, now_ns, fix)
            return [quality] if fix is None or is_repeated or self.sources.position != name else [quality, fix]
        if boot_ns is None:
            return []
        if name in (self.sources.position, self.sources.attitude):
            # By two ways, or forwarded more often than it is made, it is still one measurement.
            if self._newest_boot_ns.get(name) == boot_ns:
                return []
            self._newest_boot_ns[name] = boot_ns
            make = _filter_position if name == self.sources.position else _attitude
            event = make(message, to_host_ns(boot_ns))
            if isinstance(event, PositionFix):
                event = self._known(event)
        elif name in GIMBAL_EVENTS:
            event = GIMBAL_EVENTS[name](message, to_host_ns(boot_ns))
        elif name in ZOOM_EVENTS:
            event = ZOOM_EVENTS[name](message, to_host_ns(boot_ns))
        elif name == "DISTANCE_SENSOR":
            event = _range(message, to_host_ns(boot_ns))
        return [] if event is None else [event]

    def _known(self, fix: PositionFix) -> PositionFix | None:
        """A filter's position, without a velocity if it moves and that is exactly 0.

        A sender without one passes on what its receiver has: a position that comes again within REPEATED_NS is the same
        measurement, and no event.
        """
        place, before, now_ns = (fix.lat_deg, fix.lon_deg, fix.height_amsl_m), self._place, fix.stamp_ns
        self._place = place
        if place != before and before is not None:
            self._moved_ns = now_ns
        self._has_velocity = self._has_velocity or any(fix.velocity_ned_m_s or ())
        if self._has_velocity or self._moved_ns is None or now_ns - self._moved_ns > 2 * REPEATED_NS:
            return fix
        if place == before and 0 <= now_ns - self._passed_on_ns < REPEATED_NS:
            return None
        self._passed_on_ns = now_ns
        return replace(fix, velocity_ned_m_s=None)

    def _quality(self, message: Any, now_ns: int, fix: PositionFix | None) -> GpsQuality:
        stamp_us = int(message.time_usec)
        is_new = stamp_us != self._gps_stamp_us  # it is sent again and again as it was
        if stamp_us != self._gps_stamp_us or stamp_us == 0:
            self._gps_stamp_us, self._gps_moved_ns = stamp_us, now_ns
        frozen = now_ns - self._gps_moved_ns > FROZEN_GPS_NS
        fix_type = 0 if frozen else int(message.fix_type)
        ellipsoid_mm = getattr(message, "alt_ellipsoid", 0)
        known = ellipsoid_mm != 0 and fix_type >= 3
        return GpsQuality(
            now_ns,
            fix_type,
            None if message.satellites_visible == 255 else int(message.satellites_visible),
            _claim(message, "h_acc"),
            _claim(message, "v_acc"),
            _claim(message, "vel_acc"),
            (ellipsoid_mm - message.alt) / 1000.0 if known else None,
            fix=fix if is_new else None,
        )


def _claim(message: Any, key: str) -> float | None:
    """A receiver's own one-sigma claim, mm (or mm/s) -> m (m/s); MAVLink 1 lacks it and 0 means unknown."""
    return getattr(message, key, 0) / 1000.0 or None


def _is_place(message: Any) -> bool:
    """0, 0 is what is sent for nowhere."""
    return (message.lat, message.lon) != (0, 0) and abs(message.lat) <= 90e7 and abs(message.lon) <= 180e7


def _receiver_position(message: Any, now_ns: int, to_host_ns: Callable[[int], int]) -> PositionFix | None:
    if message.fix_type < 3 or not _is_place(message):
        return None
    boot_like = 0 < message.time_usec < MAX_BOOT_US
    velocity = None
    if UNKNOWN_U16 not in (message.vel, message.cog):
        speed, course = message.vel / 100.0, math.radians(message.cog / 100.0)
        velocity = speed * math.cos(course), speed * math.sin(course), math.nan
    return PositionFix(
        to_host_ns(int(message.time_usec) * 1000) if boot_like else now_ns,
        message.lat / 1e7,
        message.lon / 1e7,
        message.alt / 1000.0,
        velocity,
    )


def _filter_position(message: Any, stamp_ns: int) -> PositionFix | None:
    if not _is_place(message):  # sent before the filter has an origin
        return None
    return PositionFix(
        stamp_ns,
        message.lat / 1e7,
        message.lon / 1e7,
        message.alt / 1000.0,
        (message.vx / 100.0, message.vy / 100.0, message.vz / 100.0),
        message.relative_alt / 1000.0,
    )


def _attitude(message: Any, stamp_ns: int) -> Attitude | None:
    if message.get_type() == "ATTITUDE":
        q = _quaternion_from_euler(message.roll, message.pitch, message.yaw)
    else:
        q = message.q1, message.q2, message.q3, message.q4
    norm = math.hypot(*q)
    if not 0.5 < norm < 2.0:  # also false for nan
        return None
    w, x, y, z = (part / norm for part in q)
    rate = message.rollspeed, message.pitchspeed, message.yawspeed
    known = any(rate) and math.isfinite(sum(rate))  # a gyro is never still to the last bit: three zeros are unset
    return Attitude(stamp_ns, (w, x, y, z), rate if known else None)


def _quaternion_from_euler(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Scalar form of (1.2) as a quaternion: this runs for every message of a log. Not finite angles give nan."""
    if not math.isfinite(roll + pitch + yaw):
        return math.nan, 0.0, 0.0, 0.0
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def _home(message: Any, stamp_ns: int) -> list[NavEvent]:
    lat_deg, lon_deg = message.latitude / 1e7, message.longitude / 1e7
    if (lat_deg, lon_deg) == (0.0, 0.0) or abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0:  # sent for nowhere
        return []
    return [Home(stamp_ns, lat_deg, lon_deg, message.altitude / 1000.0)]


def _filter_status(message: Any, stamp_ns: int) -> FilterStatus:
    """EKF_STATUS_REPORT and ESTIMATOR_STATUS share their flags up to the ninth; those for a glitch differ."""
    flags = int(message.flags)
    is_ardupilot = message.get_type() == "EKF_STATUS_REPORT"
    glitch = mavlink.EKF_GPS_GLITCHING if is_ardupilot else mavlink.ESTIMATOR_GPS_GLITCH
    has_position = bool(flags & mavlink.EKF_POS_HORIZ_ABS)
    is_held = bool(flags & mavlink.EKF_CONST_POS_MODE)
    # A filter held at a constant position because it has none reports that as absolute too. PX4 holds it whenever it
    # stands still, with GNSS fused and position and velocity good.
    is_at_rest = is_held and not is_ardupilot and flags & AT_REST == AT_REST
    if (is_held and not is_at_rest) or (is_ardupilot and flags & mavlink.EKF_UNINITIALIZED):
        has_position = False
    return FilterStatus(stamp_ns, has_position, bool(flags & glitch), is_at_rest)


def _gimbal(message: Any, stamp_ns: int) -> GimbalAttitude | None:
    flags = int(message.flags)
    norm = math.hypot(*message.q)
    if not 0.5 < norm < 2.0 or message.failure_flags & GIMBAL_UNFIT:
        return None
    # Before there were flags for the frame, a locked yaw was one against north.
    earth = mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME | mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
    in_vehicle = flags & mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME or not flags & earth
    w, x, y, z = (part / norm for part in message.q)
    return GimbalAttitude(stamp_ns, (w, x, y, z), "vehicle" if in_vehicle else "earth")


def _mount_orientation(message: Any, stamp_ns: int) -> GimbalAttitude | None:
    """Degrees: roll and pitch against the horizon, yaw against the nose, or else against north."""
    reference: Literal["vehicle", "earth"] = "vehicle" if math.isfinite(message.yaw) else "earth"
    yaw = message.yaw if reference == "vehicle" else message.yaw_absolute
    q = _quaternion_from_euler(math.radians(message.roll), math.radians(message.pitch), math.radians(yaw))
    return GimbalAttitude(stamp_ns, q, reference) if math.isfinite(q[0]) else None


# These make an event of a gimbal's messages; the first is the newer one.
GIMBAL_EVENTS: dict[str, Callable[[Any, int], GimbalAttitude | None]] = {
    "GIMBAL_DEVICE_ATTITUDE_STATUS": _gimbal,
    "MOUNT_ORIENTATION": _mount_orientation,
}


def _zoom(value: float, stamp_ns: int, unit: Literal["percent", "hfov_deg"]) -> Zoom | None:
    return Zoom(stamp_ns, value, unit) if math.isfinite(value) else None


# These make an event of a camera's messages; a value that is not known is NaN.
ZOOM_EVENTS: dict[str, Callable[[Any, int], Zoom | None]] = {
    "CAMERA_FOV_STATUS": lambda message, stamp_ns: _zoom(message.hfov, stamp_ns, "hfov_deg"),
    "CAMERA_SETTINGS": lambda message, stamp_ns: _zoom(message.zoomLevel, stamp_ns, "percent"),
}


def _range(message: Any, stamp_ns: int) -> RangeFinder | None:
    direction = sensor_direction(int(message.orientation), tuple(getattr(message, "quaternion", ())))
    out_of_range = not message.min_distance < message.current_distance < message.max_distance
    if direction is None or out_of_range or getattr(message, "signal_quality", 0) == NO_SIGNAL:
        return None
    known = message.covariance not in (0, UNKNOWN_COVARIANCE)
    sigma_m = math.sqrt(message.covariance) / 100.0 if known else None
    return RangeFinder(stamp_ns, message.current_distance / 100.0, direction, sigma_m)


def sensor_direction(orientation: int, quaternion: tuple[float, ...] = ()) -> tuple[float, float, float] | None:
    """Return the direction that a sensor of a MAV_SENSOR_ORIENTATION looks in: a unit vector in body axes (FRD).

    None if it is not known. `quaternion` (w, x, y, z) counts for the custom orientation only.
    """
    if orientation == CUSTOM_ROTATION:
        norm = math.hypot(*quaternion) if len(quaternion) == 4 else 0.0
        if not 0.5 < norm < 2.0:
            return None
        w, x, y, z = (part / norm for part in quaternion)
        return 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)
    entry = mavlink.enums["MAV_SENSOR_ORIENTATION"].get(orientation)
    if entry is None or not entry.name.startswith(ROTATION):
        return None
    # The name holds the angles: ROLL_90_PITCH_68_YAW_293. Roll turns about the direction itself.
    words = entry.name.removeprefix(ROTATION).split("_")
    angles = dict(zip(words[::2], words[1::2], strict=False))
    pitch, yaw = (math.radians(float(angles.get(axis, 0.0))) for axis in ("PITCH", "YAW"))
    return math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), -math.sin(pitch)
