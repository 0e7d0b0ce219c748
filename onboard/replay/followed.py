"""Things clicked in a recorded flight, followed through its pictures as in the air; without a thread, so that the same
recording gives the same reports.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from contract.feature_set import FeatureSet
from contract.track import TrackReport
from onboard.events.types import Event
from onboard.events.waiting_pictures import WaitingPictures
from onboard.tracks.track_book import TrackBook

REPORT_NS = 500_000_000
MAX_HELD = 256  # pictures that wait for their set


@dataclass(frozen=True)
class Clicked:
    """A target to follow: a pixel of a picture."""

    frame: int
    u_px: float
    v_px: float


class Followed:
    """A sink: `outlets` are given the reports of all tracks, twice a second of the flight; `fail` those clicks at which
    there was nothing to be followed, or whose picture had no set.
    """

    def __init__(
        self,
        vehicle: str,
        clicks: Sequence[Clicked],
        fail: Callable[[Clicked], object],
        outlets: Sequence[Callable[[list[TrackReport]], object]],
    ) -> None:
        self._book, self._fail, self._outlets = TrackBook(vehicle), fail, outlets
        self._waiting = list(enumerate(clicks, 1))
        self._held = WaitingPictures(MAX_HELD)
        self._newest = -1
        self._reported_ns = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        for _, click in self._waiting:
            self._fail(click)

    def event(self, arrival_ns: int, event: Event) -> None:
        self._held.event(event)

    def feature_set(self, output: FeatureSet) -> None:
        """The next picture, if this is its first set and no newer picture had one before."""
        frame = self._held.take(output.frame)
        if frame is None or output.frame <= self._newest:
            return
        self._newest = output.frame
        self._book.picture(frame, output)
        for number, click in [due for due in self._waiting if due[1].frame <= self._newest]:
            self._waiting.remove((number, click))
            if click.frame not in self._book.frames or not self._book.start(
                number, (click.u_px, click.v_px), click.frame
            ):
                self._fail(click)
        if frame.stamp_ns - self._reported_ns >= REPORT_NS:
            reports = self._book.reports()
            if reports:
                self._reported_ns = frame.stamp_ns
                for outlet in self._outlets:
                    outlet(reports)
