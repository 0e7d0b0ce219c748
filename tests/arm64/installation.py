"""A Debian package of ours, unpacked, and its programs: of this machine's architecture, or emulated."""

import os
import shlex
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

from tests.arm64.emulation import QEMU, package, sysroot
from tests.bench.image.host import run

ENVIRONMENT = "opt/pointclick"


@dataclass(frozen=True)
class Installation:
    """An unpacked package. `python` is the command that runs its Python, alone."""

    architecture: str
    root: Path
    python: tuple[str, ...]
    archive: Path
    terrain: Path

    @property
    def programs(self) -> Path:
        """A folder of scripts `python`, `pc-onboard`, `pc-ground`, as `tests/test_install.py` wants them."""
        folder = self.root.parent / "bin"
        folder.mkdir(exist_ok=True)
        commands = {"python": "", "pc-onboard": " -m onboard", "pc-ground": " -m ground"}
        for name, arguments in commands.items():
            script = folder / name
            script.write_text(f'#!/bin/sh\nexec {shlex.join(self.python)} -I{arguments} "$@"\n')
            script.chmod(0o755)
        return folder

    def __call__(self, *arguments: object, timeout_s: float = 600.0) -> subprocess.CompletedProcess[str]:
        """Its Python with these arguments, without anything of ours next to it."""
        return self._run(["-I", *map(str, arguments)], {}, timeout_s)

    def beside(self, site: Path, *arguments: object, timeout_s: float = 900.0) -> subprocess.CompletedProcess[str]:
        """Its Python with one more folder of packages, in the checkout."""
        return self._run(list(map(str, arguments)), {"PYTHONPATH": str(site)}, timeout_s)

    def _run(self, arguments: list[str], more: dict[str, str], timeout_s: float) -> subprocess.CompletedProcess[str]:
        clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PYTEST"))} | more
        clean["PYTHONDONTWRITEBYTECODE"] = "1"
        return subprocess.run(
            [*self.python, *arguments], env=clean, capture_output=True, text=True, check=False, timeout=timeout_s
        )


def unpack(architecture: str, folder: Path) -> Installation:
    """Unpack a package that was built: for amd64 alone, for arm64 into a Debian of that architecture."""
    archive, terrain = package(architecture), package(architecture, "pointclick-onboard-terrain")
    root = folder / "root"
    if architecture == "amd64":
        root.mkdir()
        run(["dpkg-deb", "-x", archive, root])
        return Installation(architecture, root, (str(root / ENVIRONMENT / "bin" / "python3"),), archive, terrain)
    shutil.copytree(sysroot(), root, symlinks=True)
    run(["dpkg-deb", "-x", archive, root])
    # Named as it would be there: its own name tells Python that it is an environment, and where.
    python = (QEMU, "-L", str(root), "-0", f"/{ENVIRONMENT}/bin/python3", str(root / "usr" / "bin" / "python3.11"))
    return Installation(architecture, root, python, archive, terrain)
