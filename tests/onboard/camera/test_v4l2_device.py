"""The device's ioctls against a driver that reads and writes bytes at the offsets of the kernel's C header.

No structure of ours is used on the driver's side. The same with real drivers: tests/bench/inside.
"""

import errno
import mmap
import struct
from pathlib import Path
from typing import Any

import pytest

from onboard.camera import v4l2_device
from onboard.camera.v4l2_device import BUFFERS, Card, Control, Granted, Sizes, V4l2Device

YUYV = int.from_bytes(b"YUYV", "little")
PAGE = mmap.PAGESIZE
EXPOSURE, RATE_64, SCENE = 0x009A0902, 0x009F0902, 0x009A091A
SINGLE, MULTI = 1, 9  # V4L2_BUF_TYPE_VIDEO_CAPTURE, _MPLANE


class Driver:
    """A camera of one format; its memory is a file, a page to a buffer."""

    def __init__(self, kind: int) -> None:
        self.kind = kind
        self.queued: list[int] = []
        self.is_streaming = False
        self.values = {EXPOSURE: 100, RATE_64: 5_000_000_000}
        self.filled: list[int] = []

    def ioctl(self, _fd: int, request: int, argument: Any) -> None:
        raw = memoryview(argument).cast("B")
        assert len(raw) == request >> 16 & 0x3FFF
        name = {
            0: "capability", 2: "format_name", 5: "format", 8: "buffers", 9: "buffer", 15: "queue", 17: "dequeue",
            18: "on", 19: "off", 22: "rate", 27: "get", 28: "set", 37: "menu", 71: "get_64", 72: "set_64", 74: "sizes",
            75: "rates", 103: "control",
        }[request & 0xFF]  # fmt: skip
        getattr(self, name)(raw)

    def capability(self, raw: memoryview) -> None:
        struct.pack_into("16s32s32s", raw, 0, b"drv", b"Camera \xc3\xa9", b"usb-1")
        own = 0x04000000 | (0x1 if self.kind == SINGLE else 0x1000)
        struct.pack_into("III", raw, 80, 6 << 16, 0x80000000 | own | 0x2, own)

    def format_name(self, raw: memoryview) -> None:
        index, kind = struct.unpack_from("II", raw)
        assert kind == self.kind
        if index > 1:
            raise OSError(errno.EINVAL, "")
        struct.pack_into("I", raw, 44, YUYV if index == 0 else YUYV | 0x80000000)

    def sizes(self, raw: memoryview) -> None:
        index, code = struct.unpack_from("II", raw)
        if code == YUYV:
            if index > 1:
                raise OSError(errno.EINVAL, "")
            struct.pack_into("III", raw, 8, 1, 640 // (index + 1), 480 // (index + 1))
        else:
            struct.pack_into("IIIIIII", raw, 8, 3, 64, 1280, 16, 48, 960, 8)

    def rates(self, raw: memoryview) -> None:
        index, code, width, height = struct.unpack_from("IIII", raw)
        assert (code, width, height) == (YUYV, 640, 480)
        if index > 1:
            raise OSError(errno.EINVAL, "")
        struct.pack_into("III", raw, 16, 1, 1, 15 * (index + 1))

    def format(self, raw: memoryview) -> None:
        kind, width, height, code, field = struct.unpack_from("I4xIIII", raw)
        assert (kind, code, field) == (self.kind, YUYV, 1)
        struct.pack_into("II", raw, 8, width - width % 16, height)
        if self.kind == SINGLE:
            struct.pack_into("I", raw, 24, 2 * width + 64)
        else:
            assert raw[8 + 180] == 1  # planes
            struct.pack_into("I", raw, 8 + 24, 2 * width + 64)

    def rate(self, raw: memoryview) -> None:
        kind, over, under = struct.unpack_from("I8xII", raw)
        assert (kind, under / over) == (self.kind, 29.97)
        struct.pack_into("II", raw, 12, 1, 30)

    def control(self, raw: memoryview) -> None:
        wanted = struct.unpack_from("I", raw)[0]
        assert wanted & 0x80000000
        known = {
            EXPOSURE: (1, b"Exposure", 1, 5000, 1, 100, 0),
            SCENE: (3, b"Scene", 0, 2, 1, 0, 0x10),
            RATE_64: (5, b"Pixel Rate", -1, 2**40, 1, 5_000_000_000, 0x4),
        }
        after = sorted(number for number in known if number > wanted & 0x7FFFFFFF)
        if not after:
            raise OSError(errno.EINVAL, "")
        struct.pack_into("II32sqqQqI", raw, 0, after[0], *known[after[0]])

    def menu(self, raw: memoryview) -> None:
        number, index = struct.unpack_from("II", raw)
        assert number == SCENE
        if index == 1:
            raise OSError(errno.EINVAL, "")
        struct.pack_into("32s", raw, 8, b"none" if index == 0 else b"night")

    def get(self, raw: memoryview) -> None:
        struct.pack_into("i", raw, 4, self.values[struct.unpack_from("I", raw)[0]])

    def set(self, raw: memoryview) -> None:
        number, value = struct.unpack_from("Ii", raw)
        self.values[number] = value

    def _one(self, raw: memoryview) -> memoryview:
        _, count, _, _, _, address = struct.unpack_from("IIIiI4xQ", raw)
        assert count == 1
        return _memory(address, 20)

    def get_64(self, raw: memoryview) -> None:
        one = self._one(raw)
        struct.pack_into("<q", one, 12, self.values[struct.unpack_from("I", one)[0]])

    def set_64(self, raw: memoryview) -> None:
        number, value = struct.unpack_from("<I8xq", self._one(raw))
        self.values[number] = value

    def buffers(self, raw: memoryview) -> None:
        assert struct.unpack_from("III", raw) == (BUFFERS, self.kind, 1)
        struct.pack_into("I", raw, 0, BUFFERS - 1)  # a driver may give fewer

    def _place(self, raw: memoryview) -> memoryview | None:
        kind, memory = struct.unpack_from("I", raw, 4)[0], struct.unpack_from("I", raw, 60)[0]
        assert (kind, memory) == (self.kind, 1)
        if self.kind == SINGLE:
            return None
        assert struct.unpack_from("I", raw, 72)[0] == 8
        return _memory(struct.unpack_from("Q", raw, 64)[0], 8 * 64)

    def buffer(self, raw: memoryview) -> None:
        index, planes = struct.unpack_from("I", raw)[0], self._place(raw)
        if planes is None:
            struct.pack_into("I4xI", raw, 64, index * PAGE, PAGE)
        else:
            struct.pack_into("II", planes, 4, PAGE, index * PAGE)

    def queue(self, raw: memoryview) -> None:
        self._place(raw)
        self.queued.append(struct.unpack_from("I", raw)[0])

    def dequeue(self, raw: memoryview) -> None:
        planes = self._place(raw)
        if not self.filled:
            raise BlockingIOError(errno.EAGAIN, "")
        index = self.filled.pop(0)
        self.queued.remove(index)
        struct.pack_into("I", raw, 0, index)
        struct.pack_into("II", raw, 8, 100, 0x2000)  # bytesused, flags
        struct.pack_into("qq", raw, 24, 1_700_000_000, 123_456)
        struct.pack_into("I", raw, 56, 41 + index)
        if planes is not None:
            struct.pack_into("I", planes, 0, 100)
            struct.pack_into("I", planes, 16, 4)  # the picture begins there

    def on(self, raw: memoryview) -> None:
        assert struct.unpack("i", raw) == (self.kind,)
        self.is_streaming = True

    def off(self, raw: memoryview) -> None:
        assert struct.unpack("i", raw) == (self.kind,)
        self.is_streaming = False


def _memory(address: int, size: int) -> memoryview:
    import ctypes  # noqa: PLC0415  (only to follow an address, as a kernel does)

    return memoryview((ctypes.c_uint8 * size).from_address(address)).cast("B")


@pytest.fixture(params=[SINGLE, MULTI], ids=["single-plane", "multi-plane"])
def driver(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Driver:
    made = Driver(request.param)
    monkeypatch.setattr(v4l2_device.fcntl, "ioctl", made.ioctl)
    return made


@pytest.fixture
def node(tmp_path: Path) -> str:
    path = tmp_path / "video0"
    path.write_bytes(b"".join(bytes([index]) * PAGE for index in range(BUFFERS)))
    return str(path)


def test_what_a_driver_says_of_itself_is_read(driver: Driver, node: str) -> None:
    with V4l2Device(node) as device:
        assert device.card() == Card("drv", "Camera é", "usb-1", True)
        assert device.formats() == ["YUYV", "YUYV-BE"]
        assert device.sizes("YUYV") == Sizes(((640, 480), (320, 240)))
        assert device.sizes("NV12") == Sizes((), (64, 48), (1280, 960), (16, 8))
        assert device.rates_hz("YUYV", (640, 480)) == [30.0, 15.0]


def test_what_a_driver_makes_of_a_request_is_read(driver: Driver, node: str) -> None:
    with V4l2Device(node) as device:
        assert device.set_format("YUYV", (650, 480)) == Granted("YUYV", 640, 480, 1364, True)
        assert device.set_rate_hz(29.97) == 30.0


def test_controls_of_32_and_64_bits_and_menus_with_holes(driver: Driver, node: str) -> None:
    with V4l2Device(node) as device:
        exposure, scene, rate = device.controls()
        assert exposure == Control(EXPOSURE, "Exposure", 1, 1, 5000, 1, 100, 0)
        assert (scene.menu, scene.flags) == (((0, "none"), (2, "night")), 0x10)
        assert (rate.minimum, rate.maximum, rate.default) == (-1, 2**40, 5_000_000_000)
        device.set_control(exposure, 250)
        device.set_control(rate, -(2**33))
        assert (device.get_control(exposure), device.get_control(rate)) == (250, -(2**33))


def test_a_picture_comes_with_its_stamp_and_its_buffer_goes_back(driver: Driver, node: str) -> None:
    with V4l2Device(node) as device:
        device.start()
        assert driver.is_streaming and driver.queued == [0, 1, 2]
        driver.filled = [1]
        buffer = device.take(0.1)
        assert bytes(buffer.data) == b"\x01" * (100 if driver.kind == SINGLE else 96)
        assert (buffer.stamp_ns, buffer.sequence, buffer.flags) == (1_700_000_000_123_456_000, 42, 0x2000)
        assert sorted(driver.queued) == [0, 1, 2]
        assert device.take(0.1) is None
    assert not driver.is_streaming


def test_a_node_that_is_no_v4l2_device_is_closed_again(node: str) -> None:
    before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(OSError, match="ioctl"):
        V4l2Device(node)  # the real ioctl, on a plain file
    assert len(list(Path("/proc/self/fd").iterdir())) == before
