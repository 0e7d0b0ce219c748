"""The prior on the ground's slope: what slopes seen elsewhere say, no more, and never less wide than they are."""

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.config.schema import parse_config
from onboard.estimation.factors import Layout, SharedPrior
from onboard.estimation.ground_slope import GroundSlope, SlopeSeen, seen_alone
from onboard.estimation.platform_states import BORESIGHT, STATES
from onboard.estimation.sensor_factors import level_sigma

Array = NDArray[np.float64]
SIGMA = level_sigma(parse_config(""))
KNOWN, UNKNOWN = np.radians(0.5), 1.0
INSIDE_99 = np.sqrt(-2.0 * np.log(0.01))  # sigmas
TEN_DEG = np.tan(np.radians(10.0))
SECOND_NS = 1_000_000_000


def leg(towards: Array, slope: Array, first_s: int, start_m: Array, rng: np.random.Generator) -> list[SlopeSeen]:
    """Windows of ten seconds and 200 m one after the other, which see the slope along a level direction (2,) alone."""
    across = np.array([-towards[1], towards[0]])
    covariance = KNOWN**2 * np.outer(towards, towards) + UNKNOWN**2 * np.outer(across, across)
    factor = np.linalg.cholesky(covariance)
    return [
        seen_at(
            (first_s + 11 * k + 10) * SECOND_NS,
            start_m + 200.0 * k * towards,
            slope + factor @ rng.standard_normal(2),
            covariance,
        )
        for k in range(5)
    ]


def seen_at(end_ns: int, place_m: Array, slope: Array, covariance: Array) -> SlopeSeen:
    """A window whose ground varies along its track as its slope is."""
    _, axes = np.linalg.eigh(covariance)
    return SlopeSeen(end_ns, place_m, slope, covariance, float(axes[:, 0] @ slope) ** 2)


def after(seen: list[SlopeSeen]) -> GroundSlope:
    ground = GroundSlope(SIGMA)
    for s in seen:
        assert ground.offer(s.end_ns - 10 * SECOND_NS, s)
    return ground


EAST, NORTH = np.array([1.0, 0.0]), np.array([0.0, 1.0])
LATER_NS = 10_000 * SECOND_NS


def test_before_anything_was_seen_ten_degrees_are_inside_the_99_percent_ellipse() -> None:
    prior = GroundSlope(SIGMA).prior_for(0, np.zeros(2))
    assert np.all(prior.mean == 0.0)
    assert prior.covariance == pytest.approx(SIGMA**2 * np.eye(2))
    assert TEN_DEG / SIGMA < INSIDE_99
    assert TEN_DEG / SIGMA > 0.8 * INSIDE_99, "wider than ten degrees ask for"


def test_a_leg_tells_of_the_slope_along_it_and_not_of_that_across() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        prior = after(leg(EAST, np.array([0.0, TEN_DEG]), 0, np.zeros(2), rng)).prior_for(LATER_NS, 900.0 * EAST)
        sigmas = np.sqrt(np.diag(prior.covariance))
        assert sigmas[0] < 0.6 * SIGMA
        assert abs(TEN_DEG - prior.mean[1]) < INSIDE_99 * sigmas[1], "ten degrees across, which nobody saw"


@pytest.mark.parametrize("slope", [np.zeros(2), np.array([0.1, 0.14]), np.array([-0.17, 0.0])])
def test_legs_in_two_directions_find_the_slope(slope: Array) -> None:
    """To four fifths of a declared slope, however steep it is, and within what is claimed."""
    squares = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        first = leg(EAST, slope, 0, np.zeros(2), rng)
        second = leg(NORTH, slope, 60, 800.0 * EAST, rng)
        prior = after([*first, *second]).prior_for(LATER_NS, 800.0 * (EAST + NORTH))
        assert np.sqrt(np.linalg.eigvalsh(prior.covariance)).max() < 0.8 * SIGMA
        off = slope - prior.mean
        squares.append(float(off @ np.linalg.solve(prior.covariance, off)))
    assert max(squares) < INSIDE_99**2
    assert np.mean(squares) > 0.02, "far wider than the slope turns out to be off"


def test_far_away_nothing_is_known_again() -> None:
    rng = np.random.default_rng(1)
    ground = after([*leg(EAST, np.zeros(2), 0, np.zeros(2), rng), *leg(NORTH, np.zeros(2), 60, 800.0 * EAST, rng)])
    near, far = (ground.prior_for(LATER_NS, at * EAST).covariance for at in (800.0, 40_000.0))
    assert np.sqrt(np.diag(far)) == pytest.approx([SIGMA, SIGMA], rel=0.1)
    assert np.diag(near).max() < 0.4 * np.diag(far).min()


def test_the_sides_of_a_valley_widen_the_prior() -> None:
    """Slopes that differ from window to window by more than declared are no level ground anywhere near."""
    rng = np.random.default_rng(2)
    steep = 2.0 * TEN_DEG
    sides = [leg(EAST, np.array([s * steep, 0.0]), 60 * k, 1000.0 * k * EAST, rng) for k, s in enumerate((1, -1, 1))]
    prior = after([s for side in sides for s in side]).prior_for(LATER_NS, 6000.0 * EAST)
    assert SIGMA < np.sqrt(prior.covariance[1, 1]) < 10.0 * SIGMA


def test_how_the_newest_windows_ground_varies_widens_the_prior_and_does_not_move_it() -> None:
    """By the square of a slope three times as steep as declared; ground that varies as declared leaves it as it is."""
    along = np.diag([KNOWN**2, UNKNOWN**2])
    for times, least, most in ((0.0, 1.0, 1.0), (1.0, 0.99, 1.05), (3.0, 2.0, 2.4)):
        ground = GroundSlope(SIGMA)
        ground.newest = SlopeSeen(10 * SECOND_NS, np.zeros(2), np.zeros(2), along, (times * SIGMA) ** 2)
        prior = ground.prior_for(SECOND_NS, np.zeros(2))
        assert np.all(prior.mean == 0.0)
        assert least * SIGMA <= np.sqrt(prior.covariance[1, 1]) <= most * SIGMA
        assert prior.covariance[0, 0] == pytest.approx(prior.covariance[1, 1])
        assert ground.offer(0, ground.newest)
        kept = np.sqrt(ground.prior_for(LATER_NS, 40_000.0 * EAST).covariance[1, 1])
        assert kept == pytest.approx(np.sqrt(prior.covariance[1, 1]), rel=0.05), "counted twice, or forgotten"
        ground.forget()
        assert ground.prior_for(LATER_NS, np.zeros(2)).covariance == pytest.approx(SIGMA**2 * np.eye(2))


def test_ground_that_varies_only_as_much_as_is_unknown_of_its_slope_widens_nothing() -> None:
    """Relief by which the plane's own slope is uncertain, (5.13), is in the window's covariance already."""
    for known, widest in ((0.0, 3.0), (2.0 * SIGMA, 1.5), (100.0 * SIGMA, 1.001)):
        ground = GroundSlope(SIGMA)
        covariance = np.diag([known**2, UNKNOWN**2 + known**2])
        ground.newest = SlopeSeen(0, np.zeros(2), np.zeros(2), covariance, (3.0 * SIGMA) ** 2)
        found = np.sqrt(ground.prior_for(0, np.zeros(2)).covariance[0, 0]) / SIGMA
        assert found <= widest


def test_many_windows_give_the_variance_that_slopes_have() -> None:
    """Of slopes one, two and four times as steep as declared, two squares from each of 24 windows."""
    for times in (1.0, 2.0, 4.0):
        rng = np.random.default_rng(5)
        found = []
        for _ in range(40):
            ground = GroundSlope(SIGMA)
            for k in range(24):
                varies = (times * SIGMA) ** 2 * float(np.mean(rng.standard_normal(2) ** 2))
                noise = np.diag([(0.3 * SIGMA) ** 2, UNKNOWN**2])
                ground.offer(20 * k + 1, SlopeSeen(20 * k + 10, 1e6 * k * EAST, np.zeros(2), noise, varies))
            found.append(float(ground.prior_for(LATER_NS, -1e7 * EAST).covariance[0, 0]))
        assert 0.9 * times < np.sqrt(np.mean(found)) / SIGMA < 1.1 * max(times, 1.1)


def test_a_window_is_told_nothing_by_pictures_of_its_own() -> None:
    rng = np.random.default_rng(3)
    seen = leg(EAST, np.array([0.1, 0.0]), 0, np.zeros(2), rng)
    ground = after(seen)
    begins_ns = seen[0].end_ns - 5 * SECOND_NS
    assert np.all(ground.prior_for(begins_ns, np.zeros(2)).mean == 0.0)
    assert not ground.offer(seen[-1].end_ns - SECOND_NS, seen[-1]), "it shares pictures with the one before"
    assert ground.prior_for(LATER_NS, np.zeros(2)).mean[0] > 0.05
    ground.forget()
    assert np.all(ground.prior_for(LATER_NS, np.zeros(2)).mean == 0.0)


def test_what_a_window_alone_says_is_free_of_prior_and_mount() -> None:
    """(14.1): along the track as measured, whatever the prior; across, where roll is the mount's, next to nothing."""
    n = STATES + 3
    rows = np.zeros((2, n))
    rows[0, STATES + 1] = 1.0 / KNOWN  # the slope east, by the pictures
    rows[1, [BORESIGHT.start, STATES + 2]] = 1.0 / KNOWN  # slope north plus the mount's roll, by the attitude
    reported = np.array([0.08, -0.05])
    for sigma, believed in ((0.03, 0.0), (0.2, 0.1)):
        whitener = np.diag(1.0 / np.array([0.02] * STATES + [1e4, sigma, sigma]))
        mean = np.zeros(n)
        mean[STATES + 1 :] = believed
        prior = SharedPrior(Layout(10), mean, whitener)
        covariance = np.linalg.inv(whitener @ whitener + rows.T @ rows)
        posterior = covariance @ (whitener @ whitener @ mean + rows.T @ (reported / KNOWN))
        slope, alone = seen_alone(prior, posterior, covariance)
        assert slope[0] == pytest.approx(reported[0], rel=1e-3)
        assert np.sqrt(alone[0, 0]) == pytest.approx(KNOWN, rel=0.01)
        assert np.sqrt(alone[1, 1]) > 10.0 * SIGMA * 0.5
