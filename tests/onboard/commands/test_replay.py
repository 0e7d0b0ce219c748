"""`pc-onboard replay`: the order of events, and every kind of bad input in one line with nothing left behind."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pytest
from PIL import Image

from contract.camera import Camera
from contract.errors import InputError
from contract.feature_set import FeatureSet, Status
from onboard.__main__ import main
from onboard.commands.replay import recorded_flight
from onboard.config.schema import Config
from onboard.events.types import Event, Frame
from onboard.replay import runner
from onboard.replay.runner import Flight, replay
from tests.waiting import PATIENCE_S, eventually

DATA = Path(__file__).parents[2] / "data"
LOG, TRUTH = DATA / "plane_turn.tlog", DATA / "plane_turn.truth.csv"
CAMERA = Camera.from_field_of_view(64, 48, 40.0)
START_S = float(np.genfromtxt(TRUTH, delimiter=",", skip_header=1)[0, 0])


@dataclass
class Recorder:
    events: list[Event] = field(default_factory=list)
    moments: list[int] = field(default_factory=list)
    sets: list[FeatureSet] = field(default_factory=list)
    left: str = ""
    summary: Any = None

    def handle(self, event: Event) -> list[FeatureSet]:
        if not isinstance(event, Frame):
            return []
        return [FeatureSet("uav", 1, event.index, event.stamp_ns, Status.STARTING, CAMERA)]

    def finish(self) -> list[FeatureSet]:
        return [FeatureSet("uav", 1, 99, 0, Status.STARTING, CAMERA)]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.left = "well" if kind is None else kind.__name__

    def event(self, arrival_ns: int, event: Event) -> None:
        self.moments.append(arrival_ns)
        self.events.append(event)

    def feature_set(self, output: FeatureSet) -> None:
        self.sets.append(output)


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """A folder with five small pictures at 5 Hz, their stamps, a camera and a configuration."""
    rng = np.random.default_rng(0)
    (tmp_path / "frames").mkdir()
    lines = ["file,unix_time_s"]
    for index in range(5):
        Image.fromarray(rng.integers(0, 255, (48, 64), np.uint8)).save(tmp_path / "frames" / f"{index}.png")
        lines.append(f"{index}.png,{START_S + 2.0 + 0.2 * index:.6f}")
    (tmp_path / "stamps.csv").write_text("\n".join(lines))
    (tmp_path / "camera.json").write_text(CAMERA.to_json())
    (tmp_path / "config.toml").write_text("[mount]\nyaw_deg = 90.0\n")
    return tmp_path


def opened(session: Path, config: Config | None = None) -> Flight:
    return Flight.open(config or Config(), CAMERA, session / "frames", LOG, session / "stamps.csv")


def arguments(session: Path, **changed: Path | str) -> list[str]:
    options: dict[str, Path | str] = {
        "config": session / "config.toml",
        "frames": session / "frames",
        "telemetry": LOG,
        "camera": session / "camera.json",
        "stamps": session / "stamps.csv",
        "out": session / "out.mcap",
    }
    options |= changed
    return ["replay", *(part for key, value in options.items() for part in (f"--{key}", str(value)))]


def test_events_arrive_in_order_of_time_pictures_by_stamp_telemetry_by_arrival(session: Path) -> None:
    sink = Recorder()
    replay(opened(session), Recorder(), [sink])
    assert sink.moments == sorted(sink.moments)
    frames = [event for event in sink.events if isinstance(event, Frame)]
    assert [frame.index for frame in frames] == [0, 1, 2, 3, 4]
    first = sink.events.index(frames[0])
    assert first > 50
    assert len(sink.events) - sink.events.index(frames[-1]) > 50
    assert sink.left == "well"


def test_what_leaves_the_pipeline_reaches_every_sink_in_order(session: Path) -> None:
    one, two = Recorder(), Recorder()
    replay(opened(session), Recorder(), [one, two])
    assert [output.frame for output in one.sets] == [0, 1, 2, 3, 4, 99]
    assert one.sets == two.sets


@pytest.mark.wall_clock
def test_real_time_takes_real_time(session: Path) -> None:
    began = time.monotonic()
    replay(opened(session), Recorder(), speed=4.0)
    # One second before the first picture, 0.8 s of pictures, then as much of five seconds as the log still has.
    assert 0.4 < time.monotonic() - began < 5.0  # nearly seven at the flight's own pace


def test_a_stopped_replay_finishes_what_it_has_begun(session: Path) -> None:
    sink, stop = Recorder(), threading.Event()
    flight = opened(session)
    handed_out = sink.event

    def stopped_at_once(arrival_ns: int, event: Event) -> None:
        handed_out(arrival_ns, event)
        stop.set()

    sink.event = stopped_at_once
    began = time.monotonic()
    replay(flight, Recorder(), [sink], speed=0.05, stop=stop)
    assert time.monotonic() - began < PATIENCE_S  # the first picture alone would be twenty seconds away, the end 130
    assert sink.left == "well"
    assert [output.frame for output in sink.sets] == [99]


def test_an_error_half_way_leaves_through_the_sinks(session: Path) -> None:
    flight = opened(session)
    cut(session / "frames" / "3.png")
    sink = Recorder()
    with pytest.raises(InputError, match=r"3\.png cannot be decoded"):
        replay(flight, Recorder(), [sink])
    assert sink.left == "InputError"


def test_a_long_log_takes_part_only_near_the_pictures(shared_data: Path, session: Path) -> None:
    flight = Flight.open(
        Config(), Camera.from_json(shared_data / "cmac_2018/camera.json"), shared_data / "cmac_2018/frames",
        shared_data / "cmac_2018/telemetry.tlog", None,
    )  # fmt: skip
    moments = [moment for moment, _ in flight.events()]
    assert 25.0 < (flight.frames.stamps_ns[0] - moments[0]) / 1e9 <= 30.0
    assert 3.0 < (moments[-1] - flight.frames.stamps_ns[-1]) / 1e9 <= 5.0


def cut(picture: Path) -> None:
    picture.write_bytes(picture.read_bytes()[:500])


def test_progress_without_a_terminal_is_lines(
    session: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner, "LINE_S", 0.0)
    assert main([*arguments(session), "--progress"]) == 3
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) >= 2 and all("frame" in line for line in lines) and "\r" not in "".join(lines)


def test_a_key_is_set_for_one_replay(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ("mount.yaw_deg=12.5", "vehicle.id=x1", "recording.pictures=lossless")
    settings = [word for text in given for word in ("--set", text)]
    code = main([*arguments(session, out=session / "set.mcap"), *settings])
    assert code == 3, capsys.readouterr().err
    config, _, _ = recorded_flight(session / "set.mcap")
    assert (config.mount.yaw_deg, config.vehicle.id) == (12.5, "x1")


def test_an_earlier_recording_survives_a_failed_replay(session: Path) -> None:
    (session / "out.mcap").write_bytes(b"what was here")
    cut(session / "frames" / "3.png")
    assert main(arguments(session)) == 2
    assert (session / "out.mcap").read_bytes() == b"what was here"


def test_the_same_inputs_give_the_same_recording_and_a_summary(
    session: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recordings = []
    for name in ("a.mcap", "b.mcap"):
        assert main(arguments(session, out=session / name)) == 3, "pictures of noise: nothing is solved"
        recordings.append((session / name).read_bytes())
    reported = capsys.readouterr()
    assert "frames" in reported.out
    assert "refused" in reported.out
    assert "nothing solved" in reported.out and "what to do" in reported.out
    assert reported.err == ""
    assert recordings[0] == recordings[1]
    assert len(recordings[0]) > 500


def test_an_interrupt_keeps_a_whole_recording(session: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "onboard", *arguments(session), "--speed", "0.05"],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert eventually(lambda: list(session.glob(".out.mcap*")))
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130
    assert err == ""
    assert "frames" in out
    assert (session / "out.mcap").stat().st_size > 0
    assert not list(session.glob(".out.mcap*"))
