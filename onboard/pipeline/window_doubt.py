"""Windows that fit and must not count: of optics that moved while no window could see it.

A young window, or one in the middle of a steady turn, may miss that its frame is shifted to hide a rotation: so after
one that found it, the next that fits is refused as well, and the second in a row counts (section 19).

A lens that zooms fast loses every feature from one picture to the next. So what is lost at once, where telemetry shows
that the ground is still in view, leaves the lens in doubt: known ground does not answer for a picture then, and a new
window counts only if it finds the ground about as high as it was, or as its slope leads to, or comes much later. (21.4)
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from onboard.estimation.solved_window import Solved
from onboard.estimation.window_problem import Outcome
from onboard.navigation.limits import LONG_NS, MOST_OF

Array = NDArray[np.float64]

SAME_DEPTH = 0.3  # of the logarithm of the height above ground: what relief may change


class FrameDoubt:
    """Takes the status of every window; after one with a shifted frame, one that fits is not enough to deny that."""

    def __init__(self) -> None:
        self._wanted = 0  # windows in a row that must fit, the last of which counts again

    def denies(self, status: Status) -> bool:
        """Take a window's status; whether it fits and still must not count."""
        if status is Status.OK:
            self._wanted = max(self._wanted - 1, 0)
            return self._wanted > 0
        if status is Status.STABILISED or self._wanted:
            self._wanted = 2
        return False

    def judged(self, outcome: Outcome) -> Outcome:
        """A window's outcome, which is refused if it must not count."""
        if not self.denies(outcome.status):
            return outcome
        why = "the frame was shifted from picture to picture (stabilisation), and one window alone does not deny it"
        return replace(outcome, status=Status.STABILISED, solved=None, reason=why)


class LensDoubt:
    """Takes the success of tracking and every solved window; doubts the lens after pictures that lost their tracks."""

    def __init__(self) -> None:
        self.is_open = False
        self.ground: tuple[float, Array] | None = None  # how high, and its plane (3,), as the last window had it
        self._held: deque[float] = deque(maxlen=4)
        self._until_ns = 0.0  # stamp after which a window settles the doubt, whatever its ground

    def tracked(self, found: int, offered: int) -> None:
        """A picture has found so many of the features that were looked for."""
        self._held.append(found / offered)

    def lost(self, stamp_ns: int, overlap: float) -> None:
        """Pictures in a row have found too little; `overlap`: how much of the last keyframe they should have shown."""
        if not self.is_open and max(self._held, default=0.0) >= MOST_OF and overlap >= MOST_OF:
            self.is_open, self._until_ns = True, stamp_ns + 2 * LONG_NS
        self._held.clear()

    def denies(self, solved: Solved) -> str:
        """Take a solved window; why it must not count, as the lens is no longer what it takes it for. Empty: it may."""
        newest = solved.keyframes[-1]
        up_m, middle = float(newest.centre_enu_m[2]), np.median(solved.solution.state.points_enu_m, axis=0)
        if self.is_open and self.ground is not None and newest.nav.stamp_ns <= self._until_ns:
            level_m, plane = self.ground
            before_m = np.array([level_m, plane[0] + plane[1:] @ middle[:2]])  # level, or on as it slopes
            near = np.log(np.maximum(up_m - before_m, 1.0) / max(up_m - middle[2], 1.0))
            nearer = near[np.argmin(np.abs(near))]
            if abs(nearer) > SAME_DEPTH:
                self._until_ns = np.inf  # from now on only ground as high as it was
                return f"the lens zoomed: the ground looks {np.exp(nearer):.1f} times as near as before"
        self.is_open, self.ground = False, (float(middle[2]), solved.plane)
        return ""

    def judged(self, outcome: Outcome) -> Outcome:
        """A window's outcome, which is refused if it must not count."""
        why = "" if outcome.solved is None else self.denies(outcome.solved)
        return replace(outcome, status=Status.ZOOMED, solved=None, reason=why) if why else outcome
