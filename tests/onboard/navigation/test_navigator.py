"""Navigation: interpolation against truth, and every reason to refuse."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.feature_set import Status
from contract.geodesy import LocalFrame
from contract.rotations import R_ENU_NED, exp_so3, log_so3, matrix_from_euler, quaternion_from_matrix
from onboard.config.schema import Config, parse_config
from onboard.events.types import Attitude, FilterStatus, GpsQuality, NavEvent, PositionFix, RangeFinder
from onboard.navigation.limits import MEMORY_NS
from onboard.navigation.navigator import Navigation, NavState
from tests.recorded_logs import recorded
from tests.rest_long import rest_long

Array = NDArray[np.float64]
HOME = LocalFrame(-43.38, 172.4, 350.0)
T0 = 1_795_217_000_000_000_000
PLAIN = parse_config("[gps]\nlatency_s = 0.0")


def ns(seconds: float) -> int:
    return T0 + round(seconds * 1e9)


def circle(t: float) -> tuple[Array, Array]:
    """20 m/s around a circle of 100 m, climbing at 1 m/s: position and velocity in HOME's ENU."""
    a = 0.2 * t
    return np.array([100 * np.sin(a), 100 - 100 * np.cos(a), t]), np.array([20 * np.cos(a), 20 * np.sin(a), 1.0])


def fix(t: float, velocity: bool = True, shift_enu_m: tuple[float, float, float] = (0, 0, 0)) -> PositionFix:
    enu, v = circle(t)
    lat, lon, height = HOME.to_geodetic(enu + shift_enu_m)
    v_ned = R_ENU_NED.T @ v
    return PositionFix(
        ns(t), float(lat), float(lon), float(height), tuple(v_ned.tolist()) if velocity else None, 250.0 + t
    )


def attitude(t: float) -> Attitude:
    q = quaternion_from_matrix(matrix_from_euler(0.3, 0.1, np.pi / 2 - 0.2 * t))
    return Attitude(ns(t), tuple(q.tolist()))


def quality(t: float, fix_type: int = 3, sigma_m: float = 0.3) -> GpsQuality:
    return GpsQuality(ns(t), fix_type, 12, sigma_m, sigma_m, 0.2, 10.5)


def flown(seconds: float = 30.0, rate_hz: float = 5.0, config: Config = PLAIN, velocity: bool = True) -> Navigation:
    navigation = Navigation(config)
    for t in np.arange(0.0, seconds, 1 / rate_hz):
        navigation.add(quality(t))
        navigation.add(fix(t, velocity))
        navigation.add(attitude(t))
    return navigation


def state(navigation: Navigation, t: float) -> NavState:
    got = navigation.state_at(ns(t))
    assert isinstance(got, NavState), got
    return got


@pytest.mark.parametrize(("rate_hz", "limit_m"), [(2.0, 0.03), (5.0, 0.003), (10.0, 0.001)])
def test_positions_between_fixes_follow_a_curve(rate_hz: float, limit_m: float) -> None:
    navigation = flown(rate_hz=rate_hz)
    assert navigation.frame is not None
    errors = []
    for t in np.arange(2.0, 28.0, 0.137):
        got = state(navigation, t)
        lat, lon, height = navigation.frame.to_geodetic(got.position_enu_m)
        errors.append(np.linalg.norm(HOME.to_enu(lat, lon, height) - circle(t)[0]))
        assert got.height_above_home_m == pytest.approx(250.0 + t, abs=0.01)
    assert 1e-9 < max(errors) < limit_m


def test_without_velocities_positions_are_still_joined_smoothly() -> None:
    navigation = flown(rate_hz=5.0, velocity=False)
    got = state(navigation, 10.07)
    assert got.velocity_enu_m_s is None
    assert np.linalg.norm(got.position_enu_m - circle(10.07)[0]) < 0.05
    # How fast it goes is known, too: over two seconds, in which this circle's chord is 0.7 % shorter than its arc.
    assert 0.01 < np.linalg.norm(got.motion_enu_m_s - circle(10.07)[1]) < 0.3


def test_a_missing_climb_rate_comes_from_the_heights() -> None:
    navigation = Navigation(PLAIN)
    for t in np.arange(0.0, 10.0, 0.2):
        whole = fix(t)
        assert whole.velocity_ned_m_s is not None
        north, east, _ = whole.velocity_ned_m_s
        navigation.add(
            PositionFix(whole.stamp_ns, whole.lat_deg, whole.lon_deg, whole.height_amsl_m, (north, east, np.nan))
        )
    velocity = state(navigation, 5.1).velocity_enu_m_s
    assert velocity is not None
    np.testing.assert_allclose(velocity, circle(5.1)[1], atol=0.05)


def test_attitude_turns_through_north_the_short_way() -> None:
    navigation = flown(rate_hz=2.0)
    for t in np.arange(1.0, 29.0, 0.31):
        R = state(navigation, t).R_enu_body
        expected = R_ENU_NED @ matrix_from_euler(0.3, 0.1, np.pi / 2 - 0.2 * t)
        assert np.degrees(np.linalg.norm(log_so3(R.T @ expected))) < 0.01


def test_the_body_rate_is_that_of_the_turn() -> None:
    rate = flown(rate_hz=50.0, seconds=4.0).body_rate_at(ns(2.01))
    assert rate is not None
    R_ned_body = matrix_from_euler(0.3, 0.1, 0.0)
    np.testing.assert_allclose(rate, R_ned_body.T @ [0, 0, -0.2], atol=1e-4)


def test_gyro_rates_bend_the_path_between_slow_attitudes() -> None:
    def roll(t: float) -> float:
        return 0.3 * np.sin(2.0 * t)

    errors = {}
    for has_rates in (False, True):
        navigation = Navigation(PLAIN)
        for t in np.arange(0.0, 10.0, 0.3):
            q = quaternion_from_matrix(matrix_from_euler(roll(t), 0.0, 1.0))
            rate = (0.6 * float(np.cos(2.0 * t)), 0.0, 0.0) if has_rates else None
            navigation.add(Attitude(ns(t), tuple(q.tolist()), rate))
            navigation.add(fix(t))
        worst = 0.0
        for t in np.arange(1.0, 9.0, 0.07):
            R = state(navigation, t).R_enu_body
            worst = max(worst, float(np.linalg.norm(log_so3(R.T @ R_ENU_NED @ matrix_from_euler(roll(t), 0.0, 1.0)))))
        errors[has_rates] = np.degrees(worst)
        rate_at = navigation.body_rate_at(ns(5.05))
        assert rate_at[0] == pytest.approx(0.6 * np.cos(10.1), abs=0.02 if has_rates else 0.08)
    assert 0.3 < errors[False] < 1.5
    assert 1e-4 < errors[True] < 0.03


def test_the_time_offset_moves_the_moment() -> None:
    navigation = flown()
    late = navigation.state_at(ns(10.0), offset_s=0.25)
    assert late.stamp_ns == ns(10.0)
    np.testing.assert_allclose(late.position_enu_m, state(navigation, 10.25).position_enu_m)


def test_a_position_s_age_is_allowed_for() -> None:
    aged = flown(config=parse_config("[gps]\nlatency_s = 0.1"))
    np.testing.assert_allclose(state(aged, 10.0).position_enu_m, state(flown(), 10.1).position_enu_m, atol=1e-6)


def test_attitude_is_withheld_when_the_sensor_set_has_none() -> None:
    navigation = flown(config=parse_config('[solve]\nattitude = "none"'))
    assert state(navigation, 10.0).R_enu_body is None


def test_the_receiver_may_claim_more_than_the_configuration_but_not_less() -> None:
    navigation = flown(seconds=13.0)
    assert state(navigation, 10.0).sigma_horizontal_m == PLAIN.gps.sigma_correlated_horizontal_m
    navigation.add(quality(10.05, sigma_m=40.0))
    assert state(navigation, 10.1).sigma_horizontal_m == 40.0
    assert state(navigation, 11.9).sigma_vertical_m == 40.0  # a jammed receiver alternates
    assert state(navigation, 12.5).sigma_horizontal_m == PLAIN.gps.sigma_correlated_horizontal_m


def test_a_velocity_is_known_no_better_than_receiver_or_filter_claims() -> None:
    navigation = flown(seconds=13.0)
    assert state(navigation, 9.0).sigma_velocity_m_s == 0.2
    navigation.add(replace(quality(10.05), sigma_velocity_m_s=0.6))
    assert state(navigation, 11.9).sigma_velocity_m_s == 0.6  # the worst of two seconds, as of positions
    assert state(navigation, 12.5).sigma_velocity_m_s == 0.2
    navigation.add(FilterStatus(ns(12.6), has_position=True, is_glitching=False, sigma_velocity_m_s=0.9))
    assert state(navigation, 12.8).sigma_velocity_m_s == 0.9


def test_the_undulation_is_the_receiver_s_or_the_configuration_s() -> None:
    assert state(flown(), 10.0).undulation_m == 10.5
    silent = Navigation(parse_config("[gps]\nundulation_m = 21.0"))
    for t in np.arange(0.0, 2.6, 0.5):  # a receiver that is not heard is waited for
        silent.add(fix(t))
    assert state(silent, 0.6).undulation_m == 21.0


def test_coverage_waits_for_both_sides() -> None:
    navigation = flown(seconds=10.0)  # the last data are at 9.8
    assert navigation.covers(ns(9.79))
    assert not navigation.covers(ns(9.81))
    assert not navigation.covers(ns(-0.1))
    navigation.add(fix(10.0))
    assert not navigation.covers(ns(9.9))  # no attitude yet
    navigation.add(attitude(10.0))
    assert navigation.covers(ns(9.9))


def test_before_the_first_data_it_is_starting() -> None:
    assert Navigation(PLAIN).state_at(ns(0.0)) is Status.STARTING
    assert flown().state_at(ns(-1.0)) is Status.STARTING


def test_the_end_is_extrapolated_a_little_and_then_refused() -> None:
    navigation = flown(seconds=10.0)
    np.testing.assert_allclose(state(navigation, 10.05).position_enu_m, circle(10.05)[0], atol=0.3)
    assert navigation.state_at(ns(10.2)) is Status.UNSYNCHRONISED


def test_a_state_in_a_gap_of_the_attitudes_has_none() -> None:
    navigation = Navigation(PLAIN)
    for t in np.arange(0.0, 30.0, 0.2):
        navigation.add(fix(t))
        if not 10.0 < t < 12.0:
            navigation.add(attitude(t))
    assert state(navigation, 11.0).R_enu_body is None
    assert state(navigation, 13.0).R_enu_body is not None


def test_attitudes_that_would_come_too_late_are_not_waited_for() -> None:
    navigation = Navigation(PLAIN)
    for t in np.arange(0.0, 11.1, 0.2):
        navigation.add(fix(t))
        if t < 9.9:
            navigation.add(attitude(t))
    assert not navigation.covers(ns(10.5))
    for t in (11.2, 11.4):  # `max_attitude_gap_s` and what a message may be late behind
        navigation.add(fix(t))
    assert navigation.covers(ns(10.5))
    assert not navigation.covers(ns(11.5))


def all_of(t: float, fix_type: int = 3, east_m: float = 0.0) -> list[NavEvent]:
    """What a healthy vehicle reports of a moment, or one whose fix is lost or off to the east."""
    return [quality(t, fix_type=fix_type), fix(t, shift_enu_m=(east_m, 0.0, 0.0)), attitude(t)]


def slip_m(t: float) -> float:
    """An error that grows unseen, and is then corrected."""
    return 28.0 * np.exp(-(t - 20.0) / 4.0) if t > 20.0 else 1.4 * max(t, 0.0)


FAULTS: dict[str, tuple[Callable[[float], list[NavEvent]], Status, tuple[float, ...], tuple[float, ...]]] = {
    "a gap of all telemetry": (
        lambda t: [] if 10.0 < t < 13.0 else all_of(t), Status.UNSYNCHRONISED, (11.5,), (9.5, 15.0),
    ),
    "a lost fix, until a second after it is back": (
        lambda t: all_of(t, fix_type=1 if 10.0 < t < 15.0 else 3),
        Status.NO_GPS, (10.1, 12.0, 14.9, 15.1, 15.7), (9.9, 16.3),
    ),
    "a receiver that falls silent": (
        lambda t: all_of(t)[1:] if 10.0 < t < 20.0 else all_of(t), Status.NO_GPS, (12.5,), (11.0, 21.5),
    ),
    "a jump against the velocity, until it has settled": (
        lambda t: all_of(t, east_m=30.0 if 20.0 < t < 25.0 else 0.0),
        Status.NO_GPS, (20.1, 22.0, 24.9, 27.0), (18.0, 32.0),
    ),
    "a filter that slips": (lambda t: all_of(t, east_m=slip_m(t)), Status.NO_GPS, (10.0, 25.0), (45.0,)),
}  # fmt: skip
"""Faults: what is received of each moment, the refusal, and seconds that are refused and that are answered."""


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_refused_by_its_name_and_got_over(fault: str) -> None:
    received, status, refused, answered = FAULTS[fault]
    navigation = Navigation(PLAIN)
    for t in np.arange(0.0, 60.0, 0.2):
        for event in received(t):
            navigation.add(event)
    assert [navigation.state_at(ns(t)) for t in refused] == [status] * len(refused)
    assert all(isinstance(navigation.state_at(ns(t)), NavState) for t in answered)


def test_a_log_that_never_tells_of_its_receiver_is_believed() -> None:
    navigation = Navigation(PLAIN)
    for t in np.arange(0.0, 5.0, 0.2):
        navigation.add(fix(t))
    assert isinstance(navigation.state_at(ns(2.0)), NavState)


def test_events_out_of_order_make_no_difference() -> None:
    ordered, shuffled = flown(), Navigation(PLAIN)
    events = [make(t) for t in np.arange(0.0, 30.0, 0.2) for make in (quality, fix, attitude)]
    for i in range(6, len(events) - 6, 6):
        events[i : i + 6] = events[i : i + 6][::-1]
    for event in events:
        shuffled.add(event)
    np.testing.assert_array_equal(state(ordered, 10.07).position_enu_m, state(shuffled, 10.07).position_enu_m)


def test_memory_is_bounded() -> None:
    navigation = Navigation(PLAIN)
    for t in np.arange(0.0, 400.0, 0.2):
        navigation.add(fix(t))
    assert len(navigation._integrity.positions.stamps_ns) <= 5 * 2 * MEMORY_NS / 1e9 + 2
    assert isinstance(navigation.state_at(ns(350.0)), NavState)


def test_a_clock_set_back_starts_afresh() -> None:
    navigation = flown()
    for t in np.arange(-3600.0, -3590.0, 0.2):
        navigation.add(fix(t))
        navigation.add(attitude(t))
        navigation.add(quality(t))
    assert isinstance(navigation.state_at(ns(-3595.0)), NavState)


together = pytest.mark.xdist_group("recorded logs")  # one worker: they are read once


@cache
def replayed(
    shared_data: Path, name: str, settings: str, every: int, seconds: tuple[float, float] = (-np.inf, np.inf)
) -> tuple[list[tuple[float, NavState | Status]], Array]:
    """State at every n-th row of the truth between two moments of the flight, asked as the data come in, and these."""
    config = parse_config(settings)
    log = recorded(shared_data / "sitl" / f"{name}.tlog", 0.45 if seconds == FIRST else 1.0)
    truth = np.genfromtxt(shared_data / "sitl" / f"{name}.truth.csv", delimiter=",", skip_header=1)
    truth = truth[truth[:, 3] > 180.0]
    since_s = truth[:, 0] - truth[0, 0]
    truth = truth[(since_s >= seconds[0]) & (since_s <= seconds[1])][::every]
    navigation, answers, row = Navigation(config), [], 0
    for event in log.events:
        if row == len(truth):
            break
        navigation.add(event)
        while row < len(truth) and navigation.covers(round((truth[row, 0] + 1.0) * 1e9)):
            answers.append((truth[row, 0], navigation.state_at(round(truth[row, 0] * 1e9))))
            row += 1
    enu = navigation.frame.to_enu(truth[:row, 1], truth[:row, 2], truth[:row, 3])
    return answers, np.column_stack([truth[:row], enu])


PROMPT, AGED = "[gps]\nlatency_s = 0.0\n[mount]\ngimbal = 'never'", "[gps]\nlatency_s = 0.04"
FIRST, WHOLE = (0.0, 120.0), (-np.inf, np.inf)  # seconds of the flight


@pytest.mark.long  # short: attitudes, below
@together
@pytest.mark.parametrize(
    ("settings", "low_m", "high_m", "seconds"),
    rest_long([(AGED, 0.01, 0.1, FIRST), (AGED, 0.01, 0.1, WHOLE), (PROMPT, 0.5, 1.0, WHOLE)]),
)
def test_recorded_positions_follow_the_truth(
    shared_data: Path, settings: str, low_m: float, high_m: float, seconds: tuple[float, float]
) -> None:
    answers, truth = replayed(shared_data, "plane_clean", settings, 10, seconds)
    states = [got for _, got in answers if isinstance(got, NavState)]
    assert len(states) == len(answers)
    errors = np.linalg.norm(np.array([s.position_enu_m for s in states])[:, :2] - truth[:, 7:9], axis=1)
    assert low_m < np.median(errors) < high_m


@together
@pytest.mark.parametrize("seconds", rest_long([(FIRST,), (WHOLE,)]))
def test_recorded_attitudes_follow_the_truth(shared_data: Path, seconds: tuple[float, float]) -> None:
    answers, truth = replayed(shared_data, "plane_clean", PROMPT, 10, seconds)
    errors = []
    for (_, got), row in zip(answers, truth, strict=True):
        errors.append(log_so3((R_ENU_NED @ matrix_from_euler(*np.radians(row[4:7]))).T @ got.R_enu_body))
    roll, pitch, yaw = np.degrees(np.median(np.abs(errors), axis=0))
    assert 0.02 < roll < 0.3
    assert 0.02 < pitch < 0.4
    assert 0.1 < yaw < 1.5


@pytest.mark.long
@together
def test_lost_and_jammed_gps_is_refused_and_nothing_far_off_is_answered(shared_data: Path) -> None:
    answers, truth = replayed(shared_data, "plane_gps_outage", "", 5, (0.0, 270.0))  # a minute longer than it is jammed
    off, on, jammed, free = 1795217179.211, 1795217199.217, 1795217269.226, 1795217289.208
    worst = 0.0
    for (t, got), row in zip(answers, truth, strict=True):
        if off + 0.5 < t < on:
            assert got is Status.NO_GPS, t
        if isinstance(got, NavState):
            error = float(np.linalg.norm(got.position_enu_m[:2] - row[7:9]))
            if got.sigma_horizontal_m < 2.0:
                worst = max(worst, error)
    refused = np.mean([got is Status.NO_GPS for t, got in answers if jammed + 3.0 < t < free])
    assert refused > 0.9
    assert 0.1 < worst < 4.0
    answered = [isinstance(got, NavState) for t, got in answers if on + 5.0 < t < jammed - 1.0 or t > free + 15.0]
    assert np.mean(answered) == 1.0


def test_a_spinning_attitude_is_not_smeared() -> None:
    navigation = Navigation(PLAIN)
    for t in np.arange(0.0, 4.0, 0.02):
        navigation.add(fix(t))
        q = quaternion_from_matrix(exp_so3(np.array([2.0 * t, 0.0, 0.0])))
        navigation.add(Attitude(ns(t), tuple(q.tolist())))
    got = state(navigation, 2.013).R_enu_body
    assert np.linalg.norm(log_so3(got.T @ R_ENU_NED @ exp_so3(np.array([2.0 * 2.013, 0.0, 0.0])))) < 1e-4


RANGED = parse_config("[gps]\nlatency_s = 0.0\n[range_finder]\nuse = true\nsigma_m = 0.5\nsigma_share = 0.01")


def ranged(config: Config = RANGED, distances_m: tuple[float, ...] = (100.0, 102.0, 104.0)) -> Navigation:
    navigation = flown(5.0, config=config)
    for k, distance_m in enumerate(distances_m):
        navigation.add(RangeFinder(ns(1.0 + 0.2 * k), distance_m, (0.0, 0.0, 1.0)))
    return navigation


def test_a_range_becomes_a_vector_to_the_ground_along_the_vehicles_own_down() -> None:
    state = ranged().state_at(ns(1.1))
    np.testing.assert_allclose(state.ground_range.vector_enu_m, 101.0 * state.R_enu_body[:, 2], atol=1e-6)
    assert state.ground_range.sigma_m == pytest.approx(np.hypot(0.5 + 1.01, 1.0))


def test_a_range_is_used_only_where_asked_for_fresh_and_downward() -> None:
    for navigation, moment in (
        (ranged(PLAIN), 1.1),
        (ranged(), 2.5),  # a second after its last echo
        (ranged(distances_m=()), 1.1),
    ):
        state = navigation.state_at(ns(moment))
        assert state.ground_range is None
    upward = flown(5.0, config=RANGED)
    upward.add(RangeFinder(ns(1.0), 30.0, (0.0, 0.0, -1.0)))
    state = upward.state_at(ns(1.05))
    assert state.ground_range is None
