"""What an aircraft has no use for is left out of an installed site-packages folder.

    python packaging/slim.py SITE amd64|arm64 [--without OTHER_SITE]

Three kinds of things go: files that nothing imports (tests, types, headers, the parts of packages named in `UNUSED`),
libraries that nothing left asks for any more, and what only debuggers read. Prints what it did, in MB. With `--without`
the packages that stand in OTHER_SITE too go first, so that SITE becomes an addition to it. `docs/service.md` says what
an installation from the Debian package cannot do for it.
"""

from __future__ import annotations

import argparse
import fnmatch
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

from elf import MACHINES, Dynamic, ElfError, is_elf, machine, without_debugging

FOLDERS = ("tests", "test", "include", "__pycache__")
FILES = ("*.pyi", "*.pxd", "*.pyx", "*.h", "*.hpp", "*.c", "*.a", "py.typed", "*.exe")
UNUSED = {
    "lxml": ("",),  # pymavlink asks for it to check message definitions, and to read descriptions of parameters
    "mavsdk": ("asyncio", "plugins/*"),
    "numpy": ("distutils", "_pyinstaller", "random/lib", "_core/lib", "doc"),
    "PIL": ("_avif.*", "_imagingft.*", "_imagingtk.*", "_imagingcms.*", "_imagingmath.*", "_imagingmorph.*"),
    "pycparser": ("",),  # cffi's compiler; cryptography wants cffi's runtime
    "pymavlink": ("dialects/*", "tools", "generator/*", "message_definitions"),
    "rasterio": ("_example.*",),
    "scipy": (
        *(
            "cluster",
            "constants",
            "datasets",
            "differentiate",
            "fft",
            "fftpack",
            "integrate",
            "interpolate",
            "io",
            "misc",
        ),
        *("ndimage", "odr", "optimize", "signal", "sparse", "spatial", "stats", "conftest.py"),
    ),
    "zstandard": ("_cffi.*", "backend_cffi.py"),
}
"""Package -> patterns below it that go, "" for all of it."""
KEPT = {
    "mavsdk": ("plugins/__init__.py", "plugins/mavlink_direct"),
    "pymavlink": (
        *("dialects/__init__.py", "dialects/v10/__init__.py", "dialects/v20/__init__.py"),
        *("dialects/v20/ardupilotmega.py", "dialects/v10/all.py"),
        *("generator/__init__.py", "generator/mavcrc.py", "generator/mavparse.py"),
    ),
}
"""What stays all the same: the dialect that is spoken, and what `mavutil` loads by itself."""
NO_VIDEO = "WITHOUT_FFMPEG"
"""The file beside cv2 that says so; `onboard/camera/picture_files.py` looks for it before it opens a video."""
FFMPEG = ("libavcodec", "libavformat", "libavutil", "libswscale")


def main(argv: list[str] | None = None) -> int:
    """Make a folder slim; exit code 1 if it holds something that must not be there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("site", type=Path)
    parser.add_argument("architecture", choices=sorted(MACHINES))
    parser.add_argument("--without", type=Path)
    options = parser.parse_args(argv)
    site: Path = options.site
    wrong = [*foreign(site, options.architecture), *conditions(site)]
    if wrong:
        print("\n".join(f"slim: {line}" for line in wrong), file=sys.stderr)
        return 1
    if options.without is not None:
        subtract(site, options.without)
    steps = [("as installed", size(site))]
    drop_files(site)
    steps.append(("without tests, types, headers and unused parts", size(site)))
    if unlink_video(site):
        steps.append(("without what asks for FFmpeg", size(site)))
    drop_libraries(site)
    steps.append(("without libraries that nothing asks for", size(site)))
    strip(site)
    steps.append(("without what only debuggers read", size(site)))
    for name, amount in steps:
        print(f"slim: {amount / 1e6:7.1f} MB  {name}")
    return 0


def size(folder: Path) -> int:
    """Bytes of all files."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def libraries(site: Path) -> Iterator[tuple[Path, bytes]]:
    """Every shared library with its bytes."""
    for path in sorted(site.rglob("*.so*")):
        if path.is_file() and not path.is_symlink() and is_elf(raw := path.read_bytes()):
            yield path, raw


def foreign(site: Path, architecture: str) -> list[str]:
    """Libraries of another architecture than asked for."""
    expected = MACHINES[architecture]
    return [
        f"{path}: is for machine {machine(raw)}, not {expected} ({architecture})"
        for path, raw in libraries(site)
        if machine(raw) != expected
    ]


def conditions(site: Path) -> list[str]:
    """Requirements that hold on some processors only: pip weighs them by the machine that it runs on."""
    found = []
    for path in sorted(site.glob("*.dist-info/METADATA")):
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.startswith("Requires-Dist:") and "platform_machine" in line and "extra ==" not in line:
                found.append(f"{path.parent.name}: {line}: pip cannot weigh this for another machine")
    return found


def owned(info: Path) -> set[Path]:
    """What a distribution installed at the top, by its RECORD: its files and folders, and its own .dist-info."""
    lines = (info / "RECORD").read_text(encoding="utf-8").splitlines()
    tops = {line.rsplit(",", 2)[0].strip('"').split("/")[0] for line in lines if not line.startswith("..")}
    return {info.parent / top for top in tops}


def subtract(site: Path, other: Path) -> None:
    """Take away each distribution that `other` has too."""
    for info in sorted(site.glob("*.dist-info")):
        if (other / info.name).is_dir():
            for path in owned(info):
                remove(path)


def remove(path: Path) -> None:
    """A file or a folder with all that it holds."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def drop_files(site: Path) -> None:
    """Tests, types and headers everywhere, and `UNUSED`."""
    for path in sorted(site.rglob("*")):
        if path.is_dir() and path.name in FOLDERS and ".dist-info" not in str(path):
            shutil.rmtree(path)
        elif path.is_file() and any(fnmatch.fnmatch(path.name, pattern) for pattern in FILES):
            path.unlink()
    for package, patterns in UNUSED.items():
        folder = site / package
        kept = {folder / name for name in KEPT.get(package, ())}
        above = {parent for path in kept for parent in path.parents}
        for pattern in patterns:
            for path in [folder] if not pattern else sorted(folder.glob(pattern)):
                _remove_but(path, kept, above)
    for path in sorted(site.glob("bin")):
        shutil.rmtree(path)


def _remove_but(path: Path, kept: set[Path], above: set[Path]) -> None:
    if path in above:
        for child in sorted(path.iterdir()):
            _remove_but(child, kept, above)
    elif path not in kept:
        remove(path)


def unlink_video(site: Path) -> bool:
    """Let OpenCV no longer ask for FFmpeg, which it calls for video files alone; whether there was any to forget."""
    module = site / "cv2" / "cv2.abi3.so"
    folder = site / "opencv_python_headless.libs"
    video = {path.name: path for path in folder.glob("*") if path.name.startswith(FFMPEG)}
    if not module.is_file() or not video:
        return False
    linked = Dynamic(module.read_bytes())
    names = {name for path in video.values() for _, name, is_here in Dynamic(path.read_bytes()).symbols() if is_here}
    linked.forget(set(video), names)
    module.write_bytes(linked.raw)
    (site / "cv2" / NO_VIDEO).write_text("This OpenCV was installed without FFmpeg: it reads no video files.\n")
    return True


def drop_libraries(site: Path) -> None:
    """Libraries beside the modules (`*.libs`) that no module asks for, directly or through others."""
    needed: dict[Path, list[str]] = {}
    for path, raw in libraries(site):
        needed[path] = Dynamic(raw).needed
    carried = {path for path in needed if path.parent.name.endswith(".libs")}
    reached: set[Path] = set()
    ahead = [path for path in needed if path not in carried]
    while ahead:
        names = set(needed[ahead.pop()])
        found = {path for path in carried - reached if path.name in names}
        reached |= found
        ahead += sorted(found)
    for path in carried - reached:
        path.unlink()


def strip(site: Path) -> None:
    """Leave in each library what is loaded; one that cannot be rewritten stays as it is, and is named."""
    for path, raw in libraries(site):
        try:
            path.write_bytes(without_debugging(raw))
        except ElfError as error:
            print(f"slim: {path.relative_to(site)} stays as it is: {error}")


if __name__ == "__main__":
    sys.exit(main())
