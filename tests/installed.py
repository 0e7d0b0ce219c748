"""Environments of an installation's own, without unpacking again what pip has unpacked here."""

import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from importlib.metadata import Distribution, distribution
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]


def built(*command: object) -> None:
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr


def project() -> dict[str, Any]:
    """The table `project` of pyproject.toml."""
    table: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return table


def declared(*extras: str) -> list[str]:
    """The requirements of the base and of these extras; one that refers to others of ours gives theirs."""
    ours = project()
    lines = list(ours["dependencies"])
    for extra in extras:
        for line in ours["optional-dependencies"][extra]:
            wanted = Requirement(line)
            lines += declared(*wanted.extras) if wanted.name == ours["name"] else [line]
    return list(dict.fromkeys(lines))


def extras() -> set[str]:
    return set(project()["optional-dependencies"])


def needed(requirements: Iterable[str]) -> dict[str, Distribution]:
    """What pip would install for these: every distribution by its name, at a version that will do."""
    found: dict[str, Distribution] = {}
    done: set[str] = set()
    waiting = [Requirement(line) for line in requirements]
    while waiting:
        wanted = waiting.pop()
        if str(wanted) in done:
            continue
        done.add(str(wanted))
        name = canonicalize_name(wanted.name)
        found[name] = there = distribution(name)  # of this environment, which is the lock's
        assert wanted.specifier.contains(there.version, prereleases=True), wanted
        for line in there.requires or ():
            further = Requirement(line)
            if further.marker is None or any(further.marker.evaluate({"extra": e}) for e in ("", *wanted.extras)):
                waiting.append(further)
    return found


def laid_over(base: Path, extra: str, folder: Path) -> Path:
    """A new environment that sees the base's packages and, besides, what the extra declares and nothing else.

    The files are those that pip has installed here, of the same versions: to unpack them again takes a minute of the
    processor's.
    """
    built(sys.executable, "-m", "venv", "--without-pip", folder)
    (packages,) = (folder / "lib").glob("python3*/site-packages")
    (beneath,) = (base.parent / "lib").glob("python3*/site-packages")
    (packages / "base.pth").write_text(f"{beneath}\n")
    below = needed(declared())
    for name, there in needed(declared(extra)).items():
        for file in () if name in below else there.files or ():
            if ".." not in file.parts and there.locate_file(file).exists():  # type: ignore[attr-defined]
                (packages / file).parent.mkdir(parents=True, exist_ok=True)
                share(Path(str(there.locate_file(file))), packages / file)
    for name in ("pc-ground", "pc-onboard"):
        script = (base / name).read_text().splitlines(keepends=True)
        (folder / "bin" / name).write_text("".join([f"#!{folder}/bin/python\n", *script[1:]]))
        (folder / "bin" / name).chmod(0o755)
    return folder / "bin"


def share(file: Path | str, also: Path | str) -> None:
    """Another name of a file that no one writes to, or a copy on another disk."""
    try:
        Path(also).hardlink_to(file)
    except OSError:
        shutil.copy2(file, also)
