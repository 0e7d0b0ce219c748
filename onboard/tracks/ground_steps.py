"""The ground's motion from picture to picture: a homography from features all over the picture. (24.1)

What moves over the ground is a small part of a picture and is left out as an outlier. The last seconds of the pictures
that are kept are a row, so that a click may be seconds old and what lay behind a thing is known.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.locate import Locator
from onboard.events.kept_pictures import LEAST, RECENT_NS, KeptPictures
from onboard.geometry.plane_homography import fit_homography, move, pixel_grid

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

FEATURES, WINDOW_PX, LEVELS, SPACING = 160, 13, 3, 0.035  # spacing: of the picture's width
MAX_MISS_PX = 0.7  # of a feature against the homography
LEAST_FEATURES, LEAST_SHARE = 12, 0.4  # that must follow it, in number and of those found again
FROM_SMALL = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]])  # pixels at half the size -> the picture's
TO_SMALL = np.linalg.inv(FROM_SMALL)
GRID = (8, 6)
SHINE_PX, MIDDLE_GREY = 9, 128.0  # what features are followed in varies over less


@dataclass(eq=False)
class Seen:
    """A picture: its number, stamp (Unix ns), grey image (H, W) and set, once it has one."""

    frame: int
    stamp_ns: int
    image: Grey
    its_set: FeatureSet | None = None
    to_newest: Array | None = None  # its pixels -> those of the newest picture, (24.2); None: the row is broken
    locator: Locator | None = None  # of its set, once it was asked for
    is_joined: bool = False  # whether the step from the one before has been looked for
    _small: tuple[Grey, NDArray[np.float32]] | None = field(default=None, repr=False)
    _grain: Grey | None = field(default=None, repr=False)
    _ends: tuple[float, float] | None = field(default=None, repr=False)

    def ends(self) -> tuple[float, float]:
        """The grey levels at which the picture may be clipped: its darkest and its brightest, made once."""
        if self._ends is None:
            low, high, _, _ = cv2.minMaxLoc(self.image)
            self._ends = low, high
        return self._ends

    def grain(self) -> Grey:
        """The picture less what varies over more than SHINE_PX, made once. (24.34)

        Shine moves over the ground, as gusts do over crops and clouds over fields, and would take features with it.
        """
        if self._grain is None:
            shine = cv2.blur(self.image, (SHINE_PX, SHINE_PX))
            self._grain = np.asarray(cv2.addWeighted(self.image, 1.0, shine, -1.0, MIDDLE_GREY), np.uint8)
        return self._grain

    def small(self) -> tuple[Grey, NDArray[np.float32]]:
        """The picture at half the size and features (N, 2) in it, made once."""
        if self._small is None:
            image = np.asarray(cv2.resize(self.grain(), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)
            apart = max(3.0, SPACING * image.shape[1])
            found = cv2.goodFeaturesToTrack(image, FEATURES, 0.01, apart, blockSize=5)
            at = np.zeros((0, 2)) if found is None else found.reshape(-1, 2)
            self._small = image, np.asarray(at, np.float32)
        return self._small


class Pictures:
    """The last seconds of pictures, in capture order, without a gap: as far back as `kept` has every one."""

    def __init__(self, kept: KeptPictures | None = None, kept_ns: int = RECENT_NS) -> None:
        self._kept, self._kept_ns = KeptPictures() if kept is None else kept, kept_ns
        self._seen: deque[Seen] = deque()
        self._last_step: Array | None = None

    def __len__(self) -> int:
        return len(self._seen)

    def __iter__(self) -> Iterator[Seen]:
        return iter(self._seen)

    def add(self, seen: Seen) -> None:
        """The newest; one that is not newer begins again, as after a restart of the camera."""
        if self._seen and seen.frame <= self._seen[-1].frame:
            self.clear()
        self._seen.append(seen)
        if seen.its_set is not None:
            self._kept.add(seen.image, seen.its_set, seen.stamp_ns)
        before = list(self._seen)[:-LEAST]
        for number in reversed(range(len(before))):
            if seen.stamp_ns - before[number].stamp_ns > self._kept_ns or self._is_forgotten(before[number]):
                for _ in range(number + 1):
                    self._seen.popleft()
                break

    def _is_forgotten(self, seen: Seen) -> bool:
        return seen.its_set is not None and seen.frame not in self._kept

    def clear(self) -> None:
        self._seen.clear()

    def by_frame(self, frame: int) -> Seen | None:
        return next((seen for seen in self._seen if seen.frame == frame), None)

    def join(self) -> None:
        """Find the steps that are missing, so that every picture has its `to_newest`."""
        before: Seen | None = None
        for i, seen in enumerate(self._seen):
            if not seen.is_joined:
                H = None if before is None else step(before, seen, self._last_step)
                self._last_step, seen.is_joined, seen.to_newest = H, True, np.eye(3)
                for earlier in islice(self._seen, i):
                    earlier.to_newest = None if H is None or earlier.to_newest is None else H @ earlier.to_newest
            before = seen

    def between(self, first: Seen, second: Seen) -> Array | None:
        """H (3, 3): pixels of `first` -> of `second`, over all steps between; None if one is missing."""
        if first.to_newest is None or second.to_newest is None:
            return None
        H = np.linalg.solve(second.to_newest, first.to_newest)
        return np.asarray(H / H[2, 2], float)


def step(first: Seen, second: Seen, last_step: Array | None = None) -> Array | None:
    """(24.1): the homography that most features follow, found at half the size and then in the pictures themselves.

    Without enough of them what the poses give, None without either. `last_step`: where the search begins if the poses
    give nothing.
    """
    predicted = predicted_step(first.its_set, second.its_set)
    (image, at), (image2, _) = first.small(), second.small()
    if len(at) < LEAST_FEATURES or image.shape != image2.shape:
        return predicted
    start = predicted
    if start is None:
        start = np.eye(3) if last_step is None else last_step
    rough = _followed(image, image2, at, TO_SMALL @ start @ FROM_SMALL, LEVELS)
    if rough is None:
        return predicted
    at = 2.0 * at + np.float32(0.5)
    fine = _followed(first.grain(), second.grain(), at, FROM_SMALL @ rough @ TO_SMALL, 0)
    return FROM_SMALL @ rough @ TO_SMALL if fine is None else fine


def _followed(image: Grey, image2: Grey, at: NDArray[np.float32], start: Array, levels: int) -> Array | None:
    """The homography that most features at (N, 2) of one picture follow into another; None if they do not agree."""
    to = move(start, at.astype(float)).astype(np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 12, 0.02)
    found, is_found, _ = cv2.calcOpticalFlowPyrLK(
        image, image2, at, to, winSize=(WINDOW_PX, WINDOW_PX), maxLevel=levels, criteria=criteria,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW, minEigThreshold=1e-4,
    )  # fmt: skip
    height, width = image2.shape
    inside = (found > 2.0).all(axis=1) & (found < (width - 3.0, height - 3.0)).all(axis=1)
    good = (is_found.ravel() == 1) & inside
    count = int(np.count_nonzero(good))
    if count < LEAST_FEATURES:
        return None
    H, kept = cv2.findHomography(at[good], found[good], cv2.RANSAC, MAX_MISS_PX, maxIters=300)
    if H is None or np.count_nonzero(kept) < max(LEAST_FEATURES, LEAST_SHARE * count):
        return None
    return np.asarray(H / H[2, 2], float)


def predicted_step(first: FeatureSet | None, second: FeatureSet | None) -> Array | None:
    """The step by both pictures' poses over the first one's ground plane, (4.2); None without both."""
    if first is None or second is None or not (first.is_ok and second.is_ok):
        return None
    at = pixel_grid(first.camera.size_px, GRID)
    rays, valid = first.camera.unproject(at)
    w = first.plane_per_m[0] + rays[:, :2] @ first.plane_per_m[1:]
    valid = valid & (w > 0.05 * first.plane_per_m[0])
    here = LocalFrame(first.camera_lat_deg, first.camera_lon_deg, first.camera_height_m)
    moved_m = here.to_enu(second.camera_lat_deg, second.camera_lon_deg, second.camera_height_m)
    points = (rays / np.where(valid, w, 1.0)[:, None]) @ first.R_enu_cam.T - moved_m
    to, seen = second.camera.project(points @ second.R_enu_cam)
    valid &= seen
    if np.count_nonzero(valid) < LEAST_FEATURES:
        return None
    return fit_homography(at[valid], to[valid], np.ones(np.count_nonzero(valid)))
