"""A message of the link becomes a value here and nowhere else: its key and its content must name the same vehicle.

A router keeps rights by keys, so a key is what a vehicle is known by: a set or a picture that names another one on a
permitted key is a ForeignMessage, whoever sent it. Statuses, tracks and spots name no vehicle and are their key's.
docs/wire-format.md, section 8.
"""

from __future__ import annotations

from contract.errors import ForeignMessage
from contract.feature_set import FeatureSet
from contract.spot import SpotReport
from contract.topics import FEATURES, PICTURE, SPOTS, STATUS, TRACKS, Topic
from contract.track import TrackReport
from contract.vehicle_status import VehicleStatus, decode_status
from contract.wire.codec import Identity, decode, peek
from contract.wire.picture_code import Piece, read_piece
from contract.wire.spot_code import decode_spots
from contract.wire.track_code import decode_tracks

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


def read_tracks(key: str, payload: bytes) -> list[TrackReport]:
    """The reports on `pc/<vehicle>/tracks`."""
    return decode_tracks(payload, TRACKS.vehicle(key))


def read_spots(key: str, payload: bytes) -> SpotReport:
    """The spots on `pc/<vehicle>/spots`."""
    return decode_spots(payload, SPOTS.vehicle(key))


def checked_vehicle(topic: Topic, key: str, named: str) -> str:
    """The vehicle of a key. Raises ForeignMessage where the content names another, ValueError for no key of a topic."""
    vehicle = topic.vehicle(key)
    if named != vehicle:
        raise ForeignMessage(f"{vehicle!r} sends what names {named!r}")
    return vehicle
