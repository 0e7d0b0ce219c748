"""A second camera's pictures, each between two sets of the first camera."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.rotations import exp_so3, log_so3
from onboard.events.types import Frame
from onboard.spots.due_pictures import EARLY

MOST_HELD = 64  # pictures that wait for a set
KEPT_NS = 5_000_000_000  # of sets, behind the newest
LOOKED_BACK = 50  # sets by which it is judged how evenly the first camera moves
USUAL = 0.5, 3.0  # one sigma of angular and linear acceleration before that is known: rad/s2, m/s2


@dataclass(frozen=True, eq=False)
class Bracketed:
    """A picture of the second camera and the sets next to it in time; `after` None: none came.

    `accelerations`: one sigma of the first camera's angular (rad/s2) and linear (m/s2) acceleration, each axis.
    """

    frame: Frame
    before: FeatureSet
    after: FeatureSet | None
    accelerations: tuple[float, float] = USUAL

    @property
    def nearest(self) -> FeatureSet:
        """The set that is nearer in time."""
        if self.after is None:
            return self.before
        middle_ns = (self.before.capture_unix_ns + self.after.capture_unix_ns) // 2
        return self.before if self.frame.stamp_ns <= middle_ns else self.after


class BracketedPictures:
    """Pairs pictures of the second camera with sets: at most `rate_hz` a second, no two with the same nearest set.

    A picture waits for the next set until pictures have come that are `late_s` younger. For one thread.
    """

    def __init__(self, rate_hz: float, late_s: float) -> None:
        self._apart_ns, self._late_ns = round((1.0 - EARLY) / rate_hz * 1e9), round(late_s * 1e9)
        self._held: deque[Frame] = deque(maxlen=MOST_HELD)
        self._taken_ns = self._newest_ns = 0
        self._sets: deque[FeatureSet] = deque()
        self._squares: deque[tuple[float, float]] = deque([(USUAL[0] ** 2, USUAL[1] ** 2)], maxlen=LOOKED_BACK)
        self._reported = -1, -1  # session and frame of the last nearest set

    def picture(self, frame: Frame) -> list[Bracketed]:
        """Keep a picture of the second camera; those that are ready, in order."""
        self._newest_ns = max(self._newest_ns, frame.stamp_ns)
        if frame.counts is not None and frame.stamp_ns - self._taken_ns >= self._apart_ns:
            self._taken_ns = frame.stamp_ns
            self._held.append(frame)
        return self._ready()

    def feature_set(self, output: FeatureSet) -> list[Bracketed]:
        """Keep a set of the first camera, none that is older than the newest; the pictures that are ready, in order."""
        newest = self._sets[-1] if self._sets else None
        if newest is not None and output.session != newest.session:
            self._sets.clear()
        elif newest is not None and output.capture_unix_ns <= newest.capture_unix_ns:
            return []
        self._sets.append(output)
        self._judge()
        while output.capture_unix_ns - self._sets[0].capture_unix_ns > KEPT_NS:
            self._sets.popleft()
        return self._ready()

    def _ready(self) -> list[Bracketed]:
        found = []
        while self._held:
            frame = self._held[0]
            before = next((s for s in reversed(self._sets) if s.capture_unix_ns <= frame.stamp_ns), None)
            after = next((s for s in self._sets if s.capture_unix_ns > frame.stamp_ns), None)
            if after is None and self._newest_ns - frame.stamp_ns <= self._late_ns:
                break
            self._held.popleft()
            if before is None:
                continue
            turn, move = (float(np.sqrt(np.mean(column))) for column in zip(*self._squares, strict=True))
            one = Bracketed(frame, before, after, (turn, move))
            identity = one.nearest.session, one.nearest.frame
            if identity > self._reported:
                self._reported = identity
                found.append(one)
        return found

    def _judge(self) -> None:
        """Add how far the last set but one is from its neighbours' prediction, as squared accelerations. (27.3)

        It adds nothing until there are three sets, all with an answer.
        """
        newest = list(self._sets)[-3:]
        if len(newest) < 3 or not all(s.is_ok for s in newest):
            return
        first, middle, last = newest
        before_s, after_s = seconds(first, middle), seconds(middle, last)
        moved_m, turned = motion(first, last)
        share = before_s / (before_s + after_s)
        there_m, there = motion(first, middle)
        off_m, off = there_m - share * moved_m, log_so3(exp_so3(share * turned).T @ exp_so3(there))
        scale = (2.0 / (before_s * after_s)) ** 2 / 3.0
        self._squares.append((scale * float(off @ off), scale * float(off_m @ off_m)))


def seconds(one: FeatureSet, two: FeatureSet) -> float:
    return (two.capture_unix_ns - one.capture_unix_ns) / 1e9


def motion(one: FeatureSet, two: FeatureSet) -> tuple[np.ndarray, np.ndarray]:
    """Return the motion between two sets' poses: the way (3,) in the first's east, north, up, m, and the rotation
    vector (3,) in its camera's axes.
    """
    frame = LocalFrame(one.camera_lat_deg, one.camera_lon_deg, one.camera_height_m)
    way = frame.to_enu(two.camera_lat_deg, two.camera_lon_deg, two.camera_height_m)
    return way, log_so3(one.R_enu_cam.T @ two.R_enu_cam)
