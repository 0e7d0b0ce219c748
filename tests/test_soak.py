"""The soak finds what it is for: a short one through every fault, and figures that must not pass."""

import itertools
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from benchmarks.short_flight import Leg, leg
from benchmarks.soak import soak
from benchmarks.soak_clock import AHEAD_S, BEHIND_S, FASTER, SETTLE_NS, SLACK_NS, SLOWER, Governor, StatedClock
from benchmarks.soak_daemon import pass_ns, pictures
from benchmarks.soak_verdict import Faults, Minute, Soak
from benchmarks.soak_world import LAST_NS, GpsLoss, out_and_back, watchdog_s
from simulation.autopilot.flight import Flight

SECONDS, RATE_HZ = 4.0, 4.0
MINUTE = Minute(1, 200.0, 19, 25, 10, 0.3, 1.5, 1800, 0, 3500, 900, 900, 3.0, 1, 3.0)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("soak")


@pytest.fixture(scope="module")
def simulated(cache: Path) -> Leg:
    """Four seconds of flight at four pictures a second."""
    return leg(SECONDS, RATE_HZ, cache)


@pytest.fixture(scope="module")
def log(simulated: Leg, cache: Path) -> Flight:
    return Flight.read(cache / f"leg_{SECONDS:g}s_{RATE_HZ:g}hz" / "telemetry.tlog")


def run(minutes: int, **last: float) -> Soak:
    """A soak in which all was well, but for what the last minutes are told to be."""
    rows = [replace(MINUTE, minute=i + 1, pictures=1800 * (i + 1), sets=3500 * (i + 1)) for i in range(minutes)]
    rows[-4:] = [replace(row, **last) for row in rows[-4:]]  # type: ignore[arg-type]
    return Soak(
        Faults(),
        rows,
        code=0,
        notified={"READY=1": 1, "WATCHDOG=1": 200},
        asked=9,
        answered=9,
        gap_s=0.4,
        gap_wall_s=0.2,
        recorded_sets=3500 * minutes,
    )


@pytest.mark.long
def test_a_minute_through_every_fault_passes(simulated: Leg, cache: Path, tmp_path: Path) -> None:
    """Camera, telemetry and GPS are lost and come back; the daemon says so, is well again, and ends cleanly.

    Three times as fast as it would fly: at the speed that a quick machine reaches, five times, pictures are dropped.
    """
    faults = Faults(unplugged=((14.0, 5.0),), cut=((26.0, 5.0),), no_gps=((38.0, 8.0),))
    done = soak(
        simulated,
        tmp_path,
        minutes=1.0,
        faults=faults,
        leg_seconds=SECONDS,
        rate_hz=RATE_HZ,
        cache=cache,
        top_speed=3.0,
        rotate_mb=1.0,
    )
    # On a busy machine a picture may be dropped at this speed, and of so few one is more than one in a thousand.
    others = [good for what, good in done.verdicts() if not what.startswith("pictures dropped")]
    assert len(others) >= 5
    assert all(others), done.report() + "\n".join(done.log)
    assert {"ok", "camera lost", "telemetry lost", "no gps"} <= set(done.states), done.states
    (minute,) = done.minutes
    assert minute.dropped <= 5
    # Pictures came but for the five seconds without a camera, and one set each at least.
    assert 214 <= minute.pictures <= 222
    assert minute.sets >= minute.pictures - 20
    assert 0 < done.ok_sets < minute.sets
    # The figures are written a moment before what has come is counted.
    assert 0.9 * minute.sent <= minute.received <= 1.1 * minute.sent
    assert 0 < minute.sent < minute.sets
    assert done.notified["STOPPING=1"] == 1
    assert done.notified["WATCHDOG=1"] > 60
    assert 0.1 < done.gap_s < 10.0
    assert "camera, telemetry, GPS" in done.report()


def test_a_soak_without_fault_is_good() -> None:
    assert run(20).is_good
    assert run(20).growth == 0.0


@pytest.mark.parametrize(
    "last",
    [{"rss_mb": 211.0}, {"threads": 20}, {"files": 26}, {"dropped": 80}, {"speed": 0.9}, {"sets": 80000}],
    ids=lambda last: next(iter(last)),
)
def test_what_grows_or_falls_behind_fails(last: dict[str, float]) -> None:
    """Five per cent of memory, a thread, a file, a picture in a thousand, less than real time, sets not recorded."""
    bad = [text for text, is_good in run(20, **last).verdicts() if not is_good]
    assert len(bad) == 1, bad


def test_less_than_the_goals_passes() -> None:
    assert run(20, rss_mb=209.0, dropped=20).is_good


@pytest.mark.parametrize(
    "change",
    [
        {"gap_s": 10.5},
        {"gap_wall_s": 10.5},
        {"notified": {"READY=1": 2, "WATCHDOG=1": 200}},
        {"notified": {"READY=1": 1}},
        {"log": ["2026-11-21 06:07:37,107 ERROR   the pipeline failed"]},
        {"log": ["Traceback (most recent call last):"]},
        {"log": ["<3>the pipeline failed"]},
        {"code": 1},
        {"answered": 8},
        {"unreadable": 1},
    ],
    ids=str,
)
def test_a_missed_watchdog_an_exception_or_a_silent_link_fails(change: dict[str, object]) -> None:
    bad = [text for text, is_good in replace(run(20), **change).verdicts() if not is_good]  # type: ignore[arg-type]
    assert len(bad) == 1, bad


def test_a_short_soak_says_nothing_of_growth() -> None:
    assert not any("memory" in text for text, _ in run(6, rss_mb=500.0).verdicts())


def test_faults_of_an_hour_come_one_at_a_time() -> None:
    faults = Faults.of(60.0)
    assert [len(spans) for spans in (faults.unplugged, faults.cut, faults.no_gps)] == [6, 6, 6]
    spans = sorted([*faults.unplugged, *faults.cut, *faults.no_gps])
    assert all(begin + length + 60.0 < later for (begin, length), (later, _) in itertools.pairwise(spans))
    assert spans[-1][0] < 59 * 60.0
    assert faults.in_minute(2) == "telemetry"
    assert faults.in_minute(1) == ""


def test_the_unit_s_watchdog_is_read() -> None:
    assert watchdog_s() == 10.0


def test_the_camera_s_pictures_are_one_flight_without_end(simulated: Leg) -> None:
    """Evenly spaced, each another than the one before, and where the autopilot is by then."""
    frames = list(itertools.islice(pictures(simulated, 7_000), 4 * len(simulated.frames)))
    spacing_ns = np.diff([f.stamp_ns for f in frames])
    assert frames[0].stamp_ns == 7_000
    assert np.allclose(spacing_ns, 1e9 / RATE_HZ, rtol=0.01)
    assert all(a.image is not b.image for a, b in itertools.pairwise(frames))
    round_ = 2 * (len(simulated.frames) - 1)
    assert frames[round_].image is frames[0].image
    assert frames[round_].stamp_ns == 7_000 + 2 * pass_ns(simulated)


def test_the_autopilot_s_leg_is_one_consistent_flight_in_a_loop(simulated: Leg, log: Flight) -> None:
    """Messages fill out and back evenly, and positions move as their own velocities say, both ways."""
    looped = out_and_back(log, simulated)
    assert looped.due_ns == sorted(looped.due_ns)
    assert looped.due_ns[-1] - looped.due_ns[0] + LAST_NS == 2 * pass_ns(simulated)
    fixes = [m for m in looped.messages if m.get_type() == "GLOBAL_POSITION_INT"]
    assert len(fixes) == pytest.approx(2 * pass_ns(simulated) / 1e8, abs=3)
    stamps = np.array([m.time_boot_ms for m in fixes])
    assert np.all(np.diff(stamps) > 0)
    north_cm = np.array([m.lat for m in fixes]) * 1e-7 * np.pi / 180.0 * 6378137.0 * 100.0
    printed = np.array([m.vx for m in fixes], float)
    moved = np.diff(north_cm) / (np.diff(stamps) / 1000.0)
    same_way = np.sign(printed[1:]) == np.sign(printed[:-1])
    assert np.allclose(moved[same_way], (printed[1:] + printed[:-1])[same_way] / 2.0, rtol=0.05)
    assert np.count_nonzero(~same_way) == 1


def test_gps_is_lost_while_specified_and_only_then() -> None:
    spoil = GpsLoss(1_000, ((2.0, 3.0),))
    for into_s, fix in ((1.9, 3), (2.1, 1), (4.9, 1), (5.1, 3)):
        raw = mavlink.MAVLink_gps_raw_int_message(0, 3, 0, 0, 0, 0, 0, 0, 0, 9)
        report = mavlink.MAVLink_ekf_status_report_message(831, 0.0, 0.0, 0.0, 0.0, 0.0)
        moment_ns = 1_000 + round(into_s * 1e9)
        assert spoil(moment_ns, raw).fix_type == fix
        assert bool(spoil(moment_ns, report).flags & mavlink.EKF_POS_HORIZ_ABS) is (fix == 3)


def test_the_flight_s_clock_is_the_same_in_both_processes_and_waits_for_its_camera(tmp_path: Path) -> None:
    governor = Governor(tmp_path / "clock", 5.0, 10_000_000)
    reported = StatedClock(tmp_path / "clock")
    time.sleep(0.05)
    stopped_ns = governor.pace.now_ns()
    assert reported.now_ns() == stopped_ns == governor.pace.limit_ns
    governor.govern(0, stopped_ns + 50_000_000)
    assert reported.pace() == governor.pace
    assert governor.pace.at(governor.pace.monotonic_ns) == stopped_ns  # no leap over the time it stood still
    time.sleep(0.05)
    assert stopped_ns < reported.now_ns() <= stopped_ns + 50_000_000 + SLACK_NS
    reported.close()


def test_the_flight_slows_when_pictures_wait_but_not_below_real_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_ns = time.monotonic_ns()
    monkeypatch.setattr("benchmarks.soak_clock.time.monotonic_ns", lambda: now_ns)
    governor = Governor(tmp_path / "clock", 2.0, 0)
    next_ns = governor.pace.limit_ns

    def after(flight_s: float, waiting_s: float) -> float:
        nonlocal next_ns
        next_ns += round(flight_s * 1e9)
        governor.govern(waiting_s, next_ns)
        return governor.pace.speed

    assert after(1.0, 0.0) == pytest.approx(FASTER)
    assert after(9.0, 0.0) == 2.0
    assert after(0.1, (AHEAD_S + BEHIND_S) / 2.0) == 2.0
    assert after(0.1, BEHIND_S) == pytest.approx(2.0 * SLOWER)
    now_ns += SETTLE_NS
    assert after(0.1, BEHIND_S) == pytest.approx(2.0 * SLOWER)  # too soon after
    for _ in range(5):
        now_ns += SETTLE_NS + 1
        slowest = after(0.1, BEHIND_S)
    assert slowest == 1.0
