"""Whether the video is still stabilised: one window that does not see it does not take back what others have seen.

A frame that is shifted to hide a rotation shows where the aircraft turns, and a young window, or one in the middle of a
steady turn, may miss it and answer wrongly. So after a window that found it the next one that fits is refused as well,
and answers come back with the second in a row. (19.2)
"""

from __future__ import annotations

from contract.feature_set import Status

REASON = "the frame was shifted from picture to picture (stabilisation), and one window alone does not deny it"


class FrameDoubt:
    """Fed with the status of every window."""

    def __init__(self) -> None:
        self._is_open = False
        self._has_fitted = False  # the window before this one

    def denies(self, status: Status) -> bool:
        """Take a window's status; whether it fits and still must not count."""
        is_first = status is Status.OK and self._is_open and not self._has_fitted
        self._has_fitted = status is Status.OK
        if status is Status.STABILISED:
            self._is_open = True
        elif self._has_fitted and not is_first:
            self._is_open = False
        return is_first
