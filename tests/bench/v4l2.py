"""The other end of a camera: writes pictures with stamps of our own into a v4l2loopback device; and a plain reader.

Buffers are mapped and queued (VIDIOC_QBUF) rather than written: only so does the driver keep the stamp it is given, as
a camera's driver would set it. Constants and structures: linux/videodev2.h, 64-bit.
"""

from __future__ import annotations

import ctypes
import fcntl
import mmap
import os
import select
from dataclasses import dataclass
from types import TracebackType
from typing import Self

CAPTURE = 1
OUTPUT = 2
"""V4L2_BUF_TYPE_VIDEO_CAPTURE, _OUTPUT"""
MMAP = 1
FIELD_NONE = 1
TIMESTAMP_COPY = 0x4000
BUFFERS = 4

_U32 = ctypes.c_uint32


class _Plane(ctypes.Structure):
    """struct v4l2_pix_format"""

    _fields_ = [
        (name, _U32)
        for name in (
            *("width", "height", "pixelformat", "field", "bytesperline", "sizeimage", "colorspace", "priv", "flags"),
            *("encoding", "quantization", "transfer"),
        )
    ]


class _FormatChoice(ctypes.Union):
    _fields_ = [("pix", _Plane), ("raw", ctypes.c_uint8 * 200), ("align", ctypes.c_uint64)]


class _Format(ctypes.Structure):
    """struct v4l2_format"""

    _fields_ = [("type", _U32), ("fmt", _FormatChoice)]


class _Request(ctypes.Structure):
    """struct v4l2_requestbuffers"""

    _fields_ = [("count", _U32), ("type", _U32), ("memory", _U32), ("capabilities", _U32), ("flags", _U32)]


class _Buffer(ctypes.Structure):
    """struct v4l2_buffer"""

    _fields_ = [
        *((name, _U32) for name in ("index", "type", "bytesused", "flags", "field")),
        ("seconds", ctypes.c_int64),
        ("microseconds", ctypes.c_int64),
        ("timecode", _U32 * 4),
        ("sequence", _U32),
        ("memory", _U32),
        ("offset", ctypes.c_uint64),
        ("length", _U32),
        ("reserved2", _U32),
        ("request_fd", _U32),
    ]


class _Rate(ctypes.Structure):
    """struct v4l2_streamparm, its output half"""

    _fields_ = [
        *((name, _U32) for name in ("type", "capability", "mode", "numerator", "denominator", "extended", "buffers")),
        ("reserved", _U32 * 44),
    ]


def _request_number(direction: int, number: int, kind: type[ctypes.Structure]) -> int:
    return direction << 30 | ctypes.sizeof(kind) << 16 | ord("V") << 8 | number


_S_FMT = _request_number(3, 5, _Format)
_REQBUFS = _request_number(3, 8, _Request)
_QUERYBUF = _request_number(3, 9, _Buffer)
_QBUF = _request_number(3, 15, _Buffer)
_DQBUF = _request_number(3, 17, _Buffer)
_STREAMON = 1 << 30 | 4 << 16 | ord("V") << 8 | 18
_S_PARM = _request_number(3, 22, _Rate)


class _Stream:
    """A device opened, its format set and its buffers mapped; streams from `__enter__` to `__exit__`."""

    def __init__(self, device: str, kind: int, fourcc: str, width_px: int, height_px: int, rate_hz: int) -> None:
        """Raises OSError where the device refuses, ValueError where it chose another format than asked."""
        self._kind = kind
        self._fd = os.open(device, os.O_RDWR)
        wanted = int.from_bytes(fourcc.encode(), "little")
        chosen = _Format(type=kind)
        # Compressed pictures have no size of their own: room for an incompressible one, with its tables.
        room = width_px * height_px * 2 + 4096 if fourcc == "MJPG" else 0
        chosen.fmt.pix = _Plane(
            width=width_px, height=height_px, pixelformat=wanted, field=FIELD_NONE, sizeimage=room, colorspace=8
        )
        fcntl.ioctl(self._fd, _S_FMT, chosen)
        pix = chosen.fmt.pix
        if (pix.width, pix.height, pix.pixelformat) != (width_px, height_px, wanted):
            raise ValueError(f"{device} chose {pix.width}x{pix.height} {pix.pixelformat:#x} for {fourcc}")
        fcntl.ioctl(self._fd, _S_PARM, _Rate(type=kind, numerator=1, denominator=rate_hz))
        request = _Request(count=BUFFERS, type=kind, memory=MMAP)
        fcntl.ioctl(self._fd, _REQBUFS, request)
        self._maps = []
        for index in range(request.count):
            buffer = _Buffer(index=index, type=kind, memory=MMAP)
            fcntl.ioctl(self._fd, _QUERYBUF, buffer)
            self._maps.append(mmap.mmap(self._fd, buffer.length, offset=buffer.offset))

    def __enter__(self) -> Self:
        fcntl.ioctl(self._fd, _STREAMON, ctypes.c_int(self._kind))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for mapped in self._maps:
            mapped.close()
        os.close(self._fd)

    def _dequeue(self) -> _Buffer:
        buffer = _Buffer(type=self._kind, memory=MMAP)
        fcntl.ioctl(self._fd, _DQBUF, buffer)
        return buffer


class Output(_Stream):
    """A loopback device opened for writing."""

    def __init__(self, device: str, fourcc: str, width_px: int, height_px: int, rate_hz: int) -> None:
        """As `_Stream`."""
        super().__init__(device, OUTPUT, fourcc, width_px, height_px, rate_hz)
        self._unused = list(range(len(self._maps)))

    def put(self, picture: bytes, stamp_ns: int) -> None:
        """Hand over one picture; the driver passes its stamp on, to the microsecond."""
        index = self._unused.pop() if self._unused else self._dequeue().index
        self._maps[index][: len(picture)] = picture
        seconds, rest_ns = divmod(stamp_ns, 10**9)
        buffer = _Buffer(
            index=index,
            type=OUTPUT,
            memory=MMAP,
            field=FIELD_NONE,
            flags=TIMESTAMP_COPY,
            bytesused=len(picture),
            seconds=seconds,
            microseconds=rest_ns // 1000,
        )
        fcntl.ioctl(self._fd, _QBUF, buffer)


@dataclass(frozen=True)
class Picture:
    """What a capture device hands out."""

    raw: bytes
    stamp_ns: int
    sequence: int


class Capture(_Stream):
    """A device opened for reading, with nothing between the test and the driver."""

    def __init__(self, device: str, fourcc: str, width_px: int, height_px: int, rate_hz: int) -> None:
        """As `_Stream`."""
        super().__init__(device, CAPTURE, fourcc, width_px, height_px, rate_hz)
        for index in range(len(self._maps)):
            fcntl.ioctl(self._fd, _QBUF, _Buffer(index=index, type=CAPTURE, memory=MMAP))

    def take(self, timeout_s: float) -> Picture:
        """The next picture; TimeoutError when none comes."""
        if not select.select([self._fd], [], [], timeout_s)[0]:
            raise TimeoutError(f"no picture within {timeout_s} s")
        buffer = self._dequeue()
        raw = self._maps[buffer.index][: buffer.bytesused]
        fcntl.ioctl(self._fd, _QBUF, _Buffer(index=buffer.index, type=CAPTURE, memory=MMAP))
        return Picture(raw, buffer.seconds * 10**9 + buffer.microseconds * 1000, buffer.sequence)
