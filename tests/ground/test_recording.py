import dataclasses
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from contract.errors import InputError
from contract.feature_set import FeatureSet, Status
from contract.topics import FEATURES
from contract.wire.codec import encode
from ground.__main__ import main
from ground.recording import Recording
from onboard.events.types import Attitude, Frame, GpsQuality, PositionFix
from onboard.storage.mcap_writer import SessionRecorder
from tests.contract.sets import plain_set

pytestmark = pytest.mark.xdist_group("recording")  # one worker: what they share is made once

START_NS = 1_700_000_000_000_000_000
BASE = plain_set(20)
CAMERA = BASE.camera


def a_set(frame: int, revision: int = 0, status: Status = Status.OK) -> FeatureSet:
    stamp_ns = START_NS + frame * 10**9
    if status is Status.OK:
        return dataclasses.replace(BASE, frame=frame, revision=revision, capture_unix_ns=stamp_ns)
    return FeatureSet("uav-1", BASE.session, frame, stamp_ns, status, CAMERA, revision)


def write_session(path: Path) -> None:
    with SessionRecorder(path, "uav-1", config_text="x = 1", camera_json=CAMERA.to_json(), software_version="1") as out:
        for frame in range(6):
            stamp_ns = START_NS + frame * 10**9
            out.write_event(PositionFix(stamp_ns, -35.0, 149.0, 600.0, (1.0, 2.0, 3.0)))
            out.write_event(GpsQuality(stamp_ns, 3, 12, undulation_m=20.5))
            out.write_event(Attitude(stamp_ns, (1.0, 0.0, 0.0, 0.0)))
            out.write_event(Frame(stamp_ns, frame, None, f'image "{frame}" ü.png'))
            out.write_set(a_set(frame, status=Status.OK if frame < 5 else Status.TURNING))
        out.write_set(a_set(2, revision=3))
        out.write_set(a_set(2, revision=1))


@pytest.fixture
def session(tmp_path: Path) -> Path:
    path = tmp_path / "session.mcap"
    write_session(path)
    return path


def test_a_recording_of_two_sessions_is_refused(tmp_path: Path) -> None:
    """Two flights joined, or a part of one named as a part of another: frame 3 would be whichever came last."""
    for part, session in ((1, BASE.session), (2, BASE.session + 3600)):
        with SessionRecorder(tmp_path / f"day.{part:03d}.mcap", "uav-1") as out:
            for frame in range(4):
                out.write_set(dataclasses.replace(a_set(frame), session=session))
    with pytest.raises(InputError, match=f"holds 2 sessions of 'uav-1' \\({BASE.session}, {BASE.session + 3600}\\)"):
        Recording(tmp_path / "day.001.mcap")


def test_a_damaged_session_number_is_no_second_session(session: Path) -> None:
    data = bytearray(session.read_bytes())
    one = encode(a_set(3))
    at = data.index(one)
    data[at + next(k for k in range(len(one)) if one[k : k + 4] == BASE.session.to_bytes(4, "little"))] ^= 1
    session.write_bytes(data)
    assert Recording(session).by_frame("uav-1", 4).session == BASE.session


def test_sets_are_found_by_frame_time_name_and_as_the_newest_that_answers(session: Path) -> None:
    recording = Recording(session)
    assert recording.vehicles == ["uav-1"]
    assert recording.frames("uav-1") == [0, 1, 2, 3, 4, 5]
    three = recording.by_frame("uav-1", 3)
    assert three.capture_unix_ns == START_NS + 3 * 10**9
    assert recording.by_frame("uav-1", 6) is None
    near = recording.by_time("uav-1", START_NS / 1e9 + 2.4)
    assert near.frame == 2
    assert recording.by_time("uav-1", START_NS / 1e9 - 0.6) is None
    newest = recording.newest("uav-1")
    assert newest.frame == 4
    refused = recording.by_frame("uav-1", 5)
    assert refused.status is Status.TURNING
    assert recording.frame_of_file("uav-1", 'image "1" ü.png') == 1
    assert recording.frame_of_file("uav-1", "image") is None


def test_the_highest_revision_of_a_frame_counts(session: Path) -> None:
    two = Recording(session).by_frame("uav-1", 2)
    assert two.revision == 3


def test_the_same_session_gives_the_same_bytes(session: Path, tmp_path: Path) -> None:
    write_session(tmp_path / "again.mcap")
    assert (tmp_path / "again.mcap").read_bytes() == session.read_bytes()


def test_any_mcap_reader_reads_events_sets_and_metadata(session: Path) -> None:
    with session.open("rb") as stream:
        reader = make_reader(stream)
        messages = list(reader.iter_messages(log_time_order=False))
        metadata = list(reader.iter_metadata())
    topics = {channel.topic: channel for _, channel, _ in messages}
    ours = ("features", "frames", "position", "gps_quality", "attitude")
    assert set(topics) == {f"pc/uav-1/{name}" for name in (*ours, "view/vehicle", "view/camera", "view/features")}
    assert topics["pc/uav-1/features"].message_encoding == FEATURES.encoding
    assert {channel.message_encoding for topic, channel in topics.items() if "features" not in topic} == {"json"}
    assert all(
        schema is not None and schema.encoding == "jsonschema"
        for schema, c, _ in messages
        if c.message_encoding == "json"
    )
    sets = [m for _, c, m in messages if c.topic == "pc/uav-1/features"]
    assert sets[3].data == encode(a_set(3)) and sets[3].log_time == sets[3].publish_time == START_NS + 3 * 10**9
    assert [m.sequence for m in sets] == list(range(8))
    assert metadata[0].metadata["config"] == "x = 1" and metadata[0].metadata["camera"] == CAMERA.to_json()


def test_a_recorder_that_wrote_nothing_leaves_no_file(tmp_path: Path) -> None:
    with SessionRecorder(tmp_path / "none.mcap", "uav-1"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    recorder = SessionRecorder(tmp_path / "missing" / "s.mcap", "uav-1")
    with pytest.raises(InputError, match="missing"):
        recorder.write_set(a_set(0))


def test_a_killed_recorder_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    script = (
        "import sys, time\nfrom tests.ground.test_recording import *\n"
        "out = SessionRecorder(sys.argv[1], 'uav-1')\n"
        "for frame in range(400):\n    out.write_set(a_set(frame))\n"
        "print('written', flush=True)\ntime.sleep(60)\n"
    )
    command = [sys.executable, "-c", script, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=Path(__file__).parents[2]) as process:
        assert process.stdout.readline() == b"written\n"
        os.kill(process.pid, signal.SIGKILL)
    assert Recording(path).frames("uav-1") == list(range(400))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_file_cut_anywhere_is_read_up_to_the_cut(session: Path, data: st.DataObject) -> None:
    content = session.read_bytes()
    cut = session.with_name("cut.mcap")
    cut.unlink(missing_ok=True)
    length = data.draw(st.integers(0, len(content)))
    cut.write_bytes(content[:length])
    try:
        recording = Recording(cut)
    except InputError:
        assert length < content.index(b"PC\x40") + len(encode(a_set(0)))
        return
    frames = recording.frames("uav-1")
    assert frames == list(range(len(frames)))
    assert all(recording.by_frame("uav-1", frame) is not None for frame in frames)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_damaged_file_is_read_or_refused_by_name(session: Path, data: st.DataObject) -> None:
    content = bytearray(session.read_bytes())
    for _ in range(data.draw(st.integers(1, 5))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    damaged = session.with_name("damaged.mcap")
    damaged.unlink(missing_ok=True)
    damaged.write_bytes(content)
    try:
        recording = Recording(damaged)
        for vehicle in recording.vehicles:
            recording.newest(vehicle)
            recording.frame_of_file(vehicle, "image")
            for frame in recording.frames(vehicle):
                recording.by_frame(vehicle, frame)
    except InputError as error:
        assert str(damaged) in str(error)


def write_long(path: Path) -> list[tuple[int, int]]:
    """A hundred sets with their frame events; where each record but the last begins and how long its content is."""
    with SessionRecorder(path, "uav-1") as out:
        for frame in range(100):
            out.write_event(Frame(START_NS + frame * 10**9, frame, None, f"{frame}.png"))
            out.write_set(a_set(frame))
    content, places, position = path.read_bytes(), [], 8
    while content[position] != 0x0F:
        length = int.from_bytes(content[position + 1 : position + 9], "little")
        places.append((position, length))
        position += 9 + length
    return places


@pytest.fixture(scope="module")
def long_session(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[tuple[int, int]], list[int]]:
    path = tmp_path_factory.mktemp("long") / "session.mcap"
    places = write_long(path)
    content = path.read_bytes()
    of_sets = [i for i, (at, _) in enumerate(places) if content[at] == 5 and content[at + 31 : at + 34] == b"PC\x40"]
    assert len(of_sets) == 100
    return path, places, of_sets


Long = tuple[Path, list[tuple[int, int]], list[int]]


def test_a_click_on_a_damaged_recording_is_answered_with_a_warning(
    long_session: Long, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, places, of_sets = long_session
    content = bytearray(path.read_bytes())
    content[places[of_sets[33]][0] + 6] = 255
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(content)
    assert main(["click", "320", "240", "--frame", "90", "--from", str(damaged), "--format", "json"]) == 0
    out, err = capsys.readouterr()
    assert '"frame": 90' in out and err.startswith("pc-ground: warning: ") and err.count("\n") == 1


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_damaged_heads_cost_no_more_than_their_neighbours(long_session: Long, data: st.DataObject) -> None:
    path, places, of_sets = long_session
    content = bytearray(path.read_bytes())
    first = next(i for i in of_sets if i > 8)  # what says who publishes is whole
    hit = data.draw(st.lists(st.integers(first, len(places) - 2), min_size=1, max_size=3, unique=True))
    for i in hit:
        at, length = places[i]
        wrong = data.draw(
            st.one_of(st.integers(0, 2000), st.integers(0, 2**64 - 1)).filter(lambda n, n0=length: n != n0)
        )
        content[at + 1 : at + 9] = wrong.to_bytes(8, "little")
    damaged = path.with_name("hit.mcap")
    damaged.unlink(missing_ok=True)
    damaged.write_bytes(content)
    recording = Recording(damaged)
    near = {i + step for i in hit for step in (-1, 0, 1)}
    lost = {frame for frame, i in enumerate(of_sets) if i in near}
    assert set(range(100)) - set(recording.frames("uav-1")) <= lost
    assert recording.damage and all(str(damaged) in line for line in recording.damage)


def test_a_chunked_recording_that_cannot_be_read_to_its_end_says_so(tmp_path: Path) -> None:
    path = tmp_path / "chunked.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, chunk_size=1000)
        writer.start()
        channel = writer.register_channel("pc/uav-1/features", FEATURES.encoding, 0)
        for frame in range(20):
            writer.add_message(channel, START_NS + frame, encode(a_set(frame)), START_NS + frame)
        writer.finish()
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    recording = Recording(path)
    assert 0 < len(recording.frames("uav-1")) < 20
    assert len(recording.damage) == 1 and str(path) in recording.damage[0]


def write_chunked(path: Path) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start()
        channel = writer.register_channel("pc/uav-1/features", FEATURES.encoding, 0)
        for frame in range(3):
            stamp_ns = START_NS + frame * 10**9
            writer.add_message(channel, stamp_ns, encode(a_set(frame)), stamp_ns)
        writer.finish()


def test_a_chunked_file_is_read_through_the_mcap_package(tmp_path: Path) -> None:
    path = tmp_path / "chunked.mcap"
    write_chunked(path)
    recording = Recording(path)
    two = recording.by_frame("uav-1", 2)
    assert recording.frames("uav-1") == [0, 1, 2]
    np.testing.assert_allclose(two.plane_per_m, BASE.plane_per_m, rtol=1e-6)


def test_without_that_package_a_chunked_file_says_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "chunked.mcap"
    write_chunked(path)
    monkeypatch.setitem(sys.modules, "mcap.reader", None)
    with pytest.raises(InputError, match="needs the package mcap"):
        Recording(path)
