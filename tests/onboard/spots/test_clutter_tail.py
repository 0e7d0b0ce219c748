"""The contrast that the ground alone reaches so often a square kilometre, from the ground that was seen."""

import math

import numpy as np
import pytest

from onboard.spots.clutter_tail import LARGEST, ClutterTail
from onboard.spots.counted_ground import APART

AREA_KM2 = 0.01
DENSITY = 20_000.0  # peaks a km2


def simulated(tail: ClutterTail, pictures: int, seed: int = 0, targets: int = 0) -> ClutterTail:
    """Pictures of ground whose peaks have an exponential law with the scale 1.5, and things far above it."""
    rng = np.random.default_rng(seed)
    for k in range(pictures):
        peaks = rng.exponential(1.5, int(DENSITY * AREA_KM2))
        if k < targets:
            peaks = np.append(peaks, 60.0)
        tail.add(np.array([1000.0 * k, 0.0]), AREA_KM2, peaks)
    return tail


@pytest.mark.parametrize("rate", [1.0, 10.0, 100.0])
def test_the_ground_is_above_the_threshold_no_more_often_than_asked_for_and_that_costs_little(rate: float) -> None:
    found = [simulated(ClutterTail(rate), 40, seed).threshold for seed in range(20)]
    right = 1.5 * math.log(DENSITY / rate)
    rates = [DENSITY * math.exp(-threshold / 1.5) for threshold in found]
    assert right < np.mean(found) < 1.3 * right
    assert np.median(rates) < rate and max(rates) < 3.0 * rate


@pytest.mark.parametrize("shape", [0.1, 0.15])
def test_a_heavier_tail_has_a_higher_threshold(shape: float) -> None:
    rng = np.random.default_rng(1)
    tail = ClutterTail(1.0)
    for k in range(100):
        peaks = 1.5 * np.expm1(shape * rng.exponential(1.0, int(DENSITY * AREA_KM2))) / shape
        tail.add(np.array([1000.0 * k, 0.0]), AREA_KM2, peaks)
    right = 1.5 * math.expm1(shape * math.log(DENSITY)) / shape
    assert 0.75 * right < tail.threshold < 1.3 * right


def test_one_picture_already_says_something_and_is_not_far_off() -> None:
    found = [simulated(ClutterTail(1.0), 1, seed).threshold for seed in range(20)]
    right = 1.5 * math.log(DENSITY)
    assert right < np.mean(found) < 1.6 * right and 0.7 * right < min(found) < max(found) < 2.5 * right


def test_things_that_are_looked_for_do_not_raise_it_out_of_reach() -> None:
    without, with_things = (
        simulated(ClutterTail(1.0), 20).threshold,
        simulated(ClutterTail(1.0), 20, targets=3).threshold,
    )
    assert without <= with_things < 1.3 * without < 60.0


@pytest.mark.parametrize(("things", "pictures"), [(5, 6), (12, 14), (40, 14)])
def test_things_together_in_a_few_pictures_do_not_raise_it(things: int, pictures: int) -> None:
    """A team at take-off, a flock, a village: as hot as what is looked for, 60 sigmas above the ground's."""
    rng = np.random.default_rng(3)
    thresholds = []
    for count in (0, things):
        tail = ClutterTail(1.0)
        where = rng.integers(0, max(pictures // 4, 1), count)
        for k in range(pictures):
            peaks = np.random.default_rng([k, 4]).exponential(1.5, int(DENSITY * AREA_KM2))
            tail.add(
                np.array([1000.0 * k, 0.0]), AREA_KM2, np.append(peaks, rng.uniform(40.0, 60.0, np.sum(where == k)))
            )
        thresholds.append(tail.threshold)
    assert thresholds[1] == pytest.approx(thresholds[0], rel=0.05)


def test_what_is_as_hot_all_over_the_ground_is_ground() -> None:
    """Rocks, four a picture, seven times as hot as the rest, keep most of themselves below it."""
    thresholds = []
    for rocks in (0, 4):
        rng = np.random.default_rng(2)
        tail = ClutterTail(1.0)
        for k in range(60):
            peaks = np.append(rng.exponential(1.5, int(DENSITY * AREA_KM2)), rng.exponential(10.0, rocks))
            tail.add(np.array([1000.0 * k, 0.0]), AREA_KM2, peaks)
        thresholds.append(tail.threshold)
    assert 1.5 * thresholds[0] < thresholds[1] < 60.0
    assert 4.0 / AREA_KM2 * math.exp(-thresholds[1] / 10.0) < 30.0  # of 400 rocks a km2


def test_nothing_is_a_spot_before_anything_is_known() -> None:
    assert ClutterTail(1.0).threshold == math.inf
    tail = ClutterTail(1.0)
    tail.add(np.zeros(2), AREA_KM2, np.ones(5))
    assert tail.threshold == math.inf


def test_ground_counts_once() -> None:
    tail = ClutterTail(1.0)
    side_m = 1000.0 * math.sqrt(AREA_KM2)
    assert tail.ground.is_new(np.zeros(2), AREA_KM2)
    tail.add(np.zeros(2), AREA_KM2, np.ones(LARGEST))
    assert not tail.ground.is_new(np.array([0.9 * APART * side_m, 0.0]), AREA_KM2)
    assert tail.ground.is_new(np.array([0.0, 1.1 * APART * side_m]), AREA_KM2)
    assert tail.ground.km2 == AREA_KM2


def test_ground_without_a_place_is_never_new() -> None:
    tail = ClutterTail(1.0)
    tail.add(np.zeros(2), AREA_KM2, np.ones(LARGEST))
    assert not tail.ground.is_new(np.full(2, np.nan), AREA_KM2)
