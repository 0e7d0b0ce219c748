"""The live camera where it must refuse, wait or doubt, on the kernel's own devices; `cameras` and `calibrate` too."""

import contextlib
import io
import itertools
import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from contract.camera import Camera
from contract.errors import ConfigError
from onboard.__main__ import main
from onboard.calibration.board import Board
from onboard.camera.v4l2_camera import V4l2Camera
from onboard.camera.v4l2_device import V4l2Device
from onboard.config.schema import CameraConfig
from onboard.events.session_clock import SessionClock
from onboard.events.source import SourceStatus, State
from onboard.events.types import Frame
from tests.bench.v4l2 import Output
from tests.onboard.calibration.board_pictures import Photographer, poses_all_over

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

    def until(self, state: State, within_s: float) -> tuple[float, SourceStatus]:
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


def load_vivid(*words: str) -> None:
    modprobe = ["modprobe", "vivid", "n_devs=1", "node_types=0x1", "num_inputs=1", "input_types=0x00"]
    subprocess.run([*modprobe, *words], check=True, timeout=10)
    subprocess.run(["udevadm", "settle", "--timeout=10"], check=True, timeout=15)
    control(timestamp_source=1)


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
    """A grey 320x240 picture no two of which are the same."""
    return np.random.default_rng(number).integers(0, 255, (240, 320), np.uint8).tobytes()


def test_latency_is_taken_off_the_stamps() -> None:
    with running(latency_s=0.25) as live:
        live.more(10)
        delay_ms = np.median(np.subtract(live.arrivals_ns, [frame.stamp_ns for frame in live.frames])) / 1e6
    assert 250.0 <= delay_ms < 330.0


def test_a_multi_plane_driver_gives_the_same_pictures() -> None:
    """As the camera pipelines of many small computers are: one plane, by the other set of ioctls."""

    def shown() -> dict[str, NDArray[np.uint8]]:
        control(osd_text_mode=2)
        images = {}
        for fourcc in ("GREY", "YUYV", "NV12", "Y16"):
            with running(format=fourcc) as live:
                images[fourcc] = next(f.image for f in live.more(5)[::-1] + live.frames if f.image is not None)
        control(osd_text_mode=0)
        return images

    single = shown()
    unload("vivid")
    load_vivid("multiplanar=2")
    try:
        with V4l2Device(VIVID) as device:
            assert device.card().can_capture
        multi = shown()
    finally:
        unload("vivid")
        load_vivid()
    for fourcc, image in single.items():
        assert image.std() > 30.0
        np.testing.assert_array_equal(image, multi[fourcc])


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


def test_stamps_of_a_players_own_clock_are_replaced_by_the_arrival_and_reported() -> None:
    def stamp_ns(number: int) -> int:
        return 5_000_000_000 + number * 20_000_000

    with running(LOOPBACK, (320, 240)) as live, playing(LOOPBACK, numbered, stamp_ns=stamp_ns):
        live.until(State.DEGRADED, 5.0)
        live.more(20)
        assert "not of CLOCK_MONOTONIC" in live.camera.health().detail
    delays_ms = np.subtract(live.arrivals_ns, [frame.stamp_ns for frame in live.frames]) / 1e6
    assert np.all((delays_ms >= 0.0) & (delays_ms < 100.0))


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
    early = subprocess.run(
        f"{sys.executable} -m onboard cameras | head -1",
        shell=True,
        capture_output=True,
        text=True,
        timeout=30,
        check=True,
    )
    assert early.stdout.count("\n") == 1
    assert early.stderr == ""  # a reader that left is none
    grey = next(entry for entry in vivid["formats"] if entry["format"] == "GREY")
    sizes = {tuple(size["size_px"]): size["rates_hz"] for size in grey["sizes"]}
    assert 30.0 in sizes[640, 480]
    gain = next(entry for entry in vivid["controls"] if entry["name"] == "Gain")
    assert gain["minimum"] == 0 and gain["maximum"] == 255 and 0 <= gain["value"] <= 255


def test_a_camera_is_calibrated_live(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A board held still before the camera for a second at a time; the camera's own noise goes on."""
    truth = Camera(640, 480, 560.0, 558.0, 322.3, 236.1, (-0.28, 0.09, 0.0008, -0.0005, 0.0))
    photographer = Photographer(truth, Board())
    still = [photographer.photograph(pose, noise=0.0) for pose in poses_all_over(20, 1)]
    noise = np.random.default_rng(2).normal(0.0, 1.0, (480, 640))

    def shown(number: int) -> bytes:
        picture = still[number // 20 % len(still)]
        return (picture + np.roll(noise, number * 7919)).clip(0, 255).astype(np.uint8).tobytes()

    out = tmp_path / "camera.json"
    words = ["--size", "640x480", "--views", "16", "--seconds", "80", "--keep", str(tmp_path / "kept")]
    with playing(LOOPBACK, shown, size_px=(640, 480), period_s=0.05):
        code = main(["calibrate", "--device", LOOPBACK, "--out", str(out), *words])
    text = capsys.readouterr().out
    assert code == 0, text
    assert "16/16" in text
    assert len(list((tmp_path / "kept").glob("*.png"))) == 16
    camera = Camera.from_json(out)
    assert camera.fx_px == pytest.approx(560.0, rel=0.005)
    assert camera.distortion[0] == pytest.approx(-0.28, abs=0.02)


def test_calibrating_a_camera_of_another_size_is_refused_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    begun = time.monotonic()
    assert main(["calibrate", "--device", VIVID, "--size", "1000x700", "--out", "/tmp/c.json", "--seconds", "60"]) == 2
    assert time.monotonic() - begun < 5.0
    assert "no 1000x700" in capsys.readouterr().err
