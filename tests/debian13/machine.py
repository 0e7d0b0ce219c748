"""A Debian 13 in a folder, which a `chroot` enters: this checkout in it, and the packages that its own Python builds.

Raspberry Pi OS 13 has the same Python. The fresh system is debootstrapped once and kept in the cache of the test bench.
"""

import os
import shutil
import subprocess
from pathlib import Path

from tests.arm64 import emulation
from tests.bench.image import cache
from tests.bench.image.host import BenchError, install, mirror, run

SUITE, PYTHON = "trixie", "3.13"
ARCHITECTURES = ("amd64", "arm64")
PACKAGES = """binutils-multiarch ca-certificates git iproute2 libpython3-stdlib make procps python3 python3-venv systemd
    systemd-sysv"""
NEEDED = {"debootstrap": "debootstrap", "unshare": "util-linux"}
CHECKOUT = Path(__file__).resolve().parents[2]
ROOT = CHECKOUT / "build" / "debian13"
INSIDE = "work/checkout"
CERTIFICATES = Path("/etc/ssl/certs/ca-certificates.crt")
ENTER = f"""
mount -t proc proc "$1/proc" && mount --rbind /sys "$1/sys" && mount --rbind /dev "$1/dev" || exit 125
if [ -d "$2" ]; then mount --bind "$2" "$1/work/shared" && mount -o remount,bind,ro "$1/work/shared" || exit 125; fi
exec chroot "$1" env -i HOME=/root LANG=C.UTF-8 PATH=/usr/sbin:/usr/bin:/sbin:/bin DEBIAN_FRONTEND=noninteractive \\
    NODE_EXTRA_CA_CERTS={CERTIFICATES} sh -c "cd /{INSIDE} && $3"
"""
"""Mounts of a name space that ends with the command: nothing of them is left on this machine."""


def require() -> None:
    """Install what is missing. Raises BenchError, with what to do, where a Debian 13 cannot be made here."""
    if os.geteuid() != 0:
        raise BenchError("a Debian 13 is made and entered by root: sudo make test-debian13")
    install([package for program, package in NEEDED.items() if shutil.which(program) is None])
    emulation.require()  # of the arm64 package


def refresh() -> None:
    """Make the folder again: a fresh Debian 13, and this checkout as it is, with its history."""

    def build(work: Path) -> None:
        include = ",".join(PACKAGES.split())
        run(["debootstrap", "--variant=minbase", f"--include={include}", SUITE, work / "tree", mirror()])

    fresh = cache.artefact("debian13", cache.key_of(SUITE, PACKAGES), build) / "tree"
    shutil.rmtree(ROOT, ignore_errors=True)
    ROOT.parent.mkdir(exist_ok=True)
    run(["cp", "-a", "--reflink=auto", fresh, ROOT])
    (ROOT / "work" / "shared").mkdir(parents=True)
    if CERTIFICATES.exists():
        shutil.copy(CERTIFICATES, ROOT / str(CERTIFICATES).lstrip("/"))
    run(["git", "clone", "--quiet", "--no-hardlinks", CHECKOUT, ROOT / INSIDE])
    changed = run(["git", "-C", CHECKOUT, "diff", "--name-only", "HEAD"]).splitlines()
    changed += run(["git", "-C", CHECKOUT, "ls-files", "--others", "--exclude-standard"]).splitlines()
    for name in changed:
        (ROOT / INSIDE / name).unlink(missing_ok=True)
        if (CHECKOUT / name).exists():
            (ROOT / INSIDE / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(CHECKOUT / name, ROOT / INSIDE / name)
    there("git config --global --add safe.directory '*'; make --no-print-directory venv")


def call(command: str) -> int:
    """Run a shell's command in the checkout there, with this terminal; its exit code."""
    return subprocess.run(_entering(command), check=False).returncode


def there(command: str) -> str:
    """Run a shell's command in the checkout there; what it printed. Raises BenchError with its last lines."""
    return run(_entering(command))


def build_packages(architecture: str) -> None:
    """Build the packages there, by Debian 13's own Python."""
    printed = there(f"ARCH={architecture} PYTHON=.venv/bin/python packaging/build-deb.sh build/{architecture}")
    print("\n".join(line for line in printed.splitlines() if line.startswith("build-deb")), flush=True)


def package(architecture: str, name: str = "pointclick-onboard") -> Path:
    """A package that was built."""
    (found,) = (ROOT / INSIDE / "build" / architecture).glob(f"{name}_*_{architecture}.deb")
    return found


def _entering(command: str) -> list[str]:
    shared = CHECKOUT.parent / "shared"
    return ["unshare", "--mount", "--propagation", "private", "sh", "-c", ENTER, "sh", str(ROOT), str(shared), command]
