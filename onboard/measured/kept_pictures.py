"""The pictures that a click can be measured in: the last ones, keyframes longest, within a number of bytes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import FeatureSet

Grey = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Kept:
    """A picture (H, W) and its newest set."""

    image: Grey
    its_set: FeatureSet


class KeptPictures:
    """The pictures of the running session whose sets answer clicks, for one thread."""

    def __init__(self, kept_bytes: int) -> None:
        self._kept_bytes, self._bytes = kept_bytes, 0
        self._kept: dict[int, Kept] = {}  # by frame, in the order in which their sets were made
        self._session = -1

    def __len__(self) -> int:
        return len(self._kept)

    def add(self, image: Grey, its_set: FeatureSet) -> None:
        """A picture with its first set."""
        if its_set.session != self._session:
            self._kept.clear()
            self._session, self._bytes = its_set.session, 0
        if not its_set.is_ok or its_set.frame in self._kept:
            return
        self._kept[its_set.frame] = Kept(image, its_set)
        self._bytes += image.nbytes
        while self._bytes > self._kept_bytes and len(self._kept) > 1:
            oldest = next(iter(self._kept))
            passing = next((frame for frame, kept in self._kept.items() if not kept.its_set.is_keyframe), oldest)
            self._bytes -= self._kept.pop(passing).image.nbytes

    def revise(self, its_set: FeatureSet) -> None:
        """A later set of a picture that is kept: its pose is by more pictures."""
        held = self._kept.get(its_set.frame)
        if held is None or not its_set.is_ok or its_set.session != self._session:
            return
        if its_set.revision > held.its_set.revision:
            self._kept[its_set.frame] = Kept(held.image, its_set)

    def frame(self, session: int, frame: int) -> Kept | None:
        """A picture; None if it is not kept."""
        return self._kept.get(frame) if session == self._session else None

    def others(self, frame: int) -> list[Kept]:
        """All but one of them."""
        return [kept for number, kept in self._kept.items() if number != frame]
