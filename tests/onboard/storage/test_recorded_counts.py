"""A thermal camera's counts in a recording: back as they were, or not at all, never those of another picture."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.camera import Camera
from onboard.events.types import Frame
from onboard.storage.mcap_reader import RecordedFlight
from onboard.storage.mcap_writer import SessionRecorder

CAMERA = Camera.from_field_of_view(64, 48, 57.0)
START_NS = 1_700_000_000_000_000_000


def frame(index: int, deep: bool) -> Frame:
    counts = np.random.default_rng(index).integers(28000 if deep else 0, 30000 if deep else 256, (48, 64), np.uint16)
    return Frame(START_NS + index * 10**8, index, (counts % 256).astype(np.uint8), counts=counts)


def recorded(path: Path, frames: list[Frame], pictures: str) -> list[Frame]:
    with SessionRecorder(path, "uav-1", camera_json=CAMERA.to_json(), pictures=pictures) as file:
        for one in frames:
            file.write_event(one)
    events = [event for _, event in RecordedFlight.open([path]).events()]
    assert all(isinstance(event, Frame) for event in events) and len(events) == len(frames)
    return [event for event in events if isinstance(event, Frame)]


@pytest.mark.parametrize("deep", [True, False], ids=["16 bits", "8 bits"])
def test_lossless_recordings_give_every_count_back(tmp_path: Path, deep: bool) -> None:
    frames = [frame(index, deep) for index in range(5)]
    for back, one in zip(recorded(tmp_path / "a.mcap", frames, "lossless"), frames, strict=True):
        assert back.image is not None and back.counts.dtype == np.uint16
        np.testing.assert_array_equal(back.image, one.image)
        np.testing.assert_array_equal(back.counts, one.counts)


def test_frames_without_counts_get_none_of_their_neighbours(tmp_path: Path) -> None:
    frames = [frame(index, True) for index in range(4)]
    frames[1] = replace(frames[1], counts=None)
    frames[2] = replace(frames[2], counts=None, image=None)
    back = recorded(tmp_path / "a.mcap", frames, "lossless")
    assert [one.counts is not None for one in back] == [True, False, False, True]
    np.testing.assert_array_equal(back[3].counts, frames[3].counts)


def test_a_second_cameras_pictures_stand_next_to_the_first_ones_and_are_read_by_themselves(tmp_path: Path) -> None:
    first, second = [frame(index, False) for index in range(4)], [frame(10 + index, True) for index in range(2)]
    path, optics = tmp_path / "a.mcap", CAMERA.to_json()
    with SessionRecorder(path, "uav-1", camera_json=optics, second_camera_json=optics, pictures="lossless") as file:
        for number, one in enumerate(first):
            file.write_event(one)
            if number % 2:
                file.write_second_picture(second[number // 2])
    flight = RecordedFlight.open([path])
    assert flight.second_camera == CAMERA and flight.has_second_counts
    assert flight.stamps_ns == [one.stamp_ns for one in first]
    assert [event.stamp_ns for _, event in flight.events()] == flight.stamps_ns
    for back, one in zip(flight.second_pictures(), second, strict=True):
        assert (back.stamp_ns, back.index) == (one.stamp_ns, one.index)
        np.testing.assert_array_equal(back.counts, one.counts)


def test_without_a_second_camera_or_with_jpeg_there_is_nothing_to_look_in(tmp_path: Path) -> None:
    recorded(tmp_path / "one.mcap", [frame(0, True)], "lossless")
    with SessionRecorder(
        tmp_path / "jpeg.mcap", "uav-1", camera_json=CAMERA.to_json(), second_camera_json=CAMERA.to_json(),
        pictures="jpeg",
    ) as file:  # fmt: skip
        file.write_event(frame(0, False))
        file.write_second_picture(frame(1, True))
    one, jpeg = (RecordedFlight.open([tmp_path / f"{name}.mcap"]) for name in ("one", "jpeg"))
    assert not one.has_second_counts and not list(one.second_pictures())
    assert not jpeg.has_second_counts
    (back,) = jpeg.second_pictures()
    assert back.image is not None and back.counts is None


def test_recordings_to_look_at_hold_no_counts(tmp_path: Path) -> None:
    frames = [frame(index, True) for index in range(3)]
    small, whole = (tmp_path / f"{pictures}.mcap" for pictures in ("jpeg", "lossless"))
    assert all(one.counts is None for one in recorded(small, frames, "jpeg"))
    recorded(whole, frames, "lossless")
    assert small.stat().st_size < 0.5 * whole.stat().st_size
