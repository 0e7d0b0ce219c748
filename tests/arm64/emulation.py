"""An arm64 Debian 12 in a folder, and its Python run by qemu's user-mode emulation: neither root nor binfmt is needed.

Debian's packages come through an apt configuration of our own, so that nothing of this machine's dpkg is changed; they
are unpacked with `dpkg -x` and kept in the cache of the test bench (`tests/bench/image/cache.py`).
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from tests.bench.image import cache
from tests.bench.image.host import BenchError, install, mirror, run
from tests.locked import lines

QEMU = "qemu-aarch64-static"
QEMU_PACKAGE = "qemu-user-static"
STRIP_PACKAGE = "binutils-multiarch"
SUITE = "bookworm"
WANTED = {"bookworm": ("python3.11", "libstdc++6", "libgcc-s1"), "trixie": ("python3.13", "libstdc++6", "libgcc-s1")}
KEYS = Path("/usr/share/keyrings/debian-archive-keyring.gpg")
CHECKOUT = Path(__file__).resolve().parents[2]
TESTING = ("hypothesis", "iniconfig", "packaging", "pluggy", "Pygments", "pytest", "sortedcontainers")
"""What the tests that run under emulation need next to the installation, in the versions of requirements.lock."""


def require() -> None:
    """Install what is missing when root, else say the one command. Raises BenchError."""
    missing = [QEMU_PACKAGE] if shutil.which(QEMU) is None else []
    missing += ["debian-archive-keyring"] if not KEYS.exists() else []
    missing += [STRIP_PACKAGE] if not _strips_both() else []
    if not missing:
        return
    if os.geteuid() != 0:
        command = f"sudo apt-get install --no-install-recommends {' '.join(missing)}"
        raise BenchError(f"make test-arm64 emulates an arm64 processor. Once: {command}   then again")
    install(missing)


def _strips_both() -> bool:
    """Whether `strip` reads the libraries of both architectures, as packaging/slim.py needs it to."""
    if shutil.which("strip") is None:
        return False
    printed = subprocess.run(["strip", "--help"], capture_output=True, text=True, check=False).stdout.split()
    return {"elf64-x86-64", "elf64-littleaarch64"} <= set(printed)


def sysroot(suite: str = SUITE) -> Path:
    """A folder with a Debian's own Python for arm64 and the libraries that it loads."""

    def build(work: Path) -> None:
        apt = work / "apt"
        for folder in ("state/lists/partial", "cache/archives/partial", "etc/preferences.d"):
            (apt / folder).mkdir(parents=True)
        (apt / "status").touch()
        (apt / "etc" / "sources.list").write_text(f"deb [signed-by={KEYS}] {mirror()} {suite} main\n")
        (apt / "apt.conf").write_text(
            'APT::Architecture "arm64"; APT::Architectures { "arm64"; }; APT::Install-Recommends "false";\n'
            f'Dir::State "{apt}/state"; Dir::State::status "{apt}/status"; Dir::Cache "{apt}/cache";\n'
            f'Dir::Etc "{apt}/etc"; Dir::Etc::sourceparts "/dev/null"; Acquire::Languages "none";\n'
            'APT::Sandbox::User "root"; Debug::NoLocking "true";\n'
        )
        env = {**os.environ, "APT_CONFIG": str(apt / "apt.conf")}
        run(["apt-get", "update", "-qq"], env=env)
        run(["apt-get", "install", "--download-only", "-y", "-qq", *WANTED[suite]], env=env)
        for package in sorted((apt / "cache" / "archives").glob("*.deb")):
            run(["dpkg-deb", "-x", package, work / "root"])
        if not (work / "root" / "lib").exists():  # from Debian 13 on packages have it below usr alone
            (work / "root" / "lib").symlink_to("usr/lib")
        shutil.rmtree(apt)

    key = cache.key_of(suite, *WANTED[suite], Path(__file__).read_bytes())
    return cache.artefact("arm64-root", key, build) / "root"


def testing() -> Path:
    """A folder with pytest and hypothesis for arm64."""
    wanted = lines(TESTING)

    def build(work: Path) -> None:
        platforms = [f"--platform=manylinux_2_{minor}_aarch64" for minor in range(36, 16, -1)]
        chosen = ["--implementation=cp", "--python-version=3.11", "--abi=cp311", "--abi=abi3", "--abi=none", *platforms]
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
        listed = work / "requirements.txt"
        listed.write_text(wanted)
        into = [
            "--platform=manylinux2014_aarch64",
            "--target",
            work / "site",
            "--require-hashes",
            "--requirement",
            listed,
        ]
        run([*pip, "--only-binary=:all:", *chosen, *into])

    return cache.artefact("arm64-testing", cache.key_of(wanted), build) / "site"


def build_packages(architecture: str) -> None:
    """Build the Debian packages of this checkout for an architecture, again; wheels stay in the cache."""
    out = _packages(architecture)
    for old in out.glob("*.deb"):
        old.unlink()
    env = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "PYTHON": sys.executable, "ARCH": architecture}
    wheels = cache.folder() / "deb" / "wheels" / architecture
    done = subprocess.run(
        [CHECKOUT / "packaging" / "build-deb.sh", out, wheels], env=env, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise BenchError(f"make deb ARCH={architecture}: {done.stderr[-2000:]}")
    print("\n".join(line for line in done.stdout.splitlines() if line.startswith(("slim", "build-deb"))), flush=True)


def package(architecture: str, name: str = "pointclick-onboard") -> Path:
    """A package that was built."""
    (found,) = _packages(architecture).glob(f"{name}_*_{architecture}.deb")
    return found


def _packages(architecture: str) -> Path:
    """In the checkout: another one's may be built at the same time, and `make clean` takes these away."""
    return CHECKOUT / "build" / "tested" / architecture
