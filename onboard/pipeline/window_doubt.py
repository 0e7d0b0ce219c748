"""Windows that fit and must not count: of optics that moved while no window could see it.

A frame that is shifted to hide a rotation shows where the aircraft turns, and a young window, or one in the middle of a
steady turn, may miss it and answer wrongly. So after a window that found it the next one that fits is refused as well,
and answers come back with the second in a row. (19.2)

A lens that zooms fast loses every feature from one picture to the next, and a window of pictures that were all taken
afterwards fits a ground that is as much nearer. So what is lost at once, where telemetry says that the ground is still
in sight, leaves the lens in doubt: known ground does not answer for a picture then, and a new window counts only
if it finds the ground about as high as it was. A window that comes much later has other ground below it. (21.4)
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from contract.feature_set import Status
from onboard.estimation.solved_window import Solved
from onboard.estimation.window_request import Outcome
from onboard.navigation.limits import LONG_NS, MOST_OF

SAME_DEPTH = 0.3  # of the logarithm of the height above ground: what relief may change


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

    def judged(self, outcome: Outcome) -> Outcome:
        """A window's outcome, which is refused if it must not count."""
        if not self.denies(outcome.status):
            return outcome
        why = "the frame was shifted from picture to picture (stabilisation), and one window alone does not deny it"
        return replace(outcome, status=Status.STABILISED, solved=None, reason=why)


class LensDoubt:
    """Fed with how tracking goes, and with every solved window."""

    def __init__(self) -> None:
        self.is_open = False
        self.reason = ""
        self._held: deque[float] = deque(maxlen=4)
        self._ground_m: float | None = None  # how high the ground is, as the last window had it that counted
        self._lost_ns = 0
        self._has_denied = False

    def tracked(self, found: int, offered: int) -> None:
        """A picture has found so many of the features that were looked for."""
        self._held.append(found / max(offered, 1))

    def lost(self, stamp_ns: int, overlap: float) -> None:
        """Pictures in a row have found too little; `overlap`: how much of the last keyframe they should have shown."""
        if not self.is_open and max(self._held, default=0.0) >= MOST_OF and overlap >= MOST_OF:
            self.is_open, self._lost_ns, self._has_denied = True, stamp_ns, False
        self._held.clear()

    def denies(self, solved: Solved) -> bool:
        """Take a solved window; whether it must not count, because the lens is no longer what it takes it for."""
        newest = solved.keyframes[-1]
        up_m, ground_m = float(newest.centre_enu_m[2]), float(np.median(solved.solution.state.points_enu_m[:, 2]))
        is_outdated = newest.nav.stamp_ns - self._lost_ns > 2 * LONG_NS and not self._has_denied
        if self.is_open and self._ground_m is not None and not is_outdated:
            nearer = np.log(max(up_m - self._ground_m, 1.0) / max(up_m - ground_m, 1.0))
            if abs(nearer) > SAME_DEPTH:
                self._has_denied = True
                self.reason = f"the lens zoomed: the ground looks {np.exp(nearer):.1f} times as near as before"
                return True
        self.settle()
        self._ground_m = ground_m
        return False

    def forget_ground(self) -> None:
        """Heights count from elsewhere now."""
        self._ground_m = None

    def settle(self) -> None:
        """A window has shown the lens to be what it was, or it has been reported."""
        self.is_open, self.reason = False, ""

    def judged(self, outcome: Outcome) -> Outcome:
        """A window's outcome, which is refused if it must not count."""
        if outcome.solved is None or not self.denies(outcome.solved):
            return outcome
        return replace(outcome, status=Status.ZOOMED, solved=None, reason=self.reason)
