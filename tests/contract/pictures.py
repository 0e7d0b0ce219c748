"""Pictures for the tests of everything that carries them."""

import random
import struct

from hypothesis import strategies as st

from contract.picture import ImageFormat, LinkPicture

START_NS = 1_700_000_000_123_456_789


def webp_of(width_px: int, height_px: int, rest: bytes) -> bytes:
    """The head of a WebP file, true to RFC 9649, and what no decoder will be asked about."""
    chunk = b"\0\0\0\x9d\x01\x2a" + struct.pack("<HH", width_px, height_px) + rest
    body = b"WEBPVP8 " + struct.pack("<I", len(chunk)) + chunk
    return b"RIFF" + struct.pack("<I", len(body)) + body


def jpeg_of(width_px: int, height_px: int, rest: bytes) -> bytes:
    """The head of a JPEG file, likewise."""
    quantisation = b"\xff\xdb" + struct.pack(">H", 67) + bytes(65)
    return b"\xff\xd8" + quantisation + b"\xff\xc0" + struct.pack(">HBHH", 11, 8, height_px, width_px) + rest


def small_picture(
    frame: int = 77, size: int = 5000, vehicle: str = "uav-1", session: int = 3_000_000_001
) -> LinkPicture:
    """About so many bytes, others for every frame."""
    rest = random.Random(frame).randbytes(max(size - 30, 0))
    content = webp_of(480, 360, rest)
    return LinkPicture(vehicle, session, frame, START_NS + frame, 480, 360, ImageFormat.WEBP, content)


@st.composite
def pictures(draw: st.DrawFn) -> LinkPicture:
    width, height = draw(st.integers(1, 4096)), draw(st.integers(1, 4096))
    kind = draw(st.sampled_from(ImageFormat))
    rest = random.Random(draw(st.integers(0, 9))).randbytes(draw(st.integers(0, 30_000)))
    return LinkPicture(
        draw(
            st.text(min_size=1, max_size=8).filter(lambda t: 1 <= len(t.encode(errors="replace")) <= 32 and _is_utf8(t))
        ),
        draw(st.integers(0, 2**32 - 1)),
        draw(st.integers(0, 2**32 - 1)),
        draw(st.integers(0, 2**64 - 1)),
        width,
        height,
        kind,
        (webp_of if kind is ImageFormat.WEBP else jpeg_of)(width, height, rest),
    )


def _is_utf8(text: str) -> bool:
    return not any(0xD800 <= ord(c) <= 0xDFFF for c in text)
