"""Decoders of Video4Linux: what a stream is decoded by where the kernel has visl (stateless) and vicodec (stateful)."""

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from onboard.__main__ import main
from onboard.camera.helper_launch import decoders_text
from onboard.events.source import State
from tests.onboard.camera.test_helper_camera import running
from tests.rtsp import RtspServer, drifting_ground
from tests.waiting import eventually

SIZE_PX, RATE_HZ = (320, 240), 15.0


@pytest.fixture(autouse=True)
def loaded() -> Iterator[None]:
    modules = ["visl", "vicodec"]
    subprocess.run(["modprobe", "-a", *modules], check=True, timeout=20)
    subprocess.run(["udevadm", "settle", "--timeout=10"], check=True, timeout=15)
    yield
    unload = ["rmmod", *modules]
    assert eventually(lambda: subprocess.run(unload, check=False, capture_output=True, timeout=20).returncode == 0)


def test_decoders_are_found_and_are_no_cameras(capsys: pytest.CaptureFixture[str]) -> None:
    assert "H264 by v4l2slh264dec (hardware), else avdec_h264" in decoders_text()
    assert main(["cameras", "--json"]) == 0
    drivers = {entry["driver"] for entry in json.loads(capsys.readouterr().out) if "driver" in entry}
    assert drivers and not drivers & {"visl", "vicodec"}


def test_a_stream_is_decoded_by_the_hardware_there_is(tmp_path: Path) -> None:
    """visl decodes to bars with what it received of each picture: the way through it is real, the picture is not."""
    with (
        RtspServer(tmp_path, drifting_ground(300, SIZE_PX), RATE_HZ) as server,
        running(server.url("rtspt"), size_px=SIZE_PX, rate_hz=RATE_HZ) as camera,
    ):
        camera.wait_for_pictures(10)
        camera.wait_for(State.OK, "320x240, time stamps of the stream")
    image = camera.frames[-1][1].image
    assert image is not None and image.shape == SIZE_PX[::-1]
