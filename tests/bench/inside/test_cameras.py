"""The bench's own promises: what is put into the loopback camera comes out of it, and vivid behaves as a camera."""

import itertools
import sys
import threading
import time

import numpy as np
import pytest

from tests.bench.known_moments import Switched, delay
from tests.bench.v4l2 import Capture, Output

WIDTH_PX, HEIGHT_PX = 64, 48
PICTURES = 20
STEP_NS = 33_333_000
FIRST_NS = 5_000_001_000
"""A clock of the player's own, deliberately not now."""


def bytes_of(number: int, fourcc: str) -> bytes:
    """A picture that carries its number; a compressed one has a length of its own."""
    if fourcc == "MJPG":
        return bytes([number]) * (500 + number)
    return bytes([number]) * int(WIDTH_PX * HEIGHT_PX * {"GREY": 1, "NV12": 1.5}.get(fourcc, 2))


@pytest.mark.parametrize("fourcc", ["GREY", "YUYV", "NV12", "MJPG", "Y16 "])
def test_pictures_come_out_of_the_loopback_with_the_bytes_and_stamps_they_were_given(fourcc: str) -> None:
    ended = threading.Event()

    def play() -> None:
        for number in itertools.count():
            if ended.wait(0.02) or number > 200:
                return
            camera.put(bytes_of(number, fourcc), FIRST_NS + number * STEP_NS)

    with Output("/dev/video10", fourcc, WIDTH_PX, HEIGHT_PX, 30) as camera:
        player = threading.Thread(target=play)
        player.start()
        try:
            with Capture("/dev/video10", fourcc, WIDTH_PX, HEIGHT_PX, 30) as capture:
                capture.take(2.0)  # perhaps a buffer of the last player's: the driver empties none
                pictures = [capture.take(2.0) for _ in range(PICTURES)]
        finally:
            ended.set()
            player.join()

    numbers = [picture.raw[0] for picture in pictures]
    assert [picture.raw for picture in pictures] == [bytes_of(number, fourcc) for number in numbers]
    assert [picture.stamp_ns for picture in pictures] == [FIRST_NS + number * STEP_NS for number in numbers]
    steps = [later - earlier for earlier, later in itertools.pairwise(numbers)]
    assert steps == [later.sequence - earlier.sequence for earlier, later in itertools.pairwise(pictures)]
    assert sum(steps) < PICTURES + 5


@pytest.mark.parametrize("fourcc", ["GREY", "YUYV"])
def test_vivid_stamps_its_pictures_with_the_monotonic_clock_and_not_ahead_of_it(fourcc: str) -> None:
    before_ns = time.monotonic_ns()
    with Capture("/dev/video0", fourcc, 640, 480, 30) as capture:
        pictures = [capture.take(2.0) for _ in range(15)]
    stamps_ns = [picture.stamp_ns for picture in pictures]
    assert before_ns < stamps_ns[0] < stamps_ns[-1] < time.monotonic_ns()


def test_the_guest_runs_the_python_of_the_aircraft() -> None:
    assert sys.prefix == "/opt/pointclick"
    assert sys.version_info[:2] == (3, 11)


@pytest.mark.parametrize("late_ms", [-3.0, 0.0, 7.5])
def test_switches_at_known_moments_tell_how_late_stamps_are(late_ms: float) -> None:
    """Pictures every 30 ms, 200 switches somewhere in every third, each made within 0.1 ms."""
    begun_ns = np.arange(700) * 30_000_000
    asked_ns = begun_ns[3:603:3] + np.random.default_rng(4).integers(0, 30_000_000, 200)
    switches = [Switched(int(at_ns), int(at_ns) + 100_000) for at_ns in asked_ns]
    means = 50.0 + 100.0 * (np.searchsorted(asked_ns + 50_000, begun_ns) % 2)
    stamps_ns = begun_ns + round(1e6 * late_ms)
    least_ms, most_ms = delay(stamps_ns.tolist(), means.tolist(), switches)
    assert late_ms - 0.6 < least_ms <= late_ms <= most_ms < late_ms + 0.6
    with pytest.raises(ValueError, match="200 switches, 199 seen"):
        delay(stamps_ns[:600].tolist(), means[:600].tolist(), switches)
