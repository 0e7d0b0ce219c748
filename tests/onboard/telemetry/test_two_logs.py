"""Two logs of one flight become one: their clocks are tied by positions, and each sensor is the better log's.

Recorded autopilots' flights, taken apart: the other log has a receiver's errors of its own, few digits, and a clock
that is minutes off.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from contract.errors import InputError
from onboard.config.schema import parse_config
from onboard.events.types import Attitude, FilterStatus, GpsQuality, PositionFix
from onboard.telemetry.log_clocks import Tie, Untied, tie
from onboard.telemetry.log_files import read_log, read_logs
from onboard.telemetry.telemetry_log import TelemetryLog, Tied
from onboard.telemetry.tlog_reader import read_tlog
from onboard.telemetry.two_logs import joined, loosened
from simulation.flight import find_recording
from tests.split_logs import ahead, another_receiver, only, table, together

OURS = ("plane_turn", "plane_glitch", "qp_climb")
NAMED = (Path("video.srt"), Path("record.csv"))


def recorded(name: str) -> TelemetryLog:
    return read_tlog(find_recording(name)[0])


def seconds_of(log: TelemetryLog) -> float:
    first_ns, last_ns = log.span_ns
    return (last_ns - first_ns) / 1e9


def ratios(names: tuple[str, ...], draws: int, seed: int) -> list[float]:
    """By how many of its sigmas each offset that was found is off."""
    rng, out = np.random.default_rng(seed), []
    for name in names:
        log = recorded(name)
        for _ in range(draws):
            long_s = rng.uniform(25.0, 200.0)
            begin_s = rng.uniform(0.0, max(seconds_of(log) - long_s, 1.0))
            by_s, rate_hz, decimals = rng.uniform(-400.0, 400.0), rng.choice([1.0, 2.0, 5.0]), int(rng.integers(5, 8))
            other = another_receiver(log, rng, (begin_s, begin_s + long_s), by_s, rate_hz, decimals)
            found = tie(log, other)
            if isinstance(found, Tie):
                assert found.sigma_s < 1.0
                assert abs(found.offset_s + by_s) < 1.0
                out.append((found.offset_s + by_s) / found.sigma_s)
    return out


def test_clocks_minutes_apart_are_tied_within_the_sigma_that_is_stated() -> None:
    off = np.abs(ratios(OURS[:2], 6, seed=3))
    assert len(off) >= 10
    assert off.max() < 3.5 and 0.15 < np.sqrt(np.mean(np.square(off))) < 1.25


@pytest.mark.long
def test_so_are_those_of_all_recorded_flights(shared_data: Path) -> None:
    names = ("plane_clean", "plane_gps_outage", "copter_survey", "plane_wind_noise", "plane_breeze", "plane_rough",
             "qp_transition", "quad")  # fmt: skip
    off = np.abs(ratios(names, 12, seed=11))
    assert len(off) >= 90
    assert np.mean(off < 2.0) > 0.93 and off.max() < 4.0
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 1.2


def accepted(names: tuple[str, ...], stretches: tuple[float, ...], seed: int) -> tuple[list[str], int]:
    """Pairs of different flights that were taken for one, and of how many."""
    rng, wrong, asked = np.random.default_rng(seed), list[str](), 0
    logs = {name: recorded(name) for name in names}
    for one, log in logs.items():
        for other, theirs in logs.items():
            for long_s in stretches if one != other else ():
                begin_s = rng.uniform(0.0, max(seconds_of(theirs) - long_s, 1.0))
                by_s = (log.span_ns[0] - theirs.span_ns[0]) / 1e9 + rng.uniform(-60.0, 60.0)
                found = tie(log, another_receiver(theirs, rng, (begin_s, begin_s + long_s), by_s, 5.0))
                asked += 1
                wrong += [f"{one} with {other}: {found}"] if isinstance(found, Tie) else []
    return wrong, asked


def test_another_flight_is_not_taken_for_this_one() -> None:
    wrong, asked = accepted(OURS, (1e9, 25.0), seed=5)
    assert not wrong and asked == 12


@pytest.mark.long
def test_nor_is_the_same_mission_again_again_or_a_stretch_of_it(shared_data: Path) -> None:
    wrong, asked = accepted(
        ("plane_clean", "plane_gps_outage", "plane_wind_noise", "copter_survey"), (1e9, 90.0, 30.0), 7
    )
    assert not wrong and asked == 36


def test_a_flight_that_repeats_itself_is_not_tied_by_chance() -> None:
    """Two laps of 20 s with one speed fit each other at either."""
    t = np.arange(0.0, 60.0, 0.2)
    laps = [
        PositionFix(
            round((1.8e9 + s) * 1e9),
            -43.38 + 1e-3 * np.cos(0.1 * np.pi * s),
            172.4 + 1e-3 * np.sin(0.1 * np.pi * s),
            200.0,
        )
        for s in t
    ]
    found = tie(TelemetryLog.by_stamp(laps), TelemetryLog.by_stamp(laps[100:200]))
    assert isinstance(found, Untied) and "several offsets" in found.reason


def test_one_that_hovers_determines_nothing() -> None:
    still = [PositionFix(round((1.8e9 + 0.2 * k) * 1e9), -43.38, 172.4, 200.0) for k in range(200)]
    found = tie(TelemetryLog.by_stamp(still), TelemetryLog.by_stamp(still[:150]))
    assert isinstance(found, Untied)


def test_each_sensor_is_taken_from_the_better_log() -> None:
    log = recorded("plane_turn")
    rng = np.random.default_rng(1)
    coarse = another_receiver(log, rng, ahead_s=83.4, decimals=5)
    record = together(coarse, ahead(only(log, Attitude), 83.4))
    video = replace(only(log, PositionFix, GpsQuality, FilterStatus), video_epoch_ns=1, utc_sigma_s=None)
    for one, other, paths in ((video, record, NAMED), (record, video, NAMED[::-1])):
        both = joined(one, other, paths)
        assert both.video_epoch_ns == 1 and both.utc_sigma_s is None  # the pictures' own clock stays
        assert both.arrival_ns == sorted(both.arrival_ns)
        ours = [e for e in video.events if isinstance(e, PositionFix)]
        assert [e for e in both.events if isinstance(e, PositionFix)] == ours
        assert sum(isinstance(e, GpsQuality) for e in both.events) == sum(isinstance(e, GpsQuality) for e in log.events)
        turned = [e for e in both.events if isinstance(e, Attitude)]
        true = [e for e in log.events if isinstance(e, Attitude)]
        late_s = [(a.stamp_ns - b.stamp_ns) / 1e9 for a, b in zip(turned, true, strict=True)]
        assert both.tied.are_angles_moved and both.tied.is_mixed
        assert max(map(abs, late_s)) < 3.5 * both.tied.sigma_s < 0.5
        assert "positions from video.srt" in both.notes[-1] and "attitude from record.csv" in both.notes[-1]


def test_angles_that_never_change_are_not_taken() -> None:
    log = recorded("plane_turn")
    true = only(log, PositionFix, Attitude)
    stuck = TelemetryLog.by_stamp(
        replace(e, q_ned_body=(1.0, 0.0, 0.0, 0.0), rate_body_rad_s=None) if isinstance(e, Attitude) else e
        for e in true.events
    )
    both = joined(stuck, ahead(true, -12.0), NAMED)
    assert "attitude from record.csv" in both.notes[-1]


def test_the_tie_s_error_is_in_the_delays_of_what_it_moves() -> None:
    config = parse_config("")
    log = only(recorded("plane_turn"), PositionFix)
    assert loosened(config, log) == config
    mixed = loosened(config, replace(log, tied=Tied(True, True, 0.3)))
    assert mixed.gps.sigma_latency_s == pytest.approx(np.hypot(0.1, 0.3))
    assert mixed.camera.sigma_latency_s == pytest.approx(np.sqrt(0.3**2 + 3 * 0.1**2))
    long = loosened(config, replace(log, tied=Tied(True, True, 0.3), position_sigma_s=0.2))
    assert long.gps.sigma_latency_s == pytest.approx(np.sqrt(0.1**2 + 0.3**2 + 0.2**2))
    moved = loosened(config, replace(log, tied=Tied(True, False, 0.3)))
    assert moved.gps == config.gps and moved.camera == mixed.camera


def test_logs_of_two_flights_are_refused_with_both_their_names(tmp_path: Path) -> None:
    one, other = (table(only(recorded(name), PositionFix, Attitude), tmp_path / f"{name}.csv") for name in OURS[:2])
    with pytest.raises(InputError, match=r"plane_turn.csv and .*plane_glitch.csv: not two logs of one flight"):
        read_logs([one, other])
    with pytest.raises(InputError, match="named twice"):
        read_logs([one, one])
    with pytest.raises(InputError, match="one log of a flight, or two, not 3"):
        read_logs([one, other, one])
    assert read_logs([one]).events == read_log(one).events
