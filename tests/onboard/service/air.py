"""A daemon in the air, within the test: a simulated flight through real threads, on a clock that may run faster.

While the daemon has work left the fast clock stands still: how fast the machine is changes how long the test takes, and
nothing else. Sources are played from the flight's own files and may be spoilt on the way; states, sets, recording and
the words said to the pilot are kept, and every true click can be asked afterwards.
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
from typing import Any

from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.vehicle_status import VehicleStatus, decode_status, encode_status
from onboard.config.schema import Config
from onboard.events.session_clock import SessionClock
from onboard.events.sink import Sink
from onboard.events.source import Emit, Severity, SourceStatus, State, Stop
from onboard.events.types import Event
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
from tests.scenarios.flights import CAMERA, Outcome, click, simulated

Spoil = Callable[[Event, float], Event | None]
"""Event and seconds since the first picture -> the event that comes instead, if any does."""

# Of a flight's clicks most share one error: more of them on a picture add little, and cost as much as its set.
STRAIGHT = SessionSpec(
    DescribedSpec(PathSpec("straight")), seconds=26.0, rate_hz=4.0, camera=CAMERA, clicks_per_frame=6
)
LEAD_S = 1.5  # telemetry before the first picture


STEP_NS = 50_000_000  # the most that counts between two looks at a fast clock: then the machine itself stood still
STUCK_NS = 5_000_000_000  # work that takes longer than this holds the clock no more


class FastClock(SessionClock):
    """The session's clock, `speed` times as fast as the host's, that stands still while `is_busy`."""

    def __init__(self, speed: float, is_busy: Callable[[], bool]) -> None:
        super().__init__(0)
        self.speed, self._is_busy = speed, is_busy
        self._lock = threading.Lock()
        self._at_ns, self._seen_ns = time.time_ns(), time.monotonic_ns()
        self._idle_ns = self._seen_ns

    def now_ns(self) -> int:
        with self._lock:
            now_ns = time.monotonic_ns()
            step_ns, self._seen_ns = now_ns - self._seen_ns, now_ns
            if not self._is_busy():
                self._idle_ns = now_ns
            if self.speed == 1.0:
                self._at_ns += step_ns
            elif self._idle_ns == now_ns or now_ns - self._idle_ns > STUCK_NS:
                self._at_ns += round(min(step_ns, STEP_NS) * self.speed)
            return self._at_ns


class Work:
    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._left = 0
        self.is_recording: Callable[[], bool] = lambda: False

    def is_left(self) -> bool:
        return self._left > 0 or self.is_recording()

    def given(self) -> None:
        with self._lock:
            self._left += 1

    def done(self, *_: object) -> None:
        with self._lock:
            self._left -= 1


class CountingExecutor(ThreadPoolExecutor):
    def __init__(self, work: Work) -> None:
        super().__init__(1)
        self._work = work

    def submit(self, *given: Any, **named: Any) -> Any:
        self._work.given()
        promise = super().submit(*given, **named)
        promise.add_done_callback(self._work.done)
        return promise


class QueueOrders:
    def __init__(self) -> None:
        self.queue: queue.Queue[Order] = queue.Queue()
        self.asked = 0  # turns of the daemon that began

    def next(self, timeout_s: float) -> Order | None:
        self.asked += 1
        try:
            return self.queue.get(timeout=timeout_s)
        except queue.Empty:
            return None


class PlayedSource:
    """Hands out events when they are due; calls itself lost after `lost_after_s` without any, as real ones do."""

    def __init__(
        self, clock: FastClock, due: Sequence[tuple[int, Event]], work: Work, lost_after_s: float = 1.5
    ) -> None:
        self._clock, self._due, self._work, self._lost_after_s = clock, due, work, lost_after_s
        self._last_ns: int | None = None
        self.reported: list[tuple[Severity, str]] = []

    def run(self, emit: Emit, stop: Stop) -> None:
        for due_ns, event in self._due:
            while (wait_s := (due_ns - self._clock.now_ns()) / 1e9 / self._clock.speed) > 0.0:
                if stop.wait(max(wait_s, 0.001)):
                    return
            if stop.is_set():
                return
            self._last_ns = self._clock.now_ns()
            self._work.given()
            emit(due_ns, event)
        stop.wait()

    def health(self) -> SourceStatus:
        if self._last_ns is None:
            return SourceStatus(State.STARTING)
        silent_s = (self._clock.now_ns() - self._last_ns) / 1e9
        return SourceStatus(State.LOST, "silent") if silent_s > self._lost_after_s else SourceStatus(State.OK)

    def send_text(self, severity: Severity, text: str) -> None:
        self.reported.append((severity, text))


class Received:
    def __init__(self, clock: FastClock) -> None:
        self._clock = clock
        self.events: list[Event] = []
        self.sets: list[tuple[int, FeatureSet]] = []  # with the moment they were made

    def __enter__(self) -> Received:
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
    received: Received | None = None
    recordings: list[Path] = field(default_factory=list)

    def state(self, at_s: float) -> str:
        return [status.state for t, status in self.statuses if t <= at_s][-1]

    def states(self, begin_s: float, end_s: float) -> list[str]:
        return list(dict.fromkeys(status.state for t, status in self.statuses if begin_s <= t <= end_s))

    def first(self, word: str, since_s: float) -> float:
        """When a state first was reported after a moment; infinity if never."""
        return next((t for t, status in self.statuses if t >= since_s and status.state == word), float("inf"))

    def sets(self, begin_s: float = -1e9, end_s: float = 1e9) -> dict[int, FeatureSet]:
        """The last set of each picture taken within a stretch, as if taken in flight."""
        out = {}
        for _, output in self.received.sets:
            if begin_s <= (output.capture_unix_ns - self.first_ns) / 1e9 < end_s:
                out[output.frame] = replace(output, capture_unix_ns=output.capture_unix_ns - self.shift_ns)
        return out

    def clicked(self, begin_s: float = -1e9, end_s: float = 1e9) -> Outcome:
        return click(self.folder, self.sets(begin_s, end_s), None)


def take_off(
    where: Path,
    *,
    spec: SessionSpec = STRAIGHT,
    seconds: float | None = None,
    speed: float = 8.0,
    camera: Spoil | None = None,
    telemetry: Spoil | None = None,
    config: dict[str, dict[str, object]] | None = None,
    wrap: Callable[[Pipeline], Pipeline] | None = None,
    orders: QueueOrders | None = None,
    sinks: Callable[[], Sequence[Sink]] | None = None,
    tick_s: float = 0.02,
) -> Air:
    """Fly `seconds` of a flight (all without) and return what came of it; `where` holds recordings and state."""
    folder = simulated(spec)
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

    is_over = threading.Event()

    def stop_at(clock: FastClock, end_ns: int) -> None:
        while not is_over.wait(0.02):
            if clock.now_ns() > end_ns + round(0.1e9 * clock.speed):
                orders.queue.put(Order.STOP)
                return

    def open_parts(config: Config) -> Parts:
        work = Work()
        work.given()  # putting all this together
        clock = FastClock(speed, work.is_left)
        simulated_first_ns = flight.frames.stamps_ns[0]
        air.shift_ns = clock.now_ns() + round(LEAD_S * 1e9) - simulated_first_ns
        air.first_ns = simulated_first_ns + air.shift_ns
        end_ns = air.first_ns + round((seconds or spec.seconds) * 1e9)
        threading.Thread(target=stop_at, args=(clock, end_ns), daemon=True).start()

        def due(events: Sequence[tuple[int, Event]], spoil: Spoil | None) -> list[tuple[int, Event]]:
            out = []
            for flown_ns, event in events:
                due_ns = flown_ns + air.shift_ns
                moved = replace(event, stamp_ns=event.stamp_ns + air.shift_ns)
                kept = moved if spoil is None else spoil(moved, (due_ns - air.first_ns) / 1e9)
                if kept is not None and clock.now_ns() < due_ns < end_ns:
                    out.append((due_ns, kept))
            return out

        air.camera = PlayedSource(clock, due(pictures, camera), work)
        air.telemetry = PlayedSource(clock, due(log, telemetry), work)
        air.received = Received(clock)
        recording = Recorded(where / "recordings", config, optics, clock, "")
        work.is_recording = lambda: bool(recording._queue._waiting)
        pipeline = Pipeline(config, optics, worker=CountingExecutor(work))
        flying = pipeline if wrap is None else wrap(pipeline)
        flying.handle = counted(flying.handle, work)

        def report(report: Report) -> None:
            air.statuses.append(((clock.now_ns() - air.first_ns) / 1e9, decode_status(encode_status(report.status))))
            air.reports.append(report)

        more = [] if sinks is None else list(sinks())
        work.done()
        return Parts(
            clock,
            air.camera,
            air.telemetry,
            flying,
            [air.received, recording, *more],
            recording,
            [report],
            StateFile(where / "alignment.json"),
        )

    daemon = Daemon(lambda: configuration, open_parts, orders, Notifier({}), tick_s)
    try:
        air.code = daemon.run()
    finally:
        is_over.set()
    air.recordings = sorted((where / "recordings").glob("*.mcap"))
    return air


def counted(handle: Callable[[Event], list[FeatureSet]], work: Work) -> Callable[[Event], list[FeatureSet]]:
    def handled(event: Event) -> list[FeatureSet]:
        try:
            return handle(event)
        finally:
            work.done()

    return handled
