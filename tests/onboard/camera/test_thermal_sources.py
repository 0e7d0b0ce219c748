"""A thermal camera's counts, from every source to `Frame.counts`, untouched; and what is said of their scale."""

import shlex
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from contract.camera import Camera
from onboard.camera.factory import open_device
from onboard.camera.picture_decoder import Pictures, RawPicture
from onboard.camera.picture_files import open_frames
from onboard.camera.playback import PlayedCamera
from onboard.camera.thermal_grey import SMOOTHED_PX, ThermalGrey
from onboard.camera.v4l2_camera import V4l2Camera
from onboard.camera.v4l2_device import Sizes
from onboard.config.schema import CameraConfig, ThermalConfig
from onboard.events.source import State
from onboard.events.types import Frame
from tests.onboard.camera.fake_camera import SIZE_PX, Plugged, World
from tests.onboard.camera.test_helper_camera import CLOCK, Running, running
from tests.onboard.camera.test_playback import Time
from tests.onboard.camera.test_v4l2_camera import OURS

WIDTH, HEIGHT = SIZE_PX
CAMERA = Camera.from_field_of_view(*SIZE_PX, 57.0)
LEPTON = ThermalConfig(enabled=True, scale=0.01)
UNKNOWN = ThermalConfig(enabled=True)
UNIX_S = 1_700_000_000
MS = 1_000_000


def kelvin(number: int) -> np.ndarray:
    rows, columns = np.indices((HEIGHT, WIDTH))
    rng = np.random.default_rng(number)
    return 290.0 + np.sin((columns + 3 * number) / 5.0) + np.cos(rows / 4.0) + 0.05 * rng.standard_normal(rows.shape)


def centikelvin(number: int) -> np.ndarray:
    return np.rint(100.0 * kelvin(number)).astype("<u2")


def check(frames: list[Frame], wanted: list[np.ndarray]) -> None:
    assert len(frames) == len(wanted) > 0
    for frame, counts in zip(frames, wanted, strict=True):
        assert frame.image.dtype == np.uint8 and frame.counts.dtype == np.uint16
        np.testing.assert_array_equal(frame.counts, counts)
        assert np.corrcoef(frame.image.ravel(), counts.ravel().astype(float))[0, 1] > 0.95  # warm is bright


def plugged(thermal: ThermalConfig, **formats: Sizes) -> tuple[World, V4l2Camera]:
    camera = Plugged(OURS, formats=formats, rates_hz={"Y16": [8.7], "GREY": [30.0]})
    camera.data = lambda number: bytearray(centikelvin(number).tobytes())
    world = World(video0=camera)
    world.ends_s = 1.0
    source = V4l2Camera(
        CameraConfig(device="/dev/video0"), CAMERA, CLOCK, thermal, open_device=world.open,
        now_ns=lambda: world.now_ns, paths=world.paths, identify=lambda path, device: world.sockets[path].identity,
    )  # fmt: skip
    return world, source


def test_of_a_v4l2_device_the_sixteen_bits_are_taken_though_eight_come_faster() -> None:
    world, source = plugged(LEPTON, GREY=Sizes((SIZE_PX,)), Y16=Sizes((SIZE_PX,)))
    source.run(world.emit, world)
    check(world.frames, [centikelvin(number + 1) for number in range(len(world.frames))])


@pytest.mark.parametrize(
    ("thermal", "words"), [(LEPTON, "thermal, 0.01 K a count"), (UNKNOWN, "thermal, uncalibrated")]
)
def test_the_state_says_what_is_known_of_the_scale(thermal: ThermalConfig, words: str) -> None:
    world, source = plugged(thermal, Y16=Sizes((SIZE_PX,)))
    printed = []
    world.events = [(0.5, lambda: printed.append(source.health().detail))]
    source.run(world.emit, world)
    assert printed[0].endswith(words)


def test_a_camera_that_is_no_thermal_one_has_no_counts() -> None:
    world, source = plugged(ThermalConfig(), Y16=Sizes((SIZE_PX,)))
    source.run(world.emit, world)
    assert world.frames and all(frame.counts is None and frame.image is not None for frame in world.frames)


def offered(pictures: Pictures, number: int, data: bytes, fourcc: str) -> Frame:
    now_ns = 10**12 + number * 111 * MS
    frame = pictures.take(RawPicture(bytearray(data), fourcc, SIZE_PX, 0, now_ns - MS, number), now_ns)
    assert frame is not None
    return frame


def test_while_the_shutter_is_closed_there_is_neither_image_nor_counts() -> None:
    pictures = Pictures(CLOCK, 0.0, SIZE_PX, 9.0, thermal=ThermalGrey())
    shown = [0, 1, 2, 3, 3, 3, 3, 4, 5]  # 3: what was seen when it closed
    frames = [offered(pictures, k, centikelvin(number).tobytes(), "Y16") for k, number in enumerate(shown)]
    assert [frame.image is None for frame in frames] == [k in (4, 5, 6) for k in range(len(shown))]
    assert all((frame.counts is None) == (frame.image is None) for frame in frames)
    assert pictures.counts.repeated == 3


def test_of_eight_bits_the_counts_are_the_luma() -> None:
    pictures = Pictures(CLOCK, 0.0, SIZE_PX, 9.0, thermal=ThermalGrey())
    luma = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH), np.uint8)
    frame = offered(pictures, 0, luma.tobytes(), "GREY")
    assert frame.counts is not None
    np.testing.assert_array_equal(frame.counts, luma)
    assert np.corrcoef(frame.image.ravel(), cv2.GaussianBlur(luma, (0, 0), SMOOTHED_PX).ravel())[0, 1] > 0.98


def test_black_hot_pictures_of_eight_bits_are_turned_round_wherever_they_come_from(tmp_path: Path) -> None:
    black_hot = ThermalConfig(enabled=True, black_hot=True)
    warmth = np.clip(128.0 + 40.0 * (kelvin(0) - 290.0), 0.0, 255.0).astype(np.uint8)
    for number in range(2):
        Image.fromarray(255 - warmth).save(tmp_path / f"{UNIX_S + number}.png")
    check(list(open_frames(tmp_path, CAMERA, is_thermal=True, black_hot=True).frames()), [warmth] * 2)
    clock, out = Time(), list[object]()
    open_device(CameraConfig(device=f"replay:{tmp_path}"), CAMERA, clock, black_hot).run(
        lambda _, event: out.append(event), clock
    )
    check([event for event in out if isinstance(event, Frame)], [warmth] * 2)
    pictures = Pictures(CLOCK, 0.0, SIZE_PX, 9.0, thermal=ThermalGrey(black_hot=True))
    check([offered(pictures, 0, (255 - warmth).tobytes(), "GREY")], [warmth])
    assert black_hot.words == "thermal, black hot"


def test_sixteen_bits_are_counts_and_are_never_turned_round() -> None:
    _, counts = ThermalGrey(black_hot=True).picture(centikelvin(0))
    np.testing.assert_array_equal(counts, centikelvin(0))
    with pytest.raises(ValueError, match="leave one of them out"):
        ThermalConfig(enabled=True, black_hot=True, scale=0.01)


def test_a_folder_of_sixteen_bit_pictures_is_played_with_its_counts(tmp_path: Path) -> None:
    for number in range(4):
        suffix = ".png" if number % 2 else ".tif"
        Image.fromarray(centikelvin(number).astype(np.uint16)).save(tmp_path / f"{UNIX_S + number}{suffix}")
    wanted = [centikelvin(number) for number in range(4)]
    check(list(open_frames(tmp_path, CAMERA, is_thermal=True).frames()), wanted)
    assert all(frame.counts is None for frame in open_frames(tmp_path, CAMERA).frames())
    clock, out = Time(), list[Frame]()
    source = open_device(CameraConfig(device=f"replay:{tmp_path}"), CAMERA, clock, UNKNOWN)
    assert isinstance(source, PlayedCamera)
    printed = []

    def emit(_: int, event: object) -> None:
        assert isinstance(event, Frame)
        out.append(event)
        printed.append(source.health().detail)

    source.run(emit, clock)
    check(out, wanted)
    assert set(printed) == {"thermal, uncalibrated"}


def ffv1(path: Path, frames: int) -> Path:
    """As AP_CameraGimbal writes it: FFV1 of 16 bits in Matroska, kelvin = raw / 64."""
    deep = [cv2.VIDEOWRITER_PROP_DEPTH, cv2.CV_16U, cv2.VIDEOWRITER_PROP_IS_COLOR, 0]
    fourcc = cv2.VideoWriter_fourcc(*"FFV1")
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, fourcc, 5.0, SIZE_PX, deep)
    assert writer.isOpened()
    for number in range(frames):
        writer.write(raw64(number))
    writer.release()
    return path


def raw64(number: int) -> np.ndarray:
    return np.rint(64.0 * kelvin(number)).astype(np.uint16)


def test_a_lossless_video_keeps_its_sixteen_bits(tmp_path: Path) -> None:
    clip = ffv1(tmp_path / "20231114T221320Z.mkv", 5)
    check(list(open_frames(clip, CAMERA, is_thermal=True).frames()), [raw64(number) for number in range(5)])
    grey = next(iter(open_frames(clip, CAMERA).frames()))
    assert grey.counts is None and np.ptp(grey.image.astype(int)) > 150


def has_come(camera: Running) -> list[Frame]:
    return [frame for _, frame in camera.frames if frame.image is not None]


@pytest.mark.usefixtures("gstreamer")
def test_the_gstreamer_helper_passes_sixteen_bits_on_as_they_are(tmp_path: Path) -> None:
    clip = ffv1(tmp_path / "thermal.mkv", 60)
    device = f"gst:filesrc location={clip} ! matroskademux ! avdec_ffv1"
    with running(device, thermal=ThermalConfig(enabled=True, scale=1.0 / 64.0)) as camera:
        camera.wait_for_pictures(5)
    frames = has_come(camera)
    known = {raw64(number).tobytes(): number for number in range(60)}
    numbers = [known.get(frame.counts.tobytes()) for frame in frames if frame.counts is not None]
    assert len(numbers) == len(frames) and None not in numbers
    assert numbers == sorted(numbers, key=lambda n: -1 if n is None else n)


def test_a_program_of_ones_own_hands_counts_on(tmp_path: Path) -> None:
    script = tmp_path / "lepton.py"
    script.write_text(OWN_CAMERA)
    with running("exec:" + shlex.join([sys.executable, str(script)]), thermal=LEPTON) as camera:
        camera.wait_for(State.OK, "thermal, 0.01 K a count")
        camera.wait_for_pictures(3)
    first = has_come(camera)[0]
    assert int(first.counts[0, 0]) // 1000 == 29 and int(first.counts[5, 7]) - int(first.counts[5, 6]) == 3


OWN_CAMERA = """
import struct, sys, time, zlib
NAN = float("nan")
HEADER = struct.Struct("<4sHHIII4sIIqqQBBBB4f4f32x")
W, H, number = 64, 48, 0
while True:
    time.sleep(0.05)
    luma = struct.pack(f"<{W * H}H", *(29000 + 3 * (i % W) + 7 * (i // W) + number % 50 for i in range(W * H)))
    now = time.monotonic_ns()
    header = HEADER.pack(b"PCFR", 1, 128, W, H, 2 * W, b"Y16 ", len(luma), 0, now, now, number, 0, 0, 1, 0,
                         NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN)
    checksum = struct.pack("<I", zlib.crc32(header))
    sys.stdout.buffer.write(header + checksum + luma + struct.pack("<4sI", b"PCFE", number))
    sys.stdout.buffer.flush()
    number += 1
"""
