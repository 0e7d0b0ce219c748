"""The other end of a camera: writes pictures with stamps of our own into a v4l2loopback device; and a plain reader.

Buffers are mapped and queued (VIDIOC_QBUF) rather than written: only so does the driver keep the stamp it is given, as
a camera's driver would set it.
"""

import ctypes
import fcntl
import mmap
import os
import select
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from onboard.camera import v4l2_structures as v4l2

BUFFERS = 4
COMPRESSED = {"MJPG", "H264"}


class _Stream:
    """A device opened, its format set and its buffers mapped; streams from `__enter__` to `__exit__`."""

    def __init__(self, device: str, kind: int, fourcc: str, width_px: int, height_px: int, rate_hz: int) -> None:
        """Raises OSError where the device refuses, ValueError where it chose another format than asked."""
        self._kind = kind
        self._fd = os.open(device, os.O_RDWR)
        wanted = int.from_bytes(fourcc.encode(), "little")
        chosen = v4l2.Format(type=kind)
        # Compressed pictures have no size of their own: room for an incompressible one, with its tables.
        room = width_px * height_px * 2 + 4096 if fourcc in COMPRESSED else 0
        chosen.fmt.pix = v4l2.PixFormat(
            width=width_px,
            height=height_px,
            pixelformat=wanted,
            field=v4l2.FIELD_NONE,
            sizeimage=room,
            colorspace=v4l2.COLORSPACE_SRGB,
        )
        fcntl.ioctl(self._fd, v4l2.S_FMT, chosen)
        pix = chosen.fmt.pix
        if (pix.width, pix.height, pix.pixelformat) != (width_px, height_px, wanted):
            raise ValueError(f"{device} chose {pix.width}x{pix.height} {pix.pixelformat:#x} for {fourcc}")
        rate = v4l2.Streamparm(type=kind)
        rate.parm.capture.timeperframe = v4l2.Fract(1, rate_hz)  # at the same place for output devices
        fcntl.ioctl(self._fd, v4l2.S_PARM, rate)
        request = v4l2.Requestbuffers(count=BUFFERS, type=kind, memory=v4l2.MEMORY_MMAP)
        fcntl.ioctl(self._fd, v4l2.REQBUFS, request)
        self._maps = []
        for index in range(request.count):
            buffer = v4l2.Buffer(index=index, type=kind, memory=v4l2.MEMORY_MMAP)
            fcntl.ioctl(self._fd, v4l2.QUERYBUF, buffer)
            self._maps.append(mmap.mmap(self._fd, buffer.length, offset=buffer.m.offset))

    def __enter__(self) -> Self:
        fcntl.ioctl(self._fd, v4l2.STREAMON, ctypes.c_int(self._kind))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for mapped in self._maps:
            mapped.close()
        os.close(self._fd)

    def _dequeue(self) -> v4l2.Buffer:
        buffer = v4l2.Buffer(type=self._kind, memory=v4l2.MEMORY_MMAP)
        fcntl.ioctl(self._fd, v4l2.DQBUF, buffer)
        return buffer


class Output(_Stream):
    """A loopback device opened for writing."""

    def __init__(self, device: str, fourcc: str, width_px: int, height_px: int, rate_hz: int) -> None:
        """As `_Stream`."""
        super().__init__(device, v4l2.BUF_TYPE_VIDEO_OUTPUT, fourcc, width_px, height_px, rate_hz)
        self._unused = list(range(len(self._maps)))

    def put(self, picture: bytes, stamp_ns: int) -> None:
        """Hand over one picture; the driver passes its stamp on, to the microsecond."""
        index = self._unused.pop() if self._unused else self._dequeue().index
        self._maps[index][: len(picture)] = picture
        seconds, rest_ns = divmod(stamp_ns, 10**9)
        buffer = v4l2.Buffer(
            index=index,
            type=v4l2.BUF_TYPE_VIDEO_OUTPUT,
            memory=v4l2.MEMORY_MMAP,
            field=v4l2.FIELD_NONE,
            flags=v4l2.BUF_FLAG_TIMESTAMP_COPY,
            bytesused=len(picture),
            timestamp=v4l2.Timeval(seconds, rest_ns // 1000),
        )
        fcntl.ioctl(self._fd, v4l2.QBUF, buffer)


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
        super().__init__(device, v4l2.BUF_TYPE_VIDEO_CAPTURE, fourcc, width_px, height_px, rate_hz)
        for index in range(len(self._maps)):
            fcntl.ioctl(
                self._fd, v4l2.QBUF, v4l2.Buffer(index=index, type=v4l2.BUF_TYPE_VIDEO_CAPTURE, memory=v4l2.MEMORY_MMAP)
            )

    def take(self, timeout_s: float) -> Picture:
        """The next picture; TimeoutError when none comes."""
        if not select.select([self._fd], [], [], timeout_s)[0]:
            raise TimeoutError(f"no picture within {timeout_s} s")
        buffer = self._dequeue()
        raw = self._maps[buffer.index][: buffer.bytesused]
        fcntl.ioctl(
            self._fd,
            v4l2.QBUF,
            v4l2.Buffer(index=buffer.index, type=v4l2.BUF_TYPE_VIDEO_CAPTURE, memory=v4l2.MEMORY_MMAP),
        )
        return Picture(raw, buffer.timestamp.tv_sec * 10**9 + buffer.timestamp.tv_usec * 1000, buffer.sequence)
