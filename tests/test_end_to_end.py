"""The whole way as its users go it: a flight through `pc-onboard`, clicked with `pc-ground`, both as processes."""

import csv
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from contract.geodesy import LocalFrame
from ground.__main__ import main as ground
from ground.recording import Recording
from simulation.flight import RecordedSpec
from simulation.session import SessionSpec
from simulation.terrain import TerrainSpec
from simulation.truth import Truth
from tests.installed import share
from tests.onboard.link.ports import free_endpoint
from tests.rest_long import rest_long
from tests.scenarios.flights import CHI2_90, CHI2_99
from tests.scenarios.flights import simulated as session_of
from tests.waiting import PATIENCE_S, eventually

pytestmark = pytest.mark.xdist_group("end to end")  # one worker: what they share is made once

ROOT = Path(__file__).resolve().parents[1]
FRAMES = 31
SEED_SENSORS = '[solve]\nattitude = "none"\nvelocity = false\nlevel_ground = true\n'
FULL_SET = '[solve]\nattitude = "autopilot"\nvelocity = true\n'
MOUNT = "[mount]\nroll_deg = 0.0\npitch_deg = -90.0\nyaw_deg = -90.0\n\n"


def command(package: str, *arguments: object) -> list[str]:
    return [sys.executable, "-m", package, *map(str, arguments)]


def run(package: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(package, *arguments), cwd=ROOT, capture_output=True, text=True, check=False, timeout=300
    )


def replay_arguments(flight: Path, **changed: object) -> list[str]:
    options: dict[str, object] = {
        "config": flight / "config.toml",
        "frames": flight / "frames",
        "telemetry": flight / "telemetry.tlog",
        "camera": flight / "camera.json",
        "stamps": flight / "stamps.csv",
    }
    options |= changed
    return ["replay", *(str(part) for key, value in options.items() for part in (f"--{key}", value))]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six seconds of a recorded flight 250 m up at 20 m/s, 5 pictures a second, over hills of 10 m."""
    folder = tmp_path_factory.mktemp("flight") / "session"
    spec = SessionSpec(
        RecordedSpec("plane_turn", 3.0, whole_log=False),
        seconds=FRAMES / 5.0,
        rate_hz=5.0,
        mount_deg=(0.0, -90.0, -90.0),
        terrain=TerrainSpec(relief_m=10.0),
    )
    shutil.copytree(session_of(spec), folder, copy_function=share)
    (folder / "seed.toml").write_text(MOUNT + SEED_SENSORS)
    (folder / "full.toml").write_text(MOUNT + FULL_SET)
    return folder


@dataclass(frozen=True)
class Simulated:
    """A finished replay."""

    recording: Path
    summary: str


class Replays(dict[str, Simulated]):
    """The flight replayed with the seed's sensors and with all, by name of the configuration, once each when needed."""

    def __init__(self, flight: Path, out: Path) -> None:
        super().__init__()
        self._flight, self._out = flight, out

    def __missing__(self, name: str) -> Simulated:
        recording = self._out / f"{name}.mcap"
        done = run("onboard", *replay_arguments(self._flight, config=self._flight / f"{name}.toml", out=recording))
        assert (done.returncode, done.stderr) == (0, "")
        self[name] = Simulated(recording, done.stdout)
        return self[name]


@pytest.fixture(scope="module")
def simulated(flight: Path, tmp_path_factory: pytest.TempPathFactory) -> Replays:
    return Replays(flight, tmp_path_factory.mktemp("recordings"))


def batch(clicks: Path, recording: Path) -> list[dict[str, Any]]:
    done = run("ground", "click", "--batch", clicks, "--from", recording)
    assert (done.returncode, done.stderr) == (0, "")
    return [json.loads(line) for line in done.stdout.splitlines()]


# With the seed's sensors alone also in test_scenarios.py: "a log without attitude".
@pytest.mark.parametrize(("sensors", "bound_m"), rest_long([("full", 3.0), ("seed", 6.0)]))
def test_clicks_land_where_they_should(
    flight: Path, simulated: dict[str, Simulated], sensors: str, bound_m: float
) -> None:
    rows = list(csv.DictReader((flight / "truth_clicks.csv").open()))
    answers = batch(flight / "truth_clicks.csv", simulated[sensors].recording)
    assert len(answers) == len(rows) > 300
    errors_m, inside = [], []
    for row, answer in zip(rows, answers, strict=True):
        assert answer["frame"] == int(row["frame"])
        if answer["status"] != "ok":
            continue
        there = LocalFrame(float(row["lat_deg"]), float(row["lon_deg"]), float(row["height_amsl_m"]))
        enu_m = there.to_enu(answer["lat_deg"], answer["lon_deg"], answer["height_amsl_m"])
        errors_m.append(float(np.hypot(enu_m[0], enu_m[1])))
        inside.append(errors_m[-1] < answer["ellipse"]["semi_major_m"])
    assert len(errors_m) > 0.85 * len(rows), Counter(a["status"] for a in answers)
    # Better than a few centimetres would mean that truth leaked into the estimate.
    assert 0.02 < float(np.median(errors_m)) < bound_m
    # Nine tenths are promised; one flight's common error may lie on either side.
    assert float(np.mean(inside)) > 0.7


@pytest.mark.parametrize("sensors", rest_long(["full", "seed"]))
def test_every_picture_of_a_solved_stretch_can_be_clicked(simulated: dict[str, Simulated], sensors: str) -> None:
    recording = Recording(simulated[sensors].recording)
    sets = [recording.by_frame("uav", frame) for frame in range(FRAMES)]
    assert recording.frames("uav") == list(range(FRAMES))
    solved = [s for s in sets if s is not None and s.is_ok]
    assert len(solved) >= FRAMES - 2
    assert 3 <= sum(s.is_keyframe for s in solved) < len(solved)
    assert min(len(s) for s in solved) >= 30


def test_the_summary_tells_what_became_of_the_pictures(simulated: dict[str, Simulated]) -> None:
    reported = dict(line.split("  ", 1) for line in simulated["full"].summary.splitlines())
    assert int(reported["frames"]) == FRAMES
    assert {"keyframes", "solved", "refused", "median tracks", "reprojection", "time, tracking", "time, solve"} <= set(
        reported
    )


def test_the_same_inputs_give_the_same_bytes(flight: Path, simulated: dict[str, Simulated], tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    done = run("onboard", *replay_arguments(flight, config=flight / "full.toml", out=again))
    assert done.returncode == 0
    assert again.read_bytes() == simulated["full"].recording.read_bytes()


@pytest.mark.long
@pytest.mark.wall_clock
def test_a_cold_click_takes_under_a_second(simulated: dict[str, Simulated]) -> None:
    """Alone it takes 0.2 s."""
    assert simulated["full"]
    times: list[float] = []
    while not times or (min(times) >= 1.0 and len(times) < 10):  # the machine may stand still for a second
        began = time.monotonic()
        assert run("ground", "click", 320, 240, "--frame", 20, "--from", simulated["full"].recording).returncode == 0
        times.append(time.monotonic() - began)
    assert min(times) < 1.0


@pytest.fixture(scope="module")
def endpoint(flight: Path) -> Iterator[str]:
    """An aircraft in the air: a replay that publishes, three times the recorded speed."""
    where = free_endpoint()
    config = flight / "live.toml"
    config.write_text(f'{MOUNT}{FULL_SET}\n[link]\nlisten = ["{where}"]\n\n[vehicle]\nid = "kiwi"\n')
    arguments = [*replay_arguments(flight, config=config, speed=3, linger=3600), "--publish"]
    process = subprocess.Popen(
        command("onboard", *arguments), cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        yield where
        process.send_signal(signal.SIGINT)
        reported, complaint = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, complaint) == (130, "")
        assert "solved" in reported
    finally:
        process.kill()
        process.wait()


def click_until(endpoint: str, *arguments: object, code: int) -> subprocess.CompletedProcess[str]:
    """Ask again until it ends with `code`: the picture may still have to come."""
    deadline = time.monotonic() + 2.0 * PATIENCE_S
    while True:
        done = run("ground", "click", *arguments, "--connect", endpoint, "--format", "json")
        if done.returncode == code or time.monotonic() > deadline:
            assert done.returncode == code, done.stdout + done.stderr
            return done
        time.sleep(0.2)


def test_a_flying_aircraft_can_be_clicked_from_another_process(flight: Path, endpoint: str) -> None:
    truth = Truth.load(flight)
    for frame in (10, FRAMES - 1):
        answer = json.loads(click_until(endpoint, 200, 300, "--frame", frame, code=0).stdout)
        assert (answer["status"], answer["frame"], answer["vehicle"]) == ("ok", frame, "kiwi")
        true = truth.ground(frame, [200.0, 300.0])
        there = LocalFrame(true.lat_deg[0], true.lon_deg[0], true.height_amsl_m[0])
        enu_m = there.to_enu(answer["lat_deg"], answer["lon_deg"], answer["height_amsl_m"])
        assert np.hypot(enu_m[0], enu_m[1]) < 6.0


def test_newest_time_and_unknown_pictures_over_the_link(
    flight: Path, endpoint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The answer of the command, within this process; the test above starts it as a program."""

    def clicked(*arguments: object, code: int) -> dict[str, Any]:
        words = ["click", *map(str, arguments), "--connect", endpoint, "--format", "json"]
        assert eventually(lambda: (capsys.readouterr(), ground(words) == code)[1])
        return json.loads(capsys.readouterr().out)

    clicked(320, 240, "--frame", FRAMES - 1, code=0)
    newest = clicked(320, 240, "--max-age", "inf", code=0)
    assert newest["frame"] == FRAMES - 1
    # The flight is over and nothing newer comes: what was the newest picture is not what is seen now for long.
    stale = clicked(320, 240, code=3)
    assert (stale["status"], stale["frame"]) == ("stale", FRAMES - 1) and 3.0 < stale["age_s"] < 300.0
    stamp = float(list(csv.DictReader((flight / "stamps.csv").open()))[20]["unix_time_s"])
    assert clicked(320, 240, "--time", stamp, code=0)["frame"] == 20
    refused = clicked(320, 240, "--frame", 999, code=3)
    assert (refused["status"], refused["frame"]) == ("unknown_frame", 999)


@pytest.mark.wall_clock
def test_a_live_cold_click_takes_under_a_second(endpoint: str) -> None:
    click_until(endpoint, 320, 240, "--frame", 20, code=0)
    times: list[float] = []
    while not times or (min(times) >= 1.0 and len(times) < 10):  # the machine may stand still for a second
        began = time.monotonic()
        assert run("ground", "click", 320, 240, "--frame", 20, "--connect", endpoint).returncode == 0
        times.append(time.monotonic() - began)
    assert min(times) < 1.0


def clicks_in(text: str) -> dict[str, list[float]]:
    """The demo's table: spot, frame and pixel -> height, radius and true error, metres; coordinates in their metres."""
    row = r"^  ([A-D] +\d+ +\d+, +\d+) +(-?[\d.]+) +(-?[\d.]+) +(\d+) m +([\d.]+) m +([\d.]+) m$"
    return {
        key: [float(lat) * 111_000.0, float(lon) * 81_000.0, float(height) / 5.0, float(radius), float(error)]
        for key, lat, lon, height, radius, error in re.findall(row, text, re.MULTILINE)
    }


def demo(out: Path, *arguments: object) -> dict[str, list[float]]:
    """A demo that answers all of its clicks and draws its pictures: the table that it printed."""
    done = run("demo", "--out", out, *arguments)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "8 of 8 clicks answered" in done.stdout
    printed = clicks_in(done.stdout)
    assert len(printed) == 8
    sampled = sorted(path.name for path in out.iterdir() if path.suffix in (".png", ".jpg"))
    assert sampled == ["map.png", "overview.jpg", "tracks_1_frames.png", "tracks_2_features.png", "tracks_3_paths.png"]
    return printed


@pytest.mark.long  # short: clicks land where they should, below
def test_a_demo_of_eight_seconds_answers_every_click_within_its_99_percent(tmp_path: Path) -> None:
    printed = demo(tmp_path / "demo", "--seconds", 8)
    of_99_percent = float(np.sqrt(CHI2_99 / CHI2_90))  # radii, of that of 90 %
    assert all(0.1 < error_m < of_99_percent * radius_m for *_, radius_m, error_m in printed.values()), printed


@pytest.mark.long  # the whole flight; short, without the README: above
def test_the_demo_runs_as_the_readme_shows(tmp_path: Path) -> None:
    """The README's figures are those of the recorded flight, but for last digits, which processors round differently.

    What the demo itself prints was clicked in flight and is answered with what was known by then: on a slow machine
    that is a picture's first set, a few metres from its last.
    """
    out = tmp_path / "demo"
    shown = clicks_in((ROOT / "README.md").read_text())
    assert len(shown) == 2
    printed = demo(out)
    assert set(shown) <= set(printed)
    assert all(0.1 < error_m < radius_m for *_, radius_m, error_m in printed.values()), printed
    truth = Truth.load(out / "flight")
    for key, row in shown.items():
        frame, u, v = (int(word.rstrip(",")) for word in key.split()[1:])
        output = run("ground", "click", u, v, "--frame", frame, "--from", out / "session.mcap", "--format", "json")
        answer, true = json.loads(output.stdout), truth.ground(frame, [float(u), float(v)])
        place = answer["lat_deg"], answer["lon_deg"], answer["height_amsl_m"]
        error = LocalFrame(true.lat_deg[0], true.lon_deg[0], true.height_amsl_m[0]).to_enu(*place)[:2]
        figures = place[0] * 111_000.0, place[1] * 81_000.0, place[2] / 5.0, answer["ellipse"]["semi_major_m"]
        assert [*figures, float(np.hypot(*error))] == pytest.approx(row, abs=0.25), key


@pytest.mark.long
def test_the_real_flight_is_solved(shared_data: Path, tmp_path: Path) -> None:
    """Within a process, and with a gimbal to be found: tests/scenarios/test_gimbal_on_real_pictures.py."""
    real, recording = shared_data / "cmac_2018", tmp_path / "real.mcap"
    done = run(
        "onboard", "replay", "--frames", real / "frames", "--telemetry", real / "telemetry.tlog",
        "--camera", real / "camera.json", "--out", recording,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    sets = [Recording(recording).by_frame("uav", frame) for frame in range(18)]
    assert sum(s is not None and s.is_ok for s in sets) >= 14
