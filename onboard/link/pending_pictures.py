"""Pictures that were taken and have no set yet: a query for one waits for its set. Pure logic.

A set is made 0.1 s after its picture, of a fast camera's pictures between two that are placed at once seconds later.
"""

from __future__ import annotations

from contract.topics import TIME_TOLERANCE_S

MAX_PENDING = 512  # seventeen seconds of a camera's thirty a second


class PendingPictures:
    """Numbers and capture times (Unix ns) of the pictures under way. Not for use by several threads."""

    def __init__(self) -> None:
        self._taken_ns: dict[int, int] = {}  # by frame

    def __contains__(self, frame: int) -> bool:
        return frame in self._taken_ns

    def taken(self, frame: int, capture_unix_ns: int) -> None:
        """A picture has entered the pipeline."""
        self._taken_ns[frame] = capture_unix_ns
        if len(self._taken_ns) > MAX_PENDING:
            del self._taken_ns[next(iter(self._taken_ns))]

    def made(self, frame: int) -> None:
        self._taken_ns.pop(frame, None)

    def nearest(self, unix_s: float) -> int | None:
        """The picture captured nearest to a time, within TIME_TOLERANCE_S; None if there is none."""
        asked_ns = round(unix_s * 1e9)
        near = min(((abs(at_ns - asked_ns), frame) for frame, at_ns in self._taken_ns.items()), default=None)
        return None if near is None or near[0] > TIME_TOLERANCE_S * 1e9 else near[1]
