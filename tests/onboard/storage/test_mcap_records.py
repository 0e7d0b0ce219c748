"""Damaged recordings on board: how much of pictures and events is lost. Sets: tests/test_damaged_recordings.py."""

from __future__ import annotations

import functools
import io
import struct
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from contract.errors import InputError
from contract.mcap_records import MAGIC, Damage
from onboard.__main__ import main
from onboard.config.schema import to_toml
from onboard.events.types import Event, Frame, GpsQuality
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import replay
from onboard.storage.mcap_reader import RecordedFlight
from onboard.storage.mcap_records import Lost, walk
from onboard.storage.mcap_writer import SessionRecorder
from tests.contract.sets import plain_set
from tests.onboard.storage.test_rotating_recorder import configured, flight
from tests.scenarios.flights import CAMERA

START_NS = 1_700_000_000_000_000_000
PICTURES = 100


def picture_at(index: int) -> Frame:
    image = np.random.default_rng(index).integers(0, 255, (CAMERA.height_px, CAMERA.width_px), np.uint8)
    return Frame(START_NS + index * 10**8, index, image, f"{index}.png")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A hundred pictures, a set and two telemetry events after each."""
    path = tmp_path_factory.mktemp("whole") / "session.mcap"
    config = configured("jpeg")
    with SessionRecorder(
        path, "uav-1", config_text=to_toml(config), camera_json=CAMERA.to_json(), pictures="jpeg"
    ) as file:
        for index in range(PICTURES):
            frame = picture_at(index)
            file.write_event(frame)
            file.write_event(GpsQuality(frame.stamp_ns + 1, 3))
            file.write_event(GpsQuality(frame.stamp_ns + 2, 3))
            file.write_set(replace(plain_set(20), frame=index, capture_unix_ns=frame.stamp_ns))
    return path.read_bytes()


def records_of(content: bytes) -> list[tuple[int, int, int]]:
    """Opcode, beginning and end of each record up to the end of the data."""
    at, found = len(MAGIC), []
    while at < len(content):
        opcode, length = struct.unpack_from("<BQ", content, at)
        found.append((opcode, at, at + 9 + length))
        at += 9 + length
        if opcode == 0x0F:
            break
    return found


def messages_of(content: bytes, longer_than: int = 0) -> list[int]:
    return [begin for opcode, begin, end in records_of(content) if opcode == 5 and end - begin > longer_than]


def opened(tmp_path: Path, content: bytes) -> tuple[RecordedFlight, list[Event]]:
    path = tmp_path / "session.mcap"
    path.write_bytes(content)
    recorded = RecordedFlight.open([path])
    return recorded, [event for _, event in recorded.events()]


def frames_of(events: list[Event]) -> list[int]:
    return [event.index for event in events if isinstance(event, Frame)]


def with_length(content: bytes, at: int, length: int) -> bytes:
    return content[: at + 1] + struct.pack("<Q", length) + content[at + 9 :]


def test_a_whole_file_has_neither_damage_nor_caveats(whole: bytes, tmp_path: Path) -> None:
    recorded, events = opened(tmp_path, whole)
    assert frames_of(events) == list(range(PICTURES))
    assert recorded.damaged == {} and recorded.lost == {}
    assert recorded.caveats == ["100 pictures are JPEG, not as the pipeline saw them"]


@pytest.mark.parametrize(
    ("length", "share"),
    [(1 << 60, 0.0), ((1 << 64) - 1, 0.33), (40_000_000, 0.71), (3, 0.0), (0, 0.33), (25, 0.71), (20_000, 0.33),
     (90_000, 0.71)],
    ids=["huge", "most", "past the end", "tiny", "none", "short", "half", "into the next"],
)  # fmt: skip
def test_a_damaged_length_in_mid_file_costs_that_record_alone(
    whole: bytes, tmp_path: Path, length: int, share: float
) -> None:
    """Of a picture: its frame cannot be used without it."""
    pictures = messages_of(whole, longer_than=20_000)
    assert len(pictures) == PICTURES
    hit = round(share * PICTURES)
    recorded, events = opened(tmp_path, with_length(whole, pictures[hit], length))
    missing = set(range(PICTURES)) - set(frames_of(events))
    # What the length swallowed: one picture, and where it ran into the next one's record, that too.
    assert missing == {hit}
    assert sum(isinstance(e, GpsQuality) for e in events) == 2 * PICTURES
    assert len(list(recorded.sets())) == PICTURES
    (lost,) = recorded.lost.values()
    assert lost == Counter({"pictures": 1, "frames without their pictures": 1})
    assert len(recorded.stamps_ns) == PICTURES - 1
    (caveat,) = [c for c in recorded.caveats if "damaged" in c]
    assert (
        f"damaged at byte {pictures[hit]}, " in caveat and "1 frames without their pictures, 1 pictures lost" in caveat
    )


def test_a_stretch_of_zeros_costs_what_lay_in_it_and_is_counted(whole: bytes, tmp_path: Path) -> None:
    """A sector that the disk lost."""
    pictures = messages_of(whole, longer_than=20_000)
    begin, end = pictures[40] + 3, pictures[43] + 3
    recorded, events = opened(tmp_path, whole[:begin] + bytes(end - begin) + whole[end:])
    assert set(range(PICTURES)) - set(frames_of(events)) == {40, 41, 42, 43}
    (lost,) = recorded.lost.values()
    expected = {"pictures": 4, "frames": 3, "gps_quality": 6, "features": 3, "frames without their pictures": 1}
    assert {name: count for name, count in lost.items() if not name.startswith("view/")} == expected
    assert len(list(recorded.sets())) == PICTURES - 3


def test_content_that_cannot_be_read_is_left_out_and_counted(whole: bytes, tmp_path: Path) -> None:
    """A sector inside of a picture, which leaves every record's length whole; and a letter of a telemetry event."""
    pictures = messages_of(whole, longer_than=20_000)
    begin = pictures[40] + 9_000
    event = whole.index(b'"fix_type"', pictures[70])
    content = whole[:begin] + bytes(512) + whole[begin + 512 : event] + b"\xff" + whole[event + 1 :]
    recorded, events = opened(tmp_path, content)
    assert set(range(PICTURES)) - set(frames_of(events)) == {40}
    assert sum(isinstance(e, GpsQuality) for e in events) == 2 * PICTURES - 1
    assert recorded.damaged == {}
    for _ in range(2):  # reading it again counts nothing twice
        assert any("content is damaged: 1 frames, 1 gps_quality left out" in caveat for caveat in recorded.caveats)
        assert len(list(recorded.events())) == len(events)


def test_a_channel_of_which_nothing_can_be_read_is_no_damage(whole: bytes, tmp_path: Path) -> None:
    """Events of another version, say: a flight without its telemetry is another one."""
    path = tmp_path / "session.mcap"
    path.write_bytes(whole.replace(b'"fix_type"', b'"fix_kind"'))
    with pytest.raises(InputError, match="a GpsQuality without fix_type"):
        list(RecordedFlight.open([path]).events())


def test_channels_whose_own_records_are_lost_are_known_from_the_end_of_the_file(whole: bytes, tmp_path: Path) -> None:
    channels = [(begin, end) for opcode, begin, end in records_of(whole) if opcode == 4]
    begin = channels[1][0]  # of the frames: the second to come, after that of the pictures
    recorded, events = opened(tmp_path, with_length(whole, begin, 1 << 60))
    assert set(range(1, PICTURES)) <= set(frames_of(events))
    assert recorded.damaged


@pytest.mark.long
def test_a_replay_says_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = configured(rotate_mb=100.0)
    path = tmp_path / "session.mcap"
    recorder = SessionRecorder(
        path, "uav-1", config_text=to_toml(config), camera_json=CAMERA.to_json(), pictures="lossless"
    )

    class Sink:
        def __enter__(self) -> Sink:
            return self

        def __exit__(self, *_: object) -> None:
            recorder.close()

        def event(self, arrival_ns: int, event: Event) -> None:
            recorder.write_event(event, arrival_ns)

        def feature_set(self, output: object) -> None:
            recorder.write_set(output)

    replay(flight(config), Pipeline(config, CAMERA), [Sink()])
    content = path.read_bytes()
    pictures = messages_of(content, longer_than=15_000)
    assert main(["replay", str(path)]) == 0
    assert "damaged" not in capsys.readouterr().out
    path.write_bytes(with_length(content, pictures[10], 1 << 60))
    assert main(["replay", str(path)]) == 0
    out = capsys.readouterr().out
    assert "not exactly the same flight: session.mcap is damaged at byte" in out and "pictures lost" in out
    frames = next(int(line.split()[1]) for line in out.splitlines() if line.startswith("frames "))
    assert frames >= len(pictures) - 3


@given(share=st.floats(0.0, 1.0), length=st.integers(0, 2**64 - 1), flips=st.integers(1, 255))
def test_whatever_is_damaged_nothing_is_read_that_was_not_written(share: float, length: int, flips: int) -> None:
    """The length of any record, or its opcode."""
    content, records, written = _small()
    _, begin, _ = records[round(share * (len(records) - 1))]
    # A length that reaches over whole records to where another one begins cannot be known to be wrong.
    assume(begin + 9 + length not in _beginnings(content))
    opcode = bytes([content[begin] ^ flips])
    for damaged in (with_length(content, begin, length), content[:begin] + opcode + content[begin + 1 :]):
        parts = list(walk(io.BytesIO(damaged)))
        read = [part[1].data for part in parts if isinstance(part, tuple)]
        assert set(read) <= written
        assert len(read) >= len(written) - 2  # all but the record that is hit, and one that it may have swallowed
        assert all(part.end > part.start for part in parts if isinstance(part, Damage))
        lost = sum(part.count for part in parts if isinstance(part, Lost))
        assert lost <= 2 and (len(read) + lost == len(written) or not lost)


@functools.cache
def _beginnings(content: bytes) -> set[int]:
    """Where every record begins, those of the summary at the end too."""
    at, found = len(MAGIC), set()
    while at < len(content) - len(MAGIC):
        found.add(at)
        at += 9 + int(struct.unpack_from("<Q", content, at + 1)[0])
    return found | {at}


@functools.cache
def _small() -> tuple[bytes, list[tuple[int, int, int]], set[bytes]]:
    """A file of forty events, its records, and what its messages say."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "small.mcap"
        with SessionRecorder(path, "uav-1") as file:
            for index in range(20):
                file.write_event(GpsQuality(START_NS + index, 3, satellites=index))
                file.write_set(replace(plain_set(20, seed=index), frame=index, capture_unix_ns=START_NS + index))
        content = path.read_bytes()
    written = {part[1].data for part in walk(io.BytesIO(content)) if isinstance(part, tuple)}
    return content, records_of(content), written
