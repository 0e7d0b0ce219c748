"""A message of the link becomes a value here and nowhere else: its key and its content must name the same vehicle.

A router keeps rights by keys, so a key is what a vehicle is known by: a set or a picture that names another one on a
permitted key is a ForeignMessage, whoever sent it. Statuses, tracks and spots name no vehicle and are their key's.
docs/wire-format.md, section 8. PAYLOADS is the other half of the table of topics: the codec of each.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from contract.errors import ForeignMessage, WireError
from contract.feature_set import FeatureSet
from contract.spot import SpotReport
from contract.topics import FEATURES, PICTURE, REPORTS, SPOTS, STATUS, TRACKS, Topic
from contract.track import TrackReport
from contract.vehicle_status import VehicleStatus, decode_status
from contract.wire.codec import Identity, decode, peek
from contract.wire.picture_code import Piece, read_piece
from contract.wire.spot_code import decode_spots
from contract.wire.track_code import decode_tracks

T = TypeVar("T")


class Stamp(NamedTuple):
    """The session of a message, and its time (Unix ns): that of a picture's capture, or of a status."""

    session: int
    unix_ns: int


@dataclass(frozen=True, eq=False)
class Payload(Generic[T]):
    """The codec of a topic: `read` gives a message's values and raises as the functions below, `stamp` a value's."""

    topic: Topic
    read: Callable[[str, bytes], Sequence[T]]
    stamp: Callable[[T], Stamp]

    @property
    def is_report(self) -> bool:
        """True if only the newest counts, and none of a session before the one that runs."""
        return self.topic in REPORTS

    def found(self, key: str, payload: bytes) -> Sequence[T]:
        """Return a message's values; none of one that cannot be read, or is of another topic."""
        try:
            return self.read(key, payload)
        except (ValueError, WireError):
            return []

    def stamp_of(self, key: str, payload: bytes) -> Stamp:
        """The stamp of a message, by its first value. Raises as `read`, and ValueError for a message without any."""
        first, *_ = self.read(key, payload)
        return self.stamp(first)


# All of them raise WireError for a payload that cannot be read, ForeignMessage (one of these) for another vehicle's
# content, and ValueError for a key of another topic.


def read_set(key: str, payload: bytes) -> FeatureSet:
    """The set of a message, or of an answer, on `pc/<vehicle>/features`."""
    found = decode(payload)
    checked_vehicle(FEATURES, key, found.vehicle)
    return found


def peek_set(key: str, payload: bytes) -> Identity:
    """Return which set a message is, without decoding the rest of it."""
    found = peek(payload)
    checked_vehicle(FEATURES, key, found.vehicle)
    return found


def read_picture_piece(key: str, payload: bytes) -> Piece:
    """The piece of a picture on `pc/<vehicle>/picture`."""
    found = read_piece(payload)
    checked_vehicle(PICTURE, key, found.whole.vehicle)
    return found


def read_status(key: str, payload: bytes) -> tuple[str, VehicleStatus]:
    """The vehicle and its status, on `pc/<vehicle>/status`."""
    return STATUS.vehicle(key), decode_status(payload)


def checked_vehicle(topic: Topic, key: str, named: str) -> str:
    """The vehicle of a key. Raises ForeignMessage where the content names another, ValueError for no key of a topic."""
    vehicle = topic.vehicle(key)
    if named != vehicle:
        raise ForeignMessage(f"{vehicle!r} sends what names {named!r}")
    return vehicle


class _Captured(Protocol):
    @property
    def session(self) -> int: ...
    @property
    def capture_unix_ns(self) -> int: ...


def _capture(value: _Captured) -> Stamp:
    return Stamp(value.session, value.capture_unix_ns)


# A set is stamped without being decoded.
SETS = Payload[Identity](FEATURES, lambda key, payload: [peek_set(key, payload)], _capture)
STATUSES = Payload[VehicleStatus](
    STATUS,
    lambda key, payload: [read_status(key, payload)[1]],
    lambda status: Stamp(status.session, max(round(status.unix_s * 1e9), 0)),
)
PIECES = Payload[Piece](
    PICTURE, lambda key, payload: [read_picture_piece(key, payload)], lambda piece: _capture(piece.whole)
)
TRACK_REPORTS = Payload[TrackReport](TRACKS, lambda key, payload: decode_tracks(payload, TRACKS.vehicle(key)), _capture)
SPOT_REPORTS = Payload[SpotReport](SPOTS, lambda key, payload: [decode_spots(payload, SPOTS.vehicle(key))], _capture)
PAYLOADS: dict[str, Payload[Any]] = {
    payload.topic.name: payload for payload in (SETS, STATUSES, PIECES, TRACK_REPORTS, SPOT_REPORTS)
}


def payload_of(key: str) -> Payload[Any] | None:
    """The codec of a key, or of a key expression with a topic's last chunk; None for another."""
    return PAYLOADS.get(key.rpartition("/")[2])
