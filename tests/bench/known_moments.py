"""In the guest: how far a camera's stamps lie behind the moment at which its pictures begin.

A sensor of the kernel's is switched between two brightnesses at moments that are known: whatever its driver stamps, a
picture that shows the old one was begun before the switch had been made, and one that shows the new one after it was
asked for. Switches at many phases of the pictures' period leave less and less room between the two.

    python -m tests.bench.known_moments DEVICE WIDTHxHEIGHT [--sensor "Sensor B"]

prints the two bounds as JSON, in ms, with what the camera said of its stamps.
"""

import argparse
import fcntl
import json
import math
import os
import random
import threading
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from contract.camera import Camera
from onboard.camera import v4l2_structures as v4l2
from onboard.camera.factory import open_device
from onboard.config.schema import CameraConfig
from onboard.events.session_clock import SessionClock
from onboard.events.source import State
from onboard.events.types import Event, Frame
from tests.waiting import PATIENCE_S, eventually

BRIGHTNESS = 0x00980900
DARK, BRIGHT = 40, 200
SWITCHES_AT_ONCE, SWITCHES_AT_MOST = 30, 480
PRECISION_MS = 3.0
"""The bounds are so near to each other when enough switches have been made; each more brings them nearer."""
NEAR_S = 0.008
"""So near the moment at which a picture is expected to begin, either way, are the switches made."""


@dataclass(frozen=True)
class Switched:
    """One switch: CLOCK_MONOTONIC before it was asked for and after it was made, ns."""

    asked_ns: int
    made_ns: int


@dataclass(frozen=True)
class Delay:
    """Stamp minus the moment at which a picture begins: at least `least_ms`, and at most `most_ms`."""

    least_ms: float
    most_ms: float
    pictures: int
    meaning: str


class Sensor:
    """A device of Video4Linux with a brightness."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_RDWR)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._fd)

    def set(self, brightness: int) -> Switched:
        wanted = v4l2.Control(id=BRIGHTNESS, value=brightness)
        asked_ns = time.monotonic_ns()
        fcntl.ioctl(self._fd, v4l2.S_CTRL, wanted)
        return Switched(asked_ns, time.monotonic_ns())


def node_named(name: str) -> str:
    """The device of the kernel's that bears a name, as vimc's "Sensor B". Raises FileNotFoundError."""
    for entry in sorted(Path("/sys/class/video4linux").iterdir()):
        if (entry / "name").read_text().strip() == name:
            return f"/dev/{entry.name}"
    raise FileNotFoundError(f"no video device is named {name}")


def delay(stamps_ns: Sequence[int], means: Sequence[float], switches: Sequence[Switched]) -> tuple[float, float]:
    """Bounds of stamp minus beginning, ms, of pictures of a mean brightness that was switched to and fro.

    Raises ValueError where pictures do not show as many changes as were made.
    """
    stamps, levels = np.asarray(stamps_ns, np.int64), np.asarray(means, float)
    is_bright = levels > 0.5 * (levels.min() + levels.max())
    first = np.flatnonzero(is_bright[1:] != is_bright[:-1]) + 1  # pictures that show another brightness than before
    if len(first) != len(switches):
        raise ValueError(f"{len(switches)} switches, {len(first)} seen")
    asked, made = (np.array([getattr(s, name) for s in switches], np.int64) for name in ("asked_ns", "made_ns"))
    least_ns, most_ns = np.max(stamps[first - 1] - made), np.min(stamps[first] - asked)
    return float(least_ns) / 1e6, float(most_ns) / 1e6


class Watched:
    """A camera that runs in a thread; of its pictures the stamps (CLOCK_MONOTONIC, ns) and the mean brightness."""

    def __init__(self, config: CameraConfig, size_px: tuple[int, int]) -> None:
        self._clock = SessionClock.start()
        self.source = open_device(config, Camera.from_field_of_view(*size_px, 60.0), self._clock)
        self.stamps_ns, self.means = list[int](), list[float]()
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.source.run, args=(self._take, self.stop))

    def _take(self, _: int, event: Event) -> None:
        if isinstance(event, Frame) and event.image is not None:
            self.means.append(float(event.image.mean()))
            self.stamps_ns.append(event.stamp_ns - self._clock.offset_ns)

    def __enter__(self) -> Self:
        self.thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop.set()
        self.thread.join(PATIENCE_S)

    def more(self, count: int, since_ns: int = 0) -> None:
        """Return once so many more pictures have come, or so many with stamps since a moment. Raises TimeoutError."""
        wanted = count if since_ns else len(self.stamps_ns) + count
        if not eventually(lambda: sum(stamp_ns > since_ns for stamp_ns in self.stamps_ns) >= wanted):
            raise TimeoutError(f"no {count} pictures: {self.source.health()}")


def measured(config: CameraConfig, size_px: tuple[int, int], sensor: Sensor) -> Delay:
    """Switch a camera's sensor while it runs, until the bounds are near to each other."""
    noise, made = random.Random(5), list[Switched]()
    least_ms, most_ms = -math.inf, math.inf
    with Watched(config, size_px) as camera:
        sensor.set(DARK)
        camera.more(30)
        begun = len(camera.stamps_ns)
        while most_ms - least_ms > PRECISION_MS and len(made) < SWITCHES_AT_MOST:
            for _ in range(SWITCHES_AT_ONCE):
                camera.more(3, made[-1].made_ns if made else 0)  # the first may have been begun before
                made.append(switched(camera, sensor, BRIGHT if len(made) % 2 == 0 else DARK, noise))
            camera.more(3, made[-1].made_ns)
            least_ms, most_ms = delay(camera.stamps_ns[begun - 5 :], camera.means[begun - 5 :], made)
        health = camera.source.health()
    if health.state not in {State.OK, State.DEGRADED}:
        raise ValueError(f"{health}")
    return Delay(least_ms, most_ms, len(camera.stamps_ns) - begun, health.detail)


def switched(camera: Watched, sensor: Sensor, brightness: int, noise: random.Random) -> Switched:
    """Switch near the moment at which a picture is expected to begin."""
    recent = np.array(camera.stamps_ns[-20:], np.int64)
    period_ns = float(np.median(np.diff(recent)))
    to_next_ns = recent[-1] + 1e9 * noise.uniform(-NEAR_S, NEAR_S) - time.monotonic_ns()
    time.sleep(to_next_ns % period_ns / 1e9)
    return sensor.set(brightness)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("device")
    parser.add_argument("size")
    parser.add_argument("--sensor", help="whose brightness it is, by its name; else the device itself has one")
    given = parser.parse_args()
    width, height = (int(word) for word in given.size.split("x"))
    config = CameraConfig(device=given.device)
    with Sensor(node_named(given.sensor) if given.sensor else given.device) as sensor:
        print(json.dumps(asdict(measured(config, (width, height), sensor))))


if __name__ == "__main__":
    main()
