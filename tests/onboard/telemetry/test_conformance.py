"""One recording over every wire and both libraries: the same events, at their true moments."""

import itertools
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from onboard.clocks.timesync import NS_PER_S, SELDOM_NS
from onboard.events.source import AircraftReport, SourceStatus, State
from onboard.events.types import Attitude, FilterStatus, GpsQuality, NavEvent, PositionFix
from onboard.telemetry.tlog_reader import read_tlog
from simulation.autopilot.fake import FakeAutopilot
from tests.onboard.link.ports import free_udp_port
from tests.onboard.telemetry.listening import FLIGHT, config_for, content, errors_ms, expected, listening
from tests.waiting import eventually

pytestmark = pytest.mark.wall_clock(waits=True)

SECONDS = 5.5
DRIFT = 300e-6
WIRES = {
    "udpin": ("udpout:127.0.0.1:{free}", "pymavlink", "ardupilot"),
    "udpout": ("udpin:127.0.0.1:0", "pymavlink", "px4"),
    "tcp": ("tcpin:127.0.0.1:0", "pymavlink", "ardupilot"),
    "serial": ("pty", "pymavlink", "ardupilot"),
    "old serial": ("pty", "pymavlink", "old"),
    "mavsdk udp": ("udpout:127.0.0.1:{free}", "mavsdk", "px4"),
    "mavsdk serial": ("pty", "mavsdk", "ardupilot"),
}
ALL = pytest.mark.parametrize("name", WIRES)


@dataclass
class Simulated:
    autopilot: FakeAutopilot
    events: list[NavEvent]
    true: list[NavEvent]
    health: SourceStatus
    took_s: float  # at most, that it was listened to


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("logs")


@pytest.fixture(scope="module")
def simulated(folder: Path) -> Iterator[dict[str, Simulated]]:
    out = {}
    began_s = time.monotonic()
    with ExitStack() as stack:
        running = {}
        for number, (name, (url, backend, style)) in enumerate(WIRES.items()):
            autopilot = stack.enter_context(
                FakeAutopilot(
                    FLIGHT.with_battery(22.1, 64),
                    url.format(free=free_udp_port()),
                    style=style,
                    drift=DRIFT,
                    system=number + 1,
                    begin_s=5.0,
                    chatter=True,
                )
            )
            config = config_for(
                autopilot.url, backend=backend, lost_after_s=2.0, system=number + 1, log=str(folder / name)
            )
            running[name] = autopilot, stack.enter_context(listening(config))
        time.sleep(SECONDS)  # and longer where a machine takes its time to begin
        assert eventually(lambda: all(beats_of(autopilot) for autopilot, _ in running.values()))
        for name, (autopilot, received) in running.items():
            health = received.source.health()
            events: list[Any] = [event for _, event in list(received.got)]
            true = expected(autopilot, received.clock)  # read last, so that it holds whatever came before
            out[name] = Simulated(autopilot, events, true, health, 0.0)
    for flight in out.values():
        flight.took_s = time.monotonic() - began_s
    yield out


def beats_of(autopilot: FakeAutopilot) -> list[Any]:
    return [beat for beat in autopilot.received_of("HEARTBEAT") if beat.get_srcSystem() == autopilot.system]


@ALL
def test_the_events_are_what_was_sent_at_the_true_moments(simulated: dict[str, Simulated], name: str) -> None:
    flight = simulated[name]
    errors = errors_ms(flight.events, flight.true)
    assert len(errors) > 40
    assert {type(event) for event in flight.events} >= {PositionFix, Attitude, GpsQuality, FilterStatus}
    assert 0.0 < np.median(np.abs(errors)) < 3.0
    # What has no stamp of its own has that of the message before it, which the very first may have missed.
    assert np.max(np.abs(errors[5:])) < 20.0
    assert np.max(np.abs(errors)) < 300.0


@ALL
def test_mode_and_battery_are_the_aircraft_s_own_whoever_else_is_on_the_line(
    simulated: dict[str, Simulated], name: str
) -> None:
    mode = "MISSION" if WIRES[name][2] == "px4" else "AUTO"
    assert simulated[name].health.aircraft == AircraftReport(mode, 64, 22.1)


@ALL
def test_nothing_is_missing_between_the_first_and_the_last(simulated: dict[str, Simulated], name: str) -> None:
    flight = simulated[name]
    for kind in (PositionFix, Attitude):
        got = {content(event) for event in flight.events if isinstance(event, kind)}
        true = [content(event) for event in flight.true if isinstance(event, kind)]
        first, last = (
            next(i for i, c in order if c in got) for order in (enumerate(true), reversed([*enumerate(true)]))
        )
        missing = [c for c in true[first : last + 1] if c not in got]
        assert len(missing) <= 0.02 * (last - first)
        assert first < 0.5 * len(true)


@ALL
def test_stamps_of_a_kind_never_run_backwards(simulated: dict[str, Simulated], name: str) -> None:
    for kind in (PositionFix, Attitude):
        stamps = [event.stamp_ns for event in simulated[name].events if isinstance(event, kind)]
        assert all(a < b for a, b in itertools.pairwise(stamps))


@ALL
def test_health_says_so_with_figures(simulated: dict[str, Simulated], name: str) -> None:
    flight = simulated[name]
    assert flight.health.state is State.OK
    assert 0.0 < flight.health.figures["round_trip_ms"] < 30.0
    assert 0.0 < flight.health.figures["clock_sigma_ms"] < 10.0
    assert flight.health.figures["drift_ppm"] == pytest.approx(-300.0, abs=250.0)
    assert flight.health.figures["attitude_hz"] > 10.0
    assert flight.health.figures["reboots"] == 0.0
    assert flight.health.figures.get("lost_packets") == (0.0 if WIRES[name][1] == "pymavlink" else None)


@ALL
def test_it_is_a_good_citizen(simulated: dict[str, Simulated], name: str) -> None:
    autopilot = simulated[name].autopilot
    beats = beats_of(autopilot)
    # Two or three until the autopilot is known, the farewell, and seldom after that: a machine may take long to begin.
    assert 1 <= len(beats) <= 4 + simulated[name].took_s * NS_PER_S // SELDOM_NS
    # An onboard controller, except to PX4, and before it is known to whom: that would miss us.
    kinds = [beat.type for beat in beats if beat.system_status != mavlink.MAV_STATE_POWEROFF]
    assert {beat.get_srcComponent() for beat in beats} == {191}
    assert kinds[-1] == (0 if WIRES[name][2] == "px4" else 18)
    assert 18 not in kinds or WIRES[name][2] != "px4"
    assert autopilot.shown == []
    answers = [message for message in autopilot.received_of("TIMESYNC") if message.tc1]
    assert len(answers) >= 1
    assert all(answer.tc1 > 0 for answer in answers)


@ALL
def test_a_log_it_wrote_reads_as_the_same_flight(simulated: dict[str, Simulated], folder: Path, name: str) -> None:
    (path,) = (folder / name).glob("*.tlog")
    log = read_tlog(path, chosen=simulated[name].autopilot.system)
    live = [event for event in simulated[name].events if isinstance(event, PositionFix)]
    again = [event for event in log.events if isinstance(event, PositionFix)]
    assert {content(event) for event in live} <= {content(event) for event in again}
    errors = errors_ms(live[3:], again)
    # A log is mapped by its least delayed arrivals and one constant offset: 300 ppm over four seconds are 1.2 ms.
    assert np.max(np.abs(np.array(errors) - np.median(errors))) < 20.0
    assert abs(np.median(errors)) < 20.0
