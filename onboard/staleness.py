"""A camera that gives an old picture as new: the same to the last bit, though the aircraft has moved.

No sensor gives the same noise twice. Believed, such a picture places the camera where it was when it was taken.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from onboard.navigation import NavState

MOVED_M = 0.5
TURNED_RAD = 0.01


class Staleness:
    """Remembers the newest picture that was not a repetition, and where the vehicle then was."""

    def __init__(self) -> None:
        self._image: NDArray[np.uint8] | None = None
        self._nav: NavState | None = None

    def is_stale(self, image: NDArray[np.uint8], nav: NavState) -> bool:
        """Whether a picture (H, W) is an old one, seen from elsewhere."""
        before = self._nav
        if before is None or self._image is None or not np.array_equal(image, self._image) or not np.ptp(image):
            # A picture of one single grey (black, white, a lens cap) is old or new alike: it has nothing to follow.
            self._image, self._nav = image, nav
            return False
        moved_m = float(np.linalg.norm(nav.position_enu_m - before.position_enu_m))
        if nav.R_enu_body is None or before.R_enu_body is None:
            return moved_m > MOVED_M
        # The chord between two rotations is sqrt(2) times as long as their angle, for small angles.
        turned_rad = float(np.linalg.norm(nav.R_enu_body - before.R_enu_body) / np.sqrt(2.0))
        return moved_m > MOVED_M or turned_rad > TURNED_RAD
