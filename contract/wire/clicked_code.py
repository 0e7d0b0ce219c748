"""A clicked pixel that was measured by itself <-> bytes: section 6.1 of docs/wire-format.md."""

from __future__ import annotations

import math
import struct

from contract.camera import Camera
from contract.errors import CorruptPayload, NewerPayload
from contract.feature_set import ClickedPixel, Measured
from contract.wire.byte_cursor import ByteCursor
from contract.wire.covariance_code import sigma_code, sigma_from_code

NO_PIXEL = b"\0"
_WORD = struct.Struct("<B")  # 0: no clicked pixel, else 1 more than the word's code
_PIXEL = struct.Struct("<ff")
_DEPTH = struct.Struct("<fH")
_WORDS = tuple(Measured)


def encode_clicked(clicked: ClickedPixel, camera: Camera) -> bytes:
    """Raises ValueError."""
    if not camera.contains((clicked.u_px, clicked.v_px)):
        raise ValueError(f"the clicked pixel {clicked.u_px!r}, {clicked.v_px!r} is off the picture")
    out = _WORD.pack(clicked.measured.code + 1) + _PIXEL.pack(clicked.u_px, clicked.v_px)
    if not clicked.is_measured:
        return out
    if not (math.isfinite(clicked.inverse_depth_per_m) and 1e-9 < clicked.inverse_depth_per_m < 1e3):
        raise ValueError(f"the clicked pixel's inverse depth must be positive, not {clicked.inverse_depth_per_m!r}")
    return out + _DEPTH.pack(clicked.inverse_depth_per_m, sigma_code(clicked.sigma_per_m, "the clicked pixel's sigma"))


def decode_clicked(cursor: ByteCursor, camera: Camera) -> ClickedPixel | None:
    """Inverse of `encode_clicked`; None where there is no clicked pixel.

    Raises CorruptPayload, NewerPayload for a reason that this program does not know.
    """
    (word,) = cursor.unpack(_WORD)
    if not word:
        return None
    if word > len(_WORDS):
        raise NewerPayload(f"payload states {word} of a clicked pixel, this program knows {len(_WORDS)}: update it")
    u_px, v_px = cursor.unpack(_PIXEL)
    if not (math.isfinite(u_px) and math.isfinite(v_px) and camera.contains((u_px, v_px))):
        raise CorruptPayload("the clicked pixel is off the picture")
    measured = _WORDS[word - 1]
    if measured is not Measured.MEASURED:
        return ClickedPixel(u_px, v_px, measured)
    inverse_depth_per_m, sigma = cursor.unpack(_DEPTH)
    sigma_per_m = sigma_from_code(sigma)
    if not (1e-9 < inverse_depth_per_m < 1e3 and sigma_per_m > 0.0):
        raise CorruptPayload("the clicked pixel has no usable inverse depth")
    return ClickedPixel(u_px, v_px, measured, inverse_depth_per_m, sigma_per_m)
