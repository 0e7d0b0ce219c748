"""A telemetry source run in a thread next to a fake autopilot, and what has come out of it."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from onboard.config.schema import Config, parse_config
from onboard.events.session_clock import SessionClock
from onboard.events.source import State, TelemetrySource
from onboard.events.types import Event, GpsQuality, NavEvent
from onboard.telemetry.factory import open_telemetry
from onboard.telemetry.mavlink_events import MessageToEvent, Sources
from onboard.telemetry.pointing import Pointing
from simulation.autopilot.fake import FakeAutopilot
from simulation.autopilot.flight import Flight
from tests.waiting import PATIENCE_S, eventually

TLOG = Path(__file__).resolve().parents[2] / "data" / "plane_turn.tlog"
FLIGHT = Flight.read(TLOG)


def config_for(url: str, **keys: object) -> Config:
    """A configuration with these keys of [telemetry]; to save the tests' time silence is noticed soon, and the vehicle
    is chosen by its number."""
    keys = {"url": url, "lost_after_s": 0.6, "system": FLIGHT.system, **keys}
    text = [f"{key} = {str(value).lower() if isinstance(value, bool) else repr(value)}" for key, value in keys.items()]
    return parse_config("[telemetry]\n" + "\n".join(text))


@dataclass
class Listening:
    source: TelemetrySource
    clock: SessionClock
    stop: threading.Event = field(default_factory=threading.Event)
    got: list[tuple[int, Event]] = field(default_factory=list)
    faults: list[BaseException] = field(default_factory=list)

    def of(self, kind: type[Event]) -> list[Any]:
        return [event for _, event in list(self.got) if isinstance(event, kind)]

    def wait(self, state: State, seconds: float = PATIENCE_S) -> float:
        """Seconds until the source is in this state; fails if it is not by then."""
        began = time.monotonic()
        while self.source.health().state is not state:
            assert time.monotonic() - began < seconds, self.source.health()
            time.sleep(0.01)
        return time.monotonic() - began

    def until(self, condition: Callable[[], object]) -> None:
        assert eventually(condition), self.source.health()

    def run(self) -> None:
        try:
            self.source.run(lambda arrival_ns, event: self.got.append((arrival_ns, event)), self.stop)
        except BaseException as fault:
            self.faults.append(fault)


@contextmanager
def listening(config: Config, pointing: Pointing | None = None) -> Iterator[Listening]:
    """Runs the source of a configuration; it must end when asked to, and without an error."""
    clock = SessionClock.start()
    received = Listening(open_telemetry(config, clock, pointing=pointing), clock)
    thread = threading.Thread(target=received.run, daemon=True)
    thread.start()
    try:
        yield received
    finally:
        received.stop.set()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()
        assert not received.faults


def expected(autopilot: FakeAutopilot, clock: SessionClock) -> list[NavEvent]:
    """The events of everything the autopilot has sent, at their true moments."""
    converter = MessageToEvent(Sources())

    def truth(boot: int, boot_ns: int) -> int:
        return clock.from_monotonic_ns(autopilot.monotonic_ns(boot_ns, boot))

    out = []
    for boot, message in list(autopilot.sent):
        out += converter.convert(message, 0, partial(truth, boot))
    return out


def errors_ms(got: list[NavEvent], true: list[NavEvent]) -> list[float]:
    """How far each event's stamp is from that of the event which says the same; fails if there is none."""
    stamps: dict[str, list[int]] = {}
    for event in true:
        stamps.setdefault(content(event), []).append(event.stamp_ns)
    out = []
    for event in got:
        assert content(event) in stamps, event
        out.append(min((event.stamp_ns - stamp for stamp in stamps[content(event)]), key=abs) / 1e6)
    return out


def content(event: NavEvent) -> str:
    """An event but for its stamp, and that of the receiver's position in it."""
    if isinstance(event, GpsQuality) and event.fix is not None:
        event = replace(event, fix=replace(event.fix, stamp_ns=0))
    return repr(replace(event, stamp_ns=0))
