"""A world of V4L2 devices at the ioctl boundary, with a clock that only moves when somebody waits. Single-threaded."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from onboard.camera import v4l2_structures as v4l2
from onboard.camera.discovery import Identity
from onboard.camera.v4l2_device import Buffer, Card, Control, Granted, Sizes
from onboard.events.types import Frame

SIZE_PX = (64, 48)
PERIOD_NS = 33_000_000


def failing(number: int) -> OSError:
    return OSError(number, os.strerror(number))


def picture(number: int, size_px: tuple[int, int] = SIZE_PX) -> bytearray:
    """No two the same."""
    width, height = size_px
    return bytearray(np.random.default_rng(number).integers(0, 255, (height, width), np.uint8).tobytes())


@dataclass
class Plugged:
    """A camera in a socket: what a driver would know of it."""

    identity: Identity
    formats: dict[str, Sizes] = field(default_factory=lambda: {"GREY": Sizes((SIZE_PX, (128, 96)))})
    rates_hz: dict[str, list[float]] = field(default_factory=dict)
    controls: list[Control] = field(default_factory=list)
    values: dict[int, int] = field(default_factory=dict)
    can_capture: bool = True
    is_silent: bool = False
    is_frozen: bool = False
    fault: int = 0  # errno of the next take
    open_fault: int = 0
    data: Callable[[int], bytearray] = picture
    age_ns: int = 2_000_000  # of a picture when it can be had
    flags: int = v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC
    writes: list[tuple[str, int]] = field(default_factory=list)


class World:
    """Sockets by device path, and what happens when."""

    def __init__(self, **sockets: Plugged) -> None:
        self.sockets = {f"/dev/{name}": camera for name, camera in sockets.items()}
        self.now_ns = 1_000_000_000_000
        self.begun_ns = self.now_ns
        self.ends_s = 5.0
        self.events: list[tuple[float, Callable[[], None]]] = []
        self.open_devices = 0
        self.emitted: list[tuple[int, Frame]] = []
        self.number = 0

    @property
    def at_s(self) -> float:
        return (self.now_ns - self.begun_ns) / 1e9

    def wait(self, timeout: float | None = None) -> bool:
        """`threading.Event.wait` of the stop, and everybody's clock."""
        until_ns = self.now_ns + round(timeout * 1e9)
        while due := [event for event in self.events if event[0] <= (until_ns - self.begun_ns) / 1e9]:
            event = min(due, key=lambda one: one[0])
            self.events.remove(event)
            self.now_ns = max(self.now_ns, self.begun_ns + round(event[0] * 1e9))
            event[1]()
        self.now_ns = max(self.now_ns, until_ns)
        return self.is_set()

    def is_set(self) -> bool:
        return self.at_s >= self.ends_s

    def emit(self, arrival_ns: int, event: object) -> None:
        assert isinstance(event, Frame)
        self.emitted.append((arrival_ns, event))

    @property
    def frames(self) -> list[Frame]:
        return [frame for _, frame in self.emitted]

    def open(self, path: str) -> FakeDevice:
        camera = self.sockets.get(path)
        if camera is None:
            raise failing(errno.ENOENT)
        if camera.open_fault:
            raise failing(camera.open_fault)
        self.open_devices += 1
        return FakeDevice(self, path, camera)

    def paths(self, configured: str) -> list[str]:
        return [configured, *(path for path in sorted(self.sockets) if path != configured)]

    def move(self, source: str, target: str) -> None:
        self.sockets[f"/dev/{target}"] = self.sockets.pop(f"/dev/{source}")


class FakeDevice:
    def __init__(self, world: World, path: str, camera: Plugged) -> None:
        self.world, self.path, self.camera = world, path, camera
        self.sequence = 0
        self.due_ns = 0
        self.is_closed = False
        self.size_px = SIZE_PX

    def _check(self) -> None:
        if self.world.sockets.get(self.path) is not self.camera:
            raise failing(errno.ENODEV)

    def card(self) -> Card:
        who = self.camera.identity
        return Card(who.driver, who.card, who.bus_info, self.camera.can_capture)

    def formats(self) -> list[str]:
        return list(self.camera.formats)

    def sizes(self, fourcc: str) -> Sizes:
        return self.camera.formats[fourcc]

    def rates_hz(self, fourcc: str, size_px: tuple[int, int]) -> list[float]:
        return self.camera.rates_hz.get(fourcc, [])

    def set_format(self, fourcc: str, size_px: tuple[int, int]) -> Granted:
        sizes = self.camera.formats[fourcc]
        self.size_px = size_px if not sizes.is_known or sizes.has(size_px) else sizes.discrete_px[0]
        return Granted(fourcc, *self.size_px, 0, True)

    def set_rate_hz(self, rate_hz: float) -> float | None:
        return rate_hz

    def controls(self) -> list[Control]:
        return self.camera.controls

    def get_control(self, control: Control) -> int:
        self._check()
        return self.camera.values.get(control.id, control.default)

    def set_control(self, control: Control, value: int) -> None:
        self._check()
        self.camera.writes.append((control.name, value))
        self.camera.values[control.id] = value

    def start(self) -> None:
        self._check()
        self.due_ns = self.world.now_ns + PERIOD_NS

    def take(self, timeout_s: float) -> Buffer | None:
        self._check()
        if self.camera.fault:
            fault, self.camera.fault = self.camera.fault, 0
            raise failing(fault)
        wait_ns = self.due_ns - self.world.now_ns
        if self.camera.is_silent or wait_ns > timeout_s * 1e9:
            self.world.wait(timeout_s)
            return None
        self.world.wait(max(wait_ns, 0) / 1e9)
        self._check()
        if not self.camera.is_frozen:
            self.world.number += 1
        data = self.camera.data(self.world.number)
        buffer = Buffer(data, self.due_ns - self.camera.age_ns, self.sequence, self.camera.flags, wait_ns < 0)
        self.sequence += 1
        self.due_ns += PERIOD_NS
        return buffer

    def close(self) -> None:
        assert not self.is_closed
        self.is_closed = True
        self.world.open_devices -= 1
