"""`libcamera:` with Debian's libcamera and its pipeline over vimc: a sensor of the kernel's, with its processing."""

import json
import subprocess
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from onboard.__main__ import main
from onboard.config.schema import CameraConfig, parse_config
from onboard.events.source import State
from tests.bench import cameras
from tests.bench.known_moments import Sensor, measured, node_named
from tests.onboard.camera.test_helper_camera import Running, group_of, members, running
from tests.waiting import PATIENCE_S, eventually

CAMERA = "platform/vimc.0 Sensor B"
SIZE_PX = (636, 480)  # vimc enlarges three times what has an even number of pixels
SMALL_PX = (288, 144)  # which vimc draws, interpolates and enlarges in less than a millisecond
DRIVER = Path("/sys/bus/platform/drivers/vimc")
Record = Callable[[str, object], None]


@pytest.fixture(scope="module", autouse=True)
def vimc() -> Iterator[None]:
    subprocess.run(["modprobe", "vimc"], check=True, timeout=20)
    settle()
    control(show_information=1)  # small pictures have room for a counter alone, and without any all were the same
    yield
    unload = ["rmmod", "vimc"]
    assert eventually(lambda: subprocess.run(unload, check=False, capture_output=True, timeout=20).returncode == 0)


def settle() -> None:
    subprocess.run(["udevadm", "settle", "--timeout=10"], check=True, timeout=15)


def plug(is_in: bool) -> None:
    (DRIVER / ("bind" if is_in else "unbind")).write_text("vimc.0")
    settle()


def control(**values: int) -> None:
    settings = ",".join(f"{name}={value}" for name, value in values.items())
    subprocess.run(["v4l2-ctl", "-d", node_named("Sensor B"), "-c", settings], check=True, timeout=10)


def test_it_is_listed_with_the_line_to_write(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cameras"]) == 0
    shown = capsys.readouterr()
    line = f'device = "libcamera:{CAMERA}"'
    assert f"libcamera:{CAMERA}\n  {line}\n" in shown.out
    assert "libcamera's cameras are not listed" not in shown.err
    assert parse_config(f"[camera]\n{line}").camera.device == f"libcamera:{CAMERA}"
    assert main(["cameras", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [entry["line"] for entry in listed if entry["device"].startswith("libcamera:")] == [line]


@pytest.mark.parametrize("device", ["libcamera:", f"libcamera:{CAMERA}"])
@pytest.mark.parametrize("size_px", [SIZE_PX, (312, 240), (960, 720)])
def test_its_pictures_come_in_every_size_with_the_drivers_stamps(device: str, size_px: tuple[int, int]) -> None:
    with running(device, size_px=size_px, rate_hz=8.0) as camera:
        camera.wait_for_pictures(20)
        camera.wait_for(State.OK, "{}x{}, stamps of the camera's driver".format(*size_px))
    images = [frame.image for _, frame in camera.frames if frame.image is not None]
    assert all(image.shape == (size_px[1], size_px[0]) and image.std() > 10.0 for image in images)
    delays_ms = [(arrival_ns - frame.stamp_ns) / 1e6 for arrival_ns, frame in camera.frames]
    assert min(delays_ms) > 0.0


def test_a_size_it_does_not_have_is_reported_in_one_line() -> None:
    with running("libcamera:", size_px=(640, 480)) as camera:
        health = camera.wait_for(State.LOST, "cannot give 640x480")
    assert "\n" not in health.detail and not camera.frames


def test_an_unknown_camera_is_reported_in_one_line_with_the_one_that_is_there() -> None:
    with running("libcamera:imx219", size_px=SIZE_PX) as camera:
        camera.wait_for(State.LOST, f"libcamera:imx219: libcamera has no camera 'imx219', but '{CAMERA}'")
    assert not camera.frames


def test_an_exposure_that_this_version_cannot_fix_is_refused() -> None:
    with running("libcamera:", size_px=SIZE_PX, exposure_us=2000) as camera:
        camera.thread.join(PATIENCE_S)
    assert "cannot fix the exposure: leave camera.exposure_us out" in str(camera.error)
    assert "\n" not in str(camera.error)


def test_a_camera_slower_than_asked_is_reported() -> None:
    with running("libcamera:", size_px=SIZE_PX, rate_hz=30.0) as camera:
        camera.wait_for_pictures(10)
        control(vertical_blanking=65535)  # 0.4 s a picture
        camera.wait_for(State.DEGRADED, "")
        control(vertical_blanking=3000)


@pytest.mark.parametrize("device", ["libcamera:", "/dev/video0"])
def test_a_stamp_is_that_of_the_moment_a_picture_begins(device: str, record_property: Record) -> None:
    """The sensor's brightness is switched at known moments. vimc stamps a picture that it has finished."""
    is_vimc = device == "libcamera:"
    size_px = SMALL_PX if is_vimc else (320, 180)
    with Sensor(node_named("Sensor B") if is_vimc else device) as sensor:
        found = measured(CameraConfig(device=device), size_px, sensor)
    record_property("stamp less beginning", f"{found.least_ms:+.2f} to {found.most_ms:+.2f} ms")
    assert found.least_ms > -3.0 and found.most_ms < 3.0


def test_an_unplugged_camera_is_lost_and_taken_up_again(record_property: Record) -> None:
    with running("libcamera:", size_px=SIZE_PX, rate_hz=15.0) as camera:
        camera.wait_for_pictures(10)
        plug(False)
        camera.wait_for(State.LOST, "")
        camera.wait_for(State.LOST, "libcamera has no camera")
        record_property("plugged in", cameras.plug_in_until_new(partial(counted, camera), plug))
        assert camera.source.health().figures["reopened"] >= 1
        group = group_of(camera)
    assert members(group) == []


def counted(camera: Running) -> tuple[int, int]:
    new = sum(frame.image is not None for _, frame in camera.frames)
    return new, len(camera.frames) - new
