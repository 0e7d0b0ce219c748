"""The live camera on real drivers: vivid at /dev/video0, v4l2loopback at /dev/video10 and elsewhere."""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from contract.camera import Camera
from contract.errors import ConfigError
from onboard.__main__ import main
from onboard.camera.v4l2 import V4l2Camera
from onboard.config import CameraConfig
from onboard.events import Frame
from onboard.session_clock import SessionClock
from onboard.sources import Health, State
from tests.bench.v4l2 import Output

VIVID, LOOPBACK = "/dev/video0", "/dev/video10"
CLOCK = SessionClock.start()


class Running:
    """A camera that runs in a thread, and what it has emitted."""

    def __init__(self, camera: V4l2Camera) -> None:
        self.camera, self.arrivals_ns, self.frames = camera, list[int](), list[Frame]()
        self.stop, self.error = threading.Event(), list[BaseException]()
        self.thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        try:
            self.camera.run(self._emit, self.stop)
        except ConfigError as error:
            self.error.append(error)

    def _emit(self, arrival_ns: int, event: object) -> None:
        assert isinstance(event, Frame)
        self.arrivals_ns.append(arrival_ns)
        self.frames.append(event)

    def until(self, state: State, within_s: float) -> tuple[float, Health]:
        """Seconds until the camera is in a state, and its health then."""
        begun = time.monotonic()
        while (waited := time.monotonic() - begun) < within_s:
            if (health := self.camera.health()).state is state:
                return waited, health
            time.sleep(0.01)
        raise AssertionError(f"not {state} within {within_s} s: {self.camera.health()}")

    def more(self, count: int, within_s: float = 5.0) -> list[Frame]:
        """The next pictures."""
        before, ends = len(self.frames), time.monotonic() + within_s
        while len(self.frames) < before + count:
            assert time.monotonic() < ends, f"{len(self.frames) - before} of {count}: {self.camera.health()}"
            time.sleep(0.01)
        return self.frames[before : before + count]


@contextlib.contextmanager
def running(device: str = VIVID, size_px: tuple[int, int] = (640, 480), **keys: object) -> Iterator[Running]:
    config = CameraConfig.model_validate({"device": device, **keys})
    live = Running(V4l2Camera(config, Camera.from_field_of_view(*size_px, 60.0), CLOCK))
    live.thread.start()
    try:
        yield live
    finally:
        live.stop.set()
        live.thread.join(3.0)
        assert not live.thread.is_alive()


def control(**values: int) -> None:
    settings = ",".join(f"{name}={value}" for name, value in values.items())
    subprocess.run(["v4l2-ctl", "-d", VIVID, "-c", settings], check=True, timeout=10)


def load_vivid() -> None:
    modprobe = ["modprobe", "vivid", "n_devs=1", "node_types=0x1", "num_inputs=1", "input_types=0x00"]
    subprocess.run(modprobe, check=True, timeout=10)
    subprocess.run(["udevadm", "settle", "--timeout=10"], check=True, timeout=15)
    control(timestamp_source=1)


def load_loopback(number: int) -> None:
    words = f"modprobe v4l2loopback devices=1 video_nr={number} card_label=uavcam exclusive_caps=1 max_buffers=8"
    subprocess.run(words.split(), check=True, timeout=10)
    subprocess.run(["udevadm", "settle", "--timeout=10"], check=True, timeout=15)


def unload(module: str) -> None:
    for _ in range(50):
        if subprocess.run(["rmmod", module], check=False, timeout=10, capture_output=True).returncode == 0:
            return
        time.sleep(0.1)
    raise AssertionError(f"{module} is held")


@contextlib.contextmanager
def playing(
    device: str, picture_of: Callable[[int], bytes], fourcc: str = "GREY", size_px: tuple[int, int] = (320, 240),
    stamp_ns: Callable[[int], int] = lambda _: time.monotonic_ns(), period_s: float = 0.02,
) -> Iterator[None]:  # fmt: skip
    ended = threading.Event()

    def play(output: Output) -> None:
        for number in itertools.count():
            if ended.wait(period_s):
                return
            output.put(picture_of(number), stamp_ns(number))

    with Output(device, fourcc, *size_px, 50) as output:
        player = threading.Thread(target=play, args=(output,))
        player.start()
        try:
            yield
        finally:
            ended.set()
            player.join()


def numbered(number: int) -> bytes:
    """A grey 320x240 picture no two of which are alike."""
    return np.random.default_rng(number).integers(0, 255, (240, 320), np.uint8).tobytes()


@pytest.mark.parametrize("fourcc", ["GREY", "YUYV", "NV12", "Y16"])
def test_every_format_gives_grey_pictures_stamped_by_the_driver(fourcc: str) -> None:
    begun_ns = CLOCK.now_ns()
    with running(format=fourcc) as live:
        frames = live.more(20)
        health = live.camera.health()
    assert health.state is State.OK, health
    assert health.detail == f"{VIVID}: 640x480 {fourcc}, stamped at its start"
    for frame in frames:
        assert frame.image is not None
        assert (frame.image.shape, frame.image.dtype) == ((480, 640), np.uint8)
        assert frame.image.std() > 30.0  # vivid's colour bars
    # The mean: vivid's clock ticks in tens of milliseconds.
    step_ms = (frames[-1].stamp_ns - frames[0].stamp_ns) / 1e6 / (19 + health.figures["lost"])
    assert 31.0 < step_ms < 36.0
    assert begun_ns < frames[0].stamp_ns < live.arrivals_ns[0] < CLOCK.now_ns()
    assert [frame.index for frame in frames] == list(range(frames[0].index, frames[0].index + 20))


def test_latency_is_taken_off_the_stamps() -> None:
    with running(latency_s=0.25) as live:
        live.more(10)
        delay_ms = np.median(np.subtract(live.arrivals_ns, [frame.stamp_ns for frame in live.frames])) / 1e6
    assert 250.0 <= delay_ms < 330.0


def test_dropped_buffers_are_counted_from_the_drivers_numbers() -> None:
    control(percentage_of_dropped_buffers=20)
    try:
        with running() as live:
            live.more(100, within_s=15.0)
            figures = live.camera.health().figures
            span_s = (live.frames[-1].stamp_ns - live.frames[0].stamp_ns) / 1e9
    finally:
        control(percentage_of_dropped_buffers=0)
    # vivid makes 29.97 pictures a second, those it drops included.
    made = span_s * 29.97 + 1
    assert figures["pictures"] + figures["lost"] == pytest.approx(made, abs=3.0)
    assert 8 <= figures["lost"] <= 60


def test_a_damaged_buffer_is_a_picture_without_an_image() -> None:
    with running() as live:
        live.more(5)
        before = live.camera.health().figures["damaged"]
        for _ in range(3):
            control(inject_v4l2_buf_flag_error=1)
            live.more(5)
        damaged = [frame for frame in live.frames if frame.image is None]
        assert live.camera.health().figures["damaged"] > before == 0
    assert damaged and len(damaged) < 10


def test_a_streaming_error_is_survived_within_two_seconds() -> None:
    with running() as live:
        live.more(5)
        control(inject_fatal_streaming_error=1)
        live.until(State.LOST, 2.0)
        waited_s, health = live.until(State.OK, 4.0)
        live.more(5)
    assert waited_s < 2.0
    assert health.figures["reopened"] == 1
    stamps_ns = [frame.stamp_ns for frame in live.frames]
    assert stamps_ns == sorted(set(stamps_ns))


def test_an_unplugged_camera_is_lost_within_two_seconds_and_reopened_when_it_returns() -> None:
    with running() as live:
        live.more(5)
        control(disconnect=1)
        waited_s, health = live.until(State.LOST, 2.0)
        assert health.detail
        unload("vivid")
        time.sleep(0.5)
        assert live.camera.health().state is State.LOST
        assert VIVID in live.camera.health().detail
        load_vivid()
        live.until(State.OK, 5.0)
        live.more(10)
    assert waited_s < 2.0


def test_a_camera_comes_back_under_another_number() -> None:
    with running(LOOPBACK, (320, 240)) as live:
        with playing(LOOPBACK, numbered):
            live.until(State.OK, 5.0)
            live.more(5)
        live.until(State.LOST, 2.0)  # its player has ended: silence
        unload("v4l2loopback")
        load_loopback(12)
        try:
            with playing("/dev/video12", numbered):
                waited_s, health = live.until(State.OK, 5.0)
                live.more(5)
                # The loopback hands a new reader what was last played: it must not count as news.
                assert all(f.image is not None for f in live.frames[-3:])
            assert health.detail.startswith("/dev/video12:")
            assert waited_s < 4.0
            live.stop.set()
            live.thread.join(3.0)
        finally:
            live.stop.set()
            live.thread.join(3.0)
            unload("v4l2loopback")
            load_loopback(10)


def test_a_camera_that_is_not_there_yet_is_waited_for() -> None:
    unload("vivid")
    try:
        with running() as live:
            _, health = live.until(State.LOST, 4.0)
            assert "not there" in health.detail
            load_vivid()
            live.until(State.OK, 5.0)
            live.more(5)
    finally:
        if not Path(VIVID).exists():
            load_vivid()


def test_a_frozen_camera_is_seen_and_its_pictures_bear_no_image() -> None:
    with running() as live:
        live.more(10)
        control(osd_text_mode=2)  # without its running counters vivid shows a still picture, bit for bit
        try:
            waited_s, health = live.until(State.FROZEN, 3.0)
            assert all(frame.image is None for frame in live.more(10))
        finally:
            control(osd_text_mode=0)
        live.until(State.OK, 2.0)
        assert all(frame.image is not None for frame in live.more(10))
    assert 0.9 < waited_s < 2.0
    assert "same picture" in health.detail


def test_a_size_the_device_does_not_have_is_one_line_with_what_it_has() -> None:
    with running(size_px=(1000, 700), format="GREY") as live:
        live.thread.join(5.0)
        assert not live.thread.is_alive()
    (error,) = live.error
    assert "1000x700" in str(error) and "GREY 320x180, 320x240" in str(error)
    assert "\n" not in str(error)


def test_gain_is_held_against_the_automatic_one_and_what_is_missing_is_said() -> None:
    control(gain_automatic=1)
    with running(gain=42.0, exposure_us=2000.0) as live:
        live.more(5)
        health = live.camera.health()
        said = subprocess.run(
            ["v4l2-ctl", "-d", VIVID, "-C", "gain,gain_automatic"], capture_output=True, text=True, check=True
        )
    assert said.stdout.split() == ["gain:", "42", "gain_automatic:", "0"]
    assert health.state is State.DEGRADED
    assert health.detail == "exposure 2000 us: the driver has no such control"


def test_stamps_of_a_players_own_clock_are_replaced_by_the_arrival_and_said() -> None:
    def stamp_ns(number: int) -> int:
        return 5_000_000_000 + number * 20_000_000

    with running(LOOPBACK, (320, 240)) as live, playing(LOOPBACK, numbered, stamp_ns=stamp_ns):
        live.until(State.DEGRADED, 5.0)
        live.more(20)
        assert "not of CLOCK_MONOTONIC" in live.camera.health().detail
    delays_ms = np.subtract(live.arrivals_ns, [frame.stamp_ns for frame in live.frames]) / 1e6
    assert np.all((delays_ms >= 0.0) & (delays_ms < 100.0))


def test_stamps_are_the_players_to_the_microsecond_when_they_are_of_our_clock() -> None:
    given: dict[int, int] = {}

    def stamp_ns(number: int) -> int:
        given[number] = time.monotonic_ns() - 30_000_000
        return given[number]

    with running(LOOPBACK, (320, 240)) as live, playing(LOOPBACK, numbered, stamp_ns=stamp_ns):
        live.until(State.OK, 5.0)
        frames = live.more(20)
    known = {CLOCK.from_monotonic_ns(stamp // 1000 * 1000): number for number, stamp in given.items()}
    for frame in frames:
        assert frame.image is not None
        assert frame.image.tobytes() == numbered(known[frame.stamp_ns])


def test_motion_jpeg_is_decoded_and_a_cut_off_one_is_a_picture_without_an_image() -> None:
    smooth = np.add.outer(np.arange(240), np.arange(320)) / 3.0

    def jpeg(number: int) -> bytes:
        out = io.BytesIO()
        Image.fromarray((smooth + number % 60).astype(np.uint8)).save(out, "JPEG", quality=90)
        whole = out.getvalue()
        return whole if number % 3 else whole[: len(whole) // 2]

    with running(LOOPBACK, (320, 240), format="MJPG") as live, playing(LOOPBACK, jpeg, "MJPG"):
        frames = live.more(30)
    images = [frame.image for frame in frames if frame.image is not None]
    assert 14 <= len(images) <= 26
    for image in images:
        offset = np.median(image.astype(float) - smooth)
        assert 0.0 <= offset < 60.0
        assert np.abs(image - smooth - offset).max() < 6.0


def test_delay_does_not_grow_behind_a_slow_reader() -> None:
    slow = threading.Event()

    class Slow(Running):
        def _emit(self, arrival_ns: int, event: object) -> None:
            super()._emit(arrival_ns, event)
            if slow.is_set():
                time.sleep(0.2)

    live = Slow(V4l2Camera(CameraConfig(device=VIVID), Camera.from_field_of_view(640, 480, 60.0), CLOCK))
    live.thread.start()
    try:
        live.more(10)
        slow.set()
        live.more(15, within_s=10.0)
        delays_ms = np.subtract(live.arrivals_ns, [frame.stamp_ns for frame in live.frames])[10:] / 1e6
        assert live.camera.health().figures["lost"] + live.camera.health().figures["skipped"] > 20
    finally:
        live.stop.set()
        live.thread.join(3.0)
    assert delays_ms.max() < 750.0
    assert abs(delays_ms[-3:].mean() - delays_ms[4:7].mean()) < 150.0


def test_the_cameras_command_lists_what_the_driver_tells(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cameras"]) == 0
    text = capsys.readouterr().out
    assert "/dev/video0" in text and "GREY" in text and "Gain, Automatic" in text
    assert main(["cameras", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    (vivid,) = [entry for entry in listed if entry["device"] == VIVID]
    assert vivid["card"] == "vivid"
    grey = next(entry for entry in vivid["formats"] if entry["format"] == "GREY")
    sizes = {tuple(size["size_px"]): size["rates_hz"] for size in grey["sizes"]}
    assert 30.0 in sizes[640, 480]
    gain = next(entry for entry in vivid["controls"] if entry["name"] == "Gain")
    assert gain["minimum"] == 0 and gain["maximum"] == 255 and 0 <= gain["value"] <= 255
