"""Large pictures tracked at a size of their own: what LK finds depends on how many pixels a motion, a texture and the
picture's blur are, which grow with the number of the sensor's pixels while the ground stays the same.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.geometry.plane_homography import move
from onboard.vision.contrast_normalisation import Picture
from onboard.vision.klt_tracker import Array, Tracker, Tracks

WORKING_PX = 1640  # of the longer side: windows, levels and gates are made for pictures up to this


def tracker_for(size_px: tuple[int, int], features: int, min_distance_px: float = 0.0) -> Tracker:
    """The tracker for pictures of a size; those that are too large are reduced."""
    is_large = max(size_px) > WORKING_PX
    return (ReducedTracker if is_large else Tracker)(size_px, features, min_distance_px)


class ReducedTracker(Tracker):
    """A `Tracker` on pictures reduced to WORKING_PX; pixels and motions in and out are the full picture's."""

    def __init__(self, size_px: tuple[int, int], features: int, min_distance_px: float = 0.0) -> None:
        share = min(1.0, WORKING_PX / max(size_px))
        working = round(size_px[0] * share), round(size_px[1] * share)
        super().__init__(working, features, share * min_distance_px)
        x, y = working[0] / size_px[0], working[1] / size_px[1]
        # Full picture -> working picture: pixel centres are at whole numbers, the edges half a pixel out.
        self._reduce = np.array([[x, 0.0, 0.5 * x - 0.5], [0.0, y, 0.5 * y - 0.5], [0.0, 0.0, 1.0]])
        self._enlarge = np.linalg.inv(self._reduce)

    def leave_out(self, burned_in: NDArray[np.bool_]) -> None:
        """Take no feature where (H, W) of the full picture something is burned into every picture."""
        size = self.width_px, self.height_px
        share = cv2.resize(burned_in.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        super().leave_out(np.asarray(share) > 0.0)

    @property
    def keyframe_features(self) -> tuple[NDArray[np.int64], Array]:
        """Identifiers (N,) and pixels (N, 2) of the keyframe's features, tracked ones and new ones."""
        ids, uv = super().keyframe_features
        return ids, move(self._enlarge, uv)

    def track(self, image: Picture, predicted: Array | None, sigma_px: float | None = None) -> Tracks:
        """Track as `Tracker.track` does, with a picture, a motion and a sigma of the full size."""
        size = self.width_px, self.height_px
        small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        sigma_px = None if sigma_px is None else float(self._reduce[0, 0]) * sigma_px
        return self._moved(super().track(small, self._between(self._reduce, predicted), sigma_px), self._enlarge)

    def promote(self, tracks: Tracks) -> tuple[NDArray[np.int64], Array]:
        """Make the last picture the keyframe: keep `tracks`, fill up with new features; returns all ids and pixels."""
        ids, uv = super().promote(self._moved(tracks, self._reduce))
        if self.flow_disagreement_px is not None:
            self.flow_disagreement_px = self.flow_disagreement_px / np.diag(self._reduce)[:2]
        return ids, move(self._enlarge, uv)

    def _between(self, change: Array, motion: Array | None) -> Array | None:
        """A motion in the pixels of the other picture size."""
        if motion is None:
            return None
        out: Array = change @ motion @ np.linalg.inv(change)
        out /= out[2, 2]
        return out

    def _moved(self, tracks: Tracks, change: Array) -> Tracks:
        motion = self._between(change, tracks.motion)
        assert motion is not None
        uv, at = move(change, tracks.uv_px), move(change, tracks.keyframe_uv_px)
        return replace(tracks, uv_px=uv, keyframe_uv_px=at, motion=motion)
