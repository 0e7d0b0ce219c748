"""What is installed: the lock, and `pip install .` alone with none of the aircraft's packages beside it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from contract.camera import Camera
from contract.feature_set import FeatureSet, Status
from onboard.events.types import Frame
from onboard.storage.mcap_writer import SessionRecorder

ROOT = Path(__file__).resolve().parents[1]
AIRCRAFT_ONLY = ("cv2", "scipy", "mavsdk", "pymavlink", "serial", "mcap", "pydantic", "PIL", "tqdm")
CAPTURE_NS = 1_700_000_000_000_000_000
HEIGHT_M = 120.0


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new environment's folder of programs, with the package and its base dependencies and nothing else."""
    folder = tmp_path_factory.mktemp("ground")
    # A copy of the sources: setuptools leaves its build folder beside them.
    shutil.copytree(
        ROOT,
        folder / "source",
        ignore=shutil.ignore_patterns(".*", "out", "build", "*.egg-info", "tests", "docs", "__pycache__"),
    )
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True, timeout=120)
    pip = [folder / "venv" / "bin" / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    done = subprocess.run(
        [*pip, "--constraint", ROOT / "requirements.lock", folder / "source"],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return folder / "venv" / "bin"


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of one picture: a camera that looks straight down at level ground, on a lattice of features."""
    camera = Camera.from_field_of_view(640, 480, 40.0)
    uv = [(float(u), float(v)) for u in range(40, 640, 80) for v in range(40, 480, 80)]
    level = FeatureSet(
        "uav", 1, 0, CAPTURE_NS, Status.OK, camera,
        camera_lat_deg=-43.38, camera_lon_deg=172.4, camera_height_m=HEIGHT_M,
        R_enu_cam=np.diag([1.0, -1.0, -1.0]), common_cov=1e-4 * np.eye(9),
        plane_per_m=np.array([1.0 / HEIGHT_M, 0.0, 0.0]), plane_sigma_relative=1e-3, roughness=1e-5,
        uv_px=np.array(uv), inverse_depth_per_m=np.full(len(uv), 1.0 / HEIGHT_M),
        sigma_inverse_depth_per_m=np.full(len(uv), 1e-6),
    )  # fmt: skip
    path = tmp_path_factory.mktemp("session") / "session.mcap"
    with SessionRecorder(path, "uav") as out:
        out.write_event(Frame(CAPTURE_NS, 0, None, "picture.png"))
        out.write_set(level)
    return path


def run(environment: Path, program: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """A program of the new environment, from a folder without our sources."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    return subprocess.run(
        [environment / program, *map(str, arguments)],
        cwd=environment, env=clean, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


def test_the_lock_holds_every_dependency_at_a_version_that_will_do() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [
        *project["dependencies"],
        *(line for extra in project["optional-dependencies"].values() for line in extra),
    ]
    pins = (ROOT / "requirements.lock").read_text().splitlines()
    locked = dict(line.split("==") for line in pins if line and not line.startswith("#"))
    versions = {canonicalize_name(name): version for name, version in locked.items()}
    for requirement in map(Requirement, wanted):
        assert requirement.specifier.contains(versions[canonicalize_name(requirement.name)]), requirement


def test_none_of_the_aircrafts_packages_is_there(environment: Path) -> None:
    probe = "import importlib.util as u, sys; print([n for n in sys.argv[1:] if u.find_spec(n)])"
    assert run(environment, "python", "-c", probe, *AIRCRAFT_ONLY).stdout.strip() == "[]"
    present = run(environment, "python", "-c", probe, "numpy", "zenoh", "contract", "ground").stdout
    assert present.strip() == "['numpy', 'zenoh', 'contract', 'ground']"


def test_a_recording_can_be_clicked(environment: Path, session: Path) -> None:
    done = run(environment, "pc-ground", "click", 319.5, 239.5, "--frame", 0, "--from", session, "--format", "json")
    assert (done.returncode, done.stderr) == (0, "")
    answer = json.loads(done.stdout)
    assert answer["lat_deg"] == pytest.approx(-43.38, abs=1e-7)
    assert answer["lon_deg"] == pytest.approx(172.4, abs=1e-7)
    assert answer["height_amsl_m"] == pytest.approx(0.0, abs=0.01)


def test_a_link_without_an_aircraft_is_one_clear_line(environment: Path) -> None:
    done = run(environment, "pc-ground", "click", 1, 2, "--connect", "tcp/127.0.0.1:9")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("pc-ground: error: ")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["click", "1", "2", "--from", "nowhere.mcap"], "nowhere.mcap"),
        (["click", "1", "nan"], "finite"),
        (["click", "--batch", "clicks.csv"], "--from"),
        (["clack"], "clack"),
    ],
)
def test_wrong_usage_is_told(environment: Path, arguments: list[str], said: str) -> None:
    done = run(environment, "pc-ground", *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def test_the_aircrafts_command_says_what_it_needs(environment: Path) -> None:
    done = run(environment, "pc-onboard", "replay", "--frames", ".", "--telemetry", "x.tlog", "--camera", "c.json")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "pointclick[onboard]" in done.stderr
