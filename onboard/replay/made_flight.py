"""A flight that is made up on the spot, to measure a computer with: a plane with a texture, seen from a level leg.

No truth is kept and nothing is claimed of accuracy (`simulation/` does that, and is not installed on an aircraft). The
pictures give the pipeline the work that pictures of ground give it: as many features, tracks and windows.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, matrix_from_euler, mount_rotation, quaternion_from_matrix
from onboard.config.schema import Config
from onboard.events.types import Attitude, Event, Frame, GpsQuality, NavEvent, PositionFix

Array = NDArray[np.float64]

HEIGHT_M, SPEED_M_S = 120.0, 20.0
PLACE = LocalFrame(46.5, 8.0, 0.0)
EPOCH_NS = 1_790_000_000_000_000_000
TELEMETRY_DELAY_NS = 40_000_000  # messages arrive this long after what they report
LEAD_S = 2.0  # of telemetry before the first picture
ROLL_RAD, PITCH_RAD = 0.05, 0.035  # of a gentle sway
MOUNT_DEG = (0.0, -90.0, -90.0)
NOISE_GREY = 2.0
TEXELS_A_PIXEL = 0.7
OCTAVES = (2, 4, 8, 16, 32, 64)  # texels


class MadeFlight:
    """Events of a level leg over textured ground, without end; the same each time."""

    def __init__(self, config: Config, camera: Camera) -> None:
        """Takes rates and sigmas from the configuration; the mount looks straight down whatever is configured there."""
        mount = dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), MOUNT_DEG, strict=True))
        still = config.mount.model_copy(update={**mount, "gimbal": "never", "lever_arm_m": (0.0, 0.0, 0.0)})
        clock = config.camera.model_copy(update={"latency_s": 0.0})
        gps = config.gps.model_copy(update={"latency_s": 0.0})
        self.config = config.model_copy(update={"mount": still, "camera": clock, "gps": gps})
        self.camera = camera
        self._R_body_cam = mount_rotation(*MOUNT_DEG)
        v, u = np.mgrid[: camera.height_px, : camera.width_px]
        rays, _ = camera.unproject(np.stack([u.ravel(), v.ravel()], axis=1).astype(float))
        self._rays = rays.astype(np.float32).reshape(camera.height_px, camera.width_px, 3)
        across_m = 2.0 * HEIGHT_M * camera.width_px / (2.0 * camera.focal_px)
        self._texture = texture(2048 if camera.width_px < 1600 else 4096)
        # Fine enough to look sharp, coarse enough not to repeat within a picture.
        self._texel_m = max(TEXELS_A_PIXEL * HEIGHT_M / camera.focal_px, 2.0 * across_m / len(self._texture))
        noise = np.random.default_rng(1).normal(0.0, NOISE_GREY, camera.size_px[::-1])
        self._noise = noise.astype(np.float32)

    def events(self) -> Iterator[tuple[int, Event]]:
        """Everything in order of arrival, with that time (Unix ns)."""
        waiting = self._telemetry()
        moment_ns, message = next(waiting)
        period_s = 1.0 / self.config.camera.rate_hz
        index = 0
        while True:
            stamp_ns = EPOCH_NS + round(index * period_s * 1e9)
            while moment_ns <= stamp_ns:
                yield moment_ns, message
                moment_ns, message = next(waiting)
            yield stamp_ns, Frame(stamp_ns, index, self._picture(index, index * period_s))
            index += 1

    def _telemetry(self) -> Iterator[tuple[int, NavEvent]]:
        """Attitude, position and the receiver's report, each at its configured rate, with arrival times in order."""
        attitude_hz, position_hz = self.config.telemetry.attitude_rate_hz, self.config.telemetry.position_rate_hz
        tick = 0
        every = max(round(attitude_hz / position_hz), 1)
        while True:
            t = tick / attitude_hz - LEAD_S
            stamp_ns = EPOCH_NS + round(t * 1e9)
            R, centre = self._pose(t)
            arrived_ns = stamp_ns + TELEMETRY_DELAY_NS
            w, x, y, z = quaternion_from_matrix(R_ENU_NED.T @ R)
            rate = (self._pose(t + 5e-3)[0].T @ (self._pose(t + 5e-3)[0] - self._pose(t - 5e-3)[0])) / 1e-2
            turning = (float(rate[2, 1]), float(rate[0, 2]), float(rate[1, 0]))
            yield arrived_ns, Attitude(stamp_ns, (float(w), float(x), float(y), float(z)), turning)
            if tick % every == 0:
                lat, lon, height = PLACE.to_geodetic(centre)
                velocity = (SPEED_M_S, 0.0, 0.0)
                yield arrived_ns, PositionFix(stamp_ns, float(lat), float(lon), float(height), velocity, HEIGHT_M)
                yield arrived_ns, GpsQuality(stamp_ns, 3, 16, 0.8, 1.2, 0.1, 0.0)
            tick += 1

    def _pose(self, t: float) -> tuple[Array, Array]:
        """R_enu_body (3, 3) and the place (3,) ENU, m, northwards."""
        roll = ROLL_RAD * np.sin(2.0 * np.pi * 0.2 * t)
        pitch = PITCH_RAD * np.sin(2.0 * np.pi * 0.13 * t)
        R: Array = R_ENU_NED @ matrix_from_euler(roll, pitch, 0.0)
        return R, np.array([0.0, SPEED_M_S * t, HEIGHT_M])

    def _picture(self, index: int, t: float) -> NDArray[np.uint8]:
        R_enu_body, centre = self._pose(t)
        size, texels = len(self._texture), HEIGHT_M / self._texel_m
        # East and south on the ground, texels, times the ray's length downwards; and that length.
        turned = np.diag([texels, -texels, -1.0]) @ R_enu_body @ self._R_body_cam
        east, south, down = cv2.split(cv2.transform(self._rays, turned))
        x = cv2.add(cv2.divide(east, down), centre[0] / self._texel_m % size)
        y = cv2.add(cv2.divide(south, down), -centre[1] / self._texel_m % size)
        ground = cv2.remap(self._texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        noise = np.roll(self._noise, (37 * index, 61 * index), (0, 1))
        return np.asarray(cv2.add(ground, noise, dtype=cv2.CV_8U), np.uint8)


def texture(size: int) -> NDArray[np.uint8]:
    """Grey (size, size): random waves of many lengths, the long ones higher, as in pictures of ground."""
    rng = np.random.default_rng(0)
    out = np.zeros((size, size), np.float32)
    for texels in OCTAVES:
        coarse = rng.standard_normal((size // texels, size // texels)).astype(np.float32)
        margin = 2 * texels
        wrapped = np.pad(coarse, 2, mode="wrap")  # so that the plane continues without a seam where the texture ends
        fine = cv2.resize(wrapped, None, fx=texels, fy=texels, interpolation=cv2.INTER_CUBIC)
        out += np.float32(texels**0.5) * fine[margin:-margin, margin:-margin]
    out *= 45.0 / float(out.std())
    return np.asarray(np.clip(out + 128.0, 0.0, 255.0), np.uint8)
