"""What the pipeline remembers of a picture that the window can still place, and of a window solve under way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from contract.feature_set import Status
from onboard.estimation.keyframe import Observation
from onboard.estimation.solver_executor import Promise
from onboard.events.types import Frame
from onboard.georeferencing.feature_sets import Placed
from onboard.navigation.navigator import NavState


@dataclass(eq=False)
class Record:
    """A picture that the window can still place, or place better."""

    frame: Frame
    seen_when_asked: Observation | Callable[[], Observation]  # features are undistorted when the picture is placed
    nav: NavState
    is_keyframe: bool
    status: Status = Status.STARTING
    revision: int = -1
    is_settled: bool = False
    is_for_later: bool = False  # its only set is the one that it is settled with
    placed: Placed | None = None  # as it was last, by the window's own points: where the next revision starts

    @property
    def seen(self) -> Observation:
        """What the picture saw."""
        if not isinstance(self.seen_when_asked, Observation):
            self.seen_when_asked = self.seen_when_asked()
        return self.seen_when_asked

    @seen.setter
    def seen(self, seen: Observation) -> None:
        self.seen_when_asked = seen


@dataclass(frozen=True, eq=False)
class Pending:
    """A window solve under way for a new keyframe; `reason`: why the pictures before it were dropped, if they were."""

    promise: Promise
    record: Record
    reason: Status | None
    due_ns: int
