"""The statements of a MAVLink camera component as messages of pymavlink: functions of what is known.

Fields by MAVLink's common.xml. The standard gives no confidence for an accuracy: all are stated at 90 %, as everywhere
here, so that who takes them for one sigma is on the safe side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from contract.answer import CHI2_2, Answer, Fix, Place, Refusal
from contract.camera import Camera
from contract.errors import ConfigError
from contract.feature_set import FeatureSet, HeightDatum, Status
from contract.rotations import R_ENU_NED, R_GIMBAL_CAM, quaternion_from_matrix
from contract.track import TrackReport, TrackState

UNKNOWN, AT_INFINITY = 2**31 - 1, -(2**31)
SIGMAS_1D = 1.645  # 90 % of a normal distribution are within
NAN, MOST_REAL = math.nan, 3e38
MAX_URI = 159  # characters and the zero that ends them
VENDOR = b"pointclick"
# CAMERA_TRACKING_STATUS_FLAGS, CAMERA_TRACKING_MODE_POINT, CAMERA_TRACKING_TARGET_DATA_IN_STATUS
IDLE, ACTIVE, ERROR, COASTING = 0, 1, 2, 8
POINT, IN_STATUS = 1, 4
# CAMERA_CAP_FLAGS, VIDEO_STREAM_STATUS_FLAGS_RUNNING, CAMERA_MODE_VIDEO
HAS_VIDEO_STREAM, HAS_TRACKING_POINT, HAS_TRACKING_GEO_STATUS = 256, 512, 2048
RUNNING, VIDEO_MODE = 1, 1
STATUS = {
    TrackState.FOLLOWED: ACTIVE,
    TrackState.COASTING: ACTIVE | COASTING,
    TrackState.LOST: ERROR,
}
# VIDEO_STREAM_TYPE and VIDEO_STREAM_ENCODING (0: unknown)
SCHEMES = {
    "rtsp": (0, 0),
    "tcp": (2, 0),
    "h264": (1, 1),
    "h265": (1, 2),
    "mpegts": (3, 0),
}


@dataclass(frozen=True)
class Stream:
    """A video that the ground shows: VIDEO_STREAM_TYPE, VIDEO_STREAM_ENCODING, and an address or a port."""

    kind: int
    encoding: int
    uri: str

    @classmethod
    def parse(cls, text: str) -> Stream:
        """Read `mavlink_camera.video`. Raises ConfigError in one line."""
        scheme, _, rest = text.partition(":")
        known = SCHEMES.get(scheme)
        is_address = scheme in ("rtsp", "tcp")
        is_port = rest.isascii() and rest.isdecimal() and 0 < int(rest[:6]) < 65536
        is_good = (rest.startswith("//") and len(rest) > 2) if is_address else is_port
        if known is None or not is_good or len(text) > MAX_URI or not text.isascii():
            raise ConfigError(
                "the video (mavlink_camera.video, --video) is none of rtsp://HOST:PORT/PATH, tcp://HOST:PORT, "
                f"h264:PORT, h265:PORT and mpegts:PORT, of at most {MAX_URI} ASCII characters"
            )
        return cls(*known, text if is_address else rest)


@dataclass(frozen=True)
class CameraFacts:
    """The facts of a camera that do not change in flight.

    `boot_ns`: when the camera began, on the clock of the messages' stamps.
    """

    dialect: Any
    name: str
    camera: Camera
    rate_hz: float
    stream: Stream | None
    boot_ns: int

    def time_ms(self, now_ns: int) -> int:
        """Milliseconds since the beginning."""
        return (now_ns - self.boot_ns) // 1_000_000 % 2**32

    def information(self, now_ns: int) -> Any:
        """CAMERA_INFORMATION."""
        flags = HAS_TRACKING_POINT | HAS_TRACKING_GEO_STATUS
        if self.stream is not None:
            flags |= HAS_VIDEO_STREAM
        return self.dialect.MAVLink_camera_information_message(
            self.time_ms(now_ns), list(VENDOR.ljust(32, b"\0")), list(self.name.encode()[:31].ljust(32, b"\0")),
            0, NAN, NAN, NAN, self.camera.width_px, self.camera.height_px, 0, flags, 0, b"",
        )  # fmt: skip

    def settings(self, now_ns: int) -> Any:
        return self.dialect.MAVLink_camera_settings_message(self.time_ms(now_ns), VIDEO_MODE, NAN, NAN)

    def stream_information(self, stream: Stream) -> Any:
        """VIDEO_STREAM_INFORMATION; the bit rate is not known."""
        return self.dialect.MAVLink_video_stream_information_message(
            1, 1, stream.kind, RUNNING, self.rate_hz, self.camera.width_px,
            self.camera.height_px, 0, 0, self._hfov(), b"video", stream.uri.encode(), stream.encoding,
        )  # fmt: skip

    def stream_status(self) -> Any:
        return self.dialect.MAVLink_video_stream_status_message(
            1, RUNNING, self.rate_hz, self.camera.width_px, self.camera.height_px, 0,
            0, self._hfov(),
        )  # fmt: skip

    def _hfov(self) -> int:
        hfov_deg = fields_of_view_deg(self.camera)[0]
        return 0 if math.isnan(hfov_deg) else round(hfov_deg)

    def fov_status(self, found: FeatureSet, middle: Answer, taken_ns: int) -> Any:
        """CAMERA_FOV_STATUS of a picture by its set, stamped with when it was taken. The quaternion turns MAVLink's
        camera axes (x along the optical axis, y to the right, z down in the picture) to north, east, down.
        """
        height_m: float | None = found.camera_height_m
        if found.height_datum is HeightDatum.ELLIPSOID:
            height_m = None if math.isnan(found.undulation_m) else found.camera_height_m - found.undulation_m
        lat = lon = alt = UNKNOWN
        if isinstance(middle, Fix):
            lat, lon, alt = _degrees(middle.lat_deg), _degrees(middle.lon_deg), _millimetres(middle.height_amsl_m)
        elif middle.status is Status.ABOVE_HORIZON:
            lat = lon = alt = AT_INFINITY
        q = quaternion_from_matrix(R_ENU_NED.T @ found.R_enu_cam @ R_GIMBAL_CAM.T)
        return self.dialect.MAVLink_camera_fov_status_message(
            self.time_ms(taken_ns), _degrees(found.camera_lat_deg), _degrees(found.camera_lon_deg),
            _millimetres(height_m), lat, lon, alt, [float(c) for c in q], *fields_of_view_deg(found.camera),
        )  # fmt: skip

    def image_status(self, report: TrackReport | None) -> Any:
        """CAMERA_TRACKING_IMAGE_STATUS: where what is followed is in the picture; idle without it."""
        if report is None:
            return self.dialect.MAVLink_camera_tracking_image_status_message(IDLE, 0, 0, *[NAN] * 7)
        width, height = self.camera.width_px, self.camera.height_px
        return self.dialect.MAVLink_camera_tracking_image_status_message(
            STATUS[report.state], POINT, IN_STATUS,
            (report.u_px + 0.5) / width, (report.v_px + 0.5) / height, 0.5 * report.size_px / width, *[NAN] * 4,
        )  # fmt: skip

    def geo_of_fix(self, fix: Fix, *, is_followed: bool) -> Any:
        """CAMERA_TRACKING_GEO_STATUS of a click's answer; the distance is from where its picture was taken."""
        distance_m = float(np.linalg.norm(fix.offset_enu_m))
        return self._geo_status(ACTIVE if is_followed else IDLE, fix.place, (NAN, NAN, NAN), distance_m)

    def geo_of_track(self, report: TrackReport) -> Any | None:
        """CAMERA_TRACKING_GEO_STATUS of what is followed; None while its place is not known. Its heading never is."""
        if report.place is None:
            return None
        velocity, course = (NAN, NAN, NAN), report.course
        if course is not None:
            towards = math.radians(course.course_deg or 0.0)
            speed_m_s = course.speed_m_s if course.is_moving else 0.0
            accuracy_m_s = math.sqrt(CHI2_2) * course.sigma_speed_m_s
            velocity = speed_m_s * math.cos(towards), speed_m_s * math.sin(towards), accuracy_m_s
        return self._geo_status(STATUS[report.state], report.place, velocity, NAN)

    def _geo_status(self, status: int, place: Place, velocity: tuple[float, float, float], distance_m: float) -> Any:
        height_m = NAN if place.height_amsl_m is None else place.height_amsl_m
        v_acc_m = NAN if place.height_amsl_m is None else SIGMAS_1D * place.sigma_height_m
        north_m_s, east_m_s, vel_acc_m_s = velocity
        height_m, v_acc_m, h_acc_m, distance_m = map(_real, (height_m, v_acc_m, place.ellipse.semi_major_m, distance_m))
        return self.dialect.MAVLink_camera_tracking_geo_status_message(
            status, _degrees(place.lat_deg), _degrees(place.lon_deg), height_m, h_acc_m, v_acc_m, _real(north_m_s),
            _real(east_m_s), NAN, _real(vel_acc_m_s), distance_m, NAN, NAN,
        )  # fmt: skip


def fields_of_view_deg(camera: Camera) -> tuple[float, float]:
    """The angles between the picture's edges at its middle, across and upright, degrees; nan where the lens is not
    calibrated out to them.
    """
    u, v = 0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1)
    edges = np.array([[-0.5, v], [camera.width_px - 0.5, v], [u, -0.5], [u, camera.height_px - 0.5]])
    rays, valid = camera.unproject(edges)
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    across, upright = (
        math.degrees(math.acos(float(np.clip(unit[k] @ unit[k + 1], -1.0, 1.0)))) if valid[k : k + 2].all() else NAN
        for k in (0, 2)
    )
    return across, upright


def words_of(answer: Answer) -> str:
    """The answer in a line for a ground station's messages."""
    if isinstance(answer, Refusal):
        return f"click: {answer.reason}"
    ellipse, height_m = answer.ellipse, answer.height_amsl_m
    height = "" if height_m is None else f", {height_m:.0f} m AMSL"
    return f"{ellipse.rounded(answer.lat_deg, answer.lon_deg)} +-{math.ceil(ellipse.semi_major_m)} m{height}"


def _degrees(degrees: float) -> int:
    return _whole(degrees * 1e7)


def _millimetres(metres: float | None) -> int:
    return UNKNOWN if metres is None else _whole(metres * 1e3)


def _whole(value: float) -> int:
    """A number as it is sent; unknown where it has no place in 32 bits, which must not end the flight."""
    return round(value) if abs(value) < UNKNOWN else UNKNOWN


def _real(value: float) -> float:
    """A number as it is sent, nan where it is beyond what is sent."""
    return value if abs(value) < MOST_REAL else NAN
