"""Between positions: how far place and distance displacement may be off, by the positions themselves."""

import numpy as np
import pytest

from onboard.estimation.sensor_factors import between_covariance, shared_fixes
from onboard.navigation.position_interpolation import Path, Position
from simulation.paths import PathSpec, fly_path
from simulation.trajectory import Trajectory

SECONDS = 40.0
STEP_S = 0.4
STRAIGHT = PathSpec("straight", wobble_deg=0.0)
TURNS = [PathSpec("turns", leg_m=250.0), PathSpec("turns", leg_m=80.0, bank_deg=50.0)]


def ns(moment_s: float) -> int:
    return round(moment_s * 1e9)


def flight(spec: PathSpec, every_s: float, is_online: bool = False) -> tuple[Trajectory, Path]:
    """A path and what came of it every so often; `is_online`: nothing yet after the position past half of it."""
    path = fly_path(spec, SECONDS, 1)
    known = Path(max_gap_s=2.5)
    for t in np.arange(-4.0, SECONDS / 2.0 + every_s if is_online else SECONDS + 4.0, every_s):
        known.insert(ns(t), Position(path.position_enu_m(t), path.velocity_enu_m_s(t), None))
    return path, known


def off_and_stated(path: Trajectory, known: Path, moments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal errors of places and of distances displacement (N, 2), m, and one sigma stated for each."""
    off, stated = [], []
    for t in moments:
        place, displacement = known.at(ns(t)), known.displacement(ns(t - STEP_S), ns(t))
        assert isinstance(place, Position)
        true = [path.position_enu_m(t), path.position_enu_m(t) - path.position_enu_m(t - STEP_S)]
        off.append([np.linalg.norm((a - b)[:2]) for a, b in zip((place.enu_m, displacement.enu_m), true, strict=True)])
        by_gap = np.array(list(displacement.between_m.values()))
        stated.append([known.joined_at(ns(t)).between_m[0], np.sqrt(np.sum(by_gap**2, axis=0))[0]])
    return np.array(off), np.array(stated)


@pytest.mark.parametrize("spec", TURNS)
def test_in_turns_rare_positions_say_how_far_they_may_be_off(spec: PathSpec) -> None:
    path, known = flight(spec, 2.0)
    off, stated = off_and_stated(path, known, np.arange(4.0, 36.0, 0.1))
    assert off[:, 1].max() > 0.3, "a turn that nothing misses shows nothing"
    assert np.all(np.mean(off <= 3.0 * stated + 0.05, axis=0) > 0.97)
    rms = np.sqrt(np.mean(stated**2, axis=0) / np.mean(off**2, axis=0))
    assert np.all((rms > 1.0) & (rms < 4.0)), rms  # of two axes each


def test_what_is_known_by_the_position_that_ends_the_gap_suffices() -> None:
    off, stated = off_and_stated(*flight(TURNS[1], 2.0, is_online=True), np.arange(18.0, 20.0, 0.05))
    assert np.all(off <= 3.0 * stated + 0.05)


@pytest.mark.parametrize(("spec", "every_s"), [(STRAIGHT, 2.0), (TURNS[1], 0.1)])
def test_a_straight_leg_and_positions_that_come_often_are_taken_as_they_are(spec: PathSpec, every_s: float) -> None:
    off, stated = off_and_stated(*flight(spec, every_s), np.arange(4.0, 36.0, 0.13))
    assert off.max() < 0.03 and stated.max() < 0.03


def test_past_the_last_position_the_height_above_home_climbs_with_the_place() -> None:
    climbing = Path(max_gap_s=2.5)
    for t in (0.0, 0.2):
        climbing.insert(
            ns(t), Position(np.array([0.0, 0.0, 500.0 + 5.0 * t]), np.array([0.0, 0.0, 5.0]), 40.0 + 5.0 * t)
        )
    for t in (0.1, 0.2, 0.5):
        place = climbing.at(ns(t))
        assert place.height_above_home_m is not None
        assert place.enu_m[2] == pytest.approx(500.0 + 5.0 * t)
        assert place.height_above_home_m == pytest.approx(40.0 + 5.0 * t), "home stays where it is"


def test_at_a_position_itself_nothing_is_added() -> None:
    assert not flight(TURNS[1], 2.0)[1].joined_at(ns(8.0)).between_m.any()


def test_distances_over_one_gap_share_what_was_missed_in_it() -> None:
    _, known = flight(TURNS[1], 2.0)
    parts = [known.displacement(ns(8.0 + 0.5 * k), ns(8.5 + 0.5 * k)) for k in range(8)]
    whole = known.displacement(ns(8.0), ns(12.0))
    assert len(whole.between_m) == 2
    covariance = between_covariance(parts)[0]
    assert np.sqrt(np.linalg.norm(whole.between_m[ns(8.0)][0])) > 0.5
    assert covariance[:4, :4].sum() == pytest.approx(whole.between_m[ns(8.0)][0] ** 2)
    assert covariance.sum() == pytest.approx(between_covariance([whole])[0].sum())
    assert not covariance[:4, 4:].any()


def test_pictures_between_the_same_positions_share_their_noise_and_others_do_not() -> None:
    rare, often = (
        shared_fixes([flight(TURNS[0], every_s)[1].joined_at(ns(t)).weights for t in (8.3, 8.6, 8.9, 12.0)])
        for every_s in (2.0, 0.1)
    )
    assert np.array_equal(often, np.eye(4))
    assert np.all(rare[:3, :3] > 0.5) and np.array_equal(rare[3], np.eye(4)[3])
    assert np.linalg.eigvalsh(rare)[0] > 0.0
