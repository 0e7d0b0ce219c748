"""`pc-onboard doctor`: asks the running daemon, or looks for itself, and prints a green or red line for each thing."""

from __future__ import annotations

import argparse
import json
import os
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from typing import TextIO

from contract.camera import Camera
from contract.errors import PointclickError
from contract.link_config import Tls
from contract.supervised_thread import in_a_line
from contract.vehicle_status import VehicleStatus
from onboard.camera.factory import open_camera, open_second_camera
from onboard.camera.helper_launch import RTSP, decoders_text
from onboard.commands.checks import CHECKS
from onboard.commands.preflight import Line, Surroundings, diagnose
from onboard.config.files import load_camera, load_config_files, load_second_camera, state_folder
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.source import Source, SourceStatus, State
from onboard.events.types import Event, Frame, GpsQuality
from onboard.link.publisher import Publisher
from onboard.link.status_query import ask
from onboard.service.host import cpu_temperature_c, free_mb
from onboard.service.reports import Brightness, Report, gps_report
from onboard.service.vehicle_state import gps_findings, second_findings, source_findings
from onboard.telemetry.factory import open_telemetry

RATE_S, FEWEST_FRAMES = 4.0, 6  # a look at a camera's rate, and the fewest pictures that show one
GREEN, RED, PLAIN = "\x1b[32m", "\x1b[31m", "\x1b[0m"


def run(arguments: argparse.Namespace) -> int:
    """Print the lines; 0 if all are good, 1 if any is not."""
    config = load_config_files(arguments.config)
    link = config.link
    answer = ask(config.vehicle.id, link.listen, Tls.of(link.ca, link.certificate, link.key))
    is_running = answer is not None
    camera = _camera(config)
    report = Look(config, camera).report(arguments.seconds) if answer is None else Report.from_json(answer)
    lines = diagnose(config, report, _surroundings(config, camera, is_running))
    if arguments.json:
        print(json.dumps({"daemon": is_running, "lines": [asdict(line) for line in lines]}, indent=1))
    else:
        alone = "the daemon does not run: looked at what can be seen without it; position and answers were not judged"
        print("the daemon runs and was asked" if is_running else alone)
        print(text(lines, is_coloured(sys.stdout), arguments.explain))
    return 0 if all(line.is_good for line in lines) else 1


def is_coloured(stream: TextIO, environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether to use colours: on a terminal, unless $NO_COLOR is set (no-color.org)."""
    return stream.isatty() and not environment.get("NO_COLOR")


def text(lines: list[Line], coloured: bool, explained: bool = False) -> str:
    """One line each: `ok`, `BAD`, or `--` where it waits for another. `explained`: below it, what it means and what to
    do.
    """
    out, width = [], max(len(line.name) for line in lines) + 1
    for line in lines:
        mark = "ok " if line.is_good else "-- " if line.waits_for else "BAD"
        if coloured:
            mark = f"{GREEN if line.is_good else RED}{mark}{PLAIN}"
        out.append(f"{mark} {line.name:<{width}}{line.text}")
        out += [f"    {' ' * width}{sentence}" for sentence in CHECKS[line.name].sentences] if explained else []
    return "\n".join(out)


def measured_rate_hz(config: Config, seconds: float = RATE_S) -> float | None:
    """Pictures a second that the configured camera gives now; None where none come. Nothing is printed."""
    camera = _camera(config)
    if isinstance(camera, str):
        return None
    clock, stop, came_ns = SessionClock.start(), threading.Event(), list[int]()

    def take(_: int, event: Event) -> None:
        if isinstance(event, Frame):
            came_ns.append(event.stamp_ns)

    def look() -> None:
        with suppress(PointclickError, OSError):  # the doctor reports it, with all else
            open_camera(config, camera, clock).run(take, stop)

    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    thread.join(seconds)
    stop.set()
    thread.join(2.0)
    settled_ns = came_ns[len(came_ns) // 3 :]  # exposure and buffers have settled by then
    if len(settled_ns) < FEWEST_FRAMES:
        return None
    return (len(settled_ns) - 1) * 1e9 / (settled_ns[-1] - settled_ns[0])


def _camera(config: Config) -> Camera | str:
    try:
        return load_camera(config)
    except PointclickError as error:
        return " ".join(str(error).split())


def _surroundings(config: Config, camera: Camera | str, is_running: bool) -> Surroundings:
    link = ""
    if not is_running:
        try:
            Publisher.open(config).close()
        except PointclickError as error:
            link = str(error)
    try:
        folder = state_folder(config, dict(os.environ))
        free = free_mb(folder)
    except PointclickError:
        free = None
    decoders = decoders_text() if config.camera.device.startswith(RTSP) else ""
    return Surroundings(camera, link, free, cpu_temperature_c(), is_running, decoders)


SECOND = "thermal camera"


class Look:
    """Camera and telemetry opened for a few seconds, each in a thread."""

    def __init__(self, config: Config, camera: Camera | str) -> None:
        self._clock = SessionClock.start()
        self._sources: dict[str, Source] = {}
        self._errors: dict[str, str] = {}
        self._brightness: Brightness | None = None
        self._gps: GpsQuality | None = None
        if isinstance(camera, str):
            self._errors["camera"] = "not opened without its camera file"
        else:
            self._open("camera", lambda: open_camera(config, camera, self._clock))
        self._open("telemetry", lambda: open_telemetry(config, self._clock))
        if config.camera.thermal.is_live:
            self._open(SECOND, lambda: open_second_camera(config, load_second_camera(config), self._clock))

    def report(self, seconds: float) -> Report:
        """Look for so long (less if neither can be opened); then the report."""
        stop = threading.Event()
        threads = [
            threading.Thread(target=self._run, args=(name, source, stop), daemon=True)
            for name, source in self._sources.items()
        ]
        for thread in threads:
            thread.start()
        # Rates and clocks need their time even where all is well at once.
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not {"camera", "telemetry"} <= self._errors.keys():
            time.sleep(0.1)
        camera, telemetry = self._status("camera"), self._status("telemetry")
        second = self._status(SECOND) if SECOND in self._errors or SECOND in self._sources else None
        stop.set()
        for thread in threads:
            thread.join(2.0)
        now_ns = self._clock.now_ns()
        gps = gps_report(self._gps, now_ns)
        return Report(
            VehicleStatus(now_ns / 1e9, 0, "not running"),
            camera,
            telemetry,
            (*source_findings(camera, telemetry), *gps_findings(gps), *second_findings(second)),
            self._brightness,
            gps,
            thermal_camera=second,
        )

    def _open(self, name: str, opened: Callable[[], Source]) -> None:
        try:
            self._sources[name] = opened()
        except PointclickError as error:
            self._errors[name] = " ".join(str(error).split())

    def _run(self, name: str, source: Source, stop: threading.Event) -> None:
        try:
            source.run(self._take_nothing if name == SECOND else self._take, stop)
        except PointclickError as error:
            self._errors[name] = " ".join(str(error).split())
        except Exception as error:  # what it is, is the finding
            self._errors[name] = f"failed ({in_a_line(error)})"

    def _take(self, arrival_ns: int, event: Event) -> None:
        if isinstance(event, Frame) and event.image is not None:
            self._brightness = Brightness.of(event.image)
        elif isinstance(event, GpsQuality):
            self._gps = event

    def _take_nothing(self, arrival_ns: int, event: Event) -> None:
        """Pass over the second camera's events: only whether it comes is checked."""

    def _status(self, name: str) -> SourceStatus:
        if name in self._errors:
            return SourceStatus(State.LOST, self._errors[name])
        return self._sources[name].health()
