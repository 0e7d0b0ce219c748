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


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("--recorded nothing", "known: copter_leg"),
        ("--recorded plane_turn --start 50 --seconds 30", "is not within it"),
        ("--recorded plane_turn --height-m 100", "own path and telemetry"),
        ("--recorded plane_turn --autopilot ordinary", "autopilot: only for --path"),
        ("--path straight --start 3", "--start"),
        ("--path straight --size 640", "640x480"),
        ("--path straight --hfov-deg 190", "between 1 and 150"),
        ("--path straight --camera /nowhere.json", "/nowhere.json"),
        ("--path waypoints", "at least two"),
        ("--path straight --relief-m 900 --height-m 100", "fly higher"),
        ("--path straight --contrast 9", "contrast"),
        ("--path straight --seconds 0", "above 0"),
        ("--path straight --undulation-m nan", "finite"),
        ("--path straight --person 1 2 8", "belong to --thermal"),
        ("--path straight --thermal agc --texture sea", "only land"),
    ],
)
def test_bad_usage_is_one_line_and_writes_nothing(
    arguments: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*arguments.split(), "--out", str(tmp_path / "s")]) == 2
    reported = capsys.readouterr().err
    assert says in reported
    assert reported.count("\n") == 1
    assert not (tmp_path / "s").exists()


def test_an_unknown_option_exits_2(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--path", "straight", "--hieght-m", "100", "--out", str(tmp_path)])
    assert caught.value.code == 2
