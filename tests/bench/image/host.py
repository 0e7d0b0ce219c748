"""What the host must have before anything is built or booted, and how its commands are run."""

import os
import platform
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from tests.bench.image.cache import say

PACKAGE_OF = {
    "bc": "bc",
    "bison": "bison",
    "debootstrap": "debootstrap",
    "depmod": "kmod",
    "ethtool": "ethtool",
    "flex": "flex",
    "gcc": "gcc",
    "ip": "iproute2",
    "make": "make",
    "mke2fs": "e2fsprogs",
    "mksquashfs": "squashfs-tools",
    "setpriv": "util-linux",
    "strip": "binutils",
    "xz": "xz-utils",
}
DEBIAN_KEYS = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
LIBC_HEADERS = Path("/usr/include/stdio.h")


class BenchError(Exception):
    """The bench cannot be built or booted; the message says what to do."""


def require() -> None:
    """Install what is missing when root, else name it in one line. Raises BenchError."""
    if platform.machine() != "x86_64":
        raise BenchError(f"User Mode Linux runs on x86-64 only, this is {platform.machine()}")
    if os.geteuid() != 0:
        raise BenchError("the bench needs root (debootstrap, a veth pair): sudo make test-bench")
    os.environ["PATH"] += ":/usr/sbin:/sbin"
    missing = sorted({package for program, package in PACKAGE_OF.items() if shutil.which(program) is None})
    missing += ["debian-archive-keyring"] if not DEBIAN_KEYS.exists() else []
    missing += ["libc6-dev"] if not LIBC_HEADERS.exists() else []
    install(missing)


def install(packages: Sequence[str]) -> None:
    """Install Debian packages, as root. Raises BenchError where there is no apt, or it fails."""
    if not packages:
        return
    if shutil.which("apt-get") is None:
        raise BenchError("these Debian packages are needed: " + " ".join(packages))
    say("host: apt-get install " + " ".join(packages))
    quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    run(["apt-get", "update", "-qq"], env=quiet)
    run(["apt-get", "install", "-y", "-qq", "--no-install-recommends", *packages], env=quiet)


def run(argv: Sequence[str | Path], *, cwd: Path | None = None, env: dict[str, str] | None = None) -> str:
    """Run a command to its end and return what it said; BenchError with its last lines if it fails."""
    done = subprocess.run(
        [str(word) for word in argv],
        cwd=cwd,
        env=env,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        check=False,
    )
    if done.returncode != 0:
        tail = "\n".join(done.stdout.splitlines()[-25:])
        raise BenchError(f"{' '.join(map(str, argv))} failed with {done.returncode}:\n{tail}")
    return done.stdout


def mirror() -> str:
    """The Debian mirror this machine uses; Debian's own where the machine is not Debian."""
    if "\nID=debian\n" in "\n" + Path("/etc/os-release").read_text():
        found = run(["apt-get", "indextargets", "--format", "$(REPO_URI)", "Created-By: Packages"]).split()
        if found:
            return found[0]
    return "http://deb.debian.org/debian/"
