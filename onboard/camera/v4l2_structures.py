"""The structures, numbers and requests of V4L2 that this project uses, as the kernel documents them.

Source: "Video for Linux API" in the kernel's userspace-api documentation (Function Reference; `videodev2.h` itself is
offered under the BSD licence too). Names of structures follow the kernel's, in capitals; names of fields are its own,
so that the documentation and the code can be compared and a test can compare both with the C header of the machine.

The layout is that of 64-bit Linux, the same on x86-64 and aarch64: pointers, `long` and `time_t` have 8 bytes.
`refuse_other_layouts` raises where it is not.
"""

from __future__ import annotations

import ctypes
from typing import Any

from contract.errors import ConfigError

_S8, _U8, _U16 = ctypes.c_char, ctypes.c_uint8, ctypes.c_uint16
_S32, _U32, _S64, _U64 = ctypes.c_int32, ctypes.c_uint32, ctypes.c_int64, ctypes.c_uint64

MAX_PLANES = 8

# enum v4l2_buf_type, v4l2_memory, v4l2_field
BUF_TYPE_VIDEO_CAPTURE = 1
BUF_TYPE_VIDEO_OUTPUT = 2
BUF_TYPE_VIDEO_CAPTURE_MPLANE = 9
MEMORY_MMAP = 1
FIELD_ANY = 0
FIELD_NONE = 1
COLORSPACE_SRGB = 8

# Flags of v4l2_capability
CAP_VIDEO_CAPTURE = 0x00000001
CAP_VIDEO_CAPTURE_MPLANE = 0x00001000
CAP_STREAMING = 0x04000000
CAP_DEVICE_CAPS = 0x80000000

# Flags of v4l2_buffer
BUF_FLAG_ERROR = 0x00000040
BUF_FLAG_TIMESTAMP_MASK = 0x0000E000
BUF_FLAG_TIMESTAMP_UNKNOWN = 0x00000000
BUF_FLAG_TIMESTAMP_MONOTONIC = 0x00002000
BUF_FLAG_TIMESTAMP_COPY = 0x00004000
BUF_FLAG_TSTAMP_SRC_MASK = 0x00070000
BUF_FLAG_TSTAMP_SRC_SOE = 0x00010000

# enum v4l2_frmsizetypes, v4l2_frmivaltypes
FRMSIZE_TYPE_DISCRETE = 1
FRMIVAL_TYPE_DISCRETE = 1

# enum v4l2_ctrl_type; flags of v4l2_query_ext_ctrl
CTRL_TYPE_MENU = 3
CTRL_TYPE_INTEGER64 = 5
CTRL_TYPE_INTEGER_MENU = 9
CTRL_FLAG_NEXT_CTRL = 0x80000000


def _each(kind: type[ctypes._SimpleCData[int]], *names: str) -> list[tuple[str, Any]]:
    """Fields of one type, one after the other."""
    return [(name, kind) for name in names]


class Capability(ctypes.Structure):
    """struct v4l2_capability."""

    _fields_ = [
        ("driver", _S8 * 16),
        ("card", _S8 * 32),
        ("bus_info", _S8 * 32),
        *_each(_U32, "version", "capabilities", "device_caps"),
        ("reserved", _U32 * 3),
    ]


class Fmtdesc(ctypes.Structure):
    """struct v4l2_fmtdesc."""

    _fields_ = [
        *_each(_U32, "index", "type", "flags"),
        ("description", _S8 * 32),
        *_each(_U32, "pixelformat", "mbus_code"),
        ("reserved", _U32 * 3),
    ]


class FrmsizeDiscrete(ctypes.Structure):
    """struct v4l2_frmsize_discrete."""

    _fields_ = [("width", _U32), ("height", _U32)]


class FrmsizeStepwise(ctypes.Structure):
    """struct v4l2_frmsize_stepwise."""

    _fields_ = _each(_U32, "min_width", "max_width", "step_width", "min_height", "max_height", "step_height")


class _FrmsizeChoice(ctypes.Union):
    _fields_ = [("discrete", FrmsizeDiscrete), ("stepwise", FrmsizeStepwise)]


class Frmsizeenum(ctypes.Structure):
    """struct v4l2_frmsizeenum."""

    _anonymous_ = ("choice",)
    _fields_ = [
        *_each(_U32, "index", "pixel_format", "type"),
        ("choice", _FrmsizeChoice),
        ("reserved", _U32 * 2),
    ]


class Fract(ctypes.Structure):
    """struct v4l2_fract."""

    _fields_ = [("numerator", _U32), ("denominator", _U32)]


class FrmivalStepwise(ctypes.Structure):
    """struct v4l2_frmival_stepwise."""

    _fields_ = [("min", Fract), ("max", Fract), ("step", Fract)]


class _FrmivalChoice(ctypes.Union):
    _fields_ = [("discrete", Fract), ("stepwise", FrmivalStepwise)]


class Frmivalenum(ctypes.Structure):
    """struct v4l2_frmivalenum."""

    _anonymous_ = ("choice",)
    _fields_ = [
        *_each(_U32, "index", "pixel_format", "width", "height", "type"),
        ("choice", _FrmivalChoice),
        ("reserved", _U32 * 2),
    ]


class PixFormat(ctypes.Structure):
    """struct v4l2_pix_format."""

    _fields_ = [
        *_each(_U32, "width", "height", "pixelformat", "field", "bytesperline", "sizeimage", "colorspace", "priv"),
        *_each(_U32, "flags", "ycbcr_enc", "quantization", "xfer_func"),
    ]


class PlanePixFormat(ctypes.Structure):
    """struct v4l2_plane_pix_format."""

    _fields_ = [("sizeimage", _U32), ("bytesperline", _U32), ("reserved", _U16 * 6)]


class PixFormatMplane(ctypes.Structure):
    """struct v4l2_pix_format_mplane."""

    _fields_ = [
        *_each(_U32, "width", "height", "pixelformat", "field", "colorspace"),
        ("plane_fmt", PlanePixFormat * MAX_PLANES),
        *_each(_U8, "num_planes", "flags", "ycbcr_enc", "quantization", "xfer_func"),
        ("reserved", _U8 * 7),
    ]


class _FormatChoice(ctypes.Union):
    # `aligned` stands for struct v4l2_window, which is not used here: its pointers align the union to 8 bytes.
    _fields_ = [("pix", PixFormat), ("pix_mp", PixFormatMplane), ("raw_data", _U8 * 200), ("aligned", ctypes.c_void_p)]


class Format(ctypes.Structure):
    """struct v4l2_format."""

    _fields_ = [("type", _U32), ("fmt", _FormatChoice)]


class Captureparm(ctypes.Structure):
    """struct v4l2_captureparm; struct v4l2_outputparm has the same layout, its third field named `outputmode`."""

    _fields_ = [
        ("capability", _U32),
        ("capturemode", _U32),
        ("timeperframe", Fract),
        ("extendedmode", _U32),
        ("readbuffers", _U32),
        ("reserved", _U32 * 4),
    ]


class _ParmChoice(ctypes.Union):
    _fields_ = [("capture", Captureparm), ("raw_data", _U8 * 200)]


class Streamparm(ctypes.Structure):
    """struct v4l2_streamparm."""

    _fields_ = [("type", _U32), ("parm", _ParmChoice)]


class QueryExtCtrl(ctypes.Structure):
    """struct v4l2_query_ext_ctrl."""

    _fields_ = [
        *_each(_U32, "id", "type"),
        ("name", _S8 * 32),
        *_each(_S64, "minimum", "maximum"),
        ("step", _U64),
        ("default_value", _S64),
        *_each(_U32, "flags", "elem_size", "elems", "nr_of_dims"),
        ("dims", _U32 * 4),
        ("reserved", _U32 * 32),
    ]


class _QuerymenuChoice(ctypes.Union):
    _pack_, _layout_ = 1, "ms"
    _fields_ = [("name", _S8 * 32), ("value", _S64)]


class Querymenu(ctypes.Structure):
    """struct v4l2_querymenu, packed."""

    _pack_, _layout_ = 1, "ms"
    _anonymous_ = ("choice",)
    _fields_ = [("id", _U32), ("index", _U32), ("choice", _QuerymenuChoice), ("reserved", _U32)]


class Control(ctypes.Structure):
    """struct v4l2_control."""

    _fields_ = [("id", _U32), ("value", _S32)]


class _ExtControlChoice(ctypes.Union):
    _pack_, _layout_ = 1, "ms"
    _fields_ = [("value", _S32), ("value64", _S64), ("ptr", ctypes.c_void_p)]


class ExtControl(ctypes.Structure):
    """struct v4l2_ext_control, packed."""

    _pack_, _layout_ = 1, "ms"
    _anonymous_ = ("choice",)
    _fields_ = [("id", _U32), ("size", _U32), ("reserved2", _U32 * 1), ("choice", _ExtControlChoice)]


class ExtControls(ctypes.Structure):
    """struct v4l2_ext_controls."""

    _fields_ = [
        *_each(_U32, "which", "count", "error_idx"),
        ("request_fd", _S32),
        ("reserved", _U32 * 1),
        ("controls", ctypes.POINTER(ExtControl)),
    ]


class Requestbuffers(ctypes.Structure):
    """struct v4l2_requestbuffers."""

    _fields_ = [
        *_each(_U32, "count", "type", "memory", "capabilities"),
        ("flags", _U8),
        ("reserved", _U8 * 3),
    ]


class Timeval(ctypes.Structure):
    """struct timeval."""

    _fields_ = [("tv_sec", ctypes.c_long), ("tv_usec", ctypes.c_long)]


class Timecode(ctypes.Structure):
    """struct v4l2_timecode."""

    _fields_ = [
        *_each(_U32, "type", "flags"),
        *_each(_U8, "frames", "seconds", "minutes", "hours"),
        ("userbits", _U8 * 4),
    ]


class _PlaneMemory(ctypes.Union):
    _fields_ = [("mem_offset", _U32), ("userptr", ctypes.c_ulong), ("fd", _S32)]


class Plane(ctypes.Structure):
    """struct v4l2_plane."""

    _fields_ = [
        ("bytesused", _U32),
        ("length", _U32),
        ("m", _PlaneMemory),
        ("data_offset", _U32),
        ("reserved", _U32 * 11),
    ]


class _BufferMemory(ctypes.Union):
    _fields_ = [("offset", _U32), ("userptr", ctypes.c_ulong), ("planes", ctypes.POINTER(Plane)), ("fd", _S32)]


class Buffer(ctypes.Structure):
    """struct v4l2_buffer."""

    _fields_ = [
        *_each(_U32, "index", "type", "bytesused", "flags", "field"),
        ("timestamp", Timeval),
        ("timecode", Timecode),
        *_each(_U32, "sequence", "memory"),
        ("m", _BufferMemory),
        *_each(_U32, "length", "reserved2"),
        ("request_fd", _S32),
    ]


_WRITE, _READ = 1, 2  # as the program sees it: what it hands to the kernel, what it gets back


def _ioc(direction: int, number: int, argument: type[ctypes._SimpleCData[int] | ctypes.Structure]) -> int:
    """`_IOC` of asm-generic/ioctl.h: direction in two bits, size in 14, type 'V', number."""
    return direction << 30 | ctypes.sizeof(argument) << 16 | ord("V") << 8 | number


QUERYCAP = _ioc(_READ, 0, Capability)
ENUM_FMT = _ioc(_READ | _WRITE, 2, Fmtdesc)
S_FMT = _ioc(_READ | _WRITE, 5, Format)
REQBUFS = _ioc(_READ | _WRITE, 8, Requestbuffers)
QUERYBUF = _ioc(_READ | _WRITE, 9, Buffer)
QBUF = _ioc(_READ | _WRITE, 15, Buffer)
DQBUF = _ioc(_READ | _WRITE, 17, Buffer)
STREAMON = _ioc(_WRITE, 18, ctypes.c_int)
STREAMOFF = _ioc(_WRITE, 19, ctypes.c_int)
S_PARM = _ioc(_READ | _WRITE, 22, Streamparm)
G_CTRL = _ioc(_READ | _WRITE, 27, Control)
S_CTRL = _ioc(_READ | _WRITE, 28, Control)
QUERYMENU = _ioc(_READ | _WRITE, 37, Querymenu)
G_EXT_CTRLS = _ioc(_READ | _WRITE, 71, ExtControls)
S_EXT_CTRLS = _ioc(_READ | _WRITE, 72, ExtControls)
ENUM_FRAMESIZES = _ioc(_READ | _WRITE, 74, Frmsizeenum)
ENUM_FRAMEINTERVALS = _ioc(_READ | _WRITE, 75, Frmivalenum)
QUERY_EXT_CTRL = _ioc(_READ | _WRITE, 103, QueryExtCtrl)

POINTER_BYTES = ctypes.sizeof(ctypes.c_void_p)


def refuse_other_layouts(path: str, pointer_bytes: int = POINTER_BYTES) -> None:
    """Raises ConfigError where this program is not a 64-bit one: the kernel's structures have other sizes there."""
    if pointer_bytes != 8:
        raise ConfigError(
            f"{path}: a live camera needs a 64-bit system, this Python has {8 * pointer_bytes} bits; "
            f"install the 64-bit image of your system"
        )
