"""Leave out of an installed site-packages folder what an aircraft has no use for.

    python packaging/slim.py SITE amd64|arm64 [--without OTHER_SITE]

Three kinds of things go: files that nothing imports (tests, types, headers, the parts of packages named in `UNUSED`),
libraries that nothing left asks for any more, and what only debuggers read. Prints what it did, in MB. With `--without`
the packages that stand in OTHER_SITE too go first, so that SITE becomes an addition to it. `docs/service.md` says what
an installation from the Debian package cannot do for it.

Libraries are read and changed by LIEF and made smaller by GNU strip, both for either architecture on any machine.
"""

from __future__ import annotations

import argparse
import fnmatch
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import lief
from lief import ELF

lief.logging.disable()  # of tables that other tools have left half empty; what is wrong shows in what is read
MACHINES = {"amd64": ELF.ARCH.X86_64, "arm64": ELF.ARCH.AARCH64}
STRIPS = {
    "amd64": ("elf64-x86-64", "x86_64-linux-gnu-strip"),
    "arm64": ("elf64-littleaarch64", "aarch64-linux-gnu-strip"),
}
"""Architecture -> binutils' name of its format, and of the `strip` that reads nothing else."""
BLANKED = (ELF.Section.TYPE.SYMTAB, ELF.Section.TYPE.STRTAB, ELF.Section.TYPE.PROGBITS)
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
"""The modules that stay all the same: the dialect that is spoken, and what `mavutil` loads by itself."""
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
    program = stripper(options.architecture)
    if program is None:
        wrong.append(f"no strip for {options.architecture}; sudo apt-get install binutils-multiarch")
    if wrong or program is None:
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
    strip(site, program)
    steps.append(("without what only debuggers read", size(site)))
    for name, amount in steps:
        print(f"slim: {amount / 1e6:7.1f} MB  {name}")
    return 0


def size(folder: Path) -> int:
    """Bytes of all files."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def stripper(architecture: str) -> str | None:
    """The `strip` of this machine that can read the architecture's libraries; None if there is none."""
    format_name, own = STRIPS[architecture]
    for program in (own, "strip"):
        if shutil.which(program) is not None:
            said = subprocess.run([program, "--help"], capture_output=True, text=True, check=False).stdout
            if format_name in said.split():
                return program
    return None


def libraries(site: Path) -> Iterator[tuple[Path, ELF.Binary]]:
    """Every shared library, parsed."""
    for path in sorted(site.rglob("*.so*")):
        if path.is_file() and not path.is_symlink() and (found := ELF.parse(path)) is not None:
            yield path, found


def foreign(site: Path, architecture: str) -> list[str]:
    """Libraries of another architecture than asked for."""
    expected = MACHINES[architecture]
    return [
        f"{path}: is for {found.header.machine_type.name}, not {architecture}"
        for path, found in libraries(site)
        if found.header.machine_type != expected
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
    """The files and folders that a distribution installed at the top, by its RECORD, and its own .dist-info."""
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
    linked = _parsed(module)
    gone: set[str] = set()
    for path in video.values():
        library = _parsed(path)  # its symbols live no longer than it
        gone.update(str(symbol.name) for symbol in library.exported_symbols)
    for symbol in linked.imported_symbols:
        if symbol.name in gone:
            symbol.binding = ELF.Symbol.BINDING.WEAK  # may be missing: whoever calls it all the same ends
            if symbol.symbol_version is not None:
                symbol.symbol_version.as_global()
    for name in video:
        if name in linked.libraries:
            linked.remove_library(name)
        linked.remove_version_requirement(name)
    linked.write(str(module))
    (site / "cv2" / NO_VIDEO).write_text("This OpenCV was installed without FFmpeg: it reads no video files.\n")
    return True


def _parsed(path: Path) -> ELF.Binary:
    found = ELF.parse(path)
    assert found is not None, f"{path} is no shared library"
    return found


def drop_libraries(site: Path) -> None:
    """Libraries beside the modules (`*.libs`) that no module asks for, directly or through others."""
    needed: dict[Path, list[str]] = {}
    for path, found in libraries(site):
        needed[path] = [str(name) for name in found.libraries]
    carried = {path for path in needed if path.parent.name.endswith(".libs")}
    reached: set[Path] = set()
    ahead = [path for path in needed if path not in carried]
    while ahead:
        names = set(needed[ahead.pop()])
        asked = {path for path in carried - reached if path.name in names}
        reached |= asked
        ahead += sorted(asked)
    for path in carried - reached:
        path.unlink()


def strip(site: Path, program: str) -> None:
    """Take symbols and sections that only linkers and debuggers read from each library, where it loads as before."""
    for path, before in libraries(site):
        small = path.with_name(path.name + ".small")
        done = subprocess.run(
            [program, "--strip-unneeded", "-o", small, path], capture_output=True, text=True, check=False
        )
        after = ELF.parse(small) if done.returncode == 0 else None
        if after is not None and loads_as(before, after):
            shutil.copymode(path, small)
            small.replace(path)
        else:
            small.unlink(missing_ok=True)
            blank(path, before)
            why = done.stderr.strip() or "it would not load as before"
            print(f"slim: {path.relative_to(site)} keeps its length: {why}")


def blank(path: Path, library: ELF.Binary) -> None:
    """Zeros where symbols and notes stand that are not loaded: the file is as long as before, its package is not."""
    with path.open("r+b") as file:
        for section in library.sections:
            if not section.has(ELF.Section.FLAGS.ALLOC) and section.type in BLANKED and section.name != ".shstrtab":
                file.seek(section.file_offset)
                file.write(bytes(section.size))


def loads_as(before: ELF.Binary, after: ELF.Binary) -> bool:
    """Return whether the loader makes the same of both: segments at the same addresses, each where a page can hold it,
    and every section that is loaded with the same bytes at the same address.
    """
    segments, others = ([s for s in x.segments if s.type == ELF.Segment.TYPE.LOAD] for x in (before, after))
    kept = {section.virtual_address: bytes(section.content) for section in _loaded(after)}
    return (
        [(s.virtual_address, s.flags) for s in segments] == [(s.virtual_address, s.flags) for s in others]
        and all((s.file_offset - s.virtual_address) % max(s.alignment, 1) == 0 for s in others)
        and all(
            kept.get(section.virtual_address) == bytes(section.content)
            and any(
                s.virtual_address <= section.virtual_address
                and section.virtual_address + section.size <= s.virtual_address + s.physical_size
                for s in others
            )
            for section in _loaded(before)
        )
    )


def _loaded(library: ELF.Binary) -> list[ELF.Section]:
    """Sections with bytes in the file that have a place in memory."""
    return [
        section
        for section in library.sections
        if section.has(ELF.Section.FLAGS.ALLOC) and section.type != ELF.Section.TYPE.NOBITS and section.size > 0
    ]


if __name__ == "__main__":
    sys.exit(main())
