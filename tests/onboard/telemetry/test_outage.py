"""GPS switched off and jammed in a recorded ArduPilot flight: the pipeline refuses in time, and recovers by itself."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.camera import Camera
from contract.feature_set import Status
from onboard.config.schema import Config
from onboard.events.types import FilterStatus, Frame, GpsQuality, NavEvent, PositionFix
from onboard.navigation.navigator import Navigation, NavState
from onboard.pipeline.pipeline import Pipeline
from tests.recorded_logs import recorded

pytestmark = pytest.mark.xdist_group("recorded logs")  # one worker: they are read once

SECOND = 1_000_000_000
PERIOD = SECOND // 2


def statuses(folder: Path, keep: Callable[[NavEvent], bool]) -> list[tuple[float, Status]]:
    """Seconds since the GPS was switched off, and what became of an empty picture then: FEATURELESS if all was well."""
    log = recorded(folder / "sitl" / "plane_gps_outage.tlog", 0.6)  # of 506 s, 300
    off_ns = events_ns(folder)[0]
    pipeline = Pipeline(Config(), Camera.from_field_of_view(64, 48, 40.0))
    blank = np.full((48, 64), 128, np.uint8)
    due_ns, index, out = off_ns - 30 * SECOND, 0, []
    for arrival_ns, event in zip(log.arrival_ns, log.events, strict=True):
        if not off_ns - 60 * SECOND < arrival_ns < off_ns + 160 * SECOND or not keep(event):
            continue
        while due_ns < arrival_ns:
            out += pipeline.handle(Frame(due_ns, index, blank))
            due_ns, index = due_ns + PERIOD, index + 1
        out += pipeline.handle(event)
    return [((answer.capture_unix_ns - off_ns) / 1e9, answer.status) for answer in out if answer.revision == 0]


def events_ns(folder: Path) -> list[int]:
    return [event["unix_us"] * 1000 for event in settings_of(folder, "plane_gps_outage")]


def settings_of(folder: Path, name: str) -> list[dict[str, int]]:
    """The parameters that were changed in flight."""
    return list(json.loads((folder / "sitl" / f"{name}.events.json").read_text()))


Share = Callable[[float, float], float]


def refusals(folder: Path, keep: Callable[[NavEvent], bool]) -> Share:
    """Share of the pictures between two times that were refused for want of GPS."""
    seen = statuses(folder, keep)
    assert len(seen) > 300

    def share(begin: float, end: float) -> float:
        within = [status is Status.NO_GPS for t, status in seen if begin <= t < end]
        assert within
        return float(np.mean(within))

    return share


@pytest.mark.parametrize(
    "without", [pytest.param(None, id="all", marks=pytest.mark.long), pytest.param(FilterStatus, id="no filter")]
)
def test_each_loss_is_seen_within_two_seconds_and_got_over(shared_data: Path, without: type[NavEvent] | None) -> None:
    off, on, jammed, clear = ((t - events_ns(shared_data)[0]) / 1e9 for t in events_ns(shared_data))
    share = refusals(shared_data, lambda event: without is None or not isinstance(event, without))
    assert share(off - 30.0, off - 0.5) == 0.0
    assert share(off + 2.0, on) == 1.0
    assert share(on + 5.0, jammed - 0.5) == 0.0
    assert share(jammed + 2.0, clear) == 1.0
    assert share(clear + 15.0, clear + 50.0) == 0.0


@pytest.mark.long
def test_the_filter_alone_says_it_late_but_says_it(shared_data: Path) -> None:
    off, on, jammed, clear = ((t - events_ns(shared_data)[0]) / 1e9 for t in events_ns(shared_data))
    share = refusals(shared_data, lambda event: not isinstance(event, GpsQuality))
    assert share(off - 30.0, off - 0.5) == 0.0
    assert share(off + 2.0, off + 8.0) < 0.5  # its flags stay good for ten seconds
    assert share(off + 11.0, on) == 1.0
    assert share(jammed + 16.0, clear) == 1.0
    assert share(clear + 15.0, clear + 50.0) == 0.0


def position(t: float) -> PositionFix:
    return PositionFix(round(t * SECOND), -43.38 + 1e-6 * t, 172.4, 350.0, (0.11, 0.0, 0.0), 250.0)


def moments(report: FilterStatus) -> list[bool]:
    """Whether a steady flight of ten seconds is accepted at each half second, with one report among good ones."""
    navigation = Navigation(Config())
    for i in range(101):
        navigation.add(position(i / 10))
        if i % 10 == 0:
            stamp = round(i / 10 * SECOND)
            navigation.add(report if report.stamp_ns == stamp else FilterStatus(stamp, True, False))
    return [isinstance(navigation.state_at(round(t / 2 * SECOND)), NavState) for t in range(1, 20)]


@pytest.mark.parametrize(
    ("has_position", "is_glitching", "refused"),
    # From the good report before it, for what it says may have been so since; until it is `recovery_s` past.
    [(True, False, []), (False, False, [4.0, 4.5, 5.0, 5.5]), (True, True, [4.0, 4.5, 5.0, 5.5])],
)
def test_a_filter_that_does_not_believe_itself_is_not_accepted(
    has_position: bool, is_glitching: bool, refused: list[float]
) -> None:
    usable = moments(FilterStatus(5 * SECOND, has_position, is_glitching))
    assert [t / 2 for t, good in enumerate(usable, start=1) if not good] == refused


@pytest.mark.parametrize(
    ("receiver_m", "is_accepted"),
    [
        pytest.param((20.0, 0.0), True, id="came back"),
        pytest.param((20.0, 8.0), False, id="8 m away"),
        pytest.param((0.0, 0.0), False, id="did not jump"),
        pytest.param(None, False, id="not known"),
    ],
)
def test_a_glitch_is_over_when_receiver_and_filter_are_back(
    receiver_m: tuple[float, float] | None, is_accepted: bool
) -> None:
    """ArduPilot's flag stands for ten seconds more. `receiver_m`: how far off the receiver is then, and afterwards."""
    navigation = Navigation(Config())
    for i in range(301):
        here = position(i / 10)
        off_m = 0.0 if receiver_m is None or i < 50 else receiver_m[i >= 80]
        fix = None if receiver_m is None else replace(here, lon_deg=here.lon_deg + off_m * 1.236e-5)
        navigation.add(here)
        navigation.add(GpsQuality(here.stamp_ns, 3, 12, fix=fix))
        if i % 5 == 0:
            navigation.add(FilterStatus(here.stamp_ns, True, i >= 50))
    assert isinstance(navigation.state_at(28 * SECOND), NavState) is is_accepted
    assert isinstance(navigation.state_at(3 * SECOND), NavState)


@pytest.mark.long
def test_after_a_recorded_glitch_positions_are_accepted_once_they_have_settled(shared_data: Path) -> None:
    """33 m for 12 s until second 136: ArduPilot rejects the right ones for three seconds and flags them until 156."""
    log = recorded(shared_data / "sitl" / "plane_wind_noise.tlog")
    begin_ns, over_ns = ((event["unix_us"] * 1000) for event in settings_of(shared_data, "plane_wind_noise")[:2])
    navigation, accepted, due_ns = Navigation(Config()), [], begin_ns - 5 * SECOND
    for event in log.events:
        if not begin_ns - 30 * SECOND < event.stamp_ns < over_ns + 30 * SECOND:
            continue
        navigation.add(event)
        if isinstance(event, PositionFix) and event.stamp_ns > due_ns + 2 * SECOND:
            if isinstance(navigation.state_at(due_ns), NavState):
                accepted.append((due_ns - over_ns) / 1e9)
            due_ns += PERIOD
    assert not [t for t in accepted if (begin_ns - over_ns) / 1e9 + 2.0 < t < 3.0]
    assert min(t for t in accepted if t > 0.0) < 11.0
    assert len([t for t in accepted if t > 11.0]) > 30


def test_a_bad_report_stands_until_a_good_one_comes() -> None:
    navigation = Navigation(Config())
    for i in range(301):
        navigation.add(position(i / 10))
        if i == 50:
            navigation.add(FilterStatus(5 * SECOND, False, False))
    assert navigation.state_at(29 * SECOND) is Status.NO_GPS
    navigation.add(FilterStatus(30 * SECOND, True, False))
    navigation.add(position(32.0))
    for i in range(301, 330):
        navigation.add(position(i / 10))
    assert isinstance(navigation.state_at(32 * SECOND), NavState)
