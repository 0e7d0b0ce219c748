"""The search for a camera's mount among the 24 orientations at right angles to the vehicle's axes, by pictures.

Each orientation predicts, from the vehicle's own motion over level ground, where a keyframe's features come to lie in
the next pictures; the right one predicts them, up to the camera's deviation from right angles. As in `mount_selection`,
with the features found without any prediction.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.rotations import mount_rotation
from onboard.config.schema import Config
from onboard.events.types import Event, Frame
from onboard.geometry.plane_homography import Pose
from onboard.navigation.navigator import Navigation, NavState
from onboard.pipeline.keyframes import wants_keyframe
from onboard.pipeline.mount_selection import LEAD, cost_of
from onboard.vision.klt_tracker import MIN_TRACKS, Tracks
from onboard.vision.reduced_tracker import tracker_for

Array = NDArray[np.float64]
Angles = tuple[float, float, float]

ASKEW = 2.0  # times the sigma of a prediction: the mount is off by some degrees, the attitude's time not yet known
MIN_HEIGHT_M, MIN_SPEED_M_S = 10.0, 3.0
MOST_PICTURES = 240  # that count


def orientations() -> tuple[Angles, ...]:
    """The 24 ways: roll, pitch and yaw in degrees."""
    turns = (0.0, 90.0, 180.0, -90.0)
    vertical = ((0.0, pitch, yaw) for pitch in (-90.0, 90.0) for yaw in turns)
    return (*vertical, *((roll, 0.0, yaw) for roll in turns for yaw in turns))


@dataclass(frozen=True)
class Ranking:
    """Orientations by rising cost, and how many pictures they rest on."""

    order: tuple[Angles, ...]
    costs: tuple[float, ...]
    pictures: int

    @property
    def decided(self) -> Angles | None:
        """The one that is clearly ahead; None if none is."""
        return self.order[0] if self.pictures and self.costs[1] - self.costs[0] > 2.0 * LEAD else None


class MountSearch:
    """Takes a flight's events in order of arrival and ranks the mounts; `camera` as its file has it."""

    def __init__(self, config: Config, camera: Camera) -> None:
        mount = config.mount.model_copy(update={"gimbal": "never"})
        self._navigation = Navigation(config.model_copy(update={"mount": mount}))
        self._camera = camera
        self._tracker = tracker_for(camera.size_px, config.tracking.features, config.tracking.min_distance_px)
        self._waiting: deque[Frame] = deque(maxlen=100)  # for telemetry
        self._keyframe: NavState | None = None
        self._costs = dict.fromkeys(orientations(), 0.0)
        self.pictures = 0

    def ranking(self, events: Iterable[tuple[int, Event]]) -> Ranking:
        """Look at as many pictures as it takes."""
        for _, event in events:
            if isinstance(event, Frame):
                self._waiting.append(event)
            else:
                self._navigation.add(event)
            while self._waiting and self._navigation.covers(self._waiting[0].stamp_ns):
                self._take(self._waiting.popleft())
            if self.pictures >= MOST_PICTURES:
                break
        order, costs = zip(*sorted(self._costs.items(), key=lambda way: way[1]), strict=True)
        return Ranking(order, costs, self.pictures)

    def _take(self, frame: Frame) -> None:
        nav = self._navigation.state_at(frame.stamp_ns)
        if frame.image is None or not isinstance(nav, NavState) or not _is_flying(nav):
            return
        tracks = self._tracker.track(frame.image, None)
        if self._keyframe is not None and len(tracks) >= MIN_TRACKS:
            self._weigh(self._keyframe, nav, tracks)
            if not wants_keyframe(tracks, self._camera.size_px):
                return
        self._tracker.promote(self._tracker.nothing() if self._keyframe is None else tracks)
        self._keyframe = nav

    def _weigh(self, was: NavState, now: NavState, tracks: Tracks) -> None:
        assert was.height_above_home_m is not None
        plane = np.array([was.position_enu_m[2] - was.height_above_home_m, 0.0, 0.0])
        self.pictures += 1
        for angles in self._costs:
            R_body_cam = mount_rotation(*angles)
            poses = [Pose((n.R_enu_body @ R_body_cam).T, n.position_enu_m) for n in (was, now)]  # type: ignore[operator]
            self._costs[angles] += cost_of(self._camera, poses, plane, tracks.keyframe_uv_px, tracks.uv_px, ASKEW)


def _is_flying(nav: NavState) -> bool:
    if nav.R_enu_body is None or nav.velocity_enu_m_s is None or nav.height_above_home_m is None:
        return False
    return nav.height_above_home_m > MIN_HEIGHT_M and float(np.linalg.norm(nav.velocity_enu_m_s)) > MIN_SPEED_M_S
