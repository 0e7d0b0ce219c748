"""The aircraft's camera source, picture by picture: what is played into a device is what comes out, in every format."""

import contextlib
import itertools
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.camera import Camera
from onboard.camera.v4l2_camera import V4l2Camera
from onboard.config.schema import CameraConfig
from onboard.events.session_clock import SessionClock
from onboard.events.source import State
from onboard.events.types import Event, Frame
from tests.bench.flight import as_format
from tests.bench.v4l2 import Output

LOOPBACK = "/dev/video10"
WIDTH_PX, HEIGHT_PX, RATE_HZ = 320, 240, 30
STEP_NS = 10**9 // RATE_HZ
LATENCY_S = 0.004
LOST_WITHIN_S = 2.0
LOAD_LOOPBACK = "modprobe v4l2loopback devices=1 card_label=uavcam exclusive_caps=1 max_buffers=8"


@dataclass
class Watched:
    """A running source and what it has said."""

    source: V4l2Camera
    clock: SessionClock
    frames: list[Frame] = field(default_factory=list)

    def wait(self, what: Callable[[], bool], within_s: float) -> float:
        """Seconds until something is so; fails if it does not come to be."""
        began_s = time.monotonic()
        while not what():
            assert time.monotonic() - began_s < within_s, self.source.health()
            time.sleep(0.02)
        return time.monotonic() - began_s

    def wait_pictures(self, count: int, within_s: float = 10.0) -> float:
        wanted = len(self.frames) + count
        return self.wait(lambda: len(self.frames) >= wanted, within_s)


@contextlib.contextmanager
def watched(**config: Any) -> Iterator[Watched]:
    clock, stop = SessionClock.start(), threading.Event()
    camera = Camera.from_field_of_view(WIDTH_PX, HEIGHT_PX, 40.0)
    whole = CameraConfig(**({"rate_hz": RATE_HZ, "latency_s": LATENCY_S} | config))
    seen = Watched(V4l2Camera(whole, camera, clock), clock)

    def emit(_: int, event: Event) -> None:
        assert isinstance(event, Frame)
        seen.frames.append(event)

    thread = threading.Thread(target=seen.source.run, args=(emit, stop))
    thread.start()
    try:
        yield seen
    finally:
        stop.set()
        thread.join(5.0)
        assert not thread.is_alive()


def picture(number: int) -> NDArray[np.uint8]:
    coarse = np.random.default_rng(7).integers(20, 236, (HEIGHT_PX // 8, WIDTH_PX // 8), dtype=np.uint8)
    return np.kron(np.roll(coarse, number, axis=1), np.ones((8, 8), np.uint8))


@dataclass
class Player:
    """Pictures put into the loopback: what was sent under which stamp."""

    sent: dict[int, int] = field(default_factory=dict)


@contextlib.contextmanager
def player(device: str, fourcc: str) -> Iterator[Player]:
    """Plays in a thread of its own for as long as the block lasts; every stamp lies 12 ms before the hand-over."""
    played, ended = Player(), threading.Event()

    def play(camera: Output) -> None:
        began_ns = time.monotonic_ns()
        for number in itertools.count():
            due_ns = began_ns + number * STEP_NS
            if ended.wait(max(due_ns - time.monotonic_ns(), 0) / 1e9):
                return
            stamp_ns = (due_ns - 12_000_000) // 1000 * 1000
            played.sent[stamp_ns] = number
            camera.put(as_format(picture(number), fourcc), stamp_ns)

    with Output(device, fourcc, WIDTH_PX, HEIGHT_PX, RATE_HZ) as camera:
        thread = threading.Thread(target=play, args=(camera,))
        thread.start()
        try:
            yield played
        finally:
            ended.set()
            thread.join()


def sh(command: str) -> str:
    done = subprocess.run(["/bin/sh", "-c", command], capture_output=True, text=True, timeout=20, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def unload(module: str) -> None:
    """Take a driver away as soon as no one holds its device open."""
    sh(f"for _ in $(seq 100); do rmmod {module} 2>/dev/null && exit 0; sleep 0.05; done; rmmod {module}")


@pytest.fixture(autouse=True)
def fresh_device() -> Iterator[None]:
    """Whatever a test did to the driver is undone."""
    yield
    unload("v4l2loopback")
    sh(f"{LOAD_LOOPBACK} video_nr=10; udevadm settle")


@pytest.mark.parametrize("fourcc", ["GREY", "YUYV", "NV12", "MJPG", "Y16 "])
def test_every_format_gives_the_picture_that_was_taken_with_the_stamp_it_was_given(fourcc: str) -> None:
    with player(LOOPBACK, fourcc) as played, watched(device=LOOPBACK, format=fourcc.strip()) as seen:
        seen.wait_pictures(40)
    assert seen.source.health().figures["damaged"] == 0
    for frame in seen.frames[2:40]:  # after buffers of the last player's
        stamp_ns = frame.stamp_ns - seen.clock.offset_ns + round(LATENCY_S * 1e9)
        assert stamp_ns in played.sent
        sent = picture(played.sent[stamp_ns]).astype(float)
        assert frame.image is not None and frame.image.shape == (HEIGHT_PX, WIDTH_PX)
        got = frame.image.astype(float)
        if fourcc in ("MJPG", "Y16 "):  # coded with loss; spread over the grey scale
            assert np.corrcoef(sent.ravel(), got.ravel())[0, 1] > 0.995
        else:
            assert np.array_equal(sent, got)
    assert len({frame.index for frame in seen.frames}) == len(seen.frames)


def test_a_camera_that_falls_silent_is_lost_and_is_taken_up_again_under_another_number() -> None:
    with watched(device=LOOPBACK, format="GREY") as seen:
        with player(LOOPBACK, "GREY"):
            seen.wait_pictures(20)
        assert seen.wait(lambda: seen.source.health().state is State.LOST, 5.0) < LOST_WITHIN_S
        unload("v4l2loopback")
        sh(f"{LOAD_LOOPBACK} video_nr=12; udevadm settle")
        with player("/dev/video12", "GREY") as played:
            assert seen.wait_pictures(20) < 5.0
            assert "/dev/video12" in seen.source.health().detail
        newest = seen.frames[-1].stamp_ns - seen.clock.offset_ns + round(LATENCY_S * 1e9)
        assert newest in played.sent
