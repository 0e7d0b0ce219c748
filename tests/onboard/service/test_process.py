"""`pc-onboard run` as a process: started, watched, reloaded, killed, with a fake autopilot on a serial line.

Each takes half a minute of real time, so those are `long` whose claim is also held within a process: a kill by
test_rotating_recorder, a reload by test_daemon, a full disk by test_faults, a reboot by test_link_faults.
"""

import json
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from contract.feature_set import FeatureSet
from ground.recording import Recording
from onboard.__main__ import main
from tests.onboard.service.air import STRAIGHT
from tests.onboard.service.process import ROOT, Aircraft, aircraft
from tests.rest_long import rest_long
from tests.scenarios.flights import Outcome, click
from tests.waiting import eventually

pytestmark = pytest.mark.xdist_group("processes in real time")  # of the long tests, too, one at a time

SPEC = replace(STRAIGHT)


def sets_of(plane: Aircraft, recording: Path) -> dict[int, FeatureSet]:
    kept = Recording(recording)
    found = {frame: kept.by_frame("uav", frame) for frame in kept.frames("uav")}
    return {frame: output for frame, output in found.items() if output is not None}


def clicked(plane: Aircraft, recording: Path) -> Outcome:
    return click(plane.folder, sets_of(plane, recording), None)


def solved_since_the_first(outcome: Outcome) -> float:
    """Share of answering pictures from the first one on that does: how long a start takes is the machine's."""
    are_ok = [outcome.sets[frame].is_ok for frame in sorted(outcome.sets)]
    since = are_ok[are_ok.index(True) :]
    assert len(since) >= 20, outcome.reported
    return sum(since) / len(since)


def pc_onboard(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "onboard", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120)


def lines_of(done: subprocess.CompletedProcess[str]) -> dict[str, bool]:
    return {line["name"]: line["is_good"] for line in json.loads(done.stdout)["lines"]}


def test_a_daemon_flies_answers_for_itself_and_ends_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with aircraft(tmp_path, SPEC) as plane:
        plane.start()
        plane.wait_for("ok")

        def is_reported() -> bool:  # a busy machine may be "overloaded" for a moment
            code = main(["status", "--config", str(plane.config)])
            return (code, capsys.readouterr().out.splitlines()[:1]) == (0, ["state      ok"])

        assert eventually(is_reported)

        def is_well() -> bool:
            """This computer's own disk and temperature are what they are, and it may be busy for a moment."""
            doctor = pc_onboard("doctor", "--config", plane.config, "--json")
            bad = {name for name, good in lines_of(doctor).items() if not good}
            return json.loads(doctor.stdout)["daemon"] is True and bad <= {"disk", "processor"}

        assert eventually(is_well)
        plane.sleep_until(max(12.0, plane.now_s + 6.0))
        plane.signal(signal.SIGTERM)
        assert plane.ended() == 0  # within TimeoutStopSec, and nothing was left behind: see the log below
        (recording,) = plane.recordings
        outcome = clicked(plane, recording)
        assert solved_since_the_first(outcome) > 0.9, outcome.reported
        assert outcome.inside_99 > 0.97, outcome.reported
        assert json.loads((tmp_path / "state" / "alignment.json").read_text())
    assert [line.split(maxsplit=3)[-1] for line in plane.log[-1:]] == ["asked to stop"]
    assert pc_onboard("status", "--config", plane.config).returncode == 3


@pytest.mark.long
def test_kill_9_leaves_a_recording_to_the_last_second_and_a_restart_goes_on(tmp_path: Path) -> None:
    with aircraft(tmp_path, SPEC) as plane:
        plane.start()
        plane.wait_for("ok")
        plane.sleep_until(8.0)
        printed = plane.reported_since(0.0)
        assert printed.frame >= 8
        # It has lived for a second since, by its own clock.
        plane.reported_since(printed.unix_s + 1.0)
        plane.signal(signal.SIGKILL)
        assert plane.ended() == -signal.SIGKILL
        plane.start()
        plane.wait_for("ok")
        plane.sleep_until(min(max(20.0, plane.now_s + 5.0), 25.0))
        plane.signal(signal.SIGTERM)
        assert plane.ended() == 0
        first, second = plane.recordings
        assert max(sets_of(plane, first)) >= printed.frame
        for recording in (first, second):
            outcome = clicked(plane, recording)
            assert len(outcome.errors_m) > 100, outcome.reported
            assert outcome.inside_99 > 0.97, outcome.reported


@pytest.mark.long
def test_an_autopilot_that_reboots_and_a_line_that_is_pulled(tmp_path: Path) -> None:
    with aircraft(tmp_path, SPEC) as plane:
        plane.start()
        plane.wait_for("ok")
        plane.sleep_until(5.0)
        before = len(plane.log)
        plane.autopilot.reboot(4.0)
        plane.stated("telemetry lost", "unsynchronised", since=before)
        plane.wait_for("ok")
        assert plane.autopilot.boots == 2
        plane.signal(signal.SIGINT)
        assert plane.ended() == 0
        outcome = clicked(plane, plane.recordings[0])
        assert outcome.inside_99 > 0.97, outcome.reported


@pytest.mark.long
def test_a_reload_in_flight(tmp_path: Path) -> None:
    with aircraft(tmp_path, SPEC) as plane:
        plane.start()
        plane.wait_for("ok")
        (tmp_path / "config.d").mkdir()
        extra = tmp_path / "config.d" / "50-extra.toml"
        extra.write_text("[tracking]\nfeatuers = 80\n")
        plane.signal(signal.SIGHUP)
        (line,) = plane.logged("ERROR")
        assert "50-extra.toml" in line and "did you mean 'tracking.features'?" in line
        assert len(plane.recordings) == 1
        extra.write_text("[tracking]\nfeatures = 80\n")
        plane.signal(signal.SIGHUP)
        assert eventually(lambda: len(plane.recordings) == 2)
        plane.wait_for("ok")
        plane.signal(signal.SIGTERM)
        assert plane.ended() == 0
        assert len(plane.recordings) == 2
        assert any("a new session begins" in line for line in plane.log)


@pytest.mark.parametrize(
    ("text", "printed"),
    rest_long(
        [
            ("[camera]\nrate = 5\n", "did you mean 'camera.rate_hz'?"),
            ("", "camera.file is not set"),
            ('[camera]\nfile = "/nonexistent/camera.json"\n', "/nonexistent/camera.json"),
        ]
    ),
)
def test_a_configuration_that_cannot_fly_is_one_line_and_exit_2(tmp_path: Path, text: str, printed: str) -> None:
    (tmp_path / "config.toml").write_text(text)
    done = pc_onboard("run", "--config", tmp_path / "config.toml")
    assert done.returncode == 2
    (line,) = done.stdout.splitlines()
    assert printed in line
    assert main(["check-config", "--fly", "--config", str(tmp_path / "config.toml")]) == 2


def test_the_doctor_looks_for_itself_and_calls_what_is_missing_bad(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "config.toml").write_text(
        f'[camera]\ndevice = "/dev/video77"\n[telemetry]\nurl = "serial:{tmp_path / "tty"}:57600"\n'
        f'[link]\nlisten = ["tcp/127.0.0.1:0"]\n[service]\nstate_dir = "{tmp_path / "state"}"\n'
    )
    done = pc_onboard("doctor", "--config", tmp_path / "config.toml", "--json", "--seconds", 2)
    assert done.returncode == 1
    found = lines_of(done)
    assert not any(found[name] for name in ("camera", "rate", "exposure", "telemetry", "rates", "gps", "calibration"))
    assert found["mount"]
    assert main(["doctor", "--config", str(tmp_path / "config.toml"), "--seconds", "0.5"]) == 1
    plain = capsys.readouterr().out.splitlines()
    assert (
        plain[0]
        == "the daemon does not run: looked at what can be seen without it; position and answers were not judged"
    )
    assert plain[1].startswith("BAD camera ")
    assert "\x1b" not in "".join(plain)


@pytest.mark.long  # short: with a daemon, and without an aircraft, above; tests/onboard/commands/test_preflight.py
def test_the_doctor_looks_for_itself_at_a_good_aircraft(tmp_path: Path) -> None:
    with aircraft(tmp_path, SPEC) as plane:
        doctor = pc_onboard("doctor", "--config", plane.config, "--json", "--seconds", 8)
        assert json.loads(doctor.stdout)["daemon"] is False
        found = lines_of(doctor)
        assert {name for name, good in found.items() if not good} <= {"disk", "processor"}, doctor.stdout


@pytest.mark.long
def test_a_disk_that_takes_no_more_stops_the_recording_until_there_is_room(tmp_path: Path) -> None:
    """The system itself refuses the write, in the middle of a message."""
    with aircraft(tmp_path, SPEC) as plane:
        plane.max_file_bytes = 100_000
        plane.start()
        plane.stated("not recording", since=0)
        plane.logged("recording again")
        plane.signal(signal.SIGTERM)
        assert plane.ended() == 0
        first, _ = plane.recordings
        assert 85_000 < first.stat().st_size <= 100_000  # a message for the map takes 10 kB
        outcome = clicked(plane, first)
        assert len(outcome.errors_m) > 100, outcome.reported
        assert outcome.inside_99 > 0.97, outcome.reported
        assert sum("recording stops until there is room" in line for line in plane.log) == 1
        assert sum("recording again" in line for line in plane.log) == 1
