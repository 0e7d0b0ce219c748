"""The live recording: parts, a disk that fills and empties, SIGKILL; and what a replay makes of it."""

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from contract.camera import Camera
from contract.errors import InputError
from contract.feature_set import FeatureSet
from contract.topics import STATUS
from contract.vehicle_status import VehicleStatus, encode_status
from contract.wire.codec import decode
from ground.__main__ import main as ground_main
from ground.recording import Recording
from onboard.__main__ import main
from onboard.config.schema import Config, load_config, to_toml
from onboard.events.session_clock import SessionClock
from onboard.events.types import Event, Frame
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import Flight, replay
from onboard.storage.alignment_file import StateFile
from onboard.storage.mcap_reader import RecordedFlight
from onboard.storage.mcap_writer import SessionRecorder
from onboard.storage.rotating_recorder import Recorded
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from tests.contract.sets import plain_set
from tests.rest_long import rest_long
from tests.scenarios.flights import CAMERA, simulated
from tests.set_sink import SetSink
from tests.waiting import eventually

pytestmark = pytest.mark.xdist_group("rotating recorder")  # one worker: what they share is made once

GIGABYTE = 1_000_000_000
SPEC = SessionSpec(DescribedSpec(PathSpec("straight")), seconds=7.0, rate_hz=3.0, camera=CAMERA)
ROOT = Path(__file__).parents[3]
SESSION = 4_000_000_000  # a number that the first picture's second does not give: the clock was set back


def configured(pictures: str = "lossless", **recording: float) -> Config:
    table = load_config(simulated(SPEC) / "config.toml").model_dump()
    table["vehicle"]["id"] = "uav-1"
    table["recording"] |= {"pictures": pictures, "keep_free_mb": 1.0, **recording}
    return Config.model_validate(table)


def flight(config: Config) -> Flight:
    folder = simulated(SPEC)
    return Flight.open(config, CAMERA, folder / "frames", folder / "telemetry.tlog", folder / "stamps.csv")


def recorder(folder: Path, config: Config, **options: object) -> Recorded:
    return Recorded(folder, config, CAMERA, SessionClock.start(), to_toml(config), **options)


@pytest.fixture(scope="module")
def learned() -> str:
    """What an earlier flight taught: without it a replay comes to other bytes."""
    pipeline = Pipeline(Config(), CAMERA)
    raw = json.loads(pipeline.window.alignment.to_json())
    del raw["crc32"]  # of what is changed here
    raw["boresight_rad"] = [0.01, -0.005, 0.004]
    raw["covariance"] = (0.1 * np.array(raw["covariance"])).tolist()
    return json.dumps(raw)


class Reporting(SetSink):
    def __init__(self, sink: Recorded) -> None:
        self._sink = sink

    def feature_set(self, output: FeatureSet) -> None:
        self._sink.report(STATUS, output.capture_unix_ns, encode_status(VehicleStatus(1.7e9, 7, "ok")))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory, learned: str) -> Path:
    """A flight recorded live, pictures and all, in parts of a megabyte; the folder that holds it."""
    folder = tmp_path_factory.mktemp("recordings")
    config = configured(rotate_mb=1.0)
    pipeline = Pipeline(config, CAMERA)
    pipeline.session = SESSION
    pipeline.window.alignment.restore(learned)
    sink = recorder(folder, config, state_json=learned)
    replay(flight(config), pipeline, [sink, Reporting(sink)])
    assert sink.fault == ""
    return folder


def first(folder: Path) -> Path:
    return min(folder.glob("*.mcap"))


def as_recorded(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["replay", *arguments]) in (0, 3)  # 3: too few pictures to solve any, as of a flight cut short
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("as recorded")]
    return line


def test_a_session_recorded_with_its_pictures_replays_to_the_same_bytes(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parts = sorted(session.glob("*.mcap"))
    assert len(parts) >= 2
    for named in ([session], parts[::-1], parts[:1]):  # whatever names it, the same is replayed
        assert RecordedFlight.open(named).paths == parts
    sets = list(RecordedFlight.open([first(session)]).sets())
    assert {decode(payload).session for payload in sets} == {SESSION}
    assert len(sets) > 25 and sum(decode(payload).is_ok for payload in sets) > 15
    expected = f"as recorded: {len(sets)} of {len(sets)} sets byte for byte"
    out = tmp_path / "again.mcap"
    assert as_recorded(capsys, str(first(session)), "--out", str(out)) == expected
    assert list(RecordedFlight.open([out]).sets()) == sets  # and recorded once more, the same again
    assert as_recorded(capsys, str(out)) == expected


def test_without_what_had_been_learned_it_would_not(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The comparison can fail: another state to begin with, other bytes."""
    same_sets, all_sets = _counts(as_recorded(capsys, str(session), "--state", str(tmp_path / "fresh.json")))
    assert same_sets < all_sets


def test_every_event_comes_back_as_it_was(session: Path) -> None:
    config = configured()
    given = list(flight(config).events())
    again = list(RecordedFlight.open([first(session)]).events())
    assert [arrival for arrival, _ in again] == [arrival for arrival, _ in given]
    for (_, was), (_, now) in zip(given, again, strict=True):
        assert same(was, now)


def same(was: Event, now: Event) -> bool:
    if isinstance(was, Frame) and isinstance(now, Frame):
        assert was.image is not None and now.image is not None
        return (was.stamp_ns, was.index, was.name) == (now.stamp_ns, now.index, now.name) and np.array_equal(
            was.image, now.image
        )
    return repr(was) == repr(now)  # what is not a number equals nothing


@pytest.mark.long
def test_the_ground_clicks_in_any_part_and_in_the_folder(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parts = sorted(session.glob("*.mcap"))
    whole = Recording(session)
    assert whole.frames(whole.vehicles[0]) == list(range(21))
    for place in (session, *parts):
        code = ground_main(["click", "160", "120", "--frame", "15", "--from", str(place), "--format", "json"])
        assert code == 0 and json.loads(capsys.readouterr().out)["frame"] == 15
    assert whole.frame_of_file(whole.vehicles[0], "nothing.png") is None


def test_any_mcap_reader_opens_every_part_and_finds_the_status(session: Path) -> None:
    topics: set[str] = set()
    for path in session.glob("*.mcap"):
        with path.open("rb") as stream:
            reader = make_reader(stream)
            summary = reader.get_summary()
            assert sum(1 for _ in reader.iter_messages()) == summary.statistics.message_count
            topics |= {channel.topic for channel in summary.channels.values()}
            (metadata,) = reader.iter_metadata()
        assert metadata.metadata["complete"] == "yes" and Camera.from_text(metadata.metadata["camera"], "") == CAMERA
    assert {"pc/uav-1/status", "pc/uav-1/pictures", "pc/uav-1/view/camera"} <= topics


@pytest.mark.parametrize("pictures", rest_long(["none", "jpeg"]))
def test_without_pictures_a_replay_says_so_and_with_jpeg_that_it_is_not_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], pictures: str
) -> None:
    config = configured(pictures)
    replay(flight(config), Pipeline(config, CAMERA), [recorder(tmp_path, config)])
    path = first(tmp_path)
    if pictures == "jpeg":
        assert main(["replay", str(path)]) == 0
        reported = capsys.readouterr().out
        assert "not exactly the same flight: 21 pictures are JPEG" in reported and "solved" in reported
        return
    assert main(["replay", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "holds no pictures" in line and "21 frames" in line and "features" in line and "lossless" in line
    assert ground_main(["click", "160", "120", "--frame", "15", "--from", str(path)]) == 0


def test_a_session_cut_short_replays_up_to_the_cut(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "cut.mcap"
    content = first(session).read_bytes()
    for share in (0.35, 0.7, 0.999):
        copy.write_bytes(content[: int(share * len(content))])
        line = as_recorded(capsys, str(copy))
        same_sets, all_sets = _counts(line)
        assert same_sets == all_sets > 0


def _counts(line: str) -> tuple[int, int]:
    words = line.removeprefix("as recorded: ").split()
    return int(words[0]), int(words[2])


def test_what_is_replayed_is_not_written_over(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Other usage that cannot be: tests/transcripts/pc-onboard-replay.txt."""
    assert main(["replay", str(session), "--out", str(first(session))]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "is what is replayed" in line


def test_two_sessions_in_a_folder_are_distinguished(session: Path, tmp_path: Path) -> None:
    shutil.copytree(session, tmp_path, dirs_exist_ok=True)
    shutil.copy(first(session), tmp_path / "another.mcap")
    with pytest.raises(InputError, match="2 sessions"):
        RecordedFlight.open([tmp_path])
    with pytest.raises(InputError, match="2 sessions"):
        Recording(tmp_path)


class Disk:
    def __init__(self, free: int = GIGABYTE) -> None:
        self.free = free

    def __call__(self, folder: Path) -> int:
        return self.free


def holds(folder: Path, frame: int) -> bool:
    try:
        return frame in Recording(folder).frames("uav-1")
    except InputError:
        return False


@pytest.fixture
def running(tmp_path: Path) -> Iterator[tuple[Recorded, Disk]]:
    disk = Disk()
    with recorder(tmp_path, configured("none", keep_free_mb=100.0), free=disk, retry_s=0.1) as sink:
        yield sink, disk


def test_recording_stops_before_the_disk_is_full_and_goes_on_when_there_is_room(
    running: tuple[Recorded, Disk], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    sink, disk = running
    base = plain_set(20)

    def sets(first_frame: int, last: int) -> None:
        for frame in range(first_frame, last):
            sink.feature_set(dataclasses.replace(base, frame=frame))

    caplog.set_level("INFO", "pointclick")
    sets(0, 50)
    assert eventually(lambda: holds(tmp_path, 49))
    assert sink.fault == ""
    disk.free = GIGABYTE // 20
    assert eventually(lambda: sink.fault != "")
    assert "50 MB free, less than recording.keep_free_mb = 100" in sink.fault
    sets(50, 100)  # taken, and left out
    time.sleep(0.3)
    assert len(list(tmp_path.glob("*.mcap"))) == 1
    assert Recording(first(tmp_path)).frames("uav-1")[-1] == 49  # closed properly, all of it there
    disk.free = GIGABYTE

    def again() -> bool:
        sets(100, 101)
        return sink.fault == ""

    assert eventually(again)
    sets(101, 120)
    assert eventually(lambda: holds(tmp_path, 119))
    frames = Recording(tmp_path).frames("uav-1")
    assert frames[:50] == list(range(50)) and set(range(101, 120)) <= set(frames)
    assert not set(range(50, 100)) & set(frames)
    second = next(path for path in tmp_path.glob("*.002.mcap"))
    assert b"complete\x02\x00\x00\x00no" in second.read_bytes()  # a replay will say that something is missing
    levels = [r.levelname for r in caplog.records]
    assert levels.count("ERROR") == 1 and any("recording again" in r.message for r in caplog.records)


def test_a_disk_that_is_full_all_the_same_is_a_fault_and_not_the_end(
    running: tuple[Recorded, Disk], monkeypatch: pytest.MonkeyPatch
) -> None:
    sink, _ = running
    is_full = threading.Event()
    is_full.set()
    writes = SessionRecorder.write_set

    def write_set(self: SessionRecorder, *given: object) -> None:
        if is_full.is_set():
            raise InputError(f"recording {self.path}: No space left on device")
        writes(self, *given)

    monkeypatch.setattr(SessionRecorder, "write_set", write_set)
    sink.feature_set(plain_set(20))
    assert eventually(lambda: "No space left" in sink.fault)
    is_full.clear()

    def again() -> bool:
        sink.feature_set(plain_set(20))
        return sink.fault == ""

    assert eventually(again)


def test_a_real_full_device_is_named() -> None:
    """/dev/full takes nothing, as a full disk."""
    full = SessionRecorder("/dev/full", "uav-1")
    with pytest.raises(InputError, match="No space left on device"):
        full.write_set(plain_set(20))
    with pytest.raises(InputError, match="No space left on device"):
        full.close()


def test_a_folder_that_cannot_be_made_is_a_fault(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with recorder(tmp_path / "file" / "folder", configured("none"), retry_s=0.1) as sink:
        sink.feature_set(plain_set(20))
        assert eventually(lambda: sink.fault != "")
        assert "Not a directory" in sink.fault or "No such file" in sink.fault


def test_two_sessions_of_one_second_do_not_write_over_each_other(tmp_path: Path) -> None:
    clock, config = SessionClock.start(), configured("none")
    stopped = dataclasses.replace(clock)
    object.__setattr__(stopped, "now_ns", lambda: 1_700_000_000 * GIGABYTE)
    for _ in range(2):
        with Recorded(tmp_path, config, CAMERA, stopped, "") as sink:
            sink.feature_set(plain_set(20))
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "20231114T221320Z-uav-1-2.001.mcap",
        "20231114T221320Z-uav-1.001.mcap",
    ]


def test_a_killed_process_loses_at_most_the_last_second(tmp_path: Path) -> None:
    """kill -9 in full flight, pictures and all: what had been handed over a second before is there and replays."""
    script = (
        "import os, sys, threading, time\n"
        "from tests.onboard.storage.test_rotating_recorder import *\n"
        "def say(*words):\n    sys.stdout.write(' '.join(map(str, (time.monotonic(), *words))) + '\\n')\n"
        "    sys.stdout.flush()\n"
        "def live():\n    while True:\n        time.sleep(0.01)\n        say()\n"
        "os.fdatasync = lambda file: time.sleep(0.2)\n"  # a disk that takes its time, and the same time everywhere
        "config = configured(rotate_mb=1.0)\npipeline = Pipeline(config, CAMERA)\n"
        "given = list(flight(config).events())\n"
        "with recorder(Path(sys.argv[1]), config) as sink:\n"
        "    threading.Thread(target=live, daemon=True).start()\n"
        "    for arrival_ns, event in given:\n"
        "        sink.event(arrival_ns, event)\n"
        "        for made in pipeline.handle(event):\n"
        "            sink.feature_set(made)\n"
        "            say(made.frame, made.revision)\n"
        "    while True:\n        time.sleep(0.01)\n        sink.report(STATUS, 0, b'{}')\n"
    )
    command = [sys.executable, "-c", script, str(tmp_path)]
    handed_s: dict[tuple[int, int], float] = {}
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT, text=True) as process:
        # By the process's own word: a second for which the whole machine stood still gave it no chance to write.
        for line in process.stdout:
            at_s, *key = line.split()
            if key:
                handed_s[int(key[0]), int(key[1])] = float(at_s)
            if len(handed_s) >= 20 and float(at_s) > sorted(handed_s.values())[19] + 1.0:
                break
        os.kill(process.pid, signal.SIGKILL)
    kept = {(s.frame, s.revision) for s in map(decode, RecordedFlight.open([tmp_path]).sets())}
    a_second_before = {key for key, handed in handed_s.items() if handed < float(at_s) - 1.0}
    assert len(a_second_before) >= 20
    assert a_second_before <= kept
    assert main(["replay", str(tmp_path)]) == 0


def test_the_state_file_is_what_a_replay_begins_with(tmp_path: Path, learned: str) -> None:
    state = StateFile(tmp_path / "state.json")
    assert state.text() == ""
    state.write(learned)
    assert state.text() == learned
