"""The daemon of a soak: the real one, on a clock that runs faster, with a camera that never comes to its end.

    python -m benchmarks.soak_daemon PLAN.json

Everything else is what `pc-onboard run` opens, and the same files of configuration lead to it. A process of its own, so
that what is measured is its own too.
"""

from __future__ import annotations

import faulthandler
import json
import logging
import os
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np

from benchmarks.short_flight import Leg, leg
from benchmarks.soak_clock import FlightClock, Governor
from contract.feature_set import FeatureSet
from onboard.commands.run import open_parts
from onboard.config.files import load_config_files
from onboard.config.schema import Config, to_toml
from onboard.events.source import Emit, SourceStatus, State, Stop
from onboard.events.types import Event, Frame
from onboard.link.publisher import Publisher
from onboard.service import journal
from onboard.service.daemon import TICK_S, Daemon, Order, SignalOrders
from onboard.service.reports import Report
from onboard.service.sd_notify import Notifier
from onboard.service.session import Parts

LEAD_NS = 2_000_000_000  # from the clock's beginning to the first picture
TAIL_NS = 4_000_000_000  # after the last minute, so that the process is still there to be looked at
MOST_WAITING_S = 0.8  # of pictures: the flight waits, so that none is dropped
LOST_AFTER_NS = 1_500_000_000
MINUTE_NS = 60_000_000_000


@dataclass(frozen=True)
class Plan:
    """The flight to fly. Faults: (seconds after the first picture, for how many)."""

    folder: str  # for clock, figures, state and recordings
    endpoint: str
    telemetry_port: int
    minutes: float
    top_speed: float
    rotate_mb: float
    leg_seconds: float
    rate_hz: float
    cache: str
    unplugged: tuple[tuple[float, float], ...] = ()

    @classmethod
    def read(cls, path: Path) -> Plan:
        """Read the file that `write` wrote."""
        held = json.loads(path.read_text())
        held["unplugged"] = tuple((begin, length) for begin, length in held["unplugged"])
        return cls(**held)

    def write(self, path: Path) -> None:
        path.write_text(json.dumps(asdict(self)))

    @property
    def clock(self) -> Path:
        """The file that holds the flight's clock."""
        return Path(self.folder) / "clock"

    @property
    def begin(self) -> Path:
        """The file that states when the first picture is due, Unix ns of the flight's clock."""
        return Path(self.folder) / "begin"

    @property
    def figures(self) -> Path:
        """The file of figures, a line of JSON each minute of flight."""
        return Path(self.folder) / "figures.jsonl"

    @property
    def recordings(self) -> Path:
        """Their folder."""
        return Path(self.folder) / "recordings"


def pass_ns(simulated: Leg) -> int:
    """Length of one pass over a leg: out, or back."""
    return simulated.frames[-1].stamp_ns - simulated.frames[0].stamp_ns


def pictures(simulated: Leg, begin_ns: int) -> Iterator[Frame]:
    """The leg's pictures out and back without end, the first at `begin_ns`; no picture comes twice in a row."""
    first, last = simulated.frames[0].stamp_ns, simulated.frames[-1].stamp_ns
    for index in count():
        turn, place = divmod(index, len(simulated.frames) - 1)
        is_back = turn % 2 == 1
        picture = simulated.frames[-1 - place if is_back else place]
        into_ns = last - picture.stamp_ns if is_back else picture.stamp_ns - first
        yield Frame(begin_ns + turn * pass_ns(simulated) + into_ns, index, picture.image)


@dataclass
class Counted:
    """Since the last minute's line, and since the beginning."""

    queue: int = 0
    delays_s: list[float] = field(default_factory=list)
    pictures: int = 0
    taken: int = 0
    dropped: int = 0
    sets: int = 0
    ok: int = 0


class Camera:
    """Pictures when they are due, none while it is unplugged. Its thread governs the clock."""

    def __init__(self, plan: Plan, simulated: Leg, clock: FlightClock, begin_ns: int, counted: Counted) -> None:
        self._plan, self._simulated, self._clock, self._begin_ns = plan, simulated, clock, begin_ns
        self._counted = counted
        self._came_ns: int | None = None

    def run(self, emit: Emit, stop: Stop) -> None:
        """Until stopped."""
        counted, governor = self._counted, self._clock.governor
        for frame in pictures(self._simulated, self._begin_ns):
            governor.govern((self._waiting - 1) / self._plan.rate_hz, frame.stamp_ns)  # the last has only just come
            while (early_ns := frame.stamp_ns - self._clock.now_ns()) > 0:
                if stop.wait(self._clock.wall_s(early_ns)):
                    return
            while self._waiting >= MOST_WAITING_S * self._plan.rate_hz:
                if stop.wait(0.005):
                    return
            if stop.is_set():
                return
            into_s = (frame.stamp_ns - self._begin_ns) / 1e9
            if any(begin_s <= into_s < begin_s + length_s for begin_s, length_s in self._plan.unplugged):
                continue
            self._came_ns = self._clock.now_ns()
            counted.pictures += 1
            emit(self._came_ns, frame)
            counted.queue = max(counted.queue, self._waiting)

    @property
    def _waiting(self) -> int:
        """Pictures that the pipeline has not taken yet."""
        return self._counted.pictures - self._counted.taken - self._counted.dropped

    def health(self) -> SourceStatus:
        """Lost while unplugged, as a real one reports within two seconds."""
        if self._came_ns is None:
            return SourceStatus(State.STARTING)
        is_silent = self._clock.now_ns() - self._came_ns > LOST_AFTER_NS
        return SourceStatus(State.LOST, "unplugged") if is_silent else SourceStatus(State.OK)


class Watch:
    """A sink that counts and writes the minute's figures."""

    def __init__(self, plan: Plan, clock: FlightClock, begin_ns: int, counted: Counted, publisher: Publisher) -> None:
        self._plan, self._clock, self._begin_ns, self._counted = plan, clock, begin_ns, counted
        self._publisher = publisher
        self._frame = -1
        self._minute = 1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        return None

    def event(self, arrival_ns: int, event: Event) -> None:
        """The pipeline takes it now."""
        self._counted.taken += isinstance(event, Frame)
        if self._clock.now_ns() - self._begin_ns >= self._minute * MINUTE_NS:
            self._write()
            self._minute += 1

    def feature_set(self, output: FeatureSet) -> None:
        """The first set of a picture ends its delay."""
        counted = self._counted
        counted.sets += 1
        counted.ok += output.is_ok
        if output.frame > self._frame:
            self._frame = output.frame
            counted.delays_s.append((self._clock.now_ns() - output.capture_unix_ns) / 1e9)

    def report(self, report: Report) -> None:
        """Note how many pictures the daemon reports as dropped."""
        self._counted.dropped = report.status.dropped

    def _write(self) -> None:
        counted = self._counted
        delays_s, counted.delays_s = counted.delays_s, []
        queue, counted.queue = counted.queue, 0
        line: dict[str, Any] = {
            "minute": self._minute,
            "queue": queue,
            "delay_s": float(np.median(delays_s)) if delays_s else None,
            "longest_s": max(delays_s, default=None),
            "pictures": counted.pictures,
            "dropped": counted.dropped,
            "sets": counted.sets,
            "ok": counted.ok,
            "sent": self._publisher.sent,
        }
        with self._plan.figures.open("a") as file:
            file.write(json.dumps(line) + "\n")


class Until:
    """Orders of the service manager, waited for on the flight's clock; STOP at its end."""

    def __init__(self, orders: SignalOrders, clock: FlightClock, end_ns: int) -> None:
        self._orders, self._clock, self._end_ns = orders, clock, end_ns

    def next(self, timeout_s: float) -> Order | None:
        """Wait at most so many seconds of flight for an order; STOP once the flight is over."""
        if self._clock.now_ns() >= self._end_ns:
            return Order.STOP
        return self._orders.next(self._clock.wall_s(round(timeout_s * 1e9)))


def configured(plan: Plan, simulated: Leg) -> Path:
    """The leg's configuration with everything on, as a file."""
    folder = Path(plan.folder)
    (folder / "camera.json").write_text(simulated.camera.to_json())
    settings = simulated.config.model_dump()
    settings["camera"].update(file=str(folder / "camera.json"), rate_hz=plan.rate_hz)
    settings["telemetry"]["url"] = f"udpin:127.0.0.1:{plan.telemetry_port}"
    # The link lives by the wall clock, so it is given as much more as the flight may run faster.
    settings["link"].update(listen=(plan.endpoint,), max_bit_rate=32000.0 * plan.top_speed, max_rate_hz=30.0)
    settings["recording"].update(rotate_mb=plan.rotate_mb, keep_free_mb=100.0)
    # Two seconds of flight are half a second at four times the speed: stricter than in flight, not laxer.
    settings["service"].update(state_dir=plan.folder, max_delay_s=2.0)
    file = folder / "config.toml"
    file.write_text(to_toml(Config.model_validate(settings)))
    return file


def fly(plan: Plan) -> int:
    """The daemon's exit code."""
    journal.set_up()
    faulthandler.enable()
    cv2.setNumThreads(1)
    simulated = leg(plan.leg_seconds, plan.rate_hz, Path(plan.cache))
    load = partial(load_config_files, configured(plan, simulated))
    with SignalOrders() as signals:
        clock = FlightClock(0, governor=Governor(plan.clock, plan.top_speed, LEAD_NS))
        begin_ns = clock.now_ns() + LEAD_NS
        waiting = plan.begin.with_suffix(".new")
        waiting.write_text(str(begin_ns))
        waiting.rename(plan.begin)
        orders = Until(signals, clock, begin_ns + round(plan.minutes * MINUTE_NS) + TAIL_NS)
        code = Daemon(load, partial(open_all, plan, simulated, clock, begin_ns), orders, Notifier(), TICK_S).run()
    return code


def open_all(plan: Plan, simulated: Leg, clock: FlightClock, begin_ns: int, config: Config) -> Parts:
    """Open what `pc-onboard run` opens, but for clock and camera, and watched."""
    counted = Counted()
    camera = Camera(plan, simulated, clock, begin_ns, counted)
    parts = open_parts(config, clock, lambda *_: camera)
    (publisher,) = (sink for sink in parts.sinks if isinstance(sink, Publisher))
    watch = Watch(plan, clock, begin_ns, counted, publisher)
    return replace(parts, sinks=[watch, *parts.sinks], reporters=[*parts.reporters, watch.report])


if __name__ == "__main__":
    CODE = fly(Plan.read(Path(sys.argv[1])))
    logging.shutdown()
    sys.stdout.flush()
    if CODE:
        os._exit(CODE)  # a thread may hang where the interpreter would wait for it
