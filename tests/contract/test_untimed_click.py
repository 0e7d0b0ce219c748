"""A click whose picture's time is known to some tenths of a second: its ellipse has that, and no more."""

import copy
import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from contract.answer import Fix
from contract.feature_set import FeatureSet, Status
from contract.untimed_click import UntimedClick, locate_untimed
from tests.onboard.tracks.flat_world import CAMERA, EPOCH_NS, M_PX, PLACE, RATE_HZ, World

SPEED_M_S, SIGMA_S = 8.0, 0.3
POSE_ERROR_M = np.array([0.8, -0.5])  # of every set of that world; one sigma of it is stated as 1 m
SHARE = (0.25, 0.4)


def its_sets(world: World) -> list[FeatureSet]:
    return [world.its_set(number) for number in range(60)]


@cache
def world() -> World:
    return World(camera=lambda t: (SPEED_M_S * t, 0.0))


@cache
def passing() -> list[FeatureSet]:
    return its_sets(world())


def at_ns(time_s: float) -> int:
    return EPOCH_NS + round(time_s * 1e9)


def clicked(moment_s: float, sets: list[FeatureSet] | None = None, sigma_s: float = SIGMA_S) -> UntimedClick:
    return locate_untimed(passing() if sets is None else sets, SHARE, at_ns(moment_s), sigma_s)


def error_m(found: UntimedClick, shown_s: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """East, north from what was at SHARE of the picture of `shown_s`."""
    assert isinstance(found.answer, Fix)
    u, v = (share * size - 0.5 for share, size in zip(SHARE, (CAMERA.width_px, CAMERA.height_px), strict=True))
    truth = np.array([SPEED_M_S * shown_s + (u - CAMERA.cx_px) * M_PX, -(v - CAMERA.cy_px) * M_PX])
    where: np.ndarray[tuple[int], np.dtype[np.float64]] = PLACE.to_enu(
        found.answer.lat_deg, found.answer.lon_deg, found.answer.height_amsl_m or 0.0
    )[:2]
    return where - truth


def test_a_moment_that_is_known_gives_the_place_of_then_also_between_two_pictures() -> None:
    for moment_s in (2.0, 2.05):
        found = clicked(moment_s, sigma_s=0.0)
        assert np.allclose(error_m(found, moment_s), POSE_ERROR_M, atol=0.03)
        assert np.max(np.abs(found.by_delay_m2)) < 1e-3


def test_nine_of_ten_clicks_are_inside_whatever_the_delay_was_and_the_ellipse_is_no_wider_than_it() -> None:
    found = clicked(3.0)
    rng = np.random.default_rng(1)
    # Each with a delay and a pose of its own: those of its sets are taken off.
    errors = np.array([error_m(found, 3.0 + rng.normal(0.0, SIGMA_S)) for _ in range(2000)])
    errors += rng.normal(0.0, 1.0, errors.shape) - POSE_ERROR_M
    chi2 = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(found.answer.covariance_enu_m2[:2, :2]), errors)
    assert 0.88 <= np.mean(chi2 < 4.605) <= 0.92
    stated_m, truly_m = found.answer.ellipse.semi_major_m, 2.146 * math.hypot(SPEED_M_S * SIGMA_S, 1.0)
    assert 0.97 <= stated_m / truly_m <= 1.05
    assert np.isclose(found.by_delay_m2[0, 0], (SPEED_M_S * SIGMA_S) ** 2, rtol=0.03)


def test_a_turn_that_no_straight_line_follows_widens_it() -> None:
    """The camera swings to and fro within the delay: its mean is known, where it was is not."""
    swinging = World(camera=lambda t: (4.0 * math.sin(2.0 * math.pi * t / 0.5), 0.0))
    found = clicked(3.0, its_sets(swinging))
    assert 2.0 <= math.sqrt(found.by_delay_m2[0, 0]) <= 4.5


def test_a_hovering_aircraft_owes_nothing_to_the_delay() -> None:
    found = clicked(3.0, its_sets(World()))
    assert np.max(np.abs(found.by_delay_m2)) < 1e-6
    assert np.isclose(found.answer.ellipse.semi_major_m, 2.146, rtol=0.02)


def swung(seed: int) -> World:
    """It flies, and nods and yaws by some metres on the ground, with periods of 1.2 to 6 s."""
    rng = np.random.default_rng(seed)
    turning = 2.0 * np.pi / np.exp(rng.uniform(math.log(1.2), math.log(6.0), (2, 4)))
    phase, size_m = rng.uniform(0.0, 2.0 * np.pi, (2, 4)), rng.uniform(1.0, 4.0)

    def camera(t: float) -> tuple[float, float]:
        east_m, north_m = np.sum(size_m * np.sin(turning * t + phase), axis=1)
        return SPEED_M_S * t + float(east_m), float(north_m)

    out = copy.copy(world())  # its ground is no part of a set
    out.camera = camera
    return out


def test_what_swings_between_two_sets_a_second_apart_is_in_the_ellipse() -> None:
    """A straight line through three of them had 75 % inside, and 3.7 ellipses off."""
    inside = []
    for seed in range(60):
        swinging = swung(seed)
        rng = np.random.default_rng([seed, 1])
        shown_s = 40.0 + rng.uniform(0.0, 1.0)
        sets = [swinging.its_set(number) for number in range(320, 420, 10)]
        found = locate_untimed(sets, SHARE, at_ns(shown_s + rng.normal(0.0, 0.1)), 0.1)
        if not isinstance(found.answer, Fix):
            assert found.answer.status is Status.UNCERTAIN
            continue
        swings_m = np.subtract(swinging.camera(shown_s), [SPEED_M_S * shown_s, 0.0])
        error = error_m(found, shown_s) - swings_m - POSE_ERROR_M + rng.normal(0.0, 1.0, 2)
        inside.append(error @ np.linalg.solve(found.answer.covariance_enu_m2[:2, :2], error) / 4.605)
    assert len(inside) >= 50
    assert np.mean(np.array(inside) < 1.0) >= 0.9 and max(inside) < 3.0**2
    assert np.mean(np.array(inside) < 0.5**2) < 0.9  # nor is it wider than it need be


def test_a_camera_that_swings_too_much_between_its_pictures_is_refused() -> None:
    swinging = World(camera=lambda t: (25.0 * math.sin(2.0 * math.pi * t / 1.7), 0.0))
    assert clicked(3.0, its_sets(swinging)[::10], 0.1).answer.status is Status.UNCERTAIN
    assert isinstance(clicked(3.0, its_sets(swinging), 0.1).answer, Fix)  # ten pictures a second show how


def test_sets_that_come_seldom_still_state_how_far_it_moves() -> None:
    found = clicked(3.0, passing()[::15])
    assert np.isclose(found.by_delay_m2[0, 0], (SPEED_M_S * SIGMA_S) ** 2, rtol=0.1)


@pytest.mark.parametrize(
    ("sets", "moment_s", "status"),
    [
        pytest.param(list, 3.0, Status.STALE, id="none"),
        pytest.param(passing, 30.0, Status.STALE, id="long ago"),
        pytest.param(lambda: passing()[30:31], 3.0, Status.STALE, id="one alone knows no speed"),
        pytest.param(lambda: its_sets(World(status=Status.TURNING)), 3.0, Status.TURNING, id="no pose"),
    ],
)
def test_what_cannot_be_known_is_refused(sets: Callable[[], list[FeatureSet]], moment_s: float, status: Status) -> None:
    answer = clicked(moment_s, sets()).answer
    assert answer.status is status and answer.reason


def test_pictures_without_a_place_among_others_that_have_one_hold_up_no_click() -> None:
    lost = World(status=Status.TURNING, camera=world().camera)
    mixed = [(lost if number % 3 == 0 else world()).its_set(number) for number in range(60)]
    assert np.allclose(error_m(clicked(3.0, mixed), 3.0), POSE_ERROR_M, atol=0.05)
    assert RATE_HZ == 10.0  # so that every third of them is 0.3 s from the next
