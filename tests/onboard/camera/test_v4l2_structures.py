"""Structures, request numbers and constants of V4L2 are the kernel's: against known sizes, and against the C header."""

import ctypes
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from contract.errors import ConfigError
from onboard.camera import v4l2_structures as v4l2
from onboard.camera.v4l2_device import V4l2Device
from tests.left_out import NO_PROGRAM

# 64-bit Linux, from the kernel's header by way of a C compiler.
SIZES = {
    "v4l2_capability": 104, "v4l2_fmtdesc": 64, "v4l2_frmsize_discrete": 8, "v4l2_frmsize_stepwise": 24,
    "v4l2_frmsizeenum": 44, "v4l2_fract": 8, "v4l2_frmival_stepwise": 24, "v4l2_frmivalenum": 52, "v4l2_pix_format": 48,
    "v4l2_plane_pix_format": 20, "v4l2_pix_format_mplane": 192, "v4l2_format": 208, "v4l2_captureparm": 40,
    "v4l2_streamparm": 204, "v4l2_query_ext_ctrl": 232, "v4l2_querymenu": 44, "v4l2_control": 8, "v4l2_ext_control": 20,
    "v4l2_ext_controls": 32, "v4l2_requestbuffers": 20, "timeval": 16, "v4l2_timecode": 16, "v4l2_plane": 64,
    "v4l2_buffer": 88,
}  # fmt: skip
REQUESTS = {
    "QUERYCAP": 0x80685600, "ENUM_FMT": 0xC0405602, "S_FMT": 0xC0D05605, "REQBUFS": 0xC0145608, "QUERYBUF": 0xC0585609,
    "QBUF": 0xC058560F, "DQBUF": 0xC0585611, "STREAMON": 0x40045612, "STREAMOFF": 0x40045613, "S_PARM": 0xC0CC5616,
    "G_CTRL": 0xC008561B, "S_CTRL": 0xC008561C, "QUERYMENU": 0xC02C5625, "G_EXT_CTRLS": 0xC0205647,
    "S_EXT_CTRLS": 0xC0205648, "ENUM_FRAMESIZES": 0xC02C564A, "ENUM_FRAMEINTERVALS": 0xC034564B,
    "QUERY_EXT_CTRL": 0xC0E85667,
}  # fmt: skip
NESTED = (
    "v4l2_format.fmt.pix.xfer_func", "v4l2_format.fmt.pix_mp.num_planes", "v4l2_format.fmt.pix_mp.plane_fmt",
    "v4l2_streamparm.parm.capture.timeperframe.denominator", "v4l2_frmsizeenum.discrete.height",
    "v4l2_frmsizeenum.stepwise.step_height", "v4l2_frmivalenum.discrete.denominator",
    "v4l2_frmivalenum.stepwise.step.denominator", "v4l2_plane.m.mem_offset", "v4l2_buffer.m.offset",
    "v4l2_buffer.m.planes", "v4l2_buffer.timestamp.tv_usec",
)  # fmt: skip
NO_NUMBERS = {"MAX_PLANES", "POINTER_BYTES"}


def structures() -> dict[str, type[ctypes.Structure]]:
    """Every structure of the module by its name in C, which is the first thing its docstring says."""
    found = {}
    for name, kind in vars(v4l2).items():
        if isinstance(kind, type) and issubclass(kind, ctypes.Structure) and not name.startswith("_"):
            assert kind.__doc__
            found[kind.__doc__.split()[1].rstrip(".,;")] = kind
    return found


def constants() -> dict[str, int]:
    numbers = {
        name: value
        for name, value in vars(v4l2).items()
        if name.isupper() and name[0] != "_" and isinstance(value, int)
    }
    named = {name: ("VIDIOC_" if name in REQUESTS else "V4L2_") + name for name in numbers.keys() - NO_NUMBERS}
    return {named[name]: numbers[name] for name in named}


def types_of(kind: type[ctypes.Structure | ctypes.Union]) -> dict[str, type]:
    plain = {field[0]: field[1] for field in kind._fields_}
    for name in getattr(kind, "_anonymous_", ()):
        plain |= types_of(plain.pop(name))
    return plain


def offset_of(kind: type, path: list[str]) -> int:
    total = 0
    for name in path:
        total += getattr(kind, name).offset
        kind = types_of(kind)[name]
    return total


def expected() -> Iterator[tuple[str, int]]:
    for c_name, kind in structures().items():
        yield f"sizeof(struct {c_name})", ctypes.sizeof(kind)
        for field in types_of(kind):
            yield f"offsetof(struct {c_name}, {field})", offset_of(kind, [field])
    for nested in NESTED:
        c_name, *path = nested.split(".")
        yield f"offsetof(struct {c_name}, {'.'.join(path)})", offset_of(structures()[c_name], path)
    yield from constants().items()


def test_sizes_are_those_of_64_bit_linux() -> None:
    assert {name: ctypes.sizeof(kind) for name, kind in structures().items()} == SIZES


def test_request_numbers_are_the_kernels() -> None:
    assert {name: getattr(v4l2, name) for name in REQUESTS} == REQUESTS


@pytest.mark.skipif(
    not (shutil.which("cc") and Path("/usr/include/linux/videodev2.h").is_file()),
    reason=f"{NO_PROGRAM} cc with linux/videodev2.h; sudo apt-get install gcc libc6-dev",
)
def test_sizes_offsets_and_numbers_are_those_of_the_c_header(tmp_path: Path) -> None:
    wanted = dict(expected())
    assert len(wanted) > 180
    prints = "".join(f'printf("%llu\\n", (unsigned long long)({expression}));\n' for expression in wanted)
    source = f"#include <stdio.h>\n#include <stddef.h>\n#include <linux/videodev2.h>\nint main(void) {{\n{prints}}}\n"
    (tmp_path / "layout.c").write_text(source)
    # The header takes struct timeval from the C library outside of the kernel.
    compile_it = ["cc", "-include", "sys/time.h", "-o", tmp_path / "layout", tmp_path / "layout.c"]
    done = subprocess.run(compile_it, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    printed = subprocess.run([tmp_path / "layout"], capture_output=True, text=True, check=True, timeout=10).stdout
    got = dict(zip(wanted, map(int, printed.split()), strict=True))
    assert got == wanted


def test_a_32_bit_python_is_refused_before_the_device_is_touched(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match=r"/dev/video7: a live camera needs a 64-bit system.* has 32 bits"):
        v4l2.refuse_other_layouts("/dev/video7", 4)
    v4l2.refuse_other_layouts("/dev/video7", 8)
    refused: list[str] = []
    monkeypatch.setattr(v4l2, "refuse_other_layouts", refused.append)
    with pytest.raises(FileNotFoundError):
        V4l2Device("/nowhere/video7")
    assert refused == ["/nowhere/video7"]
