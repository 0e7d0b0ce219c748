"""A camera that is a folder: pictures when they are due, and lost when they are over."""

import threading
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from contract.camera import Camera
from contract.errors import InputError
from onboard.camera.playback import PlayedCamera
from onboard.commands.run import in_step
from onboard.config.schema import parse_config
from onboard.events.session_clock import SessionClock
from onboard.events.source import State
from onboard.events.types import Event, Frame
from onboard.telemetry.tlog_playback import PlayedTelemetry
from onboard.telemetry.tlog_reader import log_messages

TLOG = Path(__file__).parents[2] / "data" / "plane_turn.tlog"
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


class Ending:
    """An event that is set once a clock has been moved on by three seconds."""

    def __init__(self, clock: Time) -> None:
        self._clock, self._end_ns = clock, clock.now_ns() + 3_000_000_000

    def is_set(self) -> bool:
        return self._clock.now_ns() > self._end_ns

    def wait(self, timeout: float | None = None) -> bool:
        self._clock.wait(timeout)
        return self.is_set()


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


@pytest.mark.parametrize("begin_s", [20.0, -0.25])
def test_pictures_and_a_log_that_are_played_together_are_in_step(tmp_path: Path, begin_s: float) -> None:
    """Pictures that begin within the log, or before it."""
    messages, _ = log_messages(TLOG)
    logged_ns, clock = messages[0][0], Time()
    camera = PlayedCamera(folder(tmp_path, logged_ns / 1e9 + begin_s), CAMERA, clock)
    telemetry = PlayedTelemetry(parse_config(""), clock, TLOG)
    in_step(camera, telemetry)
    now_ns, arrivals_ns, frames = clock.now_ns(), list[int](), list[Frame]()
    telemetry.run(lambda arrival_ns, _: arrivals_ns.append(arrival_ns), Ending(clock))
    camera.run(lambda _, event: frames.append(event), clock)  # type: ignore[arg-type]
    assert frames[0].stamp_ns == pytest.approx(now_ns, abs=1e3)
    shift_ns = now_ns - logged_ns - begin_s * 1e9
    assert telemetry.shift_ns == pytest.approx(shift_ns, abs=1e3)
    assert arrivals_ns and {at_ns - telemetry.shift_ns for at_ns in arrivals_ns} <= {at_ns for at_ns, _ in messages}


@pytest.mark.parametrize(("begin_s", "words"), [(-600.0, "begins 599.6 s after the last"), (1e5, "before the first")])
def test_a_log_of_another_time_than_the_pictures_is_refused(tmp_path: Path, begin_s: float, words: str) -> None:
    messages, _ = log_messages(TLOG)
    telemetry = PlayedTelemetry(parse_config(""), Time(), TLOG)
    in_step(PlayedCamera(folder(tmp_path, messages[0][0] / 1e9 + begin_s), CAMERA, Time()), telemetry)
    with pytest.raises(InputError, match=words):
        telemetry.run(lambda *_: None, Time())


def test_pictures_that_wait_for_a_log_end_unread_when_asked_to(tmp_path: Path) -> None:
    camera, stop = PlayedCamera(folder(tmp_path, 1_600_000_000.0), CAMERA, SessionClock.start()), threading.Event()
    camera.log_shift_ns = lambda: None
    stop.set()
    camera.run(lambda *_: pytest.fail("a picture came"), stop)
    assert camera.health().state is State.STARTING
