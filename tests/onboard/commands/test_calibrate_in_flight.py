"""`pc-onboard calibrate --from`: a recorded flight corrects the camera file it was flown with."""

import json
from pathlib import Path

import pytest

from contract.camera import UNKNOWN_SIGMA, Camera
from onboard.__main__ import main
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from tests.scenarios.flights import simulated

pytestmark = pytest.mark.xdist_group("calibrate in flight")  # one worker: what they share is made once

CAMERA = Camera.from_field_of_view(320, 240, 50.0)
TURNS = PathSpec("turns", leg_m=120.0, speed_m_s=20.0)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight with turns, recorded with pictures and a camera file whose focal length is 3 % too long."""
    folder = tmp_path_factory.mktemp("lens")
    session = simulated(SessionSpec(DescribedSpec(TURNS), seconds=24.0, rate_hz=2.5, camera=CAMERA, clicks_per_frame=1))
    filed = json.loads((session / "camera.json").read_text())
    filed["fx_px"] *= 1.03
    filed["fy_px"] *= 1.03
    (folder / "camera.json").write_text(json.dumps(filed))
    (folder / "config.toml").write_text(
        (session / "config.toml").read_text() + '\n[recording]\npictures = "lossless"\n'
    )
    words = [
        "replay", "--config", str(folder / "config.toml"), "--frames", str(session / "frames"),
        "--telemetry", str(session / "telemetry.tlog"), "--camera", str(folder / "camera.json"),
        "--stamps", str(session / "stamps.csv"), "--out", str(folder / "session.mcap"),
    ]  # fmt: skip
    assert main(words) == 0
    return folder / "session.mcap"


@pytest.mark.long
def test_a_flight_with_turns_gives_a_better_camera_file(recorded: Path, tmp_path: Path) -> None:
    out = tmp_path / "camera.json"
    assert main(["calibrate", "--from", str(recorded), "--out", str(out)]) == 0
    found = Camera.from_json(out)
    assert found.sigma[0] < 0.5 * UNKNOWN_SIGMA[0]
    assert abs(found.fx_px / CAMERA.fx_px - 1.0) < 3.0 * found.sigma[0]
    assert abs(found.fx_px / CAMERA.fx_px - 1.0) < 0.015
    assert json.loads(out.read_text())["calibration"]["from_flight"] == recorded.name
