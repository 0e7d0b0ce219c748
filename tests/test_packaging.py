"""What packaging/ does to shared libraries: smaller files that load as before, and OpenCV without FFmpeg.

The packages themselves are built, run and weighed by `make test-arm64`.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import shutil
import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path
from types import ModuleType

import pytest

from tests.arm64 import emulation
from tests.bench.image.host import BenchError

PACKAGING = Path(__file__).resolve().parents[1] / "packaging"


def load(name: str) -> ModuleType:
    """A module of packaging/, which is a folder of programs and no package."""
    sys.path.insert(0, str(PACKAGING))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(str(PACKAGING))


elf, slim = load("elf"), load("slim")


def library(package: str, pattern: str) -> Path:
    return next(Path(str(distribution(package).locate_file(""))).glob(pattern))


def test_what_only_debuggers_read_goes_and_all_that_is_loaded_stays(tmp_path: Path) -> None:
    raw = library("zstandard", "zstandard/backend_c.*.so").read_bytes()
    small = elf.without_debugging(raw)
    assert len(small) < 0.5 * len(raw)
    before = [s for s in elf.segments(raw) if s.kind == elf.PT_LOAD]
    after = [s for s in elf.segments(small) if s.kind == elf.PT_LOAD]
    assert len(before) == len(after) > 1
    for a, b in zip(before[1:], after[1:], strict=True):  # the first holds the headers, which say where the rest is
        assert raw[a.offset : a.offset + a.in_file] == small[b.offset : b.offset + b.in_file]
        assert (a.address, a.in_memory, a.flags) == (b.address, b.in_memory, b.flags)
        assert b.offset % b.align == b.address % b.align
    (tmp_path / "small.so").write_bytes(small)
    assert ctypes.CDLL(str(tmp_path / "small.so")).PyInit_backend_c is not None


def test_a_file_whose_headers_are_not_loaded_is_left_alone() -> None:
    raw = bytearray(library("zstandard", "zstandard/backend_c.*.so").read_bytes())
    for index, segment in enumerate(elf.segments(bytes(raw))):
        if segment.kind == elf.PT_LOAD and segment.offset == 0:
            raw[64 + index * 56] = 0
    with pytest.raises(elf.ElfError):
        elf.without_debugging(bytes(raw))


def test_opencv_does_without_ffmpeg(tmp_path: Path) -> None:
    """It asks for all else as before, follows features, reads and writes pictures."""
    module = library("opencv-python-headless", "cv2/cv2.abi3.so")
    folder, libraries = tmp_path / "cv2", tmp_path / "opencv_python_headless.libs"
    shutil.copytree(module.parent, folder, ignore=shutil.ignore_patterns(module.name, "*.pyi", "__pycache__"))
    libraries.mkdir()
    for path in (module.parent.parent / libraries.name).iterdir():
        (libraries / path.name).symlink_to(path)
    (folder / module.name).write_bytes(module.read_bytes())
    asked = elf.Dynamic(module.read_bytes()).needed
    assert slim.unlink_video(tmp_path)
    now = elf.Dynamic((folder / module.name).read_bytes()).needed
    assert now == [name for name in asked if not name.startswith(slim.FFMPEG)]
    assert len(asked) - len(now) == 4
    for path in libraries.glob("lib*"):
        if path.name.startswith((*slim.FFMPEG, "libswresample", "libvpx", "libdrm")):
            path.unlink()
    program = """
import cv2, numpy as np
picture = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (240, 320), np.uint8), (0, 0), 3)
at = cv2.goodFeaturesToTrack(picture, 50, 0.01, 8)
found, good, _ = cv2.calcOpticalFlowPyrLK(picture, np.roll(picture, 3, 1), at, None)
assert good.mean() > 0.7 and abs(np.median(found - at, 0)[0, 0] - 3) < 0.1
assert cv2.imdecode(cv2.imencode(".jpg", picture)[1], 0).shape == (240, 320)
print(cv2.__file__)
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": str(tmp_path)}, cwd=tmp_path, capture_output=True, text=True, check=False,
        timeout=60,
    )  # fmt: skip
    assert (done.returncode, done.stdout.strip()) == (0, str(folder / "__init__.py")), done.stderr
    assert (folder / slim.NO_VIDEO).is_file()


def test_another_architectures_libraries_and_requirements_are_refused(tmp_path: Path) -> None:
    site = tmp_path / "site"
    (site / "thing-1.dist-info").mkdir(parents=True)
    raw = library("zstandard", "zstandard/backend_c.*.so").read_bytes()
    own = next(name for name, number in elf.MACHINES.items() if number == elf.machine(raw))
    other = next(name for name in elf.MACHINES if name != own)
    (site / "thing.so").write_bytes(raw)
    assert slim.foreign(site, own) == []
    assert slim.main([str(site), other]) == 1
    metadata = site / "thing-1.dist-info" / "METADATA"
    metadata.write_text("Requires-Dist: more; extra == 'x' and platform_machine == 'aarch64'\n")
    assert slim.conditions(site) == []
    metadata.write_text("Requires-Dist: more; platform_machine == 'aarch64'\n")
    assert slim.main([str(site), own]) == 1


def test_an_addition_holds_nothing_that_is_there_already(tmp_path: Path) -> None:
    for place, names in {"base": ["alike"], "extra": ["alike", "more"]}.items():
        for name in names:
            (tmp_path / place / name).mkdir(parents=True)
            (tmp_path / place / name / "__init__.py").touch()
            info = tmp_path / place / f"{name}-1.dist-info"
            info.mkdir()
            (info / "RECORD").write_text(f"{name}/__init__.py,,\n{info.name}/RECORD,,\n../bin/{name},,\n")
    slim.subtract(tmp_path / "extra", tmp_path / "base")
    assert sorted(p.name for p in (tmp_path / "extra").iterdir()) == ["more", "more-1.dist-info"]
    assert (tmp_path / "base" / "alike").is_dir()


def test_a_host_without_an_emulator_is_told_the_one_command(monkeypatch: pytest.MonkeyPatch) -> None:
    have = {"apt-get", "dpkg-deb"}
    monkeypatch.setattr(emulation.shutil, "which", lambda program: program if program in have else None)
    monkeypatch.setattr(emulation.os, "geteuid", lambda: 1000)
    with pytest.raises(BenchError, match=r"Once: sudo apt-get install -y .*qemu-user-static"):
        emulation.require()
    have.clear()
    with pytest.raises(BenchError, match=r"a Debian or Ubuntu with qemu-user-static"):
        emulation.require()
