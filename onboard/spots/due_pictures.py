"""The choice of pictures to look at for spots: with counts and a set, so many a second at most, never an older one."""

from __future__ import annotations

from contract.feature_set import FeatureSet
from onboard.events.types import Event, Frame
from onboard.events.waiting_pictures import WaitingPictures

EARLY = 0.1  # of the time between two, by which one may come too soon: pictures are not evenly spaced


class DuePictures:
    """Pictures that wait for their sets, the newest `most` of them; for one thread."""

    def __init__(self, rate_hz: float, most: int) -> None:
        self._apart_ns = round((1.0 - EARLY) / rate_hz * 1e9)
        self._held = WaitingPictures(most)
        self._newest = -1, -1  # session and frame of the last that was due
        self._stamp_ns = 0

    def event(self, event: Event) -> None:
        if isinstance(event, Frame) and event.counts is not None:
            self._held.event(event)

    def take(self, output: FeatureSet) -> Frame | None:
        """Return the picture that this set belongs to, if it is due and the set is the first one for it; else None."""
        frame = self._held.take(output.frame)
        identity = output.session, output.frame
        if frame is None or identity <= self._newest:
            return None
        is_same_session = output.session == self._newest[0]
        if is_same_session and frame.stamp_ns - self._stamp_ns < self._apart_ns:
            return None
        self._newest, self._stamp_ns = identity, frame.stamp_ns
        return frame
