"""`pc-onboard bench`: what this computer can do. A flight is simulated, or a recorded one is replayed.

Exit code 0: the configured camera is within what it can do; 1: it is not, or nothing was solved.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import resource
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2

from contract.camera import Camera
from contract.errors import InputError
from onboard.camera_files.formats import load_camera_file
from onboard.commands.replay import recorded_flight
from onboard.commands.status import configuration
from onboard.config.schema import Config
from onboard.events.types import Event
from onboard.replay.load import SHARE, WARM_UP, Load, measure
from onboard.replay.made_flight import MadeFlight
from onboard.replay.runner import Flight
from onboard.service.host import cpu_temperature_c

SLOWED = 1.15  # of the last quarter over the first: more is called getting slower
LEAST_PICTURES = 4 * WARM_UP
SOLVED_SHARE = 0.5  # with less, what was measured is not the work of a flight
FIELD_OF_VIEW_DEG = 60.0  # of a made camera


class Watch:
    """The hottest that the processor was and the most memory that we had, looked at once a second."""

    def __init__(self) -> None:
        self.first_c = self.hottest_c = cpu_temperature_c()
        self.resident_mb = 0.0
        self._looked_s = -math.inf

    def look(self) -> None:
        """Note both if it is time to."""
        now_s = time.monotonic()
        if now_s - self._looked_s < 1.0:
            return
        self._looked_s = now_s
        found = (self.hottest_c, cpu_temperature_c())
        self.hottest_c = max((c for c in found if c is not None), default=None)
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        self.resident_mb = max(self.resident_mb, pages * resource.getpagesize() / 1e6)


def run(arguments: argparse.Namespace) -> int:
    """Fly for the seconds asked, and print."""
    cv2.setNumThreads(1)
    watch = Watch()
    config, camera, events = _flight(arguments)
    ends_s = time.monotonic() + arguments.seconds

    def is_over(pictures: int) -> bool:
        watch.look()
        return time.monotonic() >= ends_s and pictures >= LEAST_PICTURES

    load = measure(config, camera, events, is_over)
    wanted_hz = arguments.rate or config.camera.rate_hz
    found = report(load, config, camera, wanted_hz, watch)
    print(json.dumps(found, indent=1) if arguments.json else text(found))
    return 0 if found["is_good"] else 1


def _flight(arguments: argparse.Namespace) -> tuple[Config, Camera, Iterable[tuple[int, Event]]]:
    """Return the flight to process: a session, pictures with a log, or a made flight with the configured camera."""
    if arguments.recording is not None:
        config, camera, recorded = recorded_flight(arguments.recording)
        return config, camera, recorded.events()
    config = configuration(arguments.config)
    named = arguments.camera or (None if config.camera.file is None else Path(config.camera.file))
    if arguments.frames is not None:
        if arguments.telemetry is None or named is None:
            raise InputError("bench --frames needs --telemetry and --camera too")
        flight = Flight.open(config, named_camera(named), arguments.frames, arguments.telemetry, arguments.stamps)
        return config, flight.camera, flight.events()
    width, height = arguments.size or (640, 480)
    camera = Camera.from_field_of_view(width, height, FIELD_OF_VIEW_DEG)
    if named is not None:
        camera = named_camera(named)
        if arguments.size not in (None, camera.size_px):
            raise InputError(
                f"bench --size: {named} is for {camera.width_px}x{camera.height_px}; leave one of them out"
            )
    if arguments.rate:
        config = config.model_copy(update={"camera": config.camera.model_copy(update={"rate_hz": arguments.rate})})
    made = MadeFlight(config, camera)
    return made.config, camera, made.events()


def named_camera(path: Path) -> Camera:
    """The optics in a camera file. Raises InputError."""
    return load_camera_file(path)


def report(load: Load, config: Config, camera: Camera, wanted_hz: float, watch: Watch) -> dict[str, Any]:
    """Everything that was found, for programs; `verdict` is for people."""
    total_mb, free_mb = _memory_mb()
    is_measured = load.pictures >= LEAST_PICTURES - WARM_UP and load.solved >= SOLVED_SHARE * load.replayed
    share = wanted_hz * load.picture_ms / 1e3
    most_hz = load.sustainable_hz
    slower = load.late_ms / load.early_ms - 1.0 if load.early_ms else 0.0
    if not is_measured:
        verdict = f"not measured: {load.solved} of {load.replayed} pictures solved, {LEAST_PICTURES} are needed"
    elif wanted_hz <= most_hz:
        verdict = f"good: {wanted_hz:g} Hz take {100 * share:.0f} % of a core, {100 * SHARE:.0f} % are for pictures"
    else:
        verdict = (
            f"too slow: {wanted_hz:g} Hz would take {100 * share:.0f} % of a core, {100 * SHARE:.0f} % are for "
            f"pictures; set camera.rate_hz to {max(most_hz, 0.1):.1f} or less, or a smaller picture"
        )
    return {
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "size_px": list(camera.size_px),
        "features": config.tracking.features,
        "pictures": load.replayed,
        "solved": load.solved,
        "flown_s": load.seconds,
        "flown_hz": load.rate_hz,
        "picture_ms": load.picture_ms,
        "stage_ms": load.stage_ms,
        "lag_p50_ms": load.lag_ms[0],
        "lag_p95_ms": load.lag_ms[1],
        "slower_at_the_end": slower,
        "sustainable_hz": most_hz,
        "configured_hz": wanted_hz,
        "core_share": share,
        "resident_mb": watch.resident_mb,
        "memory_mb": total_mb,
        "free_memory_mb": free_mb,
        "temperature_c": watch.first_c,
        "hottest_c": watch.hottest_c,
        "is_good": is_measured and wanted_hz <= most_hz,
        "verdict": verdict,
    }


def _memory_mb() -> tuple[float | None, float | None]:
    """The computer's memory, and what of it is available; None where the kernel does not report it."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return None, None
    kb = {line.split(":")[0]: float(line.split()[1]) for line in lines if len(line.split()) > 1}
    total, free = kb.get("MemTotal"), kb.get("MemAvailable")
    return (None if total is None else total / 1e3), (None if free is None else free / 1e3)


def text(found: dict[str, Any]) -> str:
    """The same for people, a few aligned lines."""
    width, height = found["size_px"]
    memory = f"{found['resident_mb']:.0f} MB"
    if found["memory_mb"] is not None:
        memory += f"; the computer has {found['memory_mb']:.0f} MB, {found['free_memory_mb']:.0f} MB free"
    heat = "the kernel reports none"
    if found["hottest_c"] is not None:
        heat = f"{found['temperature_c']:.0f} deg C before, {found['hottest_c']:.0f} at most"
    slower = found["slower_at_the_end"]
    if slower > SLOWED - 1.0:
        heat += f"; {100 * slower:.0f} % slower at the end than at the beginning"
    rows = [
        ("computer", f"{found['machine']}, {found['cores']} cores"),
        ("pictures", f"{width}x{height}, {found['features']} features; {found['pictures']}, {found['solved']} solved"),
        ("a picture takes", f"{found['picture_ms']:.1f} ms of processor"),
        *((f"  {name}", f"{ms:.1f} ms") for name, ms in found["stage_ms"].items()),
        (
            "answers come",
            f"{found['lag_p50_ms']:.0f} ms after telemetry; one in twenty after {found['lag_p95_ms']:.0f}",
        ),
        ("sustainable", f"{found['sustainable_hz']:.1f} pictures a second, with {100 * SHARE:.0f} % of a core"),
        ("memory", memory),
        ("temperature", heat),
        ("verdict", str(found["verdict"])),
    ]
    return "\n".join(f"{name:<15}  {value}" for name, value in rows)
