"""Videos whose frames are not evenly spaced: each frame at its container's own time."""

import itertools
import struct
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from contract.camera import Camera
from onboard.camera.picture_files import open_frames
from onboard.camera.video_times import frame_times_s

CAMERA = Camera.from_field_of_view(64, 48, 40.0)
START_NS = 1_795_217_000_000_000_000
COUNT, RATE_HZ = 90, 30.0
# Frames shown, and for how many frame times each: after 40 frames 22 are missing (0.73 s), later two once each.
UNEVEN = [(40, 1), (1, 23), (20, 1), (1, 2), (10, 1), (1, 2), (17, 1)]
STTS = (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts")


def written(path: Path, fourcc: str = "mp4v") -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*fourcc), RATE_HZ, (64, 48))
    assert writer.isOpened()
    for i in range(COUNT):
        writer.write(np.full((48, 64, 3), 20 + 2 * i, np.uint8))
    writer.release()
    return path


def with_gaps(path: Path) -> Path:
    """An MP4 as a camera writes it that dropped frames: its table of sample durations (`stts`) is uneven."""

    def uneven(table: bytes) -> bytes:
        (delta,) = struct.unpack(">I", table[12:16])
        entries = b"".join(struct.pack(">II", count, times * delta) for count, times in UNEVEN)
        return struct.pack(">II", 0, len(UNEVEN)) + entries

    data = _replaced(written(path).read_bytes(), STTS, uneven)
    path.write_bytes(data.replace(b"edts", b"free"))  # the edit list is for the length that it was
    return path


def _replaced(data: bytes, names: tuple[bytes, ...], make: Callable[[bytes], bytes]) -> bytes:
    out, at = b"", 0
    while at < len(data):
        size, name = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 8 : at + size]
        if name == names[0]:
            body = make(body) if len(names) == 1 else _replaced(body, names[1:], make)
        out += struct.pack(">I4s", len(body) + 8, name) + body
        at += size
    return out


def true_times_s() -> list[float]:
    steps = [times for count, times in UNEVEN for _ in range(count)]
    return [n / RATE_HZ for n in itertools.accumulate([0, *steps[:-1]])]


def test_frames_after_dropped_ones_keep_their_own_times_and_the_gap_is_reported(tmp_path: Path) -> None:
    source = open_frames(with_gaps(tmp_path / "a.mp4"), CAMERA, epoch_ns=START_NS)
    assert [(stamp - START_NS) / 1e9 for stamp in source.stamps_ns] == pytest.approx(true_times_s(), abs=1e-6)
    (note,) = source.notes
    assert "lacks about 24 frames in 3 gaps, the longest 0.77 s" in note
    frames = list(source.frames())
    assert [frame.stamp_ns for frame in frames] == source.stamps_ns
    brightness = [float(np.mean(frame.image)) for frame in frames if frame.image is not None]
    assert len(brightness) == COUNT and all(b > a for a, b in itertools.pairwise(brightness))


@pytest.mark.parametrize(("suffix", "fourcc"), [("mp4", "mp4v"), ("avi", "MJPG"), ("mkv", "VP90"), ("webm", "VP90")])
def test_an_even_video_of_any_container_has_its_rate_and_no_note(tmp_path: Path, suffix: str, fourcc: str) -> None:
    path = written(tmp_path / f"a.{suffix}", fourcc)
    times_s = frame_times_s(path)
    assert np.subtract(times_s, times_s[0]) == pytest.approx(np.arange(COUNT) / RATE_HZ, abs=1e-3)
    source = open_frames(path, CAMERA, epoch_ns=START_NS)
    assert source.notes == () and len(list(source.frames())) == COUNT


def test_a_frame_that_the_decoder_leaves_out_moves_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Damage can cost single frames: here the decoder is made to swallow the tenth."""
    path = written(tmp_path / "a.mp4")
    source = open_frames(path, CAMERA, epoch_ns=START_NS)
    whole = list(source.frames())
    whole_decoder = cv2.VideoCapture

    class Lossy:
        def __init__(self, name: str) -> None:
            self._inner, self._calls = whole_decoder(name), itertools.count()

        def __getattr__(self, name: str) -> object:
            return getattr(self._inner, name)

        def grab(self) -> bool:
            if next(self._calls) == 10:
                self._inner.grab()
            return self._inner.grab()

    monkeypatch.setattr(cv2, "VideoCapture", Lossy)
    lossy = list(source.frames())
    assert [frame.stamp_ns for frame in lossy] == [frame.stamp_ns for frame in whole]
    assert [i for i, frame in enumerate(lossy) if frame.image is None] == [10]
    for a, b in zip(whole[11:], lossy[11:], strict=True):
        assert a.image is not None and b.image is not None and np.array_equal(a.image, b.image)
