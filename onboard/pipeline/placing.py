"""Pictures placed by the window's points, each beginning where an earlier placing ended."""

from __future__ import annotations

from collections.abc import Callable

from contract.feature_set import FeatureSet, Status
from onboard.estimation.sliding_window import Window
from onboard.estimation.solved_window import Solved
from onboard.geometry.plane_homography import Pose
from onboard.georeferencing.feature_sets import Picture, Placed, place
from onboard.georeferencing.revision import Revisions
from onboard.pipeline.record_book import Record

NEAR_NS = 100_000_000  # between pictures that show the same ground, turned by less than a resection's own start may be


class Placing:
    """Remembers the newest picture that was placed, and the last one that was placed when it was not the newest."""

    def __init__(self) -> None:
        self._newest: Record | None = None
        self._settled: Record | None = None
        self._revisions = Revisions()
        self.watches: list[Callable[[Placed], None]] = []  # shown every picture as it is placed

    def forget(self) -> None:
        self._newest = self._settled = None

    def place(self, window: Window, solved: Solved, record: Record, picture: Picture) -> FeatureSet | Status:
        """The picture's set by `solved`, or why it has none. `record` remembers how it was placed."""
        again = record.placed
        near = again or self._near(record)
        if near is None:
            guess = window.pose_guess(record.seen, record.nav)
        else:
            guess = Pose(near.pose.R_cam_enu, window.position_guess(record.nav))
        if guess is None:
            return Status.STARTING
        # The ground's correlation length is estimated at every keyframe, and taken as known until the next.
        ground_range = None if near is None or record.is_keyframe else near.ground_range
        start = None if again is None else again.pose
        placed = place(window, solved, record.seen, picture, guess, record.nav, start, ground_range)
        if isinstance(placed, Status):
            return placed
        record.remember(placed)
        for watch in self.watches:
            watch(placed)
        if self._newest is None or record.nav.stamp_ns >= self._newest.nav.stamp_ns:
            self._newest = record
        else:
            self._settled = record
        return placed.feature_set

    def is_needless(self, solved: Solved, record: Record) -> bool:
        """Return whether clicks on the picture already have the answers that `solved` would give them."""
        return record.placed is not None and self._revisions.is_needless(record.placed, solved)

    def _near(self, record: Record) -> Placed | None:
        """The placing of a picture taken shortly before or after this one; None if there is none."""
        for other in (self._settled, self._newest):
            if other is not None and abs(record.nav.stamp_ns - other.nav.stamp_ns) <= NEAR_NS:
                return other.placed if other.nav.stretch == record.nav.stretch else None
        return None
