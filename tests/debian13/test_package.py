"""The packages for Debian 13 and Raspberry Pi OS 13, installed there by apt and started; arm64 under emulation."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.arm64.emulation import QEMU, sysroot
from tests.arm64.installation import ENVIRONMENT, Installation
from tests.bench.image.host import run
from tests.debian13.machine import ARCHITECTURES, INSIDE, PYTHON, ROOT, SUITE, package, there


@pytest.fixture(scope="module")
def installed() -> str:
    """The output of apt on the installation, which brings Debian's own Python alone."""
    names = "pointclick-onboard pointclick-onboard-terrain"
    return there(
        f"cd build/amd64; apt-get install -y -qq --no-install-recommends ./pointclick-onboard_*.deb "
        f"./pointclick-onboard-terrain_*.deb && dpkg -s {names} | grep ^Status"
    )


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_it_is_for_the_python_of_debian_13_and_for_no_other(architecture: str) -> None:
    depends, version = (run(["dpkg-deb", "-f", package(architecture), key]) for key in ("Depends", "Version"))
    assert f"python3 (>= {PYTHON}), python3 (<< 3.14)" in depends
    assert version.strip().endswith("+deb13")
    listed = run(["dpkg-deb", "-c", package(architecture)])
    assert f"/opt/pointclick/lib/python{PYTHON}/site-packages/onboard/__init__.py" in listed
    assert "cpython-311" not in listed and "python3.11" not in listed


def test_apt_installs_it_with_its_user_and_service(installed: str) -> None:
    assert installed.count("install ok installed") == 2
    assert there("systemctl is-enabled pointclick-onboard.service").strip() == "enabled"
    assert "/usr/sbin/nologin" in there("getent passwd pointclick")
    assert there("pc-onboard check-config").strip() == "/etc/pointclick/config.toml: good"
    where = there(
        "/opt/pointclick/bin/python3 -I -c 'import onboard, sys; print(sys.version_info[:2], onboard.__file__)'"
    )
    assert where.startswith("(3, 13) /opt/pointclick/lib/")


def test_a_flight_is_replayed_and_clicked_by_what_is_installed(installed: str) -> None:
    """A flight that the checkout simulates, as its own user, who owns nothing there."""
    program = (
        "from pathlib import Path; from simulation.flight import DescribedSpec; from simulation.paths import PathSpec; "
        "from simulation.session import SessionSpec, fly; "
        "fly(SessionSpec(DescribedSpec(PathSpec()), seconds=3.0), Path('/tmp/flight'))"
    )
    there(f'rm -rf /tmp/flight /tmp/out; .venv/bin/python -c "{program}"')
    files = "--frames frames --telemetry telemetry.tlog --camera camera.json --stamps stamps.csv --config config.toml"
    there(
        "install -d -o pointclick /tmp/out; cd /tmp/flight; "
        f"setpriv --reuid pointclick --clear-groups pc-onboard replay {files} --out /tmp/out/session.mcap"
    )
    click = there("pc-ground click 320 240 --frame 10 --from /tmp/out/session.mcap --format json")
    assert json.loads(click)["status"] == "ok"


def test_the_daemon_starts_under_its_unit_s_command_and_ends_when_asked(installed: str) -> None:
    """Without a camera it waits for one; SIGTERM ends it with 0."""
    unit = there("systemd-analyze verify pointclick-onboard.service 2>&1; true")
    assert "error" not in unit.lower() and "pc-onboard" not in unit, unit
    camera = "[camera]\\ndevice = '/dev/video99'\\nfile = '/tmp/flight/camera.json'\\n"
    words = camera + "[telemetry]\\nurl = 'udpin:127.0.0.1:14550'\\n"
    daemon = "timeout --preserve-status -s TERM 8 setpriv --reuid pointclick --clear-groups pc-onboard run"
    ran = there(
        f'printf "{words}" > /tmp/run.toml; export STATE_DIRECTORY=/tmp/out; '
        f"unshare --net sh -c 'ip link set lo up; {daemon} --config /tmp/run.toml' 2>&1; echo ended $?"
    )
    assert "session of uav begins" in ran and ran.strip().endswith("ended 0"), ran


def test_the_arm64_one_runs_by_the_python_of_debian_13(tmp_path: Path) -> None:
    root = tmp_path / "root"
    shutil.copytree(sysroot(SUITE), root, symlinks=True)
    run(["dpkg-deb", "-x", package("arm64"), tmp_path / "package"])
    for part in ("opt", "etc"):  # a folder `lib` would take the place of Debian's link
        shutil.copytree(tmp_path / "package" / part, root / part, symlinks=True, dirs_exist_ok=True)
    own = str(root / "usr" / "bin" / f"python{PYTHON}")
    python = (QEMU, "-L", str(root), "-0", f"/{ENVIRONMENT}/bin/python3", own)
    arm64 = Installation("arm64", root, python, package("arm64"), package("arm64", "pointclick-onboard-terrain"))
    seen = arm64(
        "-c", "import cv2, numpy, onboard, platform, sys, zenoh; print(platform.machine(), sys.version_info[:2])"
    )
    assert seen.stdout.strip() == "aarch64 (3, 13)", seen.stderr
    checked = arm64("-m", "onboard", "check-config")
    assert (checked.returncode, checked.stdout) == (0, "/etc/pointclick/config.toml: good\n"), checked.stderr


def test_nothing_of_it_stays_mounted_here() -> None:
    mounts = subprocess.run(["cat", "/proc/mounts"], capture_output=True, text=True, check=True).stdout
    assert str(ROOT) not in mounts and (ROOT / INSIDE / "Makefile").exists()
