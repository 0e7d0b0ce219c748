"""The motion of pictures that a camera would have taken on a recorded flight, from the truth, without drawing any."""

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from contract.geodesy import LocalFrame
from contract.rotations import exp_so3, mount_rotation
from onboard.commands.camera_clock import BY_PATH_DEG
from onboard.config.schema import parse_config
from onboard.events.types import PositionFix
from onboard.foreign_clock.clock_search import Evidence
from onboard.foreign_clock.log_track import LogTrack, log_track
from onboard.foreign_clock.motion_cost import MotionNoise
from onboard.foreign_clock.picture_pairs import Pairs
from onboard.telemetry.telemetry_log import TelemetryLog
from onboard.telemetry.tlog_reader import read_tlog
from simulation.flight import find_recording
from simulation.trajectory import Pose, RecordedTruth

Array = NDArray[np.float64]

CONFIG = parse_config("[mount]\npitch_deg = -90.0\nsigma_deg = 5.0")
WITHOUT_ATTITUDE = parse_config('[mount]\npitch_deg = -90.0\nsigma_deg = 5.0\n[solve]\nattitude = "none"')
HALF_FIELD = np.array([0.55, 0.42])
NOISE = MotionNoise(
    math.radians(0.35), math.radians(1.2), 0.5, 0.05, 0.03, 0.003, mount_rad=math.radians(5.0), height=0.3, focal=0.02
)


@dataclass(frozen=True)
class Camera:
    """What is wrong of it: how it sits (deg), how high the ground is and how steep to east and north, its focal length
    (share).
    """

    boresight_deg: tuple[float, float, float] = (2.0, -3.0, 2.5)
    ground_m: float = 8.0
    focal: float = 0.02
    slope: tuple[float, float] = (0.0, 0.0)


@cache
def recorded(recording: str, by_path: bool = False) -> tuple[LogTrack, RecordedTruth]:
    """What is known by the log of a recording, or by its positions alone, and its truth."""
    log_path, truth_path = find_recording(recording)
    log, truth = read_tlog(log_path), RecordedTruth.read(truth_path)
    if not by_path:
        return log_track(log, CONFIG), truth
    positions = [replace(e, velocity_ned_m_s=None) for e in log.events if isinstance(e, PositionFix)]
    return log_track(TelemetryLog.by_stamp(positions), WITHOUT_ATTITUDE), truth


def evidence(
    recording: str,
    taken_s: Array,
    ahead_s: float,
    shots_s: Sequence[float] = (),
    camera: Camera = Camera(),
    seed: int = 0,
    jitter_s: float = 0.0,
    by_path: bool = False,
) -> Evidence:
    """Pictures at these seconds of a recording, by a clock that is ahead of the log's; `jitter_s` of each stamp.
    `by_path`: the log has positions alone.
    """
    track, truth = recorded(recording, by_path)
    epoch_s = float(truth.unix_time_s[0])
    origin = LocalFrame(float(truth.lat_deg[0]), float(truth.lon_deg[0]), 100.0)
    trajectory = truth.trajectory(origin, epoch_s, 0.0)
    R_body_cam = mount_rotation(0.0, -90.0, 0.0) @ exp_so3(np.radians(camera.boresight_deg))
    poses = [trajectory.camera_pose(float(t), R_body_cam) for t in taken_s]
    rng = np.random.default_rng(seed)
    stamped_s = taken_s + jitter_s * rng.normal(size=len(taken_s))
    stamps_ns = [round((epoch_s + t + ahead_s) * 1e9) for t in stamped_s]
    pairs = seen_pairs(poses, stamps_ns, itertools.pairwise(range(len(poses))), camera, rng)
    shots_ns = [round((epoch_s + t) * 1e9) for t in shots_s]
    noises = [replace(NOISE, tilt_rad=one, heading_rad=one) for one in np.radians(BY_PATH_DEG)] if by_path else [NOISE]
    return Evidence(track, stamps_ns, 0.03, pairs, noises, shots_ns, 0.1)


def seen_pairs(
    poses: Sequence[Pose],
    stamps_ns: Sequence[int],
    chosen: Iterable[tuple[int, int]],
    camera: Camera,
    rng: np.random.Generator,
) -> Pairs:
    """Return those of the chosen pairs of pictures that share enough ground."""
    found = [
        ((stamps_ns[i], stamps_ns[j]), *seen)
        for i, j in chosen
        if (seen := _seen(poses[i], poses[j], camera, rng)) is not None
    ]
    return Pairs(
        np.array([stamps for stamps, _, _ in found], np.int64).reshape(-1, 2),
        *(np.array([each[i] for each in found]).reshape(-1, 4, 2) for i in (1, 2)),
    )


def _seen(first: Pose, second: Pose, camera: Camera, rng: np.random.Generator) -> tuple[Array, Array] | None:
    """Four points of the ground in both pictures, the second's with noise and relief of 3 m."""
    normal = np.array([-camera.slope[0], -camera.slope[1], 1.0])

    def moved(at: Array, relief_m: Array | float = 0.0) -> Array:
        rays = np.column_stack([at, np.ones(len(at))]) @ first.R_enu_cam.T
        down = rays @ normal
        places = first.centre_m + rays * ((camera.ground_m + relief_m - first.centre_m @ normal) / down)[:, None]
        q = (places - second.centre_m) @ second.R_enu_cam
        return np.where((q[:, 2:] > 0.0) & (down[:, None] < 0.0), q[:, :2] / q[:, 2:], 9.0)

    grid = np.stack(np.meshgrid(*(np.linspace(-h, h, 7) for h in HALF_FIELD)), -1).reshape(-1, 2)
    both = (np.abs(moved(grid)) < HALF_FIELD).all(axis=1)
    if np.count_nonzero(both) < 9:
        return None
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    box = grid[both].mean(axis=0) + grid[both].std(axis=0) * corners
    to = moved(box, rng.normal(0.0, 3.0, 4)) + rng.normal(0.0, 0.002, (4, 2))
    return box * (1.0 + camera.focal), to * (1.0 + camera.focal)
