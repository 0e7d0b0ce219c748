"""A camera's clock is found over the whole log to its sigma, or it is refused: on recorded autopilots."""

from dataclasses import replace

import numpy as np
import pytest

from onboard.foreign_clock.clock_search import Clock, Evidence, Stated, Unknown, search
from onboard.foreign_clock.picture_pairs import Pairs
from tests.onboard.foreign_clock.recorded_motion import evidence

TURN = np.arange(3.0, 57.0, 1.5)  # of `plane_turn`
LEG = np.arange(3.0, 17.0, 1.5)  # of `copter_leg`, straight at constant speed


def found(result: Clock | Unknown) -> Clock:
    assert isinstance(result, Clock), result
    return result


def reason(result: Clock | Unknown) -> str:
    assert isinstance(result, Unknown), result
    return result.reason


@pytest.mark.parametrize("ahead_s", [-300.0, 4.0, 5.5 * 3600.0 + 21.7])
@pytest.mark.parametrize(
    ("recording", "taken_s"),
    [("plane_turn", TURN), ("plane_glitch", np.arange(51.0, 63.0, 1.5)), ("qp_climb", np.arange(3.0, 27.0, 1.5))],
)
def test_motion_alone_finds_it_to_a_tenth_of_a_second(recording: str, taken_s: np.ndarray, ahead_s: float) -> None:
    clock = found(search(evidence(recording, taken_s, ahead_s), None))
    error_s = abs(clock.offset_s + ahead_s)
    assert error_s < 0.1 and error_s < 3.0 * clock.sigma_s
    assert 0.005 < clock.sigma_s < 0.1


@pytest.mark.parametrize("seed", [0, 1])
def test_positions_alone_show_it_to_their_sigma(seed: int) -> None:
    """A plane's nose turns after its path: 0.16 s off, by a sigma of 0.02 s, though the log had nothing of the nose."""
    clock = found(search(evidence("plane_turn", np.arange(20.0, 50.0, 0.7), 4.0, seed=seed, by_path=True), None))
    assert abs(clock.offset_s + 4.0) < 2.0 * clock.sigma_s and 0.08 < clock.sigma_s < 0.3


@pytest.mark.long
def test_its_sigma_is_what_the_errors_are() -> None:
    """It was 0.05 s at least, three times what the errors are, and without that a third of them."""
    errors = []
    stretches = {"plane_turn": TURN, "qp_climb": np.arange(3.0, 27.0, 1.5), "plane_glitch": np.arange(10.0, 60.0, 1.5)}
    for recording, taken_s in stretches.items():
        for seed in range(8):
            ahead_s = 4.0 + 0.037 * seed
            known = evidence(recording, taken_s + 0.17 * seed, ahead_s, seed=seed, jitter_s=0.03)
            clock = found(search(known, None))
            errors.append((clock.offset_s + ahead_s) / clock.sigma_s)
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.4 and np.abs(errors).max() < 3.3


def test_a_straight_flight_at_constant_speed_determines_nothing() -> None:
    assert "fit equally" in reason(search(evidence("copter_leg", LEG, 4.0), None))


def test_pictures_of_another_flight_are_not_put_into_this_one() -> None:
    """Rolls and turns of one aircraft against the log of another, at any time of it."""
    here, there = evidence("plane_turn", TURN, 0.0), evidence("plane_glitch", TURN, 0.0)
    moved_ns = there.track.start_ns - here.track.start_ns
    mixed = replace(
        here,
        track=there.track,
        moments_ns=[stamp_ns + moved_ns for stamp_ns in here.moments_ns],
        pairs=replace(here.pairs, moments_ns=here.pairs.moments_ns + moved_ns),
    )
    assert reason(search(mixed, None))


@pytest.mark.parametrize(("step_s", "since"), [(10.0, 0.8), (-3600.0, 0.7), (1800.0, 0.3)])
def test_a_clock_that_is_set_in_flight_is_named(step_s: float, since: float) -> None:
    """The pictures of before or after were put where they were not: 100 m off by an ellipse of 7 m."""
    known = evidence("plane_turn", TURN, 4.0)
    at_ns = known.pairs.moments_ns.min() + since * np.ptp(known.pairs.moments_ns)
    moved_ns = round(step_s * 1e9)
    stepped = replace(
        known,
        moments_ns=[t + moved_ns * bool(t > at_ns) for t in known.moments_ns],
        pairs=replace(known.pairs, moments_ns=known.pairs.moments_ns + moved_ns * (known.pairs.moments_ns > at_ns)),
    )
    assert "a clock was set in flight" in reason(search(stepped, None))


def test_what_is_stated_holds_where_the_flight_determines_nothing_and_keeps_its_own_sigma() -> None:
    clock = found(search(evidence("copter_leg", LEG, 4.0), Stated(-3.8, 0.1, "--clock-offset")))
    assert abs(clock.offset_s + 4.0) < 3.0 * clock.sigma_s and clock.sigma_s < 0.2
    wide = found(search(evidence("copter_leg", LEG, 4.0), Stated(-3.5, 1.0, "--start")))
    assert 0.15 < wide.sigma_s < 1.1 and abs(wide.offset_s + 4.0) < 2.0 * wide.sigma_s


def test_what_is_stated_to_the_second_is_narrowed_by_motion_and_a_wrong_sign_is_named() -> None:
    known = evidence("plane_turn", TURN, 12.4)
    clock = found(search(known, Stated(-13.0, 1.0, "--start")))
    assert abs(clock.offset_s + 12.4) < 0.1 and clock.sigma_s < 0.1
    assert "--clock-offset states +12.40 s, but" in reason(search(known, Stated(12.4, 0.1, "--clock-offset")))


def uneven(count: int) -> np.ndarray:
    """Moments as distances over the ground in gusts make them."""
    return 3.0 + np.cumsum(np.random.default_rng(3).uniform(0.8, 1.6, count))


@pytest.mark.parametrize("lost", [(), (2,), (0, 7)])
def test_recorded_shots_find_it_where_motion_does_not_though_some_are_lost(lost: tuple[int, ...]) -> None:
    shots_s = uneven(11)
    taken_s = np.delete(shots_s, lost)
    assert reason(search(evidence("copter_leg", taken_s, 4.0), None))
    # A shot of before the flight that has no picture, and one picture without its shot.
    recorded_s = [1.0, *np.delete(shots_s, 5)]
    clock = found(search(evidence("copter_leg", taken_s, 4.0, recorded_s), None))
    assert abs(clock.offset_s + 4.0) < 3.0 * clock.sigma_s and clock.sigma_s < 0.25


def still(known: Evidence) -> Evidence:
    none = known.pairs
    return replace(known, pairs=Pairs(none.moments_ns[:0], none.at[:0], none.to[:0]))


def test_even_shots_count_by_their_number_and_one_lost_at_an_end_of_a_straight_flight_is_refused() -> None:
    even = np.arange(3.0, 17.0, 1.5)
    clock = found(search(still(evidence("copter_leg", even, 4.0, even)), None))
    assert abs(clock.offset_s + 4.0) < 3.0 * clock.sigma_s
    assert "fit equally" in reason(search(still(evidence("copter_leg", even[1:], 4.0, even)), None))
