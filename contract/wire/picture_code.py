"""Pictures <-> pieces of one packet each, and parity. docs/wire-format.md, section 11.

One packet in ten lost leaves of a picture of six pieces a half. So every group of up to six gets one more piece, the
exclusive or of them all, from which any one that is lost comes back (benchmarks/picture_loss.py measures both). A
stream loses nothing and needs none.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from contract.errors import CorruptPayload, NewerPayload, TruncatedPayload
from contract.picture import MAX_BYTES, ImageFormat, LinkPicture, checked
from contract.wire.codec import MAX_VEHICLE_BYTES
from contract.wire.parity import groups_of, joined, length_of, parities, pieces_of, share_of

MAGIC = b"PP"
MAJOR, MINOR = 1, 0
PACKET_BYTES = 1250  # as a set's: within one packet on every kind of link
MAX_PIECES = 255

# Magic, version, format, length of this payload, session, frame, capture time, width, height, the image's bytes, its
# checksum, which piece, how many there are without parity, the vehicle's length.
_HEAD = struct.Struct("<2sBBHIIQHHIIBBB")
_CRC = struct.Struct("<I")
_FORMATS = {kind.code: kind for kind in ImageFormat}


@dataclass(frozen=True)
class Whole:
    """The description of a picture that every piece repeats; pieces with the same one are put together."""

    vehicle: str
    session: int
    frame: int
    capture_unix_ns: int
    width_px: int
    height_px: int
    format: ImageFormat
    bytes: int
    checksum: int
    pieces: int  # without parity

    @property
    def share(self) -> int:
        """Bytes of a piece; the last may have fewer."""
        return share_of(self.bytes, self.pieces)

    @property
    def groups(self) -> int:
        """The largest number of parities. Piece i belongs to group i modulo this."""
        return groups_of(self.pieces)


@dataclass(frozen=True)
class Piece:
    """One packet: piece `number`, or from `whole.pieces` on the parity of group `number - whole.pieces`."""

    whole: Whole
    number: int
    content: bytes


def cut(picture: LinkPicture, *, with_parity: bool, max_bytes: int = PACKET_BYTES) -> list[bytes]:
    """A picture's packets, in the order to send them. Raises ValueError for a field that cannot be written.

    Parities come last: a receiver that has all pieces before need not wait for them.
    """
    p = picture
    vehicle = p.vehicle.encode()
    if not 1 <= len(vehicle) <= MAX_VEHICLE_BYTES:
        raise ValueError(f"vehicle name {p.vehicle!r} must take 1 to {MAX_VEHICLE_BYTES} UTF-8 bytes")
    for name, value, bytes_ in (("session", p.session, 4), ("frame", p.frame, 4), ("capture", p.capture_unix_ns, 8)):
        if not 0 <= value < 256**bytes_:
            raise ValueError(f"{name} must be between 0 and {256**bytes_ - 1}, not {value}")
    try:
        checked(p)
    except CorruptPayload as error:
        raise ValueError(str(error)) from error
    room = max_bytes - _HEAD.size - len(vehicle) - _CRC.size
    pieces = -(-len(p.content) // room) if room > 0 else MAX_PIECES + 1
    if pieces + groups_of(pieces) > MAX_PIECES:
        raise ValueError(f"a picture of {len(p.content)} bytes does not go into {MAX_PIECES} packets of {max_bytes}")
    whole = Whole(
        p.vehicle, p.session, p.frame, p.capture_unix_ns, p.width_px, p.height_px, p.format, len(p.content),
        zlib.crc32(p.content), pieces,
    )  # fmt: skip
    contents = pieces_of(p.content, pieces)
    if with_parity:
        contents += parities(contents)
    return [_packed(whole, vehicle, number, content) for number, content in enumerate(contents)]


def _packed(whole: Whole, vehicle: bytes, number: int, content: bytes) -> bytes:
    w = whole
    length = _HEAD.size + len(vehicle) + len(content) + _CRC.size
    head = _HEAD.pack(
        MAGIC, MAJOR << 4 | MINOR, w.format.code, length, w.session, w.frame, w.capture_unix_ns, w.width_px,
        w.height_px, w.bytes, w.checksum, number, w.pieces, len(vehicle),
    )  # fmt: skip
    body = head + vehicle + content
    return body + _CRC.pack(zlib.crc32(body))


def read_piece(payload: bytes) -> Piece:
    """A packet. Raises TruncatedPayload, CorruptPayload or NewerPayload, and nothing else."""
    if len(payload) < _HEAD.size + _CRC.size:
        raise TruncatedPayload(f"a piece of a picture has at least {_HEAD.size + _CRC.size} bytes, not {len(payload)}")
    magic, version, code, length, session, frame, capture, width, height, size, checksum, number, pieces, named = (
        _HEAD.unpack_from(payload)
    )
    _check_envelope(payload, magic, version, length)
    if code not in _FORMATS:
        raise NewerPayload(f"image format {code} is not known to this program")
    vehicle, content = _named_content(payload, named)
    if not 1 <= size <= MAX_BYTES or not 1 <= pieces <= size or number >= pieces + groups_of(pieces):
        raise CorruptPayload(f"piece {number} of {pieces} of a picture of {size} bytes")
    whole = Whole(vehicle, session, frame, capture, width, height, _FORMATS[code], size, checksum, pieces)
    if len(content) != length_of(whole.bytes, whole.pieces, number):
        raise CorruptPayload(
            f"piece {number} of {pieces} has {len(content)} bytes, not {length_of(whole.bytes, whole.pieces, number)}"
        )
    return Piece(whole, number, content)


def _check_envelope(payload: bytes, magic: bytes, version: int, length: int) -> None:
    """Magic, version, length and checksum are as they must be."""
    if magic != MAGIC:
        raise CorruptPayload(f"begins with {magic!r}, not {MAGIC!r}")
    if version >> 4 > MAJOR:
        raise NewerPayload(f"picture version {version >> 4}; this program reads up to {MAJOR}")
    if version >> 4 < MAJOR:
        raise CorruptPayload(f"picture version {version >> 4} never was")
    if len(payload) < length:
        raise TruncatedPayload(f"a piece of a picture has {len(payload)} of {length} bytes")
    if len(payload) > length:
        raise CorruptPayload(f"a piece of a picture has {len(payload)} bytes where its head states {length}")
    if zlib.crc32(payload[: -_CRC.size]) != _CRC.unpack(payload[-_CRC.size :])[0]:
        raise CorruptPayload("checksum does not match")


def _named_content(payload: bytes, named: int) -> tuple[str, bytes]:
    """The vehicle's name, of `named` bytes, and what follows it up to the checksum."""
    begin = _HEAD.size + named
    if not 1 <= named <= MAX_VEHICLE_BYTES or begin > len(payload) - _CRC.size:
        raise CorruptPayload(f"vehicle name of {named} bytes")
    try:
        return payload[_HEAD.size : begin].decode(), payload[begin : -_CRC.size]
    except UnicodeDecodeError as error:
        raise CorruptPayload(f"vehicle name is not UTF-8: {error}") from error


def join(whole: Whole, pieces: dict[int, bytes]) -> LinkPicture | None:
    """The picture of the pieces that came, by number; None while too many are missing.

    Raises CorruptPayload if they do not make the picture that they state.
    """
    content = joined(whole.bytes, whole.pieces, pieces)
    if content is None:
        return None
    if zlib.crc32(content) != whole.checksum:
        raise CorruptPayload("the pieces of a picture do not belong together")
    w = whole
    return checked(
        LinkPicture(w.vehicle, w.session, w.frame, w.capture_unix_ns, w.width_px, w.height_px, w.format, content)
    )
