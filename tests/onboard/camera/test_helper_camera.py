"""A camera behind a helper program: whatever the helper does is reported in time, and pictures come again after it."""

import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.camera import Camera
from contract.errors import ConfigError
from onboard.camera import helper_camera
from onboard.camera.factory import open_camera
from onboard.camera.frame_protocol import NAN, GimbalFrame, Header
from onboard.camera.helper_camera import HelperCamera, _of_lens_and_gimbal
from onboard.config.schema import NOT_THERMAL, Config, ThermalConfig
from onboard.events.session_clock import SessionClock
from onboard.events.source import SourceStatus, State
from onboard.events.types import Event, Frame, GimbalAttitude, Zoom
from tests.waiting import PATIENCE_S, eventually, until

CHECKOUT = Path(__file__).resolve().parents[3]
SCRIPTED = [sys.executable, "-m", "tests.onboard.camera.scripted_helper"]
CLOCK = SessionClock(1_700_000_000_000_000_000)
REPORTED_S, BACK_S = 2.0, 3.0  # the latter and what a start of the helper takes on this machine
SHARED_MEMORY = "/dev/shm/"


class Running:
    def __init__(
        self,
        device: str,
        size_px: tuple[int, int] = (64, 48),
        thermal: ThermalConfig = NOT_THERMAL,
        **keys: object,
    ) -> None:
        config = Config.model_validate({"camera": {"device": device, **keys}, "thermal": thermal})
        source = open_camera(config, Camera.from_field_of_view(*size_px, 60.0), CLOCK)
        assert isinstance(source, HelperCamera)
        self.source = source
        self.frames: list[tuple[int, Frame]] = []
        self.error: BaseException | None = None
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self._run)
        self.begun_s = time.monotonic()
        self.start_s = 0.0  # of the helper, to its first picture

    def _run(self) -> None:
        try:
            self.source.run(self._emit, self.stop)
        except ConfigError as error:
            self.error = error

    def _emit(self, arrival_ns: int, event: Event) -> None:
        assert isinstance(event, Frame)
        if not self.frames:
            self.start_s = time.monotonic() - self.begun_s
        self.frames.append((arrival_ns, event))

    def wait_for(self, state: State, words: str, within_s: float = PATIENCE_S) -> SourceStatus:
        found = [self.source.health()]

        def is_so() -> bool:
            found.append(self.source.health())
            return found[-1].state is state and words in found[-1].detail

        assert until(is_so, within_s) <= within_s, f"not {state} '{words}' within {within_s} s: {found[-1]}"
        return found[-1]

    def wait_for_pictures(self, count: int, within_s: float = PATIENCE_S, image: bool = True) -> None:
        before = len(self.frames)

        def are_there() -> bool:
            return sum((frame.image is not None) == image for _, frame in self.frames[before:]) >= count

        assert until(are_there, within_s) <= within_s, f"no picture within {within_s} s: {self.source.health()}"


def shared_memory(group: int) -> list[str]:
    """What the processes of a group have open or mapped of it: what is not there cannot be left there."""
    used = []
    for pid in pids_of(group):
        used += [line for line in Path(f"/proc/{pid}/maps").read_text().splitlines() if SHARED_MEMORY in line]
        used += [str(fd.readlink()) for fd in Path(f"/proc/{pid}/fd").iterdir() if SHARED_MEMORY in str(fd.readlink())]
    return used


@contextmanager
def running(
    device: str, size_px: tuple[int, int] = (64, 48), thermal: ThermalConfig = NOT_THERMAL, **keys: object
) -> Iterator[Running]:
    camera = Running(device, size_px, thermal, **keys)
    camera.thread.start()
    try:
        yield camera
    finally:
        camera.stop.set()
        camera.thread.join(PATIENCE_S)
        assert not camera.thread.is_alive()
    stamps = [frame.stamp_ns for _, frame in camera.frames]
    assert stamps == sorted(set(stamps))
    assert [frame.index for _, frame in camera.frames] == list(range(len(stamps)))


def tell(folder: Path, name: str) -> None:
    (folder / name).touch()


def scripted(folder: Path, acts: str) -> str:
    return "exec:" + shlex.join([*SCRIPTED, str(folder / "starts"), *acts.split()])


@pytest.fixture(autouse=True)
def in_checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(CHECKOUT)


def members(group: int) -> list[list[str]]:
    columns = ["-o", "pid=", "-o", "pgid=", "-o", "stat=", "-o", "args="]
    listed = subprocess.run(["ps", "-eww", *columns], capture_output=True, text=True, check=True).stdout
    rows = [line.split(None, 3) for line in listed.splitlines()]
    return [row for row in rows if row[1] == str(group) and not row[2].startswith("Z")]


def processes_of(group: int) -> list[str]:
    return [row[3] for row in members(group)]


def pids_of(group: int) -> list[int]:
    return [int(row[0]) for row in members(group)]


def group_of(camera: Running) -> int:
    stream = camera.source._stream
    return stream.process.pid


def test_frames_become_pictures_with_their_stamps(tmp_path: Path) -> None:
    with running(scripted(tmp_path, "frames:300"), latency_s=0.02) as camera:
        camera.wait_for_pictures(70)
        health = camera.wait_for(State.OK, "64x48, stamps of the camera's driver")
        stamps_s = [frame.stamp_ns / 1e9 for _, frame in camera.frames[-60:]]
        group = group_of(camera)
        assert pids_of(group) and shared_memory(group) == []
    assert processes_of(group) == []
    assert "each +-1.0 ms" in health.detail and health.figures["stamp_sigma_ms"] == pytest.approx(1.0)
    assert health.figures["rate_hz"] == pytest.approx(59.0 / (stamps_s[-1] - stamps_s[0]), rel=0.3)
    # Taken 5 ms before it was written; the rest is this machine's.
    late_ns = [arrival_ns - frame.stamp_ns for arrival_ns, frame in camera.frames[:40]]
    assert min(late_ns) >= 25_000_000 and np.median(late_ns) < 400_000_000
    for _, frame in camera.frames[:40]:
        assert frame.image.shape == (48, 64) and frame.stamp_sigma_s == 0.0
    assert np.std(camera.frames[0][1].image) > 50.0


def test_a_sender_with_a_clock_of_its_own_is_timed_by_the_least_delay(tmp_path: Path) -> None:
    with running(scripted(tmp_path, "epoch:-4321 frames:300")) as camera:
        camera.wait_for_pictures(50)
        health = camera.wait_for(State.OK, "RTCP sender reports (the sender's clock, by the least delay")
    assert health.figures["stamp_sigma_ms"] < 100.0
    late_ms = np.array([(arrival_ns - frame.stamp_ns) / 1e6 for arrival_ns, frame in camera.frames[30:]])
    assert late_ms.min() > -1.0 and np.median(late_ms) < 60.0
    assert all(frame.stamp_sigma_s == 0.0 for _, frame in camera.frames)


@pytest.mark.wall_clock(waits=True)
def test_a_helper_killed_within_a_frame_is_started_again(tmp_path: Path) -> None:
    with running(scripted(tmp_path, "frames:@now half then stall:@lost frames:900")) as camera:
        camera.wait_for_pictures(15)
        tell(tmp_path, "now")
        camera.wait_for(State.LOST, "ended by SIGKILL", REPORTED_S)
        tell(tmp_path, "lost")
        camera.wait_for_pictures(5, BACK_S + camera.start_s)
        assert camera.wait_for(State.OK, "").figures["reopened"] >= 1
    assert all(frame.image is not None for _, frame in camera.frames)


@pytest.mark.wall_clock(waits=True)
def test_a_helper_stopped_for_five_seconds_is_lost_and_replaced(tmp_path: Path) -> None:
    with running(scripted(tmp_path, "frames:900 then stall:@lost frames:900")) as camera:
        camera.wait_for_pictures(10)
        stopped = group_of(camera)
        os.kill(stopped, signal.SIGSTOP)  # it can neither write nor end by itself
        camera.wait_for(State.LOST, "no picture for ", REPORTED_S)
        tell(tmp_path, "lost")
        camera.wait_for_pictures(5, BACK_S + camera.start_s)
        assert group_of(camera) != stopped and processes_of(stopped) == []


def test_a_helper_that_needs_longer_for_its_first_picture_than_is_waited_gets_longer_the_next_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As GStreamer at its first start on a slow computer: it looks through its plugins, each time from the first."""
    monkeypatch.setattr(helper_camera, "FIRST_PICTURE_S", 1.5)
    with running(scripted(tmp_path, "stall:2 frames:900")) as camera:
        camera.wait_for(State.LOST, "no picture", 3.0 * PATIENCE_S)
        camera.wait_for_pictures(5, 3.0 * PATIENCE_S)
        assert camera.source._overdue >= 1


def test_stamps_that_run_backwards_are_left_out_and_reported(tmp_path: Path) -> None:
    acts = "frames:20 back:0.4 frames:6 back:0 frames:30 back:7 frames:@seen back:0 frames:900"
    with running(scripted(tmp_path, acts)) as camera:
        camera.wait_for_pictures(30)
        assert camera.source.health().figures["skipped"] >= 5
        camera.wait_for(State.DEGRADED, "stamps are no times of CLOCK_MONOTONIC: 7")
        tell(tmp_path, "seen")
        camera.wait_for_pictures(10)
        camera.wait_for(State.OK, "")  # once the rate over two seconds is whole again


def test_garbage_between_frames_is_passed_over_and_reported(tmp_path: Path) -> None:
    with running(scripted(tmp_path, "frames:20 garbage:70000 frames:300")) as camera:
        health = camera.wait_for(State.DEGRADED, "bytes that are no frames")
        assert 60_000 < health.figures["garbage_bytes"] <= 70_000
        camera.wait_for_pictures(10)
        camera.wait_for(State.OK, "")


def test_nothing_but_garbage_is_a_lost_camera(tmp_path: Path) -> None:
    lines = " ".join(["garbage:20000 stall:0.1"] * 200)
    with running(scripted(tmp_path, "frames:5 exit:0 then " + lines), lost_after_s=0.5) as camera:
        camera.wait_for_pictures(5)
        camera.wait_for(State.LOST, "ended with exit status 0")
        time.sleep(1.0)
        assert camera.source.health().state is State.LOST
        assert len(camera.frames) == 5


def test_another_size_in_mid_stream_is_no_picture_of_ours(tmp_path: Path) -> None:
    with running(scripted(tmp_path, "frames:20 size:32x24 frames:@seen size:64x48 frames:900")) as camera:
        camera.wait_for_pictures(10)
        camera.wait_for(State.DEGRADED, "pictures are 32x24, the camera file is for 64x48: none is used")
        assert camera.frames[-1][1].image is None
        tell(tmp_path, "seen")
        camera.wait_for_pictures(10)
        camera.wait_for(State.OK, "64x48")


def test_another_rate_in_mid_stream_is_reported_and_costs_no_picture(tmp_path: Path) -> None:
    acts = "rate:60 frames:70 rate:10 frames:@slow rate:60 frames:9000"
    with running(scripted(tmp_path, acts), rate_hz=30.0) as camera:
        camera.wait_for(State.OK, "64x48")
        camera.wait_for(State.DEGRADED, "of 30 pictures a second")
        tell(tmp_path, "slow")
        camera.wait_for(State.OK, "64x48")
        stamps_ns = np.array([frame.stamp_ns for _, frame in camera.frames])
        assert np.all(np.diff(stamps_ns) > 0) and all(frame.image is not None for _, frame in camera.frames)


def test_a_picture_that_comes_again_and_again_is_frozen(tmp_path: Path) -> None:
    with running(scripted(tmp_path, "frames:10 same:@seen frames:900")) as camera:
        camera.wait_for(State.FROZEN, "the same picture for")
        assert camera.frames[-1][1].image is None
        tell(tmp_path, "seen")
        camera.wait_for_pictures(5)


@pytest.mark.wall_clock(waits=True)
def test_what_a_helper_started_ends_with_it(tmp_path: Path) -> None:
    with running(scripted(tmp_path, "child frames:900")) as camera:
        camera.wait_for_pictures(5)
        group = group_of(camera)
        assert any("sleep" in line for line in processes_of(group))
        camera.stop.set()
        assert until(lambda: not camera.thread.is_alive(), 1.0) <= 1.0
    assert processes_of(group) == []


def test_a_program_that_is_not_there_is_a_configuration_that_cannot_work() -> None:
    with running("exec:/no/such/program --gain 3") as camera:
        camera.thread.join(PATIENCE_S)
    assert str(camera.error) == "exec:/no/such/program: /no/such/program: No such file or directory"


def test_a_program_that_says_it_can_never_work_is_trusted_at_first_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Where the machine stands still while the first one starts, it is not ended for that: the second sends nothing.
    monkeypatch.setattr(helper_camera, "FIRST_PICTURE_S", PATIENCE_S)
    with running(scripted(tmp_path, "say:no-licence-file exit:2")) as camera:
        camera.thread.join(PATIENCE_S)
    assert str(camera.error) == f"exec:{sys.executable}: no-licence-file"
    (tmp_path / "starts").unlink()
    with running(scripted(tmp_path, "frames:5 say:unplugged exit:2 then stall:@lost frames:900")) as camera:
        camera.wait_for(State.LOST, "unplugged")
        tell(tmp_path, "lost")
        camera.wait_for_pictures(5)
    assert camera.error is None


def test_no_helper_outlives_a_daemon_that_is_killed(tmp_path: Path) -> None:
    program = (
        "import sys, threading\n"
        "from tests.onboard.camera.test_helper_camera import Running\n"
        f"camera = Running({scripted(tmp_path, 'child frames:9000')!r})\n"
        "camera.thread.daemon = True\n"
        "camera.thread.start()\n"
        "camera.wait_for_pictures(5)\n"
        "print(camera.source._stream.process.pid, flush=True)\n"
        "camera.thread.join()\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as daemon:
        assert daemon.stdout is not None
        try:
            group = int(daemon.stdout.readline())
            assert any("scripted_helper" in line for line in processes_of(group))
        finally:
            daemon.kill()
    assert eventually(lambda: not any("scripted_helper" in line for line in processes_of(group)))
    os.killpg(group, signal.SIGKILL)  # the `sleep` of an own program, which writes nothing: systemd's part


@pytest.mark.parametrize(
    ("device", "why"), [("exec:", "needs a command, as exec:/usr"), ("exec:cat 'x", "No closing quotation")]
)
def test_a_command_that_cannot_be_read_is_refused(device: str, why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        Running(device)


def test_the_example_for_own_cameras_gives_pictures() -> None:
    example = CHECKOUT / "examples" / "own_camera.py"
    with running(f"exec:/usr/bin/python3 -I {example}", rate_hz=20.0) as camera:
        camera.wait_for_pictures(20)
        health = camera.wait_for(State.OK, "stamps of the camera's driver")
    assert health.figures["stamp_sigma_ms"] == pytest.approx(0.5, rel=1e-3)
    # The end of the first row's exposure of 4 ms: its middle was 2 ms before.
    late_ns = [arrival_ns - frame.stamp_ns for arrival_ns, frame in camera.frames[:20]]
    assert min(late_ns) >= 1_900_000 and np.median(late_ns) < 200_000_000


def test_zoom_focal_length_and_gimbal_of_a_header_are_events_of_its_picture_s_time() -> None:
    nothing = Header(64, 48, 5, 1)
    assert list(_of_lens_and_gimbal(nothing, 7)) == []
    assert list(_of_lens_and_gimbal(replace(nothing, zoom=2.5), 7)) == [Zoom(7, 2.5, "times", is_of_picture=True)]
    both = replace(nothing, zoom=2.5, focal_px=900.0)
    assert list(_of_lens_and_gimbal(both, 7)) == [Zoom(7, 900.0, "focal_px", is_of_picture=True)]
    turned = replace(nothing, gimbal=(0.0, 2.0**0.5, 0.0, 0.0), gimbal_frame=GimbalFrame.EARTH)
    (event,) = _of_lens_and_gimbal(turned, 7)
    assert event == GimbalAttitude(7, (0.0, 1.0, 0.0, 0.0), "earth", is_of_camera=True)
    for bad in ((NAN, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)):
        assert list(_of_lens_and_gimbal(replace(turned, gimbal=bad), 7)) == []
    assert list(_of_lens_and_gimbal(replace(turned, gimbal_frame=GimbalFrame.NONE), 7)) == []
