"""A camera that sees light and a thermal one next to it, turning over level ground, with poses that are known."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import DepthSource, FeatureSet, Status
from contract.locate import pixels_of
from contract.rotations import exp_so3
from onboard.events.types import Frame
from simulation.trajectory import Pose
from tests.onboard.spots.scenes import BOSON, DOWN, set_of

Array = NDArray[np.float64]

VISIBLE = Camera.from_field_of_view(1280, 960, 62.0)
BEGIN_NS = 1_700_000_000_000_000_000
COUNTS = np.full((4, 4), 29000, np.uint16)
RNG = np.random.default_rng(5)
FEATURES = VISIBLE.size_px * RNG.uniform(0.02, 0.98, (80, 2))


@dataclass(frozen=True)
class Turn:
    """A flight at one height above level ground: around a circle (rad/s), or straight on where that is 0."""

    rate_hz: float = 5.0
    speed_m_s: float = 14.0
    turn_rad_s: float = 0.15
    height_m: float = 90.0
    tilt_deg: float = 12.0

    def pose(self, time_s: float) -> Pose:
        heading = self.turn_rad_s * time_s
        radius = self.speed_m_s / self.turn_rad_s if self.turn_rad_s else 0.0
        place = (
            radius * np.array([1.0 - np.cos(heading), np.sin(heading)])
            if self.turn_rad_s
            else np.array([0.0, self.speed_m_s * time_s])
        )
        turned = exp_so3([0.0, 0.0, -heading]) @ DOWN @ exp_so3([np.radians(self.tilt_deg), 0.0, 0.0])
        return Pose(np.array([*place, self.height_m]), turned)

    def first_set(self, number: int, status: Status = Status.OK) -> FeatureSet:
        """What the pipeline says of the first camera's picture of that number, taken `number / rate_hz` s on."""
        time_s = number / self.rate_hz
        s = set_of(VISIBLE, self.pose(time_s), number, status)
        s = replace(s, capture_unix_ns=BEGIN_NS + round(1e9 * time_s))
        if status is not Status.OK:
            return s
        rays, _ = VISIBLE.unproject(FEATURES)
        w = s.plane_per_m[0] + rays[:, :2] @ s.plane_per_m[1:]
        return replace(
            s, depth_source=DepthSource.PARALLAX, roughness=1e-6, uv_px=FEATURES, inverse_depth_per_m=w,
            sigma_inverse_depth_per_m=0.002 * w,
        )  # fmt: skip

    def pixel(self, time_s: float, R_first_second: Array, place_m: Array, camera: Camera = BOSON) -> Array:
        """Where the second camera has a place (3,) of the ground at that time."""
        pose = self.pose(time_s)
        s = replace(set_of(camera, pose, 0), R_enu_cam=pose.R_enu_cam @ R_first_second)
        uv, ahead = pixels_of(s, (place_m - pose.centre_m)[None])
        assert ahead.all()
        return uv[0]


def thermal_frame(time_s: float, index: int = 0) -> Frame:
    """A picture of the second camera that its stamp says was taken then, with nothing in it."""
    return Frame(BEGIN_NS + round(1e9 * time_s), index, np.zeros((4, 4), np.uint8), counts=COUNTS)
