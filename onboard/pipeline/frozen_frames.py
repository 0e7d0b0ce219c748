"""A camera that gives an old picture as new, though the aircraft has moved: it would be placed where it was taken.

The same to the last bit: no sensor gives the same noise twice. Or encoded again, so that bits differ: then nothing in
it has moved where telemetry predicts that all must have.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import Status
from onboard.geometry.plane_homography import move
from onboard.geometry.robust import middle
from onboard.navigation.limits import LIKELY_SIGMAS, PATIENCE_NS
from onboard.navigation.navigator import NavState
from onboard.vision.klt_tracker import PREDICTED_PX, PREDICTED_SHARE, Tracks

Array = NDArray[np.float64]

MOVED_M = 0.5
TURNED_RAD = 0.01
STILL_PX = 0.5  # median motion at 640 px width that two encodings of one picture may show


class Staleness:
    """Remembers the newest picture that was not a repetition, and where the vehicle then was."""

    def __init__(self) -> None:
        self._newest: tuple[NDArray[np.uint8], NavState] | None = None

    def is_stale(
        self, image: NDArray[np.uint8], nav: NavState, state_at: Callable[[int], NavState | Status] | None = None
    ) -> bool:
        """Return whether a picture (H, W) repeats an older one though the camera has moved since.

        `state_at` looks the older picture's state up again: the time offset may have been learned since.
        """
        # A picture of one single grey (black, white, a lens cap) looks the same whether old or new.
        if self._newest is None or not np.array_equal(image, self._newest[0]) or not np.ptp(image):
            self._newest = image, nav
            return False
        looked_up = None if state_at is None else state_at(self._newest[1].stamp_ns)
        before = looked_up if isinstance(looked_up, NavState) else self._newest[1]
        turned_rad = 0.0
        if nav.R_enu_body is not None and before.R_enu_body is not None:
            # The chord between two rotations is sqrt(2) times as long as their angle, for small angles.
            turned_rad = float(np.linalg.norm(nav.R_enu_body - before.R_enu_body) / np.sqrt(2.0))
        moved_m = float(np.linalg.norm(nav.position_enu_m - before.position_enu_m))
        return moved_m > MOVED_M or turned_rad > TURNED_RAD


class Stillness:
    """Remembers where features were seen when they last moved, and what motion telemetry has predicted since."""

    def __init__(self, width_px: int) -> None:
        self._px = width_px / 640.0
        self.begin(np.zeros(0, np.int64), np.zeros((0, 2)), 0)

    def begin(self, ids: NDArray[np.int64], uv_px: Array, stamp_ns: int) -> None:
        """A new keyframe: its features (N,) at their pixels (N, 2)."""
        self._ids, self._uv, self._predicted, self._stamp_ns = ids, uv_px, np.eye(3), stamp_ns

    def is_old(self, tracks: Tracks, predicted: Array, stamp_ns: int) -> bool:
        """Return whether `tracks` stand still though `predicted` (3, 3), from the keyframe, shows that they cannot."""
        _, here, there = np.intersect1d(tracks.ids, self._ids, assume_unique=True, return_indices=True)
        at, to = tracks.keyframe_uv_px[here], tracks.uv_px[here]
        if not len(here) or _median(to - self._uv[there]) > STILL_PX * self._px:
            self._ids, self._uv, self._predicted, self._stamp_ns = tracks.ids, tracks.uv_px, predicted, stamp_ns
            return False
        predicted_px = _median(move(predicted, at) - move(self._predicted, at))
        if predicted_px > LIKELY_SIGMAS * (PREDICTED_SHARE * predicted_px + PREDICTED_PX * self._px):
            return True
        if stamp_ns - self._stamp_ns > PATIENCE_NS:  # telemetry's drift may be what it predicts
            self._predicted, self._stamp_ns = predicted, stamp_ns
        return False


def _median(step_px: Array) -> float:
    return middle(np.linalg.norm(step_px, axis=1))
