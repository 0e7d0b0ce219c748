"""A daemon in the air, within the test: a simulated flight through real threads, on a clock that may run faster.

Sources are played from the flight's own files and may be spoilt on the way; states, sets, recording and the words said
to the pilot are kept, and every true click can be asked afterwards.
"""

from __future__ import annotations

import queue
import threading
import time
import tomllib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path

from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.vehicle_status import VehicleStatus, decode_status, encode_status
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.sink import Sink
from onboard.events.source import Emit, Severity, SourceStatus, State, Stop
from onboard.events.types import Event, Frame
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import Flight
from onboard.service.daemon import Daemon, Order
from onboard.service.reports import Report
from onboard.service.sd_notify import Notifier
from onboard.service.session import Parts
from onboard.storage.alignment_file import StateFile
from onboard.storage.rotating_recorder import Recorded
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from tests.scenarios.flights import CAMERA, Outcome, click, flown

Spoil = Callable[[Event, float], Event | None]
"""Event and seconds since the first picture -> the event that comes instead, if any does."""

STRAIGHT = SessionSpec(DescribedSpec(PathSpec("straight")), seconds=26.0, rate_hz=4.0, camera=CAMERA)
LEAD_S = 1.5  # telemetry before the first picture


@dataclass(frozen=True)
class FastClock(SessionClock):
    """The session's clock, `speed` times as fast from `began_ns` (monotonic) on."""

    began_ns: int = 0
    speed: float = 1.0

    def from_monotonic_ns(self, monotonic_ns: int) -> int:
        return self.began_ns + round((monotonic_ns - self.began_ns) * self.speed) + self.offset_ns

    def now_ns(self) -> int:
        return self.from_monotonic_ns(time.monotonic_ns())


class QueueOrders:
    """Orders put by the test."""

    def __init__(self) -> None:
        self.queue: queue.Queue[Order] = queue.Queue()

    def next(self, timeout_s: float) -> Order | None:
        try:
            return self.queue.get(timeout=timeout_s)
        except queue.Empty:
            return None


class PlayedSource:
    """Hands out events when they are due; calls itself lost after `lost_after_s` without any, as real ones do."""

    def __init__(self, clock: FastClock, due: Sequence[tuple[int, Event]], lost_after_s: float = 1.5) -> None:
        self._clock, self._due, self._lost_after_s = clock, due, lost_after_s
        self._last_ns: int | None = None
        self.reported: list[tuple[Severity, str]] = []

    def run(self, emit: Emit, stop: Stop) -> None:
        for due_ns, event in self._due:
            wait_s = (due_ns - self._clock.now_ns()) / 1e9 / self._clock.speed
            if stop.wait(wait_s) if wait_s > 0 else stop.is_set():
                return
            self._last_ns = self._clock.now_ns()
            emit(due_ns, event)
        stop.wait()

    def health(self) -> SourceStatus:
        if self._last_ns is None:
            return SourceStatus(State.STARTING)
        silent_s = (self._clock.now_ns() - self._last_ns) / 1e9
        return SourceStatus(State.LOST, "silent") if silent_s > self._lost_after_s else SourceStatus(State.OK)

    def say(self, severity: Severity, text: str) -> None:
        self.reported.append((severity, text))


class Heard:
    """A sink that keeps everything, in order."""

    def __init__(self, clock: FastClock) -> None:
        self._clock = clock
        self.events: list[Event] = []
        self.sets: list[tuple[int, FeatureSet]] = []  # with the moment they were made

    def __enter__(self) -> Heard:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def event(self, arrival_ns: int, event: Event) -> None:
        self.events.append(event)

    def feature_set(self, output: FeatureSet) -> None:
        self.sets.append((self._clock.now_ns(), output))


@dataclass
class Air:
    """One run of a daemon. Times are seconds since the first picture."""

    folder: Path
    first_ns: int = 0
    shift_ns: int = 0
    code: int | None = None
    statuses: list[tuple[float, VehicleStatus]] = field(default_factory=list)
    reports: list[Report] = field(default_factory=list)
    camera: PlayedSource | None = None
    telemetry: PlayedSource | None = None
    heard: Heard | None = None
    recordings: list[Path] = field(default_factory=list)

    def state(self, at_s: float) -> str:
        """The state last reported before a moment."""
        return [status.state for t, status in self.statuses if t <= at_s][-1]

    def states(self, begin_s: float, end_s: float) -> list[str]:
        """Every state reported within a stretch, each once in order of appearance."""
        return list(dict.fromkeys(status.state for t, status in self.statuses if begin_s <= t <= end_s))

    def first(self, word: str, since_s: float) -> float:
        """When a state first was reported after a moment; infinity if never."""
        return next((t for t, status in self.statuses if t >= since_s and status.state == word), float("inf"))

    def sets(self, begin_s: float = -1e9, end_s: float = 1e9) -> dict[int, FeatureSet]:
        """The last set of each picture taken within a stretch, as if taken when it was flown."""
        assert self.heard is not None
        out = {}
        for _, output in self.heard.sets:
            if begin_s <= (output.capture_unix_ns - self.first_ns) / 1e9 < end_s:
                out[output.frame] = replace(output, capture_unix_ns=output.capture_unix_ns - self.shift_ns)
        return out

    def clicked(self, begin_s: float = -1e9, end_s: float = 1e9) -> Outcome:
        """Every true click on the pictures of a stretch."""
        return click(self.folder, self.sets(begin_s, end_s), None)


def take_off(
    where: Path,
    *,
    spec: SessionSpec = STRAIGHT,
    seconds: float | None = None,
    speed: float = 4.0,
    camera: Spoil | None = None,
    telemetry: Spoil | None = None,
    config: dict[str, dict[str, object]] | None = None,
    wrap: Callable[[Pipeline], Pipeline] | None = None,
    orders: QueueOrders | None = None,
    sinks: Callable[[], Sequence[Sink]] | None = None,
    tick_s: float = 0.05,
) -> Air:
    """Fly `seconds` of a flight (all without) and return what came of it; `where` holds recordings and state."""
    folder = flown(spec)
    # Real seconds are few when time runs fast: nothing but the fault under test is to make the daemon shed.
    settings = Config().model_dump()
    table = (folder / "config.toml").read_text()
    for source in (tomllib.loads(table), {"service": {"max_delay_s": 20.0}}, config or {}):
        for section, keys in source.items():
            settings[section].update(keys)
    configuration = Config.model_validate(settings)
    optics = Camera.from_json(folder / "camera.json")
    flight = Flight.open(configuration, optics, folder / "frames", folder / "telemetry.tlog", folder / "stamps.csv")
    air = Air(folder)
    orders = orders or QueueOrders()
    # All that takes time comes before the clock starts.
    pictures = [(frame.stamp_ns, frame) for frame in flight.frames.frames()]
    log = list(zip(flight.telemetry.arrival_ns, flight.telemetry.events, strict=True))

    def open_parts(config: Config) -> Parts:
        began_ns = time.monotonic_ns()
        clock = FastClock(time.time_ns() - began_ns, began_ns, speed)
        flown_first_ns = flight.frames.stamps_ns[0]
        air.shift_ns = clock.now_ns() + round(LEAD_S * 1e9) - flown_first_ns
        air.first_ns = flown_first_ns + air.shift_ns
        end_ns = air.first_ns + round((seconds or spec.seconds) * 1e9)

        def due(events: Sequence[tuple[int, Event]], spoil: Spoil | None) -> list[tuple[int, Event]]:
            out = []
            for flown_ns, event in events:
                due_ns = flown_ns + air.shift_ns
                moved = replace(event, stamp_ns=event.stamp_ns + air.shift_ns)
                kept = moved if spoil is None else spoil(moved, (due_ns - air.first_ns) / 1e9)
                if kept is not None and clock.now_ns() < due_ns < end_ns:
                    out.append((due_ns, kept))
            return out

        air.camera = PlayedSource(clock, due(pictures, camera))
        air.telemetry = PlayedSource(clock, due(log, telemetry))
        air.heard = Heard(clock)
        recording = Recorded(where / "recordings", config, optics, clock, "")
        executor = ThreadPoolExecutor(1)
        pipeline = Pipeline(config, optics, worker=executor)

        def report(report: Report) -> None:
            air.statuses.append(((clock.now_ns() - air.first_ns) / 1e9, decode_status(encode_status(report.status))))
            air.reports.append(report)

        more = [] if sinks is None else list(sinks())
        return Parts(
            clock,
            air.camera,
            air.telemetry,
            pipeline if wrap is None else wrap(pipeline),
            [air.heard, recording, *more],
            recording,
            [report],
            StateFile(where / "alignment.json"),
        )

    daemon = Daemon(lambda: configuration, open_parts, orders, Notifier({}), tick_s)
    length_s = (LEAD_S + (seconds or spec.seconds)) / speed
    timer = threading.Timer(length_s + 0.1, orders.queue.put, [Order.STOP])
    timer.start()
    try:
        air.code = daemon.run()
    finally:
        timer.cancel()
    air.recordings = sorted((where / "recordings").glob("*.mcap"))
    return air


def is_frame(event: Event) -> bool:
    return isinstance(event, Frame)
