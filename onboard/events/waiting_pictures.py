"""Pictures between the camera and their sets."""

from __future__ import annotations

from onboard.events.types import Event, Frame


class WaitingPictures:
    """The newest pictures, at most so many: one whose set never comes is forgotten. For one thread."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._held: dict[int, Frame] = {}

    def __len__(self) -> int:
        return len(self._held)

    def event(self, event: Event) -> None:
        if isinstance(event, Frame) and event.image is not None:
            self._held[event.index] = event
            if len(self._held) > self._most:
                del self._held[next(iter(self._held))]

    def take(self, index: int) -> Frame | None:
        """The picture of this number; None where it has been taken, or was forgotten."""
        return self._held.pop(index, None)
