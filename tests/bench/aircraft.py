"""The aircraft's computer: the guest with our package, its configuration and its unit installed as on a real one."""

import atexit
import functools
import shutil
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

from tests.bench.image.host import run
from tests.bench.image.root import CHECKOUT, INSTALL
from tests.bench.machine import PYTHON, SHARE, Machine

UNIT = "pointclick-onboard.service"
OLD_SETUPTOOLS = 70
PROGRAM = "/usr/bin/pc-onboard"


@functools.cache
def wheel() -> Path:
    """This checkout's wheel, built once a run from a copy: a build leaves nothing in the checkout."""
    folder = Path(tempfile.mkdtemp(prefix="pointclick-wheel-"))
    atexit.register(shutil.rmtree, folder)
    source = folder / "source"
    left_out = shutil.ignore_patterns(".*", "out", "build", "*.egg-info", "__pycache__", "tests", "benchmarks")
    shutil.copytree(CHECKOUT, source, ignore=left_out)
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--disable-pip-version-check"]
    # An old setuptools makes no wheels by itself; that of requirements.lock does, with nothing fetched.
    alone = int(version("setuptools").split(".")[0]) > OLD_SETUPTOOLS
    run([*pip, *(["--no-build-isolation"] if alone else []), "--wheel-dir", folder, source])
    shutil.rmtree(source)
    (built,) = folder.glob("*.whl")
    return built


def install(machine: Machine) -> None:
    """The package into /opt/pointclick by pip, from its wheel alone; its command, its user, its unit."""
    for file in (wheel(), CHECKOUT / "systemd" / UNIT):
        shutil.copy(file, machine.share)
    pip = f"{PYTHON} -m pip install --quiet --no-deps --no-index --disable-pip-version-check --root-user-action=ignore"
    machine.shell(
        f"{pip} {SHARE}/{wheel().name}"
        f" && ln -s {INSTALL}/bin/pc-onboard {PROGRAM}"
        " && useradd --system --no-create-home --shell /usr/sbin/nologin pointclick"
        f" && install -m 644 {SHARE}/{UNIT} /etc/systemd/system/ && systemctl daemon-reload",
        timeout_s=60.0,
    )


def configure(machine: Machine, config: str, camera_file: str) -> None:
    """What an operator writes: configuration and camera file."""
    machine.put("/etc/pointclick/config.toml", config)
    machine.put("/etc/pointclick/camera.json", camera_file)
