"""R-JPEGs as DJI's and FLIR's thermal cameras write them, of given counts."""

import io
import struct
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image

Counts = NDArray[np.uint16]
Segment = tuple[int, bytes]  # an APP segment's number and content

MOST_BYTES = 65532
RECORDS_AT, RAW_AT = 64, 128  # in the FFF file


def shown(counts: Counts) -> NDArray[np.uint8]:
    """The picture for people (H, W, 3): black hot, in colours, and saturated beyond the middle nine tenths."""
    low, high = np.percentile(counts, (5.0, 95.0))
    grey = np.clip(255.0 * (high - counts) / max(high - low, 1.0), 0.0, 255.0).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(grey, cv2.COLORMAP_INFERNO), np.uint8)


def dji_segments(counts: Counts) -> list[Segment]:
    data = counts.astype("<u2").tobytes()
    return [(3, data[at : at + MOST_BYTES]) for at in range(0, len(data), MOST_BYTES)]


def flir_segments(counts: Counts, form: str = "png, bytes swapped", order: str = ">") -> list[Segment]:
    """The FFF file of a camera, cut into segments. `form`: of the counts; `order`: of the file's own numbers."""
    height, width = counts.shape
    if form.startswith("png"):
        png = io.BytesIO()
        Image.fromarray(counts.byteswap() if form.endswith("swapped") else counts).save(png, "PNG")
        pixels = png.getvalue()
    else:
        pixels = counts.astype("<u2" if form == "plain, least byte first" else ">u2").tobytes()
    record = struct.pack("<HHH26x", 2, width, height) + pixels
    other = struct.pack(f"{order}HHIIII12x", 0x20, 1, 100, 1, RAW_AT + len(record), 16)
    raw = struct.pack(f"{order}HHIIII12x", 1, 3, 100, 2, RAW_AT, len(record))
    head = struct.pack(f"{order}4s16sIII32x", b"FFF\0", b"TESTS", 101, RECORDS_AT, 2)
    fff = head + other + raw + record + bytes(16)
    parts = [fff[at : at + MOST_BYTES - 8] for at in range(0, len(fff), MOST_BYTES - 8)]
    return [(1, b"FLIR\0\1" + bytes([number, len(parts) - 1]) + part) for number, part in enumerate(parts)]


def with_segments(jpeg: bytes, segments: list[Segment]) -> bytes:
    """A JPEG with more APP segments, before its others."""
    added = (struct.pack(">HH", 0xFFE0 + number, len(data) + 2) + data for number, data in segments)
    return jpeg[:2] + b"".join(added) + jpeg[2:]


def write_radiometric(path: Path, counts: Counts, segments: list[Segment], make: str, enlarged: int = 1) -> None:
    """An R-JPEG whose picture for people is so many times as large as its counts."""
    exif, jpeg = Image.Exif(), io.BytesIO()
    exif[ExifTags.Base.Make] = make
    picture = Image.fromarray(shown(counts)[:, :, ::-1].copy())
    picture.resize((picture.width * enlarged, picture.height * enlarged)).save(jpeg, "JPEG", exif=exif)
    path.write_bytes(with_segments(jpeg.getvalue(), segments))


def make_radiometric(photograph: Path) -> None:
    """Make an R-JPEG of a grey photograph, in place, with all that it states: counts rise with its brightness."""
    with Image.open(photograph) as image:
        counts = (15000 + 9 * np.asarray(image.convert("L")).astype(np.uint16)).astype(np.uint16)
        exif, xmp = image.getexif(), image.info.get("xmp", b"")
    jpeg = io.BytesIO()
    Image.fromarray(shown(counts)[:, :, ::-1].copy()).save(jpeg, "JPEG", exif=exif, xmp=xmp)
    photograph.write_bytes(with_segments(jpeg.getvalue(), dji_segments(counts)))
