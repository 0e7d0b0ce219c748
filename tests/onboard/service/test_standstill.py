"""At rest on the ground: by PX4's word, or by positions that do not move; and what state and doctor make of it."""

import time
from collections.abc import Callable, Generator
from contextlib import closing

import numpy as np
import pytest

from contract.feature_set import Status
from onboard.commands.preflight import Surroundings, diagnose
from onboard.config.schema import Config, Gps
from onboard.events.session_clock import SessionClock
from onboard.events.source import Emit, Severity, SourceStatus, State, Stop
from onboard.events.types import Attitude, Event, FilterStatus, Frame, GpsQuality, PositionFix
from onboard.pipeline.pipeline import Pipeline
from onboard.service.reports import Report
from onboard.service.session import Parts, Session
from onboard.service.standstill import PERSISTENT_NS, Standstill
from onboard.service.vehicle_state import AT_REST, Subject
from tests.onboard.service.air import FastClock
from tests.scenarios.flights import CAMERA
from tests.waiting import PATIENCE_S

STEP_NS = 100_000_000
FIGURES = {"rate_hz": 10.0, "attitude_hz": 10.0, "position_hz": 10.0, "round_trip_ms": 2.0, "clock_sigma_ms": 1.0}


def fix(
    stamp_ns: int, velocity: tuple[float, float, float] | None = (0.05, 0.0, 0.05), height_m: float | None = 0.3
) -> PositionFix:
    return PositionFix(stamp_ns, -35.0, 149.0, 600.0, velocity, height_m)


def fed(*stretches: tuple[float, Callable[[int], PositionFix]]) -> Standstill:
    """Fed with fixes at 10 Hz for so many seconds of each kind."""
    out, stamp_ns = Standstill(Gps()), 0
    for seconds, make in stretches:
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            out.note(make(stamp_ns))
            stamp_ns += STEP_NS
    return out


def moving(stamp_ns: int) -> PositionFix:
    return fix(stamp_ns, (3.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("stretches", "at_rest"),
    [
        ([(4.0, fix)], True),
        ([(0.9 * PERSISTENT_NS / 1e9, fix)], False),
        ([(4.0, moving)], False),
        ([(4.0, moving), (4.0, fix)], True),
        ([(4.0, fix), (0.1, moving)], False),
        ([(4.0, lambda t: fix(t, height_m=60.0))], False),  # a hover
        ([(4.0, lambda t: fix(t, height_m=None))], False),
        ([(4.0, lambda t: fix(t, None))], False),
        ([(4.0, lambda t: fix(t, (0.1, 0.0, float("nan"))))], True),
    ],
)
def test_it_stands_where_nothing_moves_at_the_height_of_home(
    stretches: list[tuple[float, Callable[[int], PositionFix]]], at_rest: bool
) -> None:
    assert fed(*stretches).is_at_rest is at_rest


def test_it_stands_while_the_autopilot_says_so_and_no_longer() -> None:
    standstill = fed((1.0, lambda t: fix(t, height_m=None)))
    assert not standstill.is_at_rest
    standstill.note(FilterStatus(0, True, False, is_at_rest=True))
    assert standstill.is_at_rest
    standstill.note(FilterStatus(1, True, False, is_at_rest=False))
    assert not standstill.is_at_rest


class OnTheGround:
    """A camera or an autopilot that stands still, ten of each event a second."""

    def __init__(self, clock: SessionClock, events: Callable[[int, int], list[Event]]) -> None:
        self._clock, self._events = clock, events

    def run(self, emit: Emit, stop: Stop) -> None:
        index = 0
        while not stop.wait(0.1):
            now_ns = self._clock.now_ns()
            for event in self._events(now_ns, index):
                emit(now_ns, event)
            index += 1

    def health(self) -> SourceStatus:
        return SourceStatus(State.OK, "", FIGURES)

    def send_text(self, severity: Severity, text: str) -> None:
        """No one listens."""


def stated(fix_type: int, is_at_rest: bool) -> Callable[[int, int], list[Event]]:
    """What PX4 says where it stands; height above home is not known, so its own word is all there is."""
    return lambda now_ns, _: [
        fix(now_ns, (0.0, 0.0, 0.0), None),
        Attitude(now_ns, (1.0, 0.0, 0.0, 0.0)),
        GpsQuality(now_ns, fix_type, 14, 0.8, 1.2),
        FilterStatus(now_ns, True, False, is_at_rest),
    ]


GRASS = np.random.default_rng(5).integers(60, 180, (CAMERA.height_px, CAMERA.width_px), np.uint8)


def seen(now_ns: int, index: int) -> list[Event]:
    """Always the same grass, with the noise of a sensor."""
    noise = np.random.default_rng(index).integers(-2, 3, GRASS.shape)
    return [Frame(now_ns, index, (GRASS + noise).astype(np.uint8))]


def reports(telemetry: Callable[[int, int], list[Event]]) -> Generator[Report, None, None]:
    """What a session on the ground reports, until no one wants more.

    On a clock as fast as the host's on which the machine never stands still: nothing is silent for that.
    """
    config, clock = Config(), FastClock(1.001, lambda: False)
    session = Session(
        config, Parts(clock, OnTheGround(clock, seen), OnTheGround(clock, telemetry), Pipeline(config, CAMERA))
    )
    session.start()
    try:
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            time.sleep(0.1)
            yield session.report()
    finally:
        session.finish(5.0)


def judged(report: Report) -> dict[str, bool]:
    lines = diagnose(Config(), report, Surroundings(CAMERA, "", 20000.0, None))
    names = {"state", *(subject.value for subject in Subject)}
    return {line.name: line.is_good for line in lines if line.name in names}


def test_px4_standing_on_the_ground_is_well() -> None:
    """It was `no gps: the position is not accepted` with a doctor that was green, as long as it stood."""
    states: list[str] = []
    lasting: list[Report] = []
    with closing(reports(stated(3, True))) as reported:
        while len(lasting) <= 40 or "low_parallax" not in lasting[-1].pictures.refused:
            report = next(reported, None)
            assert report is not None, states
            states.append(report.status.state)
            if lasting or states[-1] == "at rest":
                lasting.append(report)
    for report in lasting:
        assert (report.status.state, report.status.reason, report.findings) == ("at rest", AT_REST, ())
        assert all(judged(report).values()), judged(report)
    assert lasting[-1].pictures.refused.keys() == {"starting", "low_parallax"}, "it is judged by what pictures came to"


def test_standing_there_without_a_fix_is_not_well_and_both_say_so() -> None:
    """A refusal of everything would pass the test above the other way about."""
    with closing(reports(stated(1, False))) as reported:
        for number, report in enumerate(reported):
            assert report.status.state not in ("ok", "at rest")
            assert not judged(report)["state"]
            assert not all(good for name, good in judged(report).items() if name != "state")
            if number >= 40 and report.status.state == "no gps" and Status.NO_GPS.value in report.pictures.refused:
                break
    assert report.status.state == "no gps"
    assert report.status.reason.startswith("no position")
    assert Status.NO_GPS.value in report.pictures.refused
