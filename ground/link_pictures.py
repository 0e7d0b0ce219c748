"""Pictures that cross the link in pieces: put together, and the last ones kept by vehicle, session and frame.

Always bounded: in pictures, in bytes, and in pieces of pictures that never become complete.
"""

from __future__ import annotations

import threading
from collections import OrderedDict

from contract.errors import WireError
from contract.picture import LinkPicture
from contract.wire.message import read_picture_piece
from contract.wire.picture_code import Piece, Whole, join
from ground.dropped_messages import DroppedMessages

MAX_PICTURES, MAX_BYTES = 1000, 32_000_000
MAX_PARTIAL = 4  # of a vehicle: its pictures come one after the other, and a late one may still be completed
MAX_VEHICLES = 64  # a peer may invent them

Identity = tuple[str, int, int]
"""Vehicle, session, frame."""


class Assembly:
    """Pieces in any order, of several pictures of each vehicle -> pictures. Not for use by several threads."""

    def __init__(self) -> None:
        self._partial: OrderedDict[str, OrderedDict[Whole, dict[int, bytes]]] = OrderedDict()
        self._done: dict[str, Whole] = {}  # the last of each vehicle, of which more pieces may come
        self.incomplete = 0  # pictures given up

    def take(self, piece: Piece) -> LinkPicture | None:
        """The picture that this piece completes, if it does. Raises CorruptPayload for pieces that do not fit."""
        whole = piece.whole
        if self._done.get(whole.vehicle) == whole:
            return None
        partial = self._partial.setdefault(whole.vehicle, OrderedDict())
        self._partial.move_to_end(whole.vehicle)
        pieces = partial.setdefault(whole, {})
        partial.move_to_end(whole)
        pieces[piece.number] = piece.content
        self._bound(partial)
        try:
            found = join(whole, pieces)
        except WireError:
            del partial[whole]
            raise
        if found is not None:
            del partial[whole]
            self._done[whole.vehicle] = whole
        return found

    def _bound(self, partial: OrderedDict[Whole, dict[int, bytes]]) -> None:
        while len(partial) > MAX_PARTIAL:
            partial.popitem(last=False)
            self.incomplete += 1
        while len(self._partial) > MAX_VEHICLES:
            vehicle, given_up = self._partial.popitem(last=False)
            self.incomplete += len(given_up)
            self._done.pop(vehicle, None)


class PictureCache:
    """The last pictures of all vehicles. Thread-safe; `take` may be called from zenoh's thread.

    For `SetCache`: `subscriptions={PICTURE.key(vehicle): cache.take}`. An aircraft sends pictures only while a client
    subscribes to them.
    """

    def __init__(self, max_pictures: int = MAX_PICTURES, max_bytes: int = MAX_BYTES) -> None:
        self._bounds = max_pictures, max_bytes
        self._lock = threading.Lock()
        self._assembly = Assembly()
        self._pictures: OrderedDict[Identity, LinkPicture] = OrderedDict()  # as they came
        self._bytes = 0
        self.received = 0  # whole pictures
        self.dropped = DroppedMessages("no pictures")

    @property
    def incomplete(self) -> int:
        with self._lock:
            return self._assembly.incomplete

    def take(self, key: str, payload: bytes) -> LinkPicture | None:
        """One message of the link, and the picture it completes; what is no piece of one of the vehicle's counts."""
        try:
            piece = read_picture_piece(key, payload)
            with self._lock:
                found = self._assembly.take(piece)
                if found is not None:
                    self._keep(found)
        except (WireError, ValueError) as error:
            self.dropped.failed(error)
            return None
        return found

    def picture(self, vehicle: str, session: int, frame: int) -> LinkPicture | None:
        """The picture of a frame; None if it did not come, or came too long ago."""
        with self._lock:
            return self._pictures.get((vehicle, session, frame))

    def frames(self, vehicle: str, session: int) -> set[int]:
        with self._lock:
            return {frame for name, of, frame in self._pictures if (name, of) == (vehicle, session)}

    def _keep(self, picture: LinkPicture) -> None:
        identity = picture.vehicle, picture.session, picture.frame
        self._forget(identity)
        self._pictures[identity] = picture
        self._bytes += len(picture.content)
        self.received += 1
        most, most_bytes = self._bounds
        while len(self._pictures) > most or self._bytes > most_bytes:
            self._forget(next(iter(self._pictures)))

    def _forget(self, identity: Identity) -> None:
        old = self._pictures.pop(identity, None)
        self._bytes -= 0 if old is None else len(old.content)
