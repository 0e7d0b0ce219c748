"""Pixel formats of cameras -> grey (H, W) uint8. What cannot be decoded is None: a bad picture is no failure."""

from __future__ import annotations

import io
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

Grey = NDArray[np.uint8]

# Pillow raises these for data that is not, or is no longer, a picture (SyntaxError: a PNG with a broken chunk).
UNDECODABLE = (OSError, ValueError, SyntaxError, EOFError, Image.DecompressionBombError)

# Sixteen-bit pictures: the darkest and brightest hundredth may saturate, and so many counts at least fill the grey
# scale. A thermal camera of 14 bits uses a few hundred of its 16384 counts for a landscape; below 256 counts of span
# nothing is gained by spreading them further, only noise.
SATURATED_PERCENT = 1.0
LEAST_SPAN_COUNTS = 255.0
_SAMPLE_STEP = 4
_COUNTS = np.arange(65536, dtype=np.float32)


def reduce_16_bit(deep: NDArray[np.uint16]) -> Grey:
    """Counts (H, W) -> grey, the picture's own range spread over the grey scale.

    By itself and without memory: the same picture always gives the same grey. What brightness it lands on does not
    matter, the tracker normalises contrast locally.
    """
    sample = deep[::_SAMPLE_STEP, ::_SAMPLE_STEP]
    low, high = np.percentile(sample, [SATURATED_PERCENT, 100.0 - SATURATED_PERCENT])
    missing = max(0.0, LEAST_SPAN_COUNTS - (high - low))
    low, high = low - missing / 2.0, high + missing / 2.0
    table = np.rint((_COUNTS - np.float32(low)) * np.float32(255.0 / (high - low))).clip(0.0, 255.0).astype(np.uint8)
    grey: Grey = table[deep]
    return grey


def _lines(data: bytearray, size_px: tuple[int, int], line_bytes: int, used_bytes: int) -> Grey | None:
    """The first `used_bytes` of every line, (H, used_bytes); None if the buffer is too short for that."""
    _, height = size_px
    stride = max(line_bytes, used_bytes)
    if len(data) < stride * (height - 1) + used_bytes:
        return None
    flat = np.frombuffer(data, np.uint8)
    return np.lib.stride_tricks.as_strided(flat, (height, used_bytes), (stride, 1))


def _grey8(data: bytearray, size_px: tuple[int, int], line_bytes: int) -> Grey | None:
    """GREY, and NV12, whose first plane is luma."""
    return _lines(data, size_px, line_bytes, size_px[0])


_CROSS = np.array([[0, 0.25, 0], [0.25, 0, 0.25], [0, 0.25, 0]], np.float32)


def _bayer(first_is_green: bool) -> Callable[[bytearray, tuple[int, int], int], Grey | None]:
    """Raw colours of 8 bits: green as it is, and the mean of the four greens around a red or blue pixel."""

    def decode(data: bytearray, size_px: tuple[int, int], line_bytes: int) -> Grey | None:
        lines = _grey8(data, size_px, line_bytes)
        if lines is None:
            return None
        raw = np.ascontiguousarray(lines)
        around = np.asarray(cv2.filter2D(raw, -1, _CROSS, borderType=cv2.BORDER_REFLECT_101), np.uint8)
        grey = raw.copy()
        column = int(first_is_green)  # of the first pixel of the first row that is not green
        grey[0::2, column::2] = around[0::2, column::2]
        grey[1::2, 1 - column :: 2] = around[1::2, 1 - column :: 2]
        return grey

    return decode


def _uyvy(data: bytearray, size_px: tuple[int, int], line_bytes: int) -> Grey | None:
    lines = _lines(data, size_px, line_bytes, 2 * size_px[0])
    return None if lines is None else lines[:, 1::2]


def _yuyv(data: bytearray, size_px: tuple[int, int], line_bytes: int) -> Grey | None:
    lines = _lines(data, size_px, line_bytes, 2 * size_px[0])
    return None if lines is None else lines[:, ::2]


def _yu12(data: bytearray, size_px: tuple[int, int], line_bytes: int) -> Grey | None:
    """Planes one after the other: luma, then two of a quarter of its pixels with half its stride."""
    width, height = size_px
    stride = max(line_bytes, width)
    if len(data) < stride * height + 2 * (stride // 2) * (height // 2) - (stride - width):
        return None
    return _grey8(data, size_px, line_bytes)


def _nv12(data: bytearray, size_px: tuple[int, int], line_bytes: int) -> Grey | None:
    width, height = size_px
    if len(data) < max(line_bytes, width) * height * 3 // 2 - max(line_bytes - width, 0):
        return None  # cut off within the colour: what came before it may be of two pictures
    return _grey8(data, size_px, line_bytes)


def _words(data: bytearray, size_px: tuple[int, int], line_bytes: int) -> NDArray[np.uint16] | None:
    lines = _lines(data, size_px, line_bytes, 2 * size_px[0])
    return None if lines is None else np.ascontiguousarray(lines).view("<u2")


def _y16(data: bytearray, size_px: tuple[int, int], line_bytes: int) -> Grey | None:
    words = _words(data, size_px, line_bytes)
    return None if words is None else reduce_16_bit(words)


def _mjpg(data: bytearray, size_px: tuple[int, int], line_bytes: int) -> Grey | None:
    try:
        with Image.open(io.BytesIO(data), formats=["JPEG"]) as image:
            if image.size != size_px:
                return None
            image.draft("L", image.size)
            return np.array(image.convert("L"), np.uint8)
    except UNDECODABLE:
        return None


DECODERS: dict[str, Callable[[bytearray, tuple[int, int], int], Grey | None]] = {
    "GREY": _grey8,
    "YUYV": _yuyv,
    "NV12": _nv12,
    "MJPG": _mjpg,
    "Y16": _y16,
    "UYVY": _uyvy,
    "YU12": _yu12,
    "Y10": _y16,
    "Y12": _y16,
    "GRBG": _bayer(first_is_green=True),
    "GBRG": _bayer(first_is_green=True),
    "RGGB": _bayer(first_is_green=False),
    "BA81": _bayer(first_is_green=False),
}
"""Formats we can read, the cheapest and truest first."""
DEEP = ("Y16", "Y12", "Y10")
"""The formats with sixteen bits a pixel, the best of a thermal camera first."""


def to_grey(fourcc: str, data: bytearray, size_px: tuple[int, int], line_bytes: int) -> Grey | None:
    """Decode a buffer (lines of `line_bytes`, 0: no padding) -> a new contiguous (H, W); None if it is incomplete."""
    grey = DECODERS[fourcc](data, size_px, line_bytes)
    return None if grey is None else np.ascontiguousarray(grey)


def to_raw(fourcc: str, data: bytearray, size_px: tuple[int, int], line_bytes: int) -> Grey | NDArray[np.uint16] | None:
    """Return the picture as `to_grey` does, but formats of sixteen bits a pixel as they are, uint16."""
    if fourcc in DEEP:
        return _words(data, size_px, line_bytes)
    return to_grey(fourcc, data, size_px, line_bytes)
