"""The daemon of a latency run: the real one at real time, with a played camera, and the moments of its sets noted.

    python -m benchmarks.latency_daemon PLAN.json

Everything else is what `pc-onboard run` opens. A process of its own, as in flight.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import time
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self, TextIO

import cv2

from benchmarks.short_flight import Leg, leg
from benchmarks.soak_daemon import pictures
from contract.feature_set import FeatureSet
from onboard.commands.run import open_parts
from onboard.config.files import load_config_files
from onboard.config.schema import Config, to_toml
from onboard.events.session_clock import SessionClock
from onboard.events.source import Emit, SourceStatus, State, Stop
from onboard.events.types import Event, Frame
from onboard.service import journal
from onboard.service.daemon import TICK_S, Daemon, Order, SignalOrders
from onboard.service.sd_notify import Notifier
from onboard.service.session import Parts

LEAD_NS = 4_000_000_000  # from the process's beginning to the first picture


@dataclass(frozen=True)
class Plan:
    """The flight to fly, in real time."""

    folder: str
    endpoint: str
    telemetry_port: int
    seconds: float
    bit_rate: float
    leg_seconds: float
    rate_hz: float
    cache: str

    @property
    def begin(self) -> Path:
        """The file that states when the first picture is due, ns of CLOCK_MONOTONIC."""
        return Path(self.folder) / "begin"

    @property
    def moments(self) -> Path:
        """The file of moments, a line of JSON each picture's first set that answers."""
        return Path(self.folder) / "moments.jsonl"

    def write(self) -> Path:
        """Write it as JSON into its folder; the file's path."""
        path = Path(self.folder) / "plan.json"
        path.write_text(json.dumps(asdict(self)))
        return path


class PlayedLeg:
    """The leg's pictures out and back, each passed on when it was taken."""

    def __init__(self, simulated: Leg, clock: SessionClock, begin_ns: int) -> None:
        self._simulated, self._clock, self._begin_ns = simulated, clock, begin_ns
        self._came = False

    def run(self, emit: Emit, stop: Stop) -> None:
        """Until stopped."""
        for frame in pictures(self._simulated, self._begin_ns):
            while (early_s := (frame.stamp_ns - self._clock.now_ns()) / 1e9) > 0:
                if stop.wait(early_s):
                    return
            if stop.is_set():
                return
            self._came = True
            emit(self._clock.now_ns(), frame)

    def health(self) -> SourceStatus:
        """Well, once pictures come."""
        return SourceStatus(State.OK if self._came else State.STARTING)


class Moments:
    """A sink that notes when a picture was taken up, when what it waited for came, and when its first answer was made.

    All in ns after its exposure.
    """

    def __init__(self, path: Path, clock: SessionClock) -> None:
        self._path, self._clock = path, clock
        self._taken: dict[int, int] = {}
        self._newest_event_ns = 0
        self._file: TextIO | None = None

    def __enter__(self) -> Self:
        self._file = self._path.open("w")
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        assert self._file is not None
        self._file.close()

    def event(self, arrival_ns: int, event: Event) -> None:
        """The pipeline takes it now."""
        self._newest_event_ns = self._clock.now_ns()
        if isinstance(event, Frame):
            self._taken[event.index] = self._newest_event_ns

    def feature_set(self, output: FeatureSet) -> None:
        """Write the moments of the picture whose set the newest event brought about."""
        taken_ns = self._taken.pop(output.frame, None) if output.is_ok else None
        if taken_ns is None or self._file is None:
            return
        since = output.capture_unix_ns
        moments = {
            "frame": output.frame,
            "taken": taken_ns - since,
            "covered": self._newest_event_ns - since,
            "made": self._clock.now_ns() - since,
        }
        self._file.write(json.dumps(moments) + "\n")


class Until:
    """Orders of the service manager; STOP at the end."""

    def __init__(self, orders: SignalOrders, end_s: float) -> None:
        self._orders, self._end_s = orders, end_s

    def next(self, timeout_s: float) -> Order | None:
        """The next, or None after so long."""
        return Order.STOP if time.monotonic() >= self._end_s else self._orders.next(timeout_s)


def configured(plan: Plan, simulated: Leg) -> Path:
    """The leg's configuration as a file: telemetry, link and state of the plan."""
    folder = Path(plan.folder)
    (folder / "camera.json").write_text(simulated.camera.to_json())
    settings = simulated.config.model_dump()
    settings["camera"].update(file=str(folder / "camera.json"), rate_hz=plan.rate_hz)
    settings["telemetry"]["url"] = f"udpin:127.0.0.1:{plan.telemetry_port}"
    settings["link"].update(listen=(plan.endpoint,), max_bit_rate=plan.bit_rate)
    settings["recording"].update(keep_free_mb=100.0)
    settings["service"].update(state_dir=plan.folder)
    file = folder / "config.toml"
    file.write_text(to_toml(Config.model_validate(settings)))
    return file


def fly(plan: Plan) -> int:
    """The daemon's exit code."""
    journal.set_up()
    cv2.setNumThreads(1)
    simulated = leg(plan.leg_seconds, plan.rate_hz, Path(plan.cache))
    load = partial(load_config_files, configured(plan, simulated))
    with SignalOrders() as signals:
        clock = SessionClock.start()
        begin_ns = time.monotonic_ns() + LEAD_NS
        waiting = plan.begin.with_suffix(".new")
        waiting.write_text(str(begin_ns))
        waiting.rename(plan.begin)
        orders = Until(signals, begin_ns / 1e9 + plan.seconds)
        return Daemon(load, partial(open_all, plan, simulated, clock, begin_ns), orders, Notifier(), TICK_S).run()


def open_all(plan: Plan, simulated: Leg, clock: SessionClock, begin_ns: int, config: Config) -> Parts:
    """Open what `pc-onboard run` opens, but for the camera, and with its moments noted."""
    camera = PlayedLeg(simulated, clock, clock.from_monotonic_ns(begin_ns))
    parts = open_parts(config, clock, lambda *_: camera)
    return replace(parts, sinks=[Moments(plan.moments, clock), *parts.sinks])


if __name__ == "__main__":
    CODE = fly(Plan(**json.loads(Path(sys.argv[1]).read_text())))
    logging.shutdown()
    sys.stdout.flush()
    if CODE:
        os._exit(CODE)
