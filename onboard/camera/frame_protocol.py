"""Frames in a pipe: what a helper program writes and the daemon reads. docs/own-camera.md has it as a table.

A frame is a header of 128 bytes, the luma, and a trailer of 8 bytes; all numbers little-endian. The header has a
checksum and the trailer repeats the sequence number, so that a reader finds the next frame after whatever is none, and
never takes the beginning of one picture with the end of another for a picture. No process, no clock.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

MAGIC, END = b"PCFR", b"PCFE"
VERSION = 1
HEADER_BYTES, TRAILER_BYTES = 128, 8
MAX_SIDE_PX = 16384
MAX_PAYLOAD_BYTES = 64 << 20
MAX_EXPOSURE_S = 10.0
MAX_HEADER_BYTES = 1024  # a later version may add fields behind ours

_FIELDS = struct.Struct("<4sHHIII4sIIqqQBBBB4f4f32x")
_CHECKSUM = struct.Struct("<I")
_TRAILER = struct.Struct("<4sI")
_ROW_BYTES = {"GREY": 1, "Y10": 2, "Y12": 2, "Y16": 2}

NAN = float("nan")


class Clock(IntEnum):
    """The clock that a stamp counts on."""

    MONOTONIC = 0  # CLOCK_MONOTONIC of this computer
    SENDER = 1  # the sender's own: any origin, and a rate of nearly one second a second
    SENDER_UTC = 2  # the sender's idea of Unix time


class Moment(IntEnum):
    """The moment of the exposure that a stamp states."""

    UNKNOWN = 0
    FIRST_ROW_START = 1
    FIRST_ROW_END = 2  # the sensor begins to send: most drivers' and libcamera's stamp on real hardware
    MIDDLE = 3  # the middle of the exposure of the middle row
    LAST_ROW_END = 4  # the last row has been read


class Origin(IntEnum):
    """The origin of a stamp, the best first."""

    UNKNOWN = 0
    SENSOR = 1  # the camera's driver
    SEI = 2  # written into the video by its sender (MISB ST 0604)
    RTCP = 3  # sender reports
    MEDIA = 4  # the time stamps of RTP or of a container
    ARRIVAL = 5  # when it came


class GimbalFrame(IntEnum):
    """The frame that a gimbal's attitude refers to."""

    NONE = 0
    VEHICLE = 1
    EARTH = 2


@dataclass(frozen=True)
class Header:
    """The header of a picture: what is known of it. `arrival_ns` 0, and NaN elsewhere: not known.

    `stamp_ns` counts on `clock`; `arrival_ns`, when the picture came to this computer, on CLOCK_MONOTONIC always.
    `sigma_s`: one sigma of the stamp. `focal_px`: at the picture's size. `gimbal`: quaternion w, x, y, z of
    R_ref_gimbal.
    """

    width_px: int
    height_px: int
    stamp_ns: int
    sequence: int
    stride_bytes: int = 0  # 0: no padding
    fourcc: str = "GREY"
    arrival_ns: int = 0
    clock: Clock = Clock.MONOTONIC
    moment: Moment = Moment.UNKNOWN
    origin: Origin = Origin.UNKNOWN
    is_damaged: bool = False
    exposure_s: float = NAN
    sigma_s: float = NAN
    zoom: float = NAN
    focal_px: float = NAN
    gimbal: tuple[float, float, float, float] = (NAN, NAN, NAN, NAN)
    gimbal_frame: GimbalFrame = GimbalFrame.NONE

    @property
    def line_bytes(self) -> int:
        """The bytes from the beginning of one row to that of the next."""
        return self.stride_bytes or self.width_px * _ROW_BYTES[self.fourcc]

    @property
    def payload_bytes(self) -> int:
        """The bytes of luma that follow: whole rows, the last with its padding."""
        return self.line_bytes * self.height_px


class NoFrameError(ValueError):
    """These bytes are no frame; the text states why."""


def encode(header: Header, luma: bytes | bytearray | memoryview) -> bytes:
    """A frame as bytes; raises ValueError where luma and header do not fit each other."""
    if len(luma) != header.payload_bytes:
        raise ValueError(f"{len(luma)} bytes of luma; {header.payload_bytes} by the header")
    h = header
    fields = _FIELDS.pack(
        MAGIC, VERSION, HEADER_BYTES, h.width_px, h.height_px, h.line_bytes, h.fourcc.ljust(4).encode("ascii"),
        h.payload_bytes, int(h.is_damaged), h.stamp_ns, h.arrival_ns, h.sequence, h.clock, h.moment, h.origin,
        h.gimbal_frame, h.exposure_s, h.sigma_s, h.zoom, h.focal_px, *h.gimbal,
    )  # fmt: skip
    return b"".join([fields, _CHECKSUM.pack(zlib.crc32(fields)), luma, _TRAILER.pack(END, h.sequence & 0xFFFFFFFF)])


def decode_header(data: bytes) -> tuple[Header, int]:
    """The header at the start of some bytes (at least 128), and its length; raises NoFrameError."""
    fields = data[: _FIELDS.size]
    if _CHECKSUM.unpack_from(data, _FIELDS.size)[0] != zlib.crc32(fields):
        raise NoFrameError("checksum")
    (
        magic, version, length, width, height, stride, fourcc, payload, flags, stamp, arrival, sequence, clock, moment,
        origin, frame, exposure, sigma, zoom, focal, *gimbal,
    ) = _FIELDS.unpack(fields)  # fmt: skip
    if magic != MAGIC or version != VERSION or not HEADER_BYTES <= length <= MAX_HEADER_BYTES:
        raise NoFrameError(f"version {version}; this program reads version {VERSION}")
    name = fourcc.decode("ascii", "replace").strip()
    if name not in _ROW_BYTES:
        raise NoFrameError(f"format {name!r}; it is one of {', '.join(_ROW_BYTES)}")
    if not (0 < width <= MAX_SIDE_PX and 0 < height <= MAX_SIDE_PX and stride >= width * _ROW_BYTES[name]):
        raise NoFrameError(f"size {width}x{height}, {stride} bytes a row")
    if payload != stride * height or payload > MAX_PAYLOAD_BYTES:
        raise NoFrameError(f"{payload} bytes of luma for {height} rows of {stride}")
    try:
        kinds = Clock(clock), Moment(moment), Origin(origin), GimbalFrame(frame)
    except ValueError as error:
        raise NoFrameError(str(error)) from error
    header = Header(
        width, height, stamp, sequence, stride, name, arrival, *kinds[:3], bool(flags & 1), exposure, sigma, zoom,
        focal, (gimbal[0], gimbal[1], gimbal[2], gimbal[3]), kinds[3],
    )  # fmt: skip
    return header, length


class FrameReader:
    """Bytes as they come -> frames; what is none is skipped and counted.

    It holds one frame at most (64 MB), whatever comes.
    """

    def __init__(self) -> None:
        self.skipped_bytes = 0
        self.complaint = ""  # why the newest header, whole and with the right checksum, was refused
        self._held = bytearray()
        self._ahead: tuple[Header, int] | None = None  # the header that the held bytes begin with

    def feed(self, data: bytes | memoryview) -> Iterator[tuple[Header, bytearray]]:
        """Take some bytes; hands out each frame that is whole by now, its luma with its padding."""
        self._held += data
        while True:
            if self._ahead is None and not self._find():
                return
            assert self._ahead is not None
            header, length = self._ahead
            end = length + header.payload_bytes
            if len(self._held) < end + TRAILER_BYTES:
                return
            self._ahead = None
            if _TRAILER.unpack_from(self._held, end) != (END, header.sequence & 0xFFFFFFFF):
                self._skip(len(MAGIC))  # the next frame may begin within what was taken for this one
                continue
            luma = self._held[length:end]
            del self._held[: end + TRAILER_BYTES]
            yield header, luma

    def _find(self) -> bool:
        """Put the next header at the front; False while none has come."""
        while True:
            at = self._held.find(MAGIC)
            if at < 0:
                self._skip(max(len(self._held) - len(MAGIC) + 1, 0))
                return False
            self._skip(at)
            if len(self._held) < HEADER_BYTES:
                return False
            try:
                self._ahead = decode_header(bytes(self._held[:HEADER_BYTES]))
            except NoFrameError as error:
                if str(error) != "checksum":
                    self.complaint = str(error)
                self._skip(len(MAGIC))
            else:
                return True

    def _skip(self, count: int) -> None:
        self.skipped_bytes += count
        del self._held[:count]


def middle_ns(header: Header, readout_s: float) -> int:
    """Return the time from a stamp to the middle of the middle row's exposure, ns. `readout_s`: of all rows, positive.

    An exposure that is not known counts as 0: its half is part of the time offset that is estimated in flight.
    """
    exposure_s = header.exposure_s if 0.0 <= header.exposure_s <= MAX_EXPOSURE_S else 0.0  # NaN is neither
    to_middle_s = {
        Moment.FIRST_ROW_START: 0.5 * (readout_s + exposure_s),
        Moment.FIRST_ROW_END: 0.5 * (readout_s - exposure_s),
        Moment.LAST_ROW_END: -0.5 * (readout_s + exposure_s),
    }
    return round(1e9 * to_middle_s.get(header.moment, 0.0))
