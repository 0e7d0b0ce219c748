"""A simulated flight over rendered ground: its pictures as a video, and its sets with features at corners."""

import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.feature_set import FeatureSet, Status
from ground.web.source import FrameRow, Picture, VehicleReport
from tests.web.rendered import VEHICLE, rendered_set
from tests.web.unfollowed import Unfollowed

VIDEO_HZ = 20.0
SET_S = 0.25
SPEED_PX_S = 100.0
SIZE_PX = (400, 300)  # of the video; the camera's is 640 x 480


@lru_cache(maxsize=4)
def ground_of(place: int) -> NDArray[np.uint8]:
    """As seen from above, grey."""
    noise = np.random.default_rng(place).normal(0.0, 1.0, (700, 4300)).astype(np.float32)
    soft = cv2.GaussianBlur(noise, (0, 0), 3.0) + 3.0 * cv2.GaussianBlur(noise, (0, 0), 12.0)
    return np.asarray(cv2.normalize(soft, None, 20, 235, cv2.NORM_MINMAX), np.uint8)


def picture_at(t_s: float, place: int = 1) -> NDArray[np.uint8]:
    """What the camera sees at a time of the flight, 640 x 480."""
    x, y = 400.0 + SPEED_PX_S * t_s, 100.0 + 40.0 * np.sin(0.7 * t_s)
    move = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y]])
    return np.asarray(cv2.warpAffine(ground_of(place), move, (640, 480)), np.uint8)


def write_video(
    path: Path, from_s: float, seconds: float, place: int = 1, size_px: tuple[int, int] = SIZE_PX, still: bool = False
) -> Path:
    """The flight's pictures from a time on, with what a poor link does to them."""
    out = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), VIDEO_HZ, size_px)
    assert out.isOpened()
    noise = np.random.default_rng(5).normal(10.0, 3.0, (7, size_px[1], size_px[0])).astype(np.float32)
    for k in range(round(seconds * VIDEO_HZ)):
        seen = picture_at(0.0 if still else from_s + k / VIDEO_HZ, place)
        seen = cv2.resize(seen, size_px, interpolation=cv2.INTER_AREA)
        noisy = 0.8 * seen.astype(np.float32) + noise[k % 7]
        out.write(cv2.cvtColor(np.clip(noisy, 0, 255).astype(np.uint8), cv2.COLOR_GRAY2BGR))
    out.release()
    return path


def time_of(frame: int) -> float:
    """Of a set, since the flight began; not at a frame of the video."""
    return frame * SET_S


@lru_cache(maxsize=500)
def flight_set(frame: int) -> FeatureSet:
    found = cv2.goodFeaturesToTrack(picture_at(time_of(frame)), 120, 0.005, 12.0)
    assert found is not None and len(found) == 120
    made = rendered_set(0)
    return replace(
        made,
        frame=frame,
        capture_unix_ns=made.capture_unix_ns + round(time_of(frame) * 1e9),
        uv_px=found[:, 0, :].astype(np.float64),
    )


def shift_px(jpeg: bytes, frame: int) -> float:
    """How far a video's picture is off a set's, in pixels of the camera."""
    got = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert got is not None
    got = cv2.resize(got, (640, 480), interpolation=cv2.INTER_CUBIC)
    window = cv2.createHanningWindow((640, 480), cv2.CV_32F)
    (u, v), _ = cv2.phaseCorrelate(picture_at(time_of(frame)).astype(np.float32), got.astype(np.float32), window)
    return float(np.hypot(u, v))


class SampledFlight(Unfollowed):
    """Serves `Source`. Recorded: all sets are there. Live: they come `late_s` after their pictures, from `start` on."""

    name = "a drawn flight"

    def __init__(self, sets: int, is_live: bool = False, late_s: float = 0.2) -> None:
        self.is_live = is_live
        self._sets = sets
        self._late_s = late_s
        self.start_s = time.monotonic()
        self.own_picture: int | None = None  # the frame that came with a picture
        self.refused: set[int] = set()

    def _count(self) -> int:
        if not self.is_live:
            return self._sets
        return int(min(max((time.monotonic() - self.start_s - self._late_s) / SET_S + 1.0, 0.0), self._sets))

    def vehicles(self) -> list[str]:
        return [VEHICLE] if self._count() else []

    def version(self, vehicle: str) -> int:
        return self._count()

    def frames(self, vehicle: str, newest: int | None = None) -> list[FrameRow]:
        count, first = self._count(), rendered_set(0)
        return [
            FrameRow(
                first.session, k, 0, first.capture_unix_ns + round(time_of(k) * 1e9),
                Status.TURNING if k in self.refused else Status.OK, k == self.own_picture,
            )
            for k in range(0 if newest is None else max(count - newest, 0), count)
        ]  # fmt: skip

    def feature_set(self, vehicle: str, session: int | None, frame: int) -> FeatureSet | None:
        return flight_set(frame) if 0 <= frame < self._count() else None

    def picture(self, vehicle: str, session: int | None, frame: int) -> Picture | None:
        return Picture(b"own", "image/webp") if frame == self.own_picture else None

    def age_s(self, feature_set: FeatureSet) -> float | None:
        return time.monotonic() - self.start_s - time_of(feature_set.frame)

    def report(self, vehicle: str) -> VehicleReport:
        return VehicleReport(vehicle, 0, None, None, None, None, None, None)

    def no_pictures(self) -> str:
        return ""

    def damage(self) -> list[str]:
        return []

    def close(self) -> None:
        """Nothing is held."""
