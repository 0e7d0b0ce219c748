"""A recorded flight whose positions and attitudes are in two logs with different clocks: clicks are as with the whole.

Replayed by the command, as its owner would: `--telemetry A --telemetry B`.
"""

from pathlib import Path

import numpy as np
import pytest

from contract.camera import Camera
from ground.recording import Recording
from onboard.__main__ import main
from onboard.events.types import Attitude, PositionFix
from onboard.telemetry.log_files import read_log
from simulation.flight import RecordedSpec
from simulation.session import SessionSpec
from tests.scenarios.flights import CHI2_90, Outcome, click, simulated
from tests.split_logs import ahead, another_receiver, only, table, together

AHEAD_S = 83.4


def replayed(folder: Path, out: Path, *logs: Path) -> Outcome:
    """What the command makes of the flight's pictures with these logs."""
    named = {name: folder / name for name in ("frames", "config.toml", "camera.json", "stamps.csv")}
    words = [word for log in logs for word in ("--telemetry", str(log))]
    for option, path in zip(("--frames", "--config", "--camera", "--stamps"), named.values(), strict=True):
        words += [option, str(path)]
    assert main(["replay", *words, "--out", str(out)]) == 0
    recording = Recording(str(out))
    (vehicle,) = recording.vehicles
    return click(folder, {frame: recording.by_frame(vehicle, frame) for frame in recording.frames(vehicle)}, None)


@pytest.mark.long
def test_clicks_are_as_good_as_with_the_whole_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    camera = Camera.from_field_of_view(320, 240, 50.0)
    folder = simulated(SessionSpec(RecordedSpec("plane_turn", 12.0), seconds=10.0, rate_hz=4.0, camera=camera))
    log = read_log(folder / "telemetry.tlog")
    receiver = another_receiver(log, np.random.default_rng(0), ahead_s=AHEAD_S, decimals=5)
    angles = together(receiver, ahead(only(log, Attitude), AHEAD_S))
    one = replayed(folder, tmp_path / "one.mcap", table(only(log, PositionFix, Attitude), tmp_path / "whole.csv"))
    capsys.readouterr()
    places = table(only(log, PositionFix), tmp_path / "places.csv")
    two = replayed(folder, tmp_path / "two.mcap", places, table(angles, tmp_path / "angles.csv"))
    noted = capsys.readouterr().err
    assert "positions from places.csv; attitude from angles.csv; clock of angles.csv moved by -83." in noted
    assert two.solved >= 0.95 * one.solved > 0.7, (one.reported, two.reported)
    assert len(two.errors_m) > 0.9 * len(one.errors_m), (one.reported, two.reported)
    assert two.inside_99 >= 0.97 and np.mean(two.chi2 < CHI2_90) >= 0.85, two.reported
    # Attitudes some hundredths of a second off, of a receiver with one position a second, are within what is stated.
    assert np.median(two.errors_m) < np.median(one.errors_m) + 0.15 * np.median(one.semi_m), (
        one.reported,
        two.reported,
    )
    assert np.median(two.semi_m) < 1.15 * np.median(one.semi_m), (one.reported, two.reported)
