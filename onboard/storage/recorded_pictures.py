"""The pictures of a recorded flight for who looks back in them, as `KeptPictures` has those of a running one.

Of a recording both sides of the clicked picture are there. They are read when they are looked into; a few are kept.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import OrderedDict
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from contract.errors import InputError, WireError
from contract.feature_set import FeatureSet, Status
from contract.recorded_pictures import PictureIndex
from contract.wire.codec import Identity, decode, peek
from onboard.events.kept_pictures import KEPT_BYTES, RECENT_NS, Grey
from onboard.storage.mcap_reader import RecordedFlight, decoded_picture

# How far apart in time pictures are that are looked at: closely spaced, as on board, and further off to both sides
# fewer, of which a slow flight has its baselines.
SPACING_NS, FURTHER_SPACING_NS = 100_000_000, 500_000_000
FURTHEST_NS = 60_000_000_000
_NEAR = np.arange(SPACING_NS, RECENT_NS, SPACING_NS)
_OFFSETS_NS = np.concatenate([_NEAR, np.arange(RECENT_NS, FURTHEST_NS, FURTHER_SPACING_NS)])
KEPT_SETS = 1024


@dataclass(frozen=True, eq=False)
class RecordedPicture:
    """One with its set, the last that the recording has of it."""

    its_set: FeatureSet
    _all: RecordedPictures

    @property
    def image(self) -> Grey | None:
        """The picture as the pipeline had it, but for what JPEG leaves out; None where it cannot be decoded."""
        return self._all.image(self.its_set.frame)


class RecordedPictures:
    """A flight's sets and pictures, found once. For one thread.

    `sets`: the last payload of every picture's set, by its frame.
    """

    def __init__(self, flight: RecordedFlight, kept_bytes: int = KEPT_BYTES) -> None:
        self._flight, self._kept_bytes = flight, kept_bytes
        self._index = PictureIndex(flight.paths[0])
        found = _newest_sets(flight)
        self.sets = {identity.frame: payload for identity, payload in found.values()}
        placed = sorted(
            (identity.capture_unix_ns, frame)
            for frame, (identity, _) in found.items()
            if identity.status is Status.OK and self._index.has(flight.vehicle, frame)
        )
        self._times_ns, self._frames = [ns for ns, _ in placed], [frame for _, frame in placed]
        self._images: OrderedDict[int, Grey | None] = OrderedDict()
        self._bytes = 0
        self._set = lru_cache(maxsize=KEPT_SETS)(self._decoded)

    def __len__(self) -> int:
        return len(self._frames)

    def placed(self, session: int, frame: int) -> tuple[RecordedPicture | None, list[RecordedPicture]]:
        """A picture whose set answers clicks, None if it is not there; and others from shortly before and after it."""
        clicked = self._picture(frame) if session == self._flight.session else None
        if clicked is None or not self._index.has(self._flight.vehicle, frame):
            return None, []
        at_ns = clicked.its_set.capture_unix_ns
        wanted_ns = at_ns + np.concatenate([-_OFFSETS_NS[::-1], _OFFSETS_NS])
        near = dict.fromkeys(self._nearest(int(ns)) for ns in wanted_ns)
        near.pop(frame, None)
        others = [self._picture(other) for other in near]
        return clicked, [other for other in others if other is not None]

    def image(self, frame: int) -> Grey | None:
        """A frame's picture (H, W); None where it is not there or damaged."""
        if frame not in self._images:
            message = self._index.message(self._flight.vehicle, frame)
            found: Grey | None = None
            if message is not None:
                try:
                    found = decoded_picture(message, self._flight.camera).astype(np.uint8, copy=False)
                except InputError:
                    found = None
            self._images[frame] = found
            self._bytes += 0 if found is None else found.nbytes
            while self._bytes > self._kept_bytes and len(self._images) > 1:
                _, gone = self._images.popitem(last=False)
                self._bytes -= 0 if gone is None else gone.nbytes
        self._images.move_to_end(frame)
        return self._images[frame]

    def _nearest(self, unix_ns: int) -> int:
        after = bisect_left(self._times_ns, unix_ns)
        near = range(max(after - 1, 0), min(after + 1, len(self._times_ns)))
        return self._frames[min(near, key=lambda i: abs(self._times_ns[i] - unix_ns))]

    def _picture(self, frame: int) -> RecordedPicture | None:
        its_set = self._set(frame)
        return None if its_set is None or not its_set.is_ok else RecordedPicture(its_set, self)

    def _decoded(self, frame: int) -> FeatureSet | None:
        try:
            return decode(self.sets[frame]) if frame in self.sets else None
        except WireError:
            return None


def _newest_sets(flight: RecordedFlight) -> dict[int, tuple[Identity, bytes]]:
    """The last revision of every picture's set, of the recording's own session; what cannot be read is left out."""
    found: dict[int, tuple[Identity, bytes]] = {}
    for payload in flight.sets():
        try:
            identity = peek(payload)
        except WireError:
            continue
        held = found.get(identity.frame)
        is_older = held is not None and held[0].revision > identity.revision
        if identity.session == flight.session and identity.vehicle == flight.vehicle and not is_older:
            found[identity.frame] = identity, payload
    return found
