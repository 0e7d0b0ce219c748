"""Thermal pictures of rendered ground from poses that are known, each with a set that says so."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import DepthSource, FeatureSet, HeightDatum, SharedErrors, Status
from contract.geodesy import LocalFrame
from onboard.events.types import Frame
from simulation.terrain import Terrain, TerrainSpec
from simulation.texture import Texture, TextureSpec
from simulation.thermal import ThermalRenderer, ThermalSpec
from simulation.trajectory import Pose

Array = NDArray[np.float64]

BOSON = Camera.from_field_of_view(640, 512, 50.0)
LEPTON = Camera.from_field_of_view(160, 120, 57.0)
ORIGIN = LocalFrame(-35.36, 149.17, 600.0)
DOWN = np.diag([1.0, -1.0, -1.0])
STEP_NS = 500_000_000
SIGMAS = np.array([1.0, 1.2, 1.5, 0.008, 0.008, 0.02, 0.01, 0.0, 0.0])


def set_of(
    camera: Camera, pose: Pose, frame: int, status: Status = Status.OK, session: int = 7, ground_m: float = 0.0
) -> FeatureSet:
    """What a pipeline says that knows the pose: level ground at `ground_m` of ORIGIN, with errors of its own."""
    if status is not Status.OK:
        return FeatureSet("uav-1", session, frame, 1_700_000_000_000_000_000 + frame * STEP_NS, status, camera)
    lat, lon, height = (float(c) for c in ORIGIN.to_geodetic(pose.centre_m))
    p = pose.R_enu_cam.T @ np.array([0.0, 0.0, -1.0]) / (pose.centre_m[2] - ground_m)
    by_nuisance = np.zeros((9, 13))
    by_nuisance[:3, :3] = 0.7 * np.diag(SIGMAS[:3])
    return FeatureSet(
        vehicle="uav-1", session=session, frame=frame, capture_unix_ns=1_700_000_000_000_000_000 + frame * STEP_NS,
        status=Status.OK, camera=camera, camera_lat_deg=lat, camera_lon_deg=lon, camera_height_m=height,
        height_datum=HeightDatum.AMSL, undulation_m=0.0, R_enu_cam=pose.R_enu_cam, common_cov=np.diag(SIGMAS**2),
        shared=SharedErrors(by_nuisance, 60.0, 20.0), depth_source=DepthSource.PLANE,
        plane_per_m=np.array([p[2], p[0], p[1]]), plane_sigma_relative=0.01,
    )  # fmt: skip


@dataclass(frozen=True)
class Scene:
    """A flight straight on, `step_m` from picture to picture, at 2 pictures a second."""

    spec: ThermalSpec
    camera: Camera = BOSON
    height_m: float = 100.0
    step_m: float = 5.0
    tilt_deg: float = 0.0  # forward of straight down
    seed: int = 3

    @cached_property
    def terrain(self) -> Terrain:
        return Terrain(TerrainSpec())

    @cached_property
    def sampled(self) -> ThermalRenderer:
        """Land takes seconds to render: when it is first seen, and not where a test's file is only read."""
        return ThermalRenderer(self.camera, self.terrain, Texture(TextureSpec(seed=self.seed)), self.spec, self.seed)

    def pose(self, frame: int) -> Pose:
        """Flying north, as high above the curved earth everywhere: 10 km on it lies 8 m below its tangent."""
        a = np.radians(self.tilt_deg)
        tilted = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(a), -np.sin(a)], [0.0, np.sin(a), np.cos(a)]])
        return Pose(np.array([0.0, self.step_m * frame, self.ground_m(frame) + self.height_m]), DOWN @ tilted)

    def ground_m(self, frame: int) -> float:
        """Height of the ground below, above the level through the first picture's."""
        return float(self.terrain.height_m(0.0, self.step_m * frame))

    def picture(self, frame: int, status: Status = Status.OK) -> tuple[Frame, FeatureSet]:
        pose, counts = self.pose(frame), _counts(self, frame)
        grey = np.zeros(counts.shape, np.uint8)
        return Frame(frame * STEP_NS, frame, grey, counts=counts), set_of(
            self.camera, pose, frame, status, ground_m=self.ground_m(frame)
        )


@lru_cache(maxsize=32)  # several tests of a file fly over the same people
def _counts(scene: Scene, frame: int) -> NDArray[np.uint16]:
    counts = scene.sampled.picture([scene.pose(frame)], 1.0, frame, 0.5 * frame).astype(np.uint16)
    counts.flags.writeable = False
    return counts


def place_of(east_m: float, north_m: float) -> tuple[float, float]:
    lat, lon, _ = (float(c) for c in ORIGIN.to_geodetic(np.array([east_m, north_m, 0.0])))
    return lat, lon
