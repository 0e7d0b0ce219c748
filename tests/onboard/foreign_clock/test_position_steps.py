"""Positions of photographs that step in flight: found by the pictures' motion, joined, and doubted by as much."""

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.foreign_clock.picture_pairs import Pairs
from onboard.foreign_clock.position_steps import Step, bridging, intervals, joined, steps

Array = NDArray[np.float64]

HEIGHT_M, APART_M, CLAIM_M = 120.0, 20.0, 1.5
CORNERS = 0.3 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
STEP = np.array([0.8, 0.6])


def survey(legs: int = 4, pictures: int = 8) -> tuple[Array, Array]:
    """Places (N, 2), east and north m, of legs there and back with two pictures across, and headings (N,), rad."""
    places, headings, east = [], [], 0.0
    for leg in range(legs):
        for k in range(pictures):
            places.append((east, APART_M * (k if leg % 2 == 0 else pictures - 1 - k)))
            headings.append(0.0 if leg % 2 == 0 else np.pi)
        for _ in range(2):
            east += APART_M
            places.append((east, places[-1][1]))
            headings.append(0.5 * np.pi)
    return np.array(places), np.array(headings)


def seen(
    places: Array,
    headings: Array,
    rng: np.random.Generator,
    noise: float = 0.003,
    chosen: list[tuple[int, int]] | None = None,
) -> tuple[Pairs, list[Array]]:
    """Pairs of pictures straight down, the tops ahead, and their attitudes R_enu_cam (3, 3)."""
    chosen = list(itertools.pairwise(range(len(places)))) if chosen is None else chosen
    c, s = np.cos(headings), np.sin(headings)
    R = [np.array([[c[k], s[k], 0.0], [-s[k], c[k], 0.0], [0.0, 0.0, 1.0]]) for k in range(len(headings))]
    down = np.diag([1.0, -1.0, -1.0])  # of a picture whose top is north
    R_enu_cam = [each @ down for each in R]
    ground = np.concatenate([HEIGHT_M * CORNERS, np.full((4, 1), HEIGHT_M)], axis=1)
    at, to = [], []
    for first, second in chosen:
        points = ground @ R_enu_cam[first].T + np.array([*places[first], 0.0])
        rays = (points - np.array([*places[second], 0.0])) @ R_enu_cam[second]
        at.append(CORNERS)
        to.append(rays[:, :2] / rays[:, 2:] + noise * rng.standard_normal(2))
    return Pairs(np.array(chosen), np.array(at), np.array(to)), R_enu_cam


def found_in(stepped: Array, places: Array, headings: Array, seed: int, has_attitude: bool) -> dict[int, Step]:
    rng = np.random.default_rng(seed)
    pairs, R_enu_cam = seen(places, headings, rng)
    stated = stepped + 0.3 * rng.standard_normal(places.shape)
    known = intervals(pairs, R_enu_cam if has_attitude else [None] * len(places))
    return steps(stated, known, np.full(len(places), CLAIM_M))


@pytest.mark.parametrize("has_attitude", [True, False])
@pytest.mark.parametrize("size_m", [10.0, 30.0, 100.0])
def test_a_step_is_found_wherever_it_is(size_m: float, has_attitude: bool) -> None:
    """Next to a turn and in it, after the first picture and before the last."""
    places, headings = survey()
    for at in range(len(places) - 1):
        stepped = places.copy()
        stepped[at + 1 :] += size_m * STEP
        found = found_in(stepped, places, headings, at, has_attitude)
        assert list(found) == [at]
        off_m = abs(found[at].moved_m - size_m * complex(*STEP))
        assert off_m < 3.5 * found[at].sigma_m and 0.2 < found[at].sigma_m < 2.0


@pytest.mark.parametrize("has_attitude", [True, False])
def test_turns_are_no_steps(has_attitude: bool) -> None:
    places, headings = survey()
    assert all(not found_in(places, places, headings, seed, has_attitude) for seed in range(40))


@pytest.mark.parametrize("has_attitude", [True, False])
@pytest.mark.parametrize("at", [0, 3, 7, 8, 9, 10, 18])
def test_an_interval_without_overlap_is_what_pictures_farther_apart_leave_of_it(at: int, has_attitude: bool) -> None:
    """In a turn, before and after one, and at either end: a step there was seen by nothing."""
    places, headings = survey(legs=2)
    every, R_enu_cam = seen(places, headings, np.random.default_rng(0), noise=0.0)
    R_known = R_enu_cam if has_attitude else [None] * len(places)
    kept = every.moments_ns[:, 0] != at
    less = Pairs(every.moments_ns[kept], every.at[kept], every.to[kept])
    whole, gapped = intervals(every, R_known), intervals(less, R_known)
    assert not np.isfinite(gapped.way[at])
    bridges = bridging(gapped)
    assert len(bridges) >= 3
    for bridge in bridges:
        across, _ = seen(places, headings, np.random.default_rng(0), 0.0, [bridge])
        filled = intervals(less.with_others(across), R_known)
        assert filled.way[at] == pytest.approx(whole.way[at], abs=1e-6)
        assert filled.turn[at] == pytest.approx(whole.turn[at], abs=1e-6)
        assert filled.warp[at] > 0.0029  # of another match


@pytest.mark.parametrize("has_attitude", [True, False])
def test_a_step_of_a_few_metres_in_a_short_flight_of_rtk(has_attitude: bool) -> None:
    """It widened the scatter that it was judged by: of sixty 53 were found alone, 6 with others that were none; and in
    4 of sixty without a step there was one.
    """
    places, headings = survey(legs=2, pictures=6)
    alone, false = 0, 0
    for seed in range(60):
        rng = np.random.default_rng(5000 + seed)
        pairs, R_enu_cam = seen(places, headings, rng)
        known = intervals(pairs, R_enu_cam if has_attitude else [None] * len(places))
        stated, claims_m = places + 0.02 * rng.standard_normal(places.shape), np.full(len(places), 0.012)
        false += bool(steps(stated, known, claims_m))
        at, angle = int(rng.integers(0, len(places) - 1)), rng.uniform(0.0, 2.0 * np.pi)
        stated[at + 1 :] += 5.0 * np.array([np.cos(angle), np.sin(angle)])
        alone += list(steps(stated, known, claims_m)) == [at]
    assert false <= 1 and alone >= 57


def test_pictures_that_show_no_motion_deny_nothing() -> None:
    places, _ = survey()
    none = Pairs(np.zeros((0, 2), np.int64), np.zeros((0, 4, 2)), np.zeros((0, 4, 2)))
    assert not steps(places, intervals(none, [None] * len(places)), np.full(len(places), CLAIM_M))


def test_which_side_of_a_step_is_right_is_not_known() -> None:
    whole = joined(10, {4: Step(30.0 + 0.0j, 1.0)}, CLAIM_M)
    assert whole.doubt_m == pytest.approx(15.0)
    assert whole.add_m[:5] == pytest.approx(15.0) and whole.add_m[5:] == pytest.approx(-15.0)
    assert not whole.sigma_m[:5].any() and whole.sigma_m[5:] == pytest.approx(1.0)


def test_what_steps_there_and_back_was_off_between() -> None:
    """Also from a place that had stepped itself."""
    there_and_back = {4: Step(60.0 + 0.0j, 1.0), 6: Step(-59.0 + 0.5j, 1.0)}
    whole = joined(10, there_and_back, CLAIM_M)
    assert whole.doubt_m == 0.0
    assert whole.add_m[5:7] == pytest.approx(-60.0) and not whole.add_m[[0, 4, 7, 9]].any()
    assert whole.sigma_m[5:7] == pytest.approx(1.0) and not whole.sigma_m[[0, 4, 7, 9]].any()
    later = joined(10, {1: Step(20.0j, 1.0), **there_and_back}, CLAIM_M)
    assert later.doubt_m == pytest.approx(10.0)
    assert later.add_m[[2, 4, 7, 9]] == pytest.approx(-10.0j) and later.add_m[:2] == pytest.approx(10.0j)
