"""The pictures that are kept in memory, one ring for all that look back: so many bytes, keyframes longest."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contract.feature_set import FeatureSet

Grey = NDArray[np.uint8]

KEPT_BYTES = 48_000_000
RECENT_NS = 6_000_000_000  # every picture is kept for so long, if there is room
KEYFRAMES_SHARE = 0.25  # of the bytes, that keyframes older than that have at least
LEAST = 2  # pictures, however large


class Pictured(Protocol):
    """A picture (H, W), None where it cannot be read after all, and its newest set."""

    @property
    def image(self) -> Grey | None: ...

    @property
    def its_set(self) -> FeatureSet: ...


@dataclass(frozen=True, eq=False)
class Kept:
    """A picture (H, W), its stamp (Unix ns), and its newest set."""

    image: Grey
    its_set: FeatureSet
    stamp_ns: int = 0


class KeptPictures:
    """The pictures of the running session, by number, in the order in which their sets were made. From any thread."""

    def __init__(self, kept_bytes: int = KEPT_BYTES) -> None:
        self._kept_bytes, self._bytes = kept_bytes, 0
        self._kept: dict[int, Kept] = {}
        self._plain: dict[int, None] = {}  # the numbers of those that are no keyframes
        self._session = -1
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._kept)

    def __contains__(self, number: int) -> bool:
        return number in self._kept

    def add(self, image: Grey, its_set: FeatureSet, stamp_ns: int | None = None) -> None:
        """A picture with its first set. One that is kept already stays as it is: more than one thread hands it over."""
        with self._lock:
            if its_set.session != self._session:
                self._kept.clear()
                self._plain.clear()
                self._session, self._bytes = its_set.session, 0
            held = self._kept.get(its_set.frame)
            if held is not None and held.image is image:
                return
            if held is not None:  # the camera began again
                self._drop(its_set.frame)
            added = Kept(image, its_set, its_set.capture_unix_ns if stamp_ns is None else stamp_ns)
            self._kept[its_set.frame] = added
            if not its_set.is_keyframe:
                self._plain[its_set.frame] = None
            self._bytes += image.nbytes
            while self._bytes > self._kept_bytes and len(self._kept) > LEAST:
                self._drop(self._passing(its_set.frame, added.stamp_ns - RECENT_NS))

    def revise(self, its_set: FeatureSet) -> None:
        """A later set of a picture that is kept: its pose is by more pictures."""
        with self._lock:
            held = self._kept.get(its_set.frame)
            if held is None or not its_set.is_ok or its_set.session != self._session:
                return
            if its_set.revision > held.its_set.revision:
                self._kept[its_set.frame] = replace(held, its_set=its_set)

    def placed(self, session: int, frame: int) -> tuple[Kept | None, list[Kept]]:
        """A picture whose set answers clicks, None if it is not kept; and all others of these."""
        with self._lock:
            if session != self._session:
                return None, []
            placed = {number: kept for number, kept in self._kept.items() if kept.its_set.is_ok}
        return placed.pop(frame, None), list(placed.values())

    def _drop(self, frame: int) -> None:
        self._bytes -= self._kept.pop(frame).image.nbytes
        self._plain.pop(frame, None)

    def _passing(self, newest: int, recent_ns: int) -> int:
        """The picture that goes next: one that is neither recent nor a keyframe, then a keyframe beyond their share."""
        plain = next((number for number in self._plain if number != newest), None)
        if plain is not None and self._kept[plain].stamp_ns < recent_ns:
            return plain
        old_bytes = 0
        for kept in self._kept.values():
            if kept.stamp_ns >= recent_ns:
                break
            old_bytes += kept.image.nbytes
            if old_bytes > KEYFRAMES_SHARE * self._kept_bytes:
                return next(iter(self._kept))
        return next(iter(self._kept)) if plain is None else plain
