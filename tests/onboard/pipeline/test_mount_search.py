"""How a camera sits, found by the pictures of a flight among 24 ways, and said only where they tell."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from contract.camera import Camera
from contract.rotations import log_so3, mount_rotation
from onboard.__main__ import main
from onboard.commands import setup
from onboard.config.files import load_config_files
from onboard.config.schema import Config, to_toml
from onboard.pipeline.mount_search import MountSearch, Ranking, orientations
from onboard.replay.runner import Flight
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from tests.rest_long import rest_long
from tests.scenarios.flights import simulated

pytestmark = pytest.mark.xdist_group("mount search")  # one worker: what they share is made once

CAMERA = Camera.from_field_of_view(320, 240, 60.0)
TURNS = PathSpec("turns", speed_m_s=15.0, height_m=100.0, leg_m=80.0)
SIDEWAYS = (0.0, -90.0, 90.0)


def session(mount: tuple[float, float, float]) -> Path:
    """A flight whose camera sits 7 degrees off that."""
    spec = SessionSpec(
        DescribedSpec(TURNS), seconds=12.0, rate_hz=3.0, camera=CAMERA, clicks_per_frame=1,
        mount_deg=mount, boresight_deg=(4.0, -3.0, 5.0),
    )  # fmt: skip
    return simulated(spec)


def ranked(folder: Path, seconds: float = 99.0, wrong: bool = True) -> Ranking:
    """Told a mount that is wrong, which must not matter."""
    table = tomllib.loads((folder / "config.toml").read_text())
    table["mount"].update({"roll_deg": 180.0, "yaw_deg": 30.0} if wrong else {})
    config = Config.model_validate(table)
    flight = Flight.open(config, CAMERA, folder / "frames", folder / "telemetry.tlog", folder / "stamps.csv")
    until_ns = flight.stamps_ns[0] + round(seconds * 1e9)
    return MountSearch(config, CAMERA).ranking((t, e) for t, e in flight.events() if t < until_ns)


def test_there_are_24_ways_and_each_is_another() -> None:
    turns = [mount_rotation(*angles) for angles in orientations()]
    assert len(turns) == 24
    apart = [np.linalg.norm(log_so3(a.T @ b)) for i, a in enumerate(turns) for b in turns[:i]]
    assert min(apart) > 1.5


@pytest.mark.parametrize("mount", rest_long([((0.0, -90.0, 0.0),), (SIDEWAYS,)]))
def test_the_pictures_of_a_flight_with_turns_tell_how_the_camera_sits(mount: tuple[float, float, float]) -> None:
    ranking = ranked(session(mount))
    assert ranking.decided == mount and ranking.pictures > 20
    assert ranking.costs[0] < 0.2 * ranking.costs[1]


def test_too_few_pictures_decide_nothing() -> None:
    ranking = ranked(session(SIDEWAYS), 1.2)
    assert ranking.decided is None and ranking.pictures < 5


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The flight as a session with pictures, configured as if the camera looked with its top to the nose."""
    folder, flight = tmp_path_factory.mktemp("mount"), session(SIDEWAYS)
    table = tomllib.loads((flight / "config.toml").read_text())
    table["mount"]["yaw_deg"], table["recording"] = 0.0, {"pictures": "lossless"}
    (folder / "config.toml").write_text(to_toml(Config.model_validate(table)))
    words = ["--config", str(folder / "config.toml"), "--frames", str(flight / "frames"), "--camera",
             str(flight / "camera.json"), "--telemetry", str(flight / "telemetry.tlog"), "--stamps",
             str(flight / "stamps.csv"), "--out", str(folder / "session.mcap")]  # fmt: skip
    assert main(["replay", *words]) in (0, 3)
    return folder / "session.mcap"


def test_setup_corrects_the_mount_by_the_first_flight(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(setup, "DOCTOR_S", 0.1)  # it finds no camera, however long it looks
    out = tmp_path / "config.toml"
    capsys.readouterr()
    assert main(["setup", "--out", str(out), "--yes", "--first-flight", str(recorded)]) == 1
    config = load_config_files(out)
    assert (config.mount.roll_deg, config.mount.pitch_deg, config.mount.yaw_deg) == SIDEWAYS
    assert config.recording.pictures == "lossless"
    assert "0/-90/90 (" in capsys.readouterr().out
    assert main(["setup", "--out", str(out), "--yes", "--first-flight", str(recorded)]) == 2
    assert "--force" in capsys.readouterr().err
