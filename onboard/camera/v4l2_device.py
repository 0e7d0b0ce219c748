"""A V4L2 device: the ioctls the camera needs, each as one method in plain numbers.

What a driver reports is passed on as numbers and text, never mapped to a closed list: drivers have controls, formats
and flags newer than this program. Every method raises OSError with the driver's errno; what that means is decided by
`v4l2_camera`. Structures and requests: `v4l2_structures`.

Single-plane and multi-plane drivers (the latter with one plane, as camera pipelines of many small computers have) look
the same from outside.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import mmap
import os
import select
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from contract.closing import Closing
from onboard.camera import v4l2_structures as v4l2

BUFFERS = 4
_ENDS_A_LIST = {errno.EINVAL, errno.ENOTTY, errno.ENODATA, errno.EPIPE}
_MAX_LISTED = 1024  # entries of any list: a driver that never ends one must not block us


@dataclass(frozen=True)
class Card:
    """The identity that a device reports."""

    driver: str
    card: str
    bus_info: str
    can_capture: bool


@dataclass(frozen=True)
class Sizes:
    """Picture sizes of one format, width and height: some, or all from `least_px` to `most_px` in steps."""

    discrete_px: tuple[tuple[int, int], ...] = ()
    least_px: tuple[int, int] = (0, 0)
    most_px: tuple[int, int] = (0, 0)
    step_px: tuple[int, int] = (1, 1)

    @property
    def is_known(self) -> bool:
        return bool(self.discrete_px) or self.most_px != (0, 0)

    def has(self, size_px: tuple[int, int]) -> bool:
        return size_px in self.discrete_px or all(
            low <= n <= high and (n - low) % max(step, 1) == 0
            for n, low, high, step in zip(size_px, self.least_px, self.most_px, self.step_px, strict=True)
        )


@dataclass(frozen=True)
class Granted:
    """The format that a driver granted on a request."""

    fourcc: str
    width_px: int
    height_px: int
    bytes_per_line: int
    is_progressive: bool


@dataclass(frozen=True)
class Control:
    """A control of a driver: V4L2's own number, type, range and flags."""

    id: int
    name: str
    kind: int
    minimum: int
    maximum: int
    step: int
    default: int
    flags: int
    menu: tuple[tuple[int, str], ...] = ()  # entries of a menu, or the numbers of an integer menu as text


@dataclass(frozen=True)
class Buffer:
    """A filled buffer, copied out of the driver's memory."""

    data: bytearray
    stamp_ns: int  # on the clock that `flags` specifies
    sequence: int
    flags: int
    has_waited: bool  # it was there before we came for it


class Device(Protocol):
    """The interface that the camera needs of a device; the real one is `V4l2Device`."""

    def card(self) -> Card: ...

    def formats(self) -> list[str]: ...

    def sizes(self, fourcc: str) -> Sizes: ...

    def rates_hz(self, fourcc: str, size_px: tuple[int, int]) -> list[float]: ...

    def set_format(self, fourcc: str, size_px: tuple[int, int]) -> Granted: ...

    def set_rate_hz(self, rate_hz: float) -> float | None: ...

    def controls(self) -> list[Control]: ...

    def get_control(self, control: Control) -> int: ...

    def set_control(self, control: Control, value: int) -> None: ...

    def start(self) -> None: ...

    def take(self, timeout_s: float) -> Buffer | None: ...

    def close(self) -> None: ...


class V4l2Device(Closing):
    """An open device node."""

    def __init__(self, path: str) -> None:
        """Raises OSError where it cannot be opened or is no V4L2 device, ConfigError on a system that is not 64-bit."""
        v4l2.refuse_other_layouts(path)
        self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        self._maps: list[mmap.mmap] = []
        self._is_streaming = False
        try:
            caps = v4l2.Capability()
            self._ioctl(v4l2.QUERYCAP, caps)
        except OSError:
            os.close(self._fd)
            raise
        own = caps.device_caps if caps.capabilities & v4l2.CAP_DEVICE_CAPS else caps.capabilities
        self._card = Card(
            _text(caps.driver),
            _text(caps.card),
            _text(caps.bus_info),
            bool(own & (v4l2.CAP_VIDEO_CAPTURE | v4l2.CAP_VIDEO_CAPTURE_MPLANE) and own & v4l2.CAP_STREAMING),
        )
        self._is_multiplanar = not own & v4l2.CAP_VIDEO_CAPTURE and bool(own & v4l2.CAP_VIDEO_CAPTURE_MPLANE)
        self._type = v4l2.BUF_TYPE_VIDEO_CAPTURE_MPLANE if self._is_multiplanar else v4l2.BUF_TYPE_VIDEO_CAPTURE

    def _ioctl(self, request: int, argument: Any) -> None:
        fcntl.ioctl(self._fd, request, argument)

    def _listed(self, request: int, argument: Any) -> Iterator[None]:
        for index in range(_MAX_LISTED):
            argument.index = index
            try:
                self._ioctl(request, argument)
            except OSError as error:
                if error.errno in _ENDS_A_LIST:
                    return
                raise
            yield

    def card(self) -> Card:
        return self._card

    def formats(self) -> list[str]:
        """Pixel formats, four letters each, in the driver's order."""
        entry = v4l2.Fmtdesc()
        entry.type = self._type
        return [_fourcc(entry.pixelformat) for _ in self._listed(v4l2.ENUM_FMT, entry)]

    def sizes(self, fourcc: str) -> Sizes:
        """Picture sizes of a format; unknown ones where the driver does not list them."""
        entry = v4l2.Frmsizeenum()
        entry.pixel_format = _code(fourcc)
        discrete = []
        for _ in self._listed(v4l2.ENUM_FRAMESIZES, entry):
            if entry.type != v4l2.FRMSIZE_TYPE_DISCRETE:
                s = entry.stepwise
                return Sizes(
                    (), (s.min_width, s.min_height), (s.max_width, s.max_height), (s.step_width, s.step_height)
                )
            discrete.append((int(entry.discrete.width), int(entry.discrete.height)))
        return Sizes(tuple(discrete))

    def rates_hz(self, fourcc: str, size_px: tuple[int, int]) -> list[float]:
        """Picture rates of a format and size (the ends of a range, where it is one), highest first."""
        entry = v4l2.Frmivalenum()
        entry.pixel_format = _code(fourcc)
        entry.width, entry.height = size_px
        rates = []
        for _ in self._listed(v4l2.ENUM_FRAMEINTERVALS, entry):
            if entry.type != v4l2.FRMIVAL_TYPE_DISCRETE:
                rates = [_rate_hz(entry.stepwise.min), _rate_hz(entry.stepwise.max)]
                break
            rates.append(_rate_hz(entry.discrete))
        return sorted({rate for rate in rates if rate > 0.0}, reverse=True)

    def set_format(self, fourcc: str, size_px: tuple[int, int]) -> Granted:
        """Ask for a format; returns what the driver chose, which may be another."""
        wanted = v4l2.Format()
        wanted.type = self._type
        pix = wanted.fmt.pix_mp if self._is_multiplanar else wanted.fmt.pix
        pix.width, pix.height = size_px
        pix.pixelformat = _code(fourcc)
        pix.field = v4l2.FIELD_NONE
        if self._is_multiplanar:
            pix.num_planes = 1
        self._ioctl(v4l2.S_FMT, wanted)
        line = pix.plane_fmt[0].bytesperline if self._is_multiplanar else pix.bytesperline
        progressive = pix.field in {v4l2.FIELD_NONE, v4l2.FIELD_ANY}
        return Granted(_fourcc(pix.pixelformat), int(pix.width), int(pix.height), int(line), progressive)

    def set_rate_hz(self, rate_hz: float) -> float | None:
        """Ask for a picture rate; returns the driver's choice, None where it has no such setting."""
        wanted = v4l2.Streamparm()
        wanted.type = self._type
        interval = wanted.parm.capture.timeperframe
        interval.numerator, interval.denominator = 1000, round(rate_hz * 1000)
        try:
            self._ioctl(v4l2.S_PARM, wanted)
        except OSError as error:
            if error.errno == errno.ENODEV:
                raise
            return None
        return _rate_hz(interval) or None

    def controls(self) -> list[Control]:
        """Every simple control, in the driver's order."""
        found = []
        entry = v4l2.QueryExtCtrl()
        for _ in range(_MAX_LISTED):
            entry.id |= v4l2.CTRL_FLAG_NEXT_CTRL
            try:
                self._ioctl(v4l2.QUERY_EXT_CTRL, entry)
            except OSError as error:
                if error.errno in _ENDS_A_LIST:
                    break
                raise
            found.append(
                Control(
                    int(entry.id),
                    _text(entry.name),
                    int(entry.type),
                    int(entry.minimum),
                    int(entry.maximum),
                    int(entry.step),
                    int(entry.default_value),
                    int(entry.flags),
                    self._menu(entry),
                )
            )
        return found

    def _menu(self, entry: Any) -> tuple[tuple[int, str], ...]:
        if entry.type not in {v4l2.CTRL_TYPE_MENU, v4l2.CTRL_TYPE_INTEGER_MENU}:
            return ()
        listed = []
        item = v4l2.Querymenu()
        item.id = entry.id
        for index in range(max(entry.minimum, 0), min(entry.maximum, _MAX_LISTED) + 1):
            item.index = index
            with contextlib.suppress(OSError):  # menus have holes
                self._ioctl(v4l2.QUERYMENU, item)
                is_number = entry.type == v4l2.CTRL_TYPE_INTEGER_MENU
                listed.append((index, str(item.value) if is_number else _text(item.name)))
        return tuple(listed)

    def get_control(self, control: Control) -> int:
        """A control's value."""
        if control.kind == v4l2.CTRL_TYPE_INTEGER64:
            one = v4l2.ExtControl()
            one.id = control.id
            self._extended(v4l2.G_EXT_CTRLS, one)
            return int(one.value64)
        plain = v4l2.Control()
        plain.id = control.id
        self._ioctl(v4l2.G_CTRL, plain)
        return int(plain.value)

    def set_control(self, control: Control, value: int) -> None:
        """Set a control; the driver may clamp it: read it back."""
        if control.kind == v4l2.CTRL_TYPE_INTEGER64:
            one = v4l2.ExtControl()
            one.id, one.value64 = control.id, value
            self._extended(v4l2.S_EXT_CTRLS, one)
            return
        plain = v4l2.Control()
        plain.id, plain.value = control.id, value
        self._ioctl(v4l2.S_CTRL, plain)

    def _extended(self, request: int, one: Any) -> None:
        several = v4l2.ExtControls()
        several.count = 1
        several.controls = ctypes.pointer(one)
        self._ioctl(request, several)

    def _blank(self, index: int) -> tuple[Any, Any]:
        """A buffer to ask with, and its one plane, which must be kept (None for single-plane drivers)."""
        buffer = v4l2.Buffer()
        buffer.type, buffer.memory, buffer.index = self._type, v4l2.MEMORY_MMAP, index
        plane = None
        if self._is_multiplanar:
            plane = (v4l2.Plane * v4l2.MAX_PLANES)()
            buffer.m.planes = ctypes.cast(plane, ctypes.POINTER(v4l2.Plane))
            buffer.length = v4l2.MAX_PLANES
        return buffer, plane

    def start(self) -> None:
        """Map buffers, queue them all and begin."""
        request = v4l2.Requestbuffers()
        request.count, request.type, request.memory = BUFFERS, self._type, v4l2.MEMORY_MMAP
        self._ioctl(v4l2.REQBUFS, request)
        for index in range(request.count):
            buffer, planes = self._blank(index)
            self._ioctl(v4l2.QUERYBUF, buffer)
            if planes is not None:
                length, offset = planes[0].length, planes[0].m.mem_offset
            else:
                length, offset = buffer.length, buffer.m.offset
            self._maps.append(mmap.mmap(self._fd, length, offset=offset))
            self._queue(index)
        self._ioctl(v4l2.STREAMON, ctypes.c_int(self._type))
        self._is_streaming = True

    def _queue(self, index: int) -> None:
        buffer, _planes = self._blank(index)
        self._ioctl(v4l2.QBUF, buffer)

    def take(self, timeout_s: float) -> Buffer | None:
        """The oldest filled buffer, copied and given back to the driver; None if none came in time."""
        poll = select.poll()
        poll.register(self._fd, select.POLLIN)
        events = poll.poll(0)
        has_waited = bool(events)
        events = events or poll.poll(timeout_s * 1000.0)
        if not events:
            return None
        buffer, planes = self._blank(0)
        try:
            self._ioctl(v4l2.DQBUF, buffer)  # after POLLERR this raises the cause
        except BlockingIOError as error:
            if events[0][1] & (select.POLLERR | select.POLLHUP):
                raise OSError(errno.EIO, "the stream has ended") from error  # or we would ask for ever
            return None
        start, used = 0, int(buffer.bytesused)
        if planes is not None:
            start, used = int(planes[0].data_offset), int(planes[0].bytesused)
        mapped = self._maps[buffer.index]
        data = bytearray(memoryview(mapped)[start:used]) if used > start else bytearray()
        self._queue(buffer.index)
        stamp_ns = int(buffer.timestamp.tv_sec) * 1_000_000_000 + int(buffer.timestamp.tv_usec) * 1000
        return Buffer(data, stamp_ns, int(buffer.sequence), int(buffer.flags), has_waited)

    def close(self) -> None:
        """End the stream and let go; never fails, the device may be gone."""
        if self._fd < 0:
            return
        if self._is_streaming:
            with contextlib.suppress(OSError):
                self._ioctl(v4l2.STREAMOFF, ctypes.c_int(self._type))
        for mapped in self._maps:
            mapped.close()
        self._maps.clear()
        with contextlib.suppress(OSError):
            os.close(self._fd)
        self._fd = -1


def _text(raw_text: bytes) -> str:
    return raw_text.decode("utf-8", "replace").strip()


def _code(fourcc: str) -> int:
    return int.from_bytes(fourcc.ljust(4).encode("ascii"), "little")


def _fourcc(code: int) -> str:
    # The highest bit means big-endian; it is no letter.
    return (code & 0x7FFFFFFF).to_bytes(4, "little").decode("latin-1").rstrip() + ("-BE" if code >> 31 else "")


def _rate_hz(interval: Any) -> float:
    return interval.denominator / interval.numerator if interval.numerator else 0.0
