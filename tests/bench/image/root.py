"""The guest's disks: Debian 12 with systemd and this kernel's modules; and the locked Python packages."""

import shutil
import sys
from pathlib import Path

from packaging.utils import canonicalize_name

from tests.bench.image import cache
from tests.bench.image.host import mirror, run
from tests.locked import lines, versions

SUITE = "bookworm"
PACKAGES = "systemd systemd-sysv dbus udev kmod python3 python3-venv iproute2 iputils-ping v4l-utils procps"
MASKED = """apt-daily.timer apt-daily-upgrade.timer dpkg-db-backup.timer e2scrub_all.timer e2scrub_reap.service
    fstrim.timer systemd-timesyncd.service getty@tty1.service console-getty.service systemd-logind.service"""
DISK_SIZE = "2200M"

VIDEO = """gir1.2-gst-plugins-base-1.0 gir1.2-gst-rtsp-server-1.0 gir1.2-gstreamer-1.0 gstreamer1.0-libav
    gstreamer1.0-libcamera gstreamer1.0-plugins-bad gstreamer1.0-plugins-base gstreamer1.0-plugins-good libcamera-ipa
    libcamera-tools python3-gi"""
"""What docs/camera.md asks for, for all but V4L2; libcamera's `cam`; and an RTSP server to test with."""
REGISTRY = "import gi; gi.require_version('Gst', '1.0'); from gi.repository import Gst; Gst.init(None)"
"""Has GStreamer look through its plugins, which takes a guest much longer than the host."""

CHECKOUT = Path(__file__).resolve().parents[3]
GUEST = Path(__file__).resolve().parents[1] / "guest"
INSTALLED = ("bench-mount", "bench-agent.service")
"""Files of `guest/` that are inside the image; the others are read from the checkout at every boot."""

INSTALL = "/opt/pointclick"
PACKAGES_AT = f"{INSTALL}-packages"
NOT_IN_GUEST = """affine ast_serialize click-plugins cligj contourpy cycler execnet fonttools kiwisolver librt
    matplotlib mypy mypy_extensions pyparsing pyproj pytest-xdist rasterio ruff"""
"""Of requirements.lock, what neither the daemon nor a test inside the guest asks for."""


def root(kernel: Path) -> Path:
    """The guest's root file system, an ext4 image; a guest writes to a layer of its own above it."""
    files = [(GUEST / name).read_bytes() for name in INSTALLED]
    base_key = cache.key_of(SUITE, PACKAGES)
    video_key = cache.key_of(base_key, VIDEO, REGISTRY)
    key = cache.key_of(video_key, kernel.name, MASKED, DISK_SIZE, *files, Path(__file__).read_bytes())

    def with_video(work: Path) -> None:
        _with_video(cache.artefact("debian", base_key, _debian) / "debian.tar", work)

    def build(work: Path) -> None:
        tree = work / "tree"
        tree.mkdir()
        run(["tar", "-xf", cache.artefact("video", video_key, with_video) / "debian.tar", "-C", tree])
        shutil.copytree(kernel / "modules" / "lib" / "modules", tree / "lib" / "modules", symlinks=True)
        _configure(tree)
        run(["mke2fs", "-q", "-t", "ext4", "-O", "^has_journal", "-d", tree, work / "root.img", DISK_SIZE])
        shutil.rmtree(tree)

    return cache.artefact("root", key, build) / "root.img"


def _debian(work: Path) -> None:
    tree = work / "tree"
    include = ",".join(PACKAGES.split())
    run(["debootstrap", "--variant=minbase", f"--include={include}", SUITE, tree, mirror()])
    # Where the unit's program lives: a virtual environment, as on an aircraft. Its packages are the other disk.
    run(["chroot", tree, "/usr/bin/python3", "-m", "venv", INSTALL])
    _packed(tree, work)


def _with_video(debian: Path, work: Path) -> None:
    """The same with GStreamer and libcamera, installed as a user would."""
    tree = work / "tree"
    tree.mkdir()
    run(["tar", "-xf", debian, "-C", tree])
    apt: list[str | Path] = [
        "chroot",
        tree,
        "/usr/bin/env",
        "DEBIAN_FRONTEND=noninteractive",
        "/usr/bin/apt-get",
        "-qq",
    ]
    run([*apt, "update"])
    run([*apt, "install", "--yes", "--no-install-recommends", *VIDEO.split()])
    run(["chroot", tree, "/usr/bin/env", "HOME=/root", "/usr/bin/python3", "-c", REGISTRY])
    _packed(tree, work)


def _packed(tree: Path, work: Path) -> None:
    """`debian.tar` without what no guest reads."""
    for waste in ("var/cache/apt", "var/lib/apt/lists", "usr/share/doc", "usr/share/man", "usr/share/locale"):
        shutil.rmtree(tree / waste)
        (tree / waste).mkdir()
    run(["tar", "-cf", work / "debian.tar", "-C", tree, "."])
    shutil.rmtree(tree)


def _configure(tree: Path) -> None:
    (tree / "etc" / "hostname").write_text("uav\n")
    (tree / "etc" / "hosts").write_text("127.0.0.1 localhost uav\n")
    (tree / "etc" / "fstab").write_text(f"/dev/ubdb {PACKAGES_AT} squashfs ro 0 0\n")
    (tree / PACKAGES_AT.lstrip("/")).mkdir()
    (site,) = (tree / INSTALL.lstrip("/")).glob("lib/python3.*/site-packages")
    (site / "locked-packages.pth").write_text(f"{PACKAGES_AT}\n")
    units = tree / "etc" / "systemd" / "system"
    for unit in MASKED.split():
        link = units / unit
        link.unlink(missing_ok=True)
        link.symlink_to("/dev/null")
    (units / "default.target").unlink(missing_ok=True)
    (units / "default.target").symlink_to("/lib/systemd/system/multi-user.target")
    mount, service = INSTALLED
    shutil.copy(GUEST / mount, tree / "usr" / "local" / "sbin" / mount)
    (tree / "usr" / "local" / "sbin" / mount).chmod(0o755)
    shutil.copy(GUEST / service, units / service)
    wants = units / "multi-user.target.wants"
    wants.mkdir(exist_ok=True)
    (wants / service).symlink_to(f"../{service}")


def packages() -> Path:
    """The packages of requirements.lock for the guest's Python 3.11, a squashfs image."""
    wanted = lines(sorted(set(versions()) - {canonicalize_name(name) for name in NOT_IN_GUEST.split()}))

    def build(work: Path) -> None:
        listed = work / "requirements.txt"
        listed.write_text(wanted)
        platforms = [f"manylinux_2_{minor}_x86_64" for minor in range(36, 4, -1)]
        platforms += ["manylinux2014_x86_64", "manylinux2010_x86_64", "manylinux1_x86_64", "linux_x86_64"]
        run(
            [
                *(sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"),
                *("--no-deps", "--only-binary=:all:", "--implementation=cp", "--python-version=3.11"),
                *("--abi=cp311", "--abi=abi3", "--abi=none"),
                *(f"--platform={name}" for name in platforms),
                *("--target", work / "packages", "--require-hashes", "--requirement", listed),
            ]
        )
        compress = ["-comp", "zstd", "-Xcompression-level", "3", "-quiet", "-no-progress", "-all-root"]
        run(["mksquashfs", work / "packages", work / "packages.squashfs", *compress])
        shutil.rmtree(work / "packages")

    return cache.artefact("packages", cache.key_of(wanted), build) / "packages.squashfs"
