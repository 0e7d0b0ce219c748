"""A small picture of a keyframe, as it crosses the link: a compressed image and which feature set it belongs to.

What came from elsewhere goes to a browser's decoder, so an image has the format and size that its first bytes state, or
it is none. A click on it is one on the camera's picture: u = (u' + 0.5) width / width' - 0.5, v likewise.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum

from contract.errors import CorruptPayload

MAX_SIDE_PX = 4096
MAX_BYTES = 200_000
_JPEG, _SOI = b"\xff\xd8\xff", 2
_WEBP_KEY = b"\x9d\x01\x2a"  # of a VP8 key frame, before its size
# JPEG markers whose segment begins with precision and size: baseline, extended and progressive, Huffman or arithmetic.
_FRAME_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


class ImageFormat(Enum):
    """The compression of an image."""

    JPEG = "jpeg"
    WEBP = "webp"

    @property
    def code(self) -> int:
        return list(ImageFormat).index(self) + 1

    @property
    def media_type(self) -> str:
        return f"image/{self.value}"


@dataclass(frozen=True)
class LinkPicture:
    """One picture; `width_px` and `height_px` are the image's own, the camera's are in the feature set."""

    vehicle: str
    session: int
    frame: int
    capture_unix_ns: int
    width_px: int
    height_px: int
    format: ImageFormat
    content: bytes

    @property
    def media_type(self) -> str:
        return self.format.media_type


def image_size(content: bytes) -> tuple[ImageFormat, int, int]:
    """Format, width and height (px) that an image's own head states. Raises CorruptPayload if it is neither kind."""
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        size = _webp_size(content)
        if size is not None:
            return ImageFormat.WEBP, *size
    elif content.startswith(_JPEG):
        size = _jpeg_size(content)
        if size is not None:
            return ImageFormat.JPEG, *size
    raise CorruptPayload("a picture must be a WebP or JPEG image")


def _webp_size(content: bytes) -> tuple[int, int] | None:
    """Read width and height of a simple lossy file: one VP8 chunk (RFC 9649, RFC 6386). None for other content."""
    if content[12:16] != b"VP8 " or content[23:26] != _WEBP_KEY or len(content) < 30:
        return None
    if struct.unpack_from("<I", content, 4)[0] + 8 != len(content):
        return None
    width, height = struct.unpack_from("<HH", content, 26)
    return width & 0x3FFF, height & 0x3FFF  # above are two bits of scale


def _jpeg_size(content: bytes) -> tuple[int, int] | None:
    """Read width and height from the first frame header (ITU-T T.81, B.2.2); None if there is none."""
    at = _SOI
    while at + 9 <= len(content) and content[at] == 0xFF:
        marker, length = content[at + 1], int.from_bytes(content[at + 2 : at + 4], "big")
        if marker in _FRAME_MARKERS:
            height, width = struct.unpack_from(">HH", content, at + 5)
            return width, height
        if length < 2:
            return None
        at += 2 + length
    return None


def checked(picture: LinkPicture) -> LinkPicture:
    """The picture, if its image is of the format and size that it is declared to be. Raises CorruptPayload."""
    if not 0 < len(picture.content) <= MAX_BYTES:
        raise CorruptPayload(f"a picture of {len(picture.content)} bytes; 1 to {MAX_BYTES} are taken")
    found = image_size(picture.content)
    declared = picture.format, picture.width_px, picture.height_px
    if found != declared:
        raise CorruptPayload(f"a picture declared as {_words(*declared)} holds {_words(*found)}")
    if not (0 < picture.width_px <= MAX_SIDE_PX and 0 < picture.height_px <= MAX_SIDE_PX):
        raise CorruptPayload(f"a picture of {picture.width_px}x{picture.height_px} px; at most {MAX_SIDE_PX} a side")
    return picture


def _words(kind: ImageFormat, width_px: int, height_px: int) -> str:
    return f"{kind.value} of {width_px}x{height_px} px"
