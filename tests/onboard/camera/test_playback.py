"""A camera that is a folder: pictures when they are due, and lost when they are over."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from contract.camera import Camera
from contract.errors import InputError
from onboard.camera.playback import PlayedCamera
from onboard.events.session_clock import SessionClock
from onboard.events.source import State
from onboard.events.types import Event, Frame

CAMERA = Camera.from_field_of_view(64, 48, 40.0)


def folder(where: Path, begin_s: float) -> Path:
    lines = ["file,unix_time_s"]
    for index in range(5):
        Image.fromarray(np.full((48, 64), 10 * index, np.uint8)).save(where / f"{index}.png")
        lines.append(f"{index}.png,{begin_s + 0.1 * index:.6f}")
    (where / "stamps.csv").write_text("\n".join(lines))
    return where


class Time(SessionClock):
    """A clock, and an event to stop by, on which waiting takes no time: each wait moves the clock on."""

    def __init__(self) -> None:
        super().__init__(0)
        self.at_ns = 1_700_000_000_000_000_000

    def now_ns(self) -> int:
        return self.at_ns

    def is_set(self) -> bool:
        return False

    def wait(self, timeout: float | None = None) -> bool:
        self.at_ns += round((timeout or 0.0) * 1e9)
        return timeout is None


def played(where: Path, clock: Time) -> tuple[PlayedCamera, list[tuple[int, Frame]]]:
    source = PlayedCamera(where, CAMERA, clock)
    assert source.health().state is State.STARTING
    out: list[tuple[int, Frame]] = []

    def emit(arrival_ns: int, event: Event) -> None:
        assert isinstance(event, Frame)
        assert source.health().state is State.OK
        out.append((arrival_ns, event))

    source.run(emit, clock)
    return source, out


def test_pictures_of_long_ago_come_now_as_far_apart_as_they_were(tmp_path: Path) -> None:
    clock = Time()
    began_ns = clock.now_ns()
    source, out = played(folder(tmp_path, 1_600_000_000.0), clock)
    assert [frame.index for _, frame in out] == [0, 1, 2, 3, 4]
    assert np.diff([frame.stamp_ns for _, frame in out]) == pytest.approx([1e8] * 4)
    assert out[0][1].stamp_ns == began_ns
    assert all(0 <= arrival_ns - frame.stamp_ns < 1e6 for arrival_ns, frame in out)
    assert source.health().state is State.LOST


def test_pictures_ahead_come_at_their_own_stamps_and_those_gone_by_do_not(tmp_path: Path) -> None:
    clock = Time()
    begin_s = clock.now_ns() / 1e9 - 0.15
    _, out = played(folder(tmp_path, begin_s), clock)
    assert [frame.index for _, frame in out] == [2, 3, 4]
    for arrival_ns, frame in out:
        assert 0 <= arrival_ns - frame.stamp_ns < 1e6
        assert frame.stamp_ns / 1e9 == pytest.approx(begin_s + 0.1 * frame.index, abs=1e-3)
        assert frame.image[0, 0] == 10 * frame.index


def test_what_cannot_be_played_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no picture"):
        PlayedCamera(tmp_path, CAMERA, SessionClock.start())
