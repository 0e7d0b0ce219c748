"""A flat textured world seen straight down, with things on it: pictures and sets whose truth is simple arithmetic."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import DepthSource, FeatureSet, Status
from contract.geodesy import LocalFrame
from onboard.events.types import Frame

Array = NDArray[np.float64]
Place = Callable[[float], tuple[float, float]]  # seconds -> east, north, m

PLACE = LocalFrame(-43.38, 172.40, 100.0)
EPOCH_NS = 1_795_217_000_000_000_000
HEIGHT_M, FOCAL_PX, RATE_HZ = 60.0, 300.0, 10.0
M_PX = HEIGHT_M / FOCAL_PX
CAMERA = Camera(320, 240, FOCAL_PX, FOCAL_PX, 159.5, 119.5)
LOOKING_DOWN = np.diag([1.0, -1.0, -1.0])
SESSION = 7


@dataclass(frozen=True)
class Thing:
    """A square or a disc of spots. `until_s`: it is there no longer from then on, as under a tree, till `again_s`."""

    place: Place
    size_m: float = 1.0
    grey: float = 210.0
    until_s: float = math.inf
    again_s: float = math.inf

    def is_shown(self, time_s: float) -> bool:
        return not self.until_s <= time_s < self.again_s


def covered(centre_px: float, half_px: float, count: int) -> tuple[int, int]:
    """The first of `count` pixels that a thing covers a part of, and the first after those."""
    first = min(max(math.floor(centre_px - half_px - 0.5), 0), count)
    return first, min(max(math.ceil(centre_px + half_px + 0.5) + 1, first), count)


@dataclass
class World:
    """The camera is above `camera` (east, north) at a time, `gain` (of the exposure) times as bright."""

    things: tuple[Thing, ...] = ()
    camera: Place = field(default=lambda _: (0.0, 0.0))
    gain: Callable[[float], float] = field(default=lambda _: 1.0)
    status: Status = Status.OK
    seed: int = 0
    clipped: float = 0.0  # share of the ground that is as bright as a picture can be; negative: as dark

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        coarse = cv2.resize(
            rng.normal(0.0, 22.0, (150, 150)).astype(np.float32), (900, 900), interpolation=cv2.INTER_CUBIC
        )
        fine = cv2.GaussianBlur(rng.normal(0.0, 28.0, (900, 900)).astype(np.float32), (0, 0), 1.2)
        self._ground = 100.0 + coarse + fine
        self._rng = rng
        self._scale = 255.0 / np.quantile(self._ground, 1.0 - self.clipped) if self.clipped > 0.0 else 1.0
        self._lift = -np.quantile(self._ground, -self.clipped) if self.clipped < 0.0 else 0.0

    def ground(self, time_s: float) -> Array:
        return self._ground

    def image(self, frame: int) -> NDArray[np.uint8]:
        t = frame / RATE_HZ
        east, north = self.camera(t)
        left, top = 450.0 + east / M_PX - 159.5, 450.0 - north / M_PX - 119.5
        M = np.array([[1.0, 0.0, left], [0.0, 1.0, top]])
        out = cv2.warpAffine(self.ground(t), M, (320, 240), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        for thing in self.things:
            if not thing.is_shown(t):
                continue
            u, v = self.pixel(thing, frame)
            half = 0.5 * thing.size_m / M_PX
            columns, rows = np.arange(*covered(u, half, 320)), np.arange(*covered(v, half, 240))[:, np.newaxis]
            cover = np.clip(half - np.abs(columns - u) + 0.5, 0.0, 1.0) * np.clip(
                half - np.abs(rows - v) + 0.5, 0.0, 1.0
            )
            spots = 25.0 * np.sign((columns - u) * (rows - v))
            out = out.astype(np.float64)
            out[rows, columns] += cover * (thing.grey + spots - out[rows, columns])
        noisy = self.gain(t) * (self._scale * out + self._lift) + self._rng.normal(0.0, 1.5, out.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    def pixel(self, thing: Thing, frame: int) -> Array:
        t = frame / RATE_HZ
        east, north = np.subtract(thing.place(t), self.camera(t))
        return np.array([159.5 + east / M_PX, 119.5 - north / M_PX])

    def frame(self, number: int) -> Frame:
        return Frame(stamp_ns(number), number, self.image(number))

    def its_set(self, number: int) -> FeatureSet:
        """With a pose that is off by some of its stated errors, the same in every picture: 1 m of position."""
        east, north = self.camera(number / RATE_HZ)
        lat, lon, height = PLACE.to_geodetic([east + 0.8, north - 0.5, HEIGHT_M])
        cov = np.diag([1.0, 1.0, 1.0, 1e-6, 1e-6, 1e-6, 1e-4, 0.0, 0.0])
        return FeatureSet(
            "uav-1", SESSION, number, stamp_ns(number), self.status, CAMERA, camera_lat_deg=float(lat),
            camera_lon_deg=float(lon), camera_height_m=float(height), undulation_m=10.0, R_enu_cam=LOOKING_DOWN,
            common_cov=cov, depth_source=DepthSource.PLANE, plane_per_m=np.array([1.0 / HEIGHT_M, 0.0, 0.0]),
            plane_sigma_relative=0.001,
        )  # fmt: skip


@dataclass
class Paved(World):
    """With pavement from the origin on to the east, brighter than the things on it; grass is darker than they are."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._ground[:, 450:] += 95.0


@dataclass
class Crops(World):
    """With a wind of 4 m/s, whose gusts make it brighter and darker by some 14 grey levels in waves of 6 m."""

    def __post_init__(self) -> None:
        super().__post_init__()
        gusts = np.random.default_rng([self.seed, 7]).normal(0.0, 21.0, (60, 60)).astype(np.float32)
        self._gusts = cv2.resize(gusts, (900, 900), interpolation=cv2.INTER_CUBIC)

    def ground(self, time_s: float) -> Array:
        M = np.array([[1.0, 0.0, 4.0 * time_s / M_PX], [0.0, 1.0, 0.0]])
        return np.asarray(self._ground + cv2.warpAffine(self._gusts, M, (900, 900)), float)


@dataclass
class Leafy(World):
    """With a tree of 5 m at the origin whose leaves sway, and through whose gaps the ground, or a thing, is seen."""

    def __post_init__(self) -> None:
        super().__post_init__()
        grey = np.random.default_rng(99).normal(0.0, 60.0, (2, 240, 320)).astype(np.float32)
        self._leaves = [75.0 + 2.5 * cv2.GaussianBlur(one, (0, 0), 1.5) for one in grey]

    def image(self, frame: int) -> NDArray[np.uint8]:
        t, below = frame / RATE_HZ, super().image(frame).astype(np.float32)
        east, north = self.camera(t)
        at_px = np.array([-east / M_PX, north / M_PX])
        turned, layers = 0.5 + 0.5 * math.sin(2.0 * math.pi * 0.4 * t), []
        for layer, more_px in zip(self._leaves, (0.0, 1.5), strict=True):
            sway = at_px + (1.2 * math.sin(4.4 * t) + more_px, 0.9 * math.sin(6.9 * t + 1.0))
            M = np.column_stack([np.eye(2), sway])
            layers.append(cv2.warpAffine(layer, M, (320, 240), borderMode=cv2.BORDER_REFLECT))
        leaves = (1.0 - 0.4 * turned) * layers[0] + 0.4 * turned * layers[1]
        columns, rows = np.meshgrid(np.arange(320.0), np.arange(240.0))
        crown = np.clip(25.5 - np.hypot(columns - at_px[0] - 159.5, rows - at_px[1] - 119.5), 0.0, 1.0)
        crown *= 1.0 - 0.5 * (cv2.GaussianBlur(leaves, (0, 0), 2.0) > 88.0)
        return np.clip(below + crown * (leaves - below), 0.0, 255.0).astype(np.uint8)


def stamp_ns(number: int) -> int:
    return EPOCH_NS + round(number * 1e9 / RATE_HZ)


def at(east_m: float, north_m: float, velocity: tuple[float, float] = (0.0, 0.0), from_s: float = 0.0) -> Place:
    def place(t: float) -> tuple[float, float]:
        gone = max(t - from_s, 0.0) if from_s > 0.0 else t
        return east_m + velocity[0] * gone, north_m + velocity[1] * gone

    return place
