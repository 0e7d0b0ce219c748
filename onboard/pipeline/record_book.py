"""The pictures that the window can still place: which have no set, which wait for it, which the window has seen past.

The link takes a few sets a second, and of those that wait for their turn the newest. Where the camera is faster, most
pictures would be placed without use, and again when the window is past them. They are placed only then: once,
and as well as they ever are.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from onboard.config.schema import Config
from onboard.estimation.keyframe import Observation, seen_with
from onboard.estimation.solver_executor import Promise
from onboard.events.types import Frame
from onboard.georeferencing.feature_sets import Placed
from onboard.navigation.navigator import NavState

PLACED_A_SET = 4.0  # pictures placed for each set that the link may send: what it sends is at most so much older


@dataclass(eq=False)
class Record:
    """A picture that the window can still place, or place better. It is changed by its own methods alone."""

    frame: Frame
    look: Callable[[], Observation]
    nav: NavState
    is_keyframe: bool = False
    status: Status = Status.STARTING
    revision: int = -1
    is_settled: bool = False
    is_for_later: bool = False  # its only set is the one that it is settled with
    placed: Placed | None = None  # as it was last, by the window's own points: where the next revision starts

    @cached_property
    def seen(self) -> Observation:
        """The picture's observations: undistorted when it is placed, and again by a newer calibration."""
        return self.look()

    def see_with(self, camera: Camera, readout_s: float) -> None:
        """Undistort the observations again, by a newer calibration and readout."""
        self.seen = seen_with(camera, self.seen, readout_s)

    def remember(self, placed: Placed) -> None:
        self.placed = placed

    def answer(self, feature_set: FeatureSet) -> None:
        """Take the picture's newest set, or its refusal."""
        self.status, self.revision = feature_set.status, feature_set.revision

    def settle(self) -> None:
        """Keep the next placing, if it needs one, as the last."""
        self.is_settled = True

    def change_mount(self, nav: NavState) -> None:
        """Take another mount's attitude: the picture is to be placed afresh."""
        self.nav, self.placed, self.is_settled = nav, None, False


@dataclass(frozen=True, eq=False)
class Pending:
    """A window solve under way for a new keyframe; `reason`: why the pictures before it were dropped, if they were."""

    promise: Promise
    record: Record
    reason: Status | None
    due_ns: int


class RecordBook:
    """Records in the order of capture, and two queues of them: to be placed, and to be placed for the last time."""

    def __init__(self, config: Config) -> None:
        self.records: list[Record] = []
        self.unplaced: list[Record] = []  # the newest is placed first
        self.settling: deque[Record] = deque()  # the oldest is settled first
        self._interval_ns = round(1e9 / (PLACED_A_SET * config.link.max_rate_hz))
        self._newest_ns: int | None = None  # that was placed at once; None: the last one could not be

    def queue(self, frames: Sequence[int], behind: int) -> None:
        """Queue, after a solve of keyframes `frames`, records without a set and those `behind` or more keyframes back.

        Settled pictures before the window are forgotten.
        """
        self.unplaced = [r for r in self.records if r.status is not Status.OK and not r.is_for_later]
        if len(frames) > behind:
            passed = (r for r in self.records if r.frame.index <= frames[-1 - behind])
            self.settling = deque(r for r in passed if not r.is_settled)
        self.records = [r for r in self.records if r.frame.index > frames[0] or not r.is_settled]

    def take(self, before: float = math.inf) -> list[Record]:
        """The records of pictures `before` one, which begins the book again with those after it; by default all."""
        taken = [r for r in self.records if r.frame.index < before]
        self.records = self.records[len(taken) :]
        self.settling.clear()
        self.unplaced.clear()
        return taken

    def take_since(self, stamp_ns: int) -> list[Record]:
        """The records of pictures taken then or later, which leave the book."""
        taken = [r for r in self.records if r.frame.stamp_ns >= stamp_ns]
        self.records = [r for r in self.records if r.frame.stamp_ns < stamp_ns]
        return taken

    def may_wait(self, stamp_ns: int, has_newer: bool) -> bool:
        """Return whether a picture may wait, so that its first set is its last.

        `has_newer`: a newer picture can be placed already. True only while placing succeeds: refusals must be known at
        once, and cost little.
        """
        newest_ns = self._newest_ns
        return newest_ns is not None and (has_newer or 0 <= stamp_ns - newest_ns < self._interval_ns)

    def note_first(self, stamp_ns: int, is_placed: bool) -> None:
        """Note whether a picture that did not wait was placed."""
        self._newest_ns = stamp_ns if is_placed else None
