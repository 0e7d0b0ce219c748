"""The sixteen bit counts of a thermal camera's R-JPEG, whose picture for people is a palette over a part of them.

DJI writes them as they are, least byte first, into the APP3 segments, without their size; FLIR as a record of an FFF
file, which lies in APP1 segments, plain or as a PNG, some with the bytes of each count the wrong way round: counts of
ground are smooth one way only. Sources: ExifTool's tables (DJI.pm, FLIR.pm), and pictures of a Zenmuse H20T and XT R,
a FLIR AX8, E40 and SC660.
"""

from __future__ import annotations

import io
import math
import struct

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image

Counts = NDArray[np.uint16]
Size = tuple[int, int]

DJI, FLIR = "DJI R-JPEG", "FLIR R-JPEG"
FLIR_MARK, FLIR_HEAD = b"FLIR\0\1", 8  # of an APP1 segment: the mark, its number, the last one's number
FFF_MARK, FFF_VERSIONS = b"FFF\0", range(100, 200)  # the version states the byte order as well
RECORD_BYTES, RAW_RECORD, RAW_HEAD, RAW_MARK = 32, 1, 32, 2
PNG_MARK = b"\x89PNG"
SHEARED = 1.25  # times as large a step from row to row as by the right width, at least


def radiometric(image: Image.Image) -> tuple[str, Size] | None:
    """Return the kind of R-JPEG and its counts' size (width, height); None for any other picture.

    Raises ValueError where it is one whose counts cannot be read.
    """
    if (record := _flir_record(image)) is not None:
        return FLIR, _flir_size(record)[0]
    if (counts := _dji_counts(image)) is not None:
        return DJI, _dji_size(image, counts)
    return None


def counts_of(image: Image.Image) -> Counts | None:
    """Return an R-JPEG's counts (H, W); None for any other picture.

    Raises ValueError where it is one whose counts cannot be read.
    """
    if (record := _flir_record(image)) is not None:
        return _flir_counts(record)
    if (data := _dji_counts(image)) is not None:
        width, height = _dji_size(image, data)
        return np.frombuffer(data, "<u2").reshape(height, width).astype(np.uint16)
    return None


def _segments(image: Image.Image, name: str) -> list[bytes]:
    return [bytes(data) for marker, data in getattr(image, "applist", []) if marker == name]


def _dji_counts(image: Image.Image) -> bytes | None:
    """The content of a DJI picture's APP3 segments; None without any."""
    if str(image.getexif().get(ExifTags.Base.Make, "")).strip("\0 ").upper() != "DJI":
        return None
    return b"".join(_segments(image, "APP3")) or None


def _dji_size(image: Image.Image, data: bytes) -> Size:
    """The size of counts: the picture's, which may have been enlarged by a whole number."""
    pixels = len(data) // 2
    enlarged = math.isqrt(image.width * image.height // max(pixels, 1))
    width, height = image.width // max(enlarged, 1), image.height // max(enlarged, 1)
    if enlarged < 1 or width * height != pixels:
        raise ValueError(f"its {pixels} thermal counts are no picture of {image.width} x {image.height}")
    counts = np.frombuffer(data, "<u2", pixels).astype(np.int32)
    if _step_down(counts, width) > SHEARED * _step_down(counts, height):
        raise ValueError(f"its thermal counts are {height} x {width}: the picture was turned, and they were not")
    return width, height


def _step_down(counts: NDArray[np.int32], width: int) -> float:
    """The mean step from a pixel to the one below it in rows so wide: by another width they have nothing in common."""
    return float(np.abs(counts[width:] - counts[:-width]).mean())


def _flir_record(image: Image.Image) -> bytes | None:
    """The FFF file's record of raw counts; None without any."""
    parts = {data[6]: data for data in _segments(image, "APP1") if data[:6] == FLIR_MARK and len(data) > FLIR_HEAD}
    if not parts:
        return None
    last = max(data[7] for data in parts.values())
    if sorted(parts) != list(range(last + 1)):
        raise ValueError(f"{len(parts)} of {last + 1} parts of its thermal counts are there")
    fff = b"".join(parts[number][FLIR_HEAD:] for number in range(last + 1))
    try:
        return _raw_record(fff)
    except struct.error as error:
        raise ValueError("its thermal counts are cut off") from error


def _raw_record(fff: bytes) -> bytes | None:
    order = next((o for o in "><" if struct.unpack_from(f"{o}I", fff, 20)[0] in FFF_VERSIONS), None)
    if fff[:4] != FFF_MARK or order is None:
        raise ValueError("its thermal counts are of an unknown form")
    directory, count = struct.unpack_from(f"{order}II", fff, 24)
    for number in range(min(count, len(fff) // RECORD_BYTES)):
        at = directory + number * RECORD_BYTES
        kind, begin, length = struct.unpack_from(f"{order}H10xII", fff, at)
        if kind == RAW_RECORD:
            if begin + length > len(fff):
                raise ValueError("its thermal counts are cut off")
            return fff[begin : begin + length]
    return None


def _flir_size(record: bytes) -> tuple[Size, str]:
    """The size that a record of raw counts states, and its byte order."""
    for order in "<>":
        if len(record) > RAW_HEAD and struct.unpack_from(f"{order}H", record)[0] == RAW_MARK:
            width, height = struct.unpack_from(f"{order}HH", record, 2)
            if min(width, height) > 1:
                return (width, height), order
    raise ValueError("its thermal counts are of an unknown form")


def _flir_counts(record: bytes) -> Counts:
    (width, height), order = _flir_size(record)
    data = record[RAW_HEAD:]
    if data[:4] == PNG_MARK:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as png:
            if png.size != (width, height) or not png.mode.startswith("I"):
                raise ValueError("its thermal counts are of an unknown form")
            counts = np.asarray(png).astype(np.uint16)
    elif len(data) >= 2 * width * height:
        counts = np.frombuffer(data, f"{order}u2", width * height).reshape(height, width).astype(np.uint16)
    else:
        raise ValueError("its thermal counts are cut off, or packed in an unknown way")
    return min(counts, counts.byteswap(), key=_roughness)


def _roughness(counts: Counts) -> float:
    """The mean step from a pixel to the next in its row: with bytes the wrong way round the least counts most."""
    return float(np.abs(np.diff(counts.astype(np.int32), axis=1)).mean())
