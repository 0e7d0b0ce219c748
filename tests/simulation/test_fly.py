"""The command line: what it accepts, and one clear line with exit 2 for what it does not."""

from pathlib import Path

import pytest

from simulation.flight import DescribedSpec, RecordedSpec
from simulation.fly import main, session_spec


def test_a_described_flight_takes_its_options(tmp_path: Path) -> None:
    spec, _ = session_spec(
        "--path survey --height-m 120 --crab-deg -8 --mount 0 -60 90 --relief-m 7 --gps-slow-m 1.5 2.5 --size 320x200 "
        f"--hfov-deg 60 --seed 9 --no-velocity --attitude none --out {tmp_path}".split()
    )
    assert isinstance(spec.flight, DescribedSpec)
    assert (spec.flight.path.kind, spec.flight.path.height_m, spec.flight.path.crab_deg) == ("survey", 120.0, -8.0)
    assert (spec.flight.telemetry.slow_horizontal_m, spec.flight.telemetry.slow_vertical_m) == (1.5, 2.5)
    assert spec.mount_deg == (0.0, -60.0, 90.0)
    assert spec.camera.size_px == (320, 200)
    assert (spec.attitude, spec.velocity, spec.terrain.relief_m, spec.seed) == ("none", False, 7.0, 9)


def test_a_recorded_flight_takes_its_options(tmp_path: Path) -> None:
    spec, _ = session_spec(f"--recorded plane_turn --start 3 --log part --out {tmp_path}".split())
    assert isinstance(spec.flight, RecordedSpec)
    assert (spec.flight.start_s, spec.flight.whole_log) == (3.0, False)
    assert spec.camera.size_px == (640, 480)


def test_a_thermal_flight_takes_its_options(tmp_path: Path) -> None:
    spec, _ = session_spec(
        f"--path straight --thermal agc --person 4 5 8 --rocks-km2 50 --shutter 2 --shutter 9 --out {tmp_path}".split()
    )
    assert spec.thermal is not None
    assert (spec.thermal.output, spec.thermal.rocks_km2, spec.thermal.shutter_s) == ("agc", 50.0, (2.0, 9.0))
    assert [(s.mover.start_m, s.excess_k) for s in spec.thermal.sources] == [((4.0, 5.0), 8.0)]


def test_it_writes_a_session(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = f"--recorded copter_leg --seconds 0.4 --size 160x120 --out {tmp_path / 's'}".split()
    assert main(arguments) == 0
    assert "2 pictures" in capsys.readouterr().out
    assert len(list((tmp_path / "s/frames").iterdir())) == 2


def test_a_recording_of_no_such_name_is_one_line_with_those_there_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Other usage that cannot be: tests/transcripts/simulation-fly.txt."""
    assert main(f"--recorded nothing --out {tmp_path / 's'}".split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "known: copter_leg" in line and not (tmp_path / "s").exists()


def test_an_unknown_option_exits_2(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--path", "straight", "--hieght-m", "100", "--out", str(tmp_path)])
    assert caught.value.code == 2
