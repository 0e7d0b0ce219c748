"""What packaging/ does to shared libraries: smaller files that load as before, and OpenCV without FFmpeg.

The packages themselves are built, run and weighed by `make test-arm64`.
"""

import ast
import ctypes
import os
import platform
import re
import shutil
import subprocess
import sys
import zlib
from functools import cache
from importlib.metadata import distribution
from pathlib import Path
from types import ModuleType

import pytest

from onboard.camera.gstreamer_helper import BASE, PACKAGES
from tests.arm64 import emulation
from tests.bench.image.host import BenchError
from tests.installed import project
from tests.left_out import NO_PROGRAM
from tests.locked import PACKAGING, program
from tests.parsed import parsed

OWN = "arm64" if platform.machine() == "aarch64" else "amd64"


@cache
def slim() -> ModuleType:
    """Return packaging/slim.py; with LIEF behind it, two seconds of processor time for each worker that collects."""
    return program("slim")


def library(package: str, pattern: str) -> Path:
    return next(Path(str(distribution(package).locate_file(""))).glob(pattern))


@pytest.fixture
def zstandard(tmp_path: Path) -> Path:
    """A copy of a library with much that only debuggers read, alone in a folder."""
    (tmp_path / "site").mkdir()
    return Path(shutil.copy(library("zstandard", "zstandard/backend_c.*.so"), tmp_path / "site" / "small.so"))


@pytest.fixture
def strip_program() -> str:
    program = slim().stripper(OWN)
    if program is None:
        pytest.skip(f"{NO_PROGRAM} strip for {OWN}; sudo apt-get install binutils")
    return str(program)


def test_what_only_debuggers_read_goes_and_all_that_is_loaded_stays(zstandard: Path, strip_program: str) -> None:
    before, size = slim().ELF.parse(zstandard), zstandard.stat().st_size
    slim().strip(zstandard.parent, strip_program)
    after = slim().ELF.parse(zstandard)
    assert before is not None and after is not None
    assert zstandard.stat().st_size < 0.5 * size
    assert slim().loads_as(before, after)
    assert ctypes.CDLL(str(zstandard)).PyInit_backend_c is not None
    assert [path.name for path in zstandard.parent.iterdir()] == ["small.so"]


@pytest.mark.parametrize("spoil", ["offset", "content", "nothing is written"])
def test_of_a_library_that_would_not_load_as_before_only_what_is_not_loaded_becomes_zeros(
    zstandard: Path, tmp_path: Path, spoil: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Some tools move a segment to where no page begins, which the loader refuses."""
    raw = zstandard.read_bytes()
    found = slim().ELF.parse(zstandard)
    assert found is not None
    spoilt = bytearray(raw)
    index = [s.type == slim().ELF.Segment.TYPE.LOAD and s.file_offset > 0 for s in found.segments].index(True)
    if spoil == "offset":
        at = 64 + 56 * index + 8
        spoilt[at : at + 8] = (found.segments[index].file_offset + 8).to_bytes(8, "little")
    else:
        text = next(section for section in found.sections if section.name == ".text")
        spoilt[text.file_offset + 100] ^= 1
    (tmp_path / "spoilt.so").write_bytes(spoilt)
    program = tmp_path / "strip"
    program.write_text("#!/bin/sh\n" + ("exit 1\n" if "nothing" in spoil else f'cp {tmp_path}/spoilt.so "$3"\n'))
    program.chmod(0o755)
    slim().strip(zstandard.parent, str(program))
    assert "small.so keeps its length: it would not load as before" in capsys.readouterr().out
    assert zstandard.stat().st_size == len(raw)
    assert len(zlib.compress(zstandard.read_bytes(), 1)) < 0.5 * len(zlib.compress(raw, 1))
    after = slim().ELF.parse(zstandard)
    assert after is not None and slim().loads_as(found, after)
    assert ctypes.CDLL(str(zstandard)).PyInit_backend_c is not None
    assert [path.name for path in zstandard.parent.iterdir()] == ["small.so"]


def test_a_machine_whose_strip_does_not_know_the_architecture_is_given_the_command(
    zstandard: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(slim().shutil, "which", lambda program: None)
    assert slim().main([str(zstandard.parent), OWN]) == 1
    assert f"no strip for {OWN}; sudo apt-get install binutils-multiarch" in capsys.readouterr().err


def needed(path: Path) -> list[str]:
    found = slim().ELF.parse(path)
    assert found is not None
    return [str(name) for name in found.libraries]


def test_no_module_of_the_aircraft_loads_a_part_of_scipy_that_the_packages_leave_out() -> None:
    """Within a function it may: what that is for is then refused by name."""
    left_out = {f"scipy.{part}" for part in slim().UNUSED["scipy"]}
    loaded: dict[str, set[str]] = {}
    for folder in (PACKAGING.parent / "contract", PACKAGING.parent / "onboard"):
        for file in folder.rglob("*.py"):
            for node in parsed(file).body:
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("scipy"):
                    names = {node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)}
                    loaded.setdefault(file.name, set()).update(".".join(name.split(".")[:2]) for name in names)
    assert loaded  # scipy.linalg and scipy.special at least
    assert {file: found & left_out for file, found in loaded.items() if found & left_out} == {}


def test_opencv_does_without_ffmpeg(tmp_path: Path) -> None:
    """It asks for all else as before, follows features, reads and writes pictures."""
    module = library("opencv-python-headless", "cv2/cv2.abi3.so")
    folder, libraries = tmp_path / "cv2", tmp_path / "opencv_python_headless.libs"
    shutil.copytree(module.parent, folder, ignore=shutil.ignore_patterns(module.name, "*.pyi", "__pycache__"))
    libraries.mkdir()
    for path in (module.parent.parent / libraries.name).iterdir():
        (libraries / path.name).symlink_to(path)
    (folder / module.name).write_bytes(module.read_bytes())
    asked = needed(module)
    assert slim().unlink_video(tmp_path)
    now = needed(folder / module.name)
    assert now == [name for name in asked if not name.startswith(slim().FFMPEG)]
    assert len(asked) - len(now) == 4
    for path in libraries.glob("lib*"):
        if path.name.startswith((*slim().FFMPEG, "libswresample", "libvpx", "libdrm")):
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
    assert (folder / slim().NO_VIDEO).is_file()


def test_another_architectures_libraries_and_requirements_are_refused(tmp_path: Path) -> None:
    site = tmp_path / "site"
    (site / "thing-1.dist-info").mkdir(parents=True)
    other = next(name for name in slim().MACHINES if name != OWN)
    shutil.copy(library("zstandard", "zstandard/backend_c.*.so"), site / "thing.so")
    assert slim().foreign(site, OWN) == []
    assert slim().main([str(site), other]) == 1
    metadata = site / "thing-1.dist-info" / "METADATA"
    metadata.write_text("Requires-Dist: more; extra == 'x' and platform_machine == 'aarch64'\n")
    assert slim().conditions(site) == []
    metadata.write_text("Requires-Dist: more; platform_machine == 'aarch64'\n")
    assert slim().main([str(site), OWN]) == 1


def test_an_addition_holds_nothing_that_is_there_already(tmp_path: Path) -> None:
    for place, names in {"base": ["alike"], "extra": ["alike", "more"]}.items():
        for name in names:
            (tmp_path / place / name).mkdir(parents=True)
            (tmp_path / place / name / "__init__.py").touch()
            info = tmp_path / place / f"{name}-1.dist-info"
            info.mkdir()
            (info / "RECORD").write_text(f"{name}/__init__.py,,\n{info.name}/RECORD,,\n../bin/{name},,\n")
    slim().subtract(tmp_path / "extra", tmp_path / "base")
    assert sorted(p.name for p in (tmp_path / "extra").iterdir()) == ["more", "more-1.dist-info"]
    assert (tmp_path / "base" / "alike").is_dir()


def test_a_host_without_an_emulator_is_given_the_one_command(monkeypatch: pytest.MonkeyPatch) -> None:
    have = {"apt-get", "dpkg-deb"}
    monkeypatch.setattr(emulation.shutil, "which", lambda program: program if program in have else None)
    monkeypatch.setattr(emulation.os, "geteuid", lambda: 1000)
    with pytest.raises(BenchError, match=r"Once: sudo apt-get install .*qemu-user-static"):
        emulation.require()
    have.clear()
    monkeypatch.setattr(emulation.os, "geteuid", lambda: 0)
    with pytest.raises(BenchError, match=r"Debian packages are needed: qemu-user-static"):
        emulation.require()


def test_the_package_recommends_what_the_helper_says_to_install() -> None:
    script = (PACKAGING / "build-deb.sh").read_text()
    recommended = re.search(r'^gstreamer="(.*?)"$', script, re.MULTILINE | re.DOTALL)
    suggested = re.search(r"^Suggests: (.*)$", script, re.MULTILINE)
    assert recommended is not None and suggested is not None and "Recommends: $gstreamer" in script
    named = {name.split()[0] for part in (recommended[1], suggested[1]) for name in re.split(r",\s*", part)}
    assert {*" ".join(PACKAGES).split(), *BASE.split()} <= named


@pytest.mark.long
def test_a_release_is_made_of_a_tagged_checkout_alone_and_every_page_has_its_version(tmp_path: Path) -> None:
    root, version = PACKAGING.parent, project()["version"]
    assert f"\nversion: {version}\n" in (root / "CITATION.cff").read_text()
    assert f"## {version}" in (root / "CHANGELOG.md").read_text()
    git = tmp_path / "git"  # one that knows no tag, whatever this checkout has
    git.write_text("#!/bin/sh\nexit 1\n")
    git.chmod(0o755)
    done = subprocess.run(
        ["make", "release", f"VENV={Path(sys.executable).parents[1]}"],
        cwd=root, env={**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode != 0
    assert f"git tag v{version}" in done.stderr
