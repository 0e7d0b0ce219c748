"""A camera that hands out H.264, as webcams do: v4l2loopback with an encoder's pictures, read by `gst:v4l2src`."""

import itertools
import json
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from onboard.camera.helper_launch import SYSTEM_PYTHON
from onboard.events.source import State
from tests.bench.v4l2 import Output
from tests.onboard.camera.test_helper_camera import CLOCK, running
from tests.rtsp import drifting_ground, number_of

DEVICE = "/dev/video10"
PIPELINE = f"gst:v4l2src device={DEVICE} ! video/x-h264 ! h264parse ! avdec_h264"
ENCODER = Path(__file__).parents[2] / "access_units.py"
SIZE_PX, RATE_HZ, COUNT = (320, 240), 30, 150
STEP_NS = 10**9 // RATE_HZ
HANDED_OVER_NS = 12_000_000  # after the stamp


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """What an encoder made of numbered pictures, each by itself."""
    folder = tmp_path_factory.mktemp("h264")
    (folder / "frames.raw").write_bytes(b"".join(picture.tobytes() for picture in drifting_ground(COUNT, SIZE_PX)))
    spec = {"frames": str(folder / "frames.raw"), "out": str(folder / "units"), "codec": "H264", "bit_rate": 2_000_000}
    spec |= {"width": SIZE_PX[0], "height": SIZE_PX[1], "rate_hz": RATE_HZ}
    command = [SYSTEM_PYTHON, "-I", str(ENCODER)]
    subprocess.run(command, input=json.dumps(spec), text=True, check=True, timeout=100)
    raw, units, at = (folder / "units").read_bytes(), [], 0
    while at < len(raw):
        size = int.from_bytes(raw[at : at + 4], "little")
        units.append(raw[at + 4 : at + 4 + size])
        at += 4 + size
    assert len(units) == COUNT
    return units


@contextmanager
def playing(units: list[bytes]) -> Iterator[dict[int, list[int]]]:
    """The camera, over and over: of each number the stamps (ns) that its pictures were given."""
    ended, stamps = threading.Event(), dict[int, list[int]]()

    def play(camera: Output) -> None:
        begun_ns = time.monotonic_ns()
        for k in itertools.count():
            due_ns = begun_ns + k * STEP_NS
            if ended.wait(max(due_ns - time.monotonic_ns(), 0) / 1e9):
                return
            stamp_ns = due_ns - HANDED_OVER_NS
            stamps.setdefault(k % COUNT, []).append(stamp_ns)
            camera.put(units[k % COUNT], stamp_ns)

    with Output(DEVICE, "H264", *SIZE_PX, RATE_HZ) as camera:
        thread = threading.Thread(target=play, args=(camera,))
        thread.start()
        try:
            yield stamps
        finally:
            ended.set()
            thread.join()


def test_h264_of_a_device_is_decoded_and_bears_the_drivers_stamps(
    pictures: list[bytes], record_property: pytest.FixtureRequest
) -> None:
    with playing(pictures) as given, running(PIPELINE, size_px=SIZE_PX, sigma_latency_s=0.1, latency_s=0.0) as camera:
        camera.wait_for_pictures(90)
        health = camera.wait_for(State.OK, "320x240, stamps of the camera's driver")
    off_ms = []
    for _, frame in camera.frames[30:]:
        assert frame.image is not None
        stamp_ns = frame.stamp_ns - CLOCK.offset_ns
        off_ms.append(min((stamp_ns - true_ns for true_ns in given[number_of(frame.image)]), key=abs) / 1e6)
    record_property("stamps less true", f"{np.min(off_ms):+.3f} to {np.max(off_ms):+.3f} ms")  # type: ignore[operator]
    assert np.max(np.abs(off_ms)) < 1.0
    assert health.figures["damaged"] == 0
