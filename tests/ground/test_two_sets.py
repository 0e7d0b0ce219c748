"""Between clicks of two sets: what both suffer from cancels, as far as it is the same, and nothing else."""

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.answer import CHI2_2, Fix
from contract.feature_set import ALIGNMENT, ATTITUDE, GROUND, NUISANCES, POSITION, FeatureSet, SharedErrors
from contract.locate import Locator
from ground.two_sets import common_cross_covariance, difference_covariance, nuisance_correlations
from tests.ground.worlds import Errors, World, build
from tests.rest_long import rest_long

Array = NDArray[np.float64]

POSITION_S, ATTITUDE_S = 100.0, 20.0


def shared(alignment_scale: float = 1.0, span_s: float = 0.0) -> SharedErrors:
    """Position and attitude wander, a mount, a clock and a slope, as a window of a straight flight has them."""
    F = np.zeros((9, NUISANCES))
    F[:3, POSITION] = np.diag([3.0, 3.0, 4.0])
    F[3:6, ATTITUDE] = np.diag([0.008, 0.008, 0.03])
    F[3:6, ALIGNMENT] = 0.017 * alignment_scale * np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]])
    F[1, ALIGNMENT.stop - 1] = 2.0 * alignment_scale
    F[3, GROUND.start + 1] = 0.01
    sigma = alignment_scale * np.array([0.017, 0.017, 0.017, 0.1])
    return SharedErrors(F, POSITION_S, ATTITUDE_S, sigma, (-span_s / 2.0, span_s / 2.0))


def answered(world: World, index: int = 0) -> Fix:
    answer = Locator(world.feature_set).locate(world.clicks_px[index])
    assert isinstance(answer, Fix), answer
    return answer


def later(rng: np.random.Generator, draws: Array, gap_s: float) -> Array:
    """The same draws some time on: what wanders has wandered."""
    out = draws.copy()
    for part, tau in ((POSITION, POSITION_S), (ATTITUDE, ATTITUDE_S)):
        keep = math.exp(-gap_s / tau)
        out[part] = keep * draws[part] + math.sqrt(1.0 - keep * keep) * rng.normal(size=3)
    return out


@pytest.mark.parametrize(
    ("gap_s", "least", "most"), rest_long([(20.0, 0.3, 0.8), (1.0, 0.05, 0.45), (400.0, 0.5, 0.95)])
)
def test_the_ellipse_of_a_difference_between_two_sets_holds_ninety_percent(
    gap_s: float, least: float, most: float
) -> None:
    """Position, rotation and slope are sampled once and wander on; the rest is sampled for each set.

    `least` and `most`: the stated variance, relative to that of two sets that share nothing.
    """
    rng = np.random.default_rng(8)
    errors = Errors(shared=shared())
    inside, relative = [], []
    for _ in range(400):
        draws = rng.normal(size=NUISANCES)
        a = build(rng, errors, features=50, draws=draws)
        b = build(
            rng,
            errors,
            features=50,
            draws=later(rng, draws, gap_s),
            position_enu_m=(60.0, 0.0, 250.0),
            capture_unix_ns=a.feature_set.capture_unix_ns + round(gap_s * 1e9),
        )
        one, two = answered(a), answered(b)
        d = (b.error(0, two) - a.error(0, one))[:2]
        covariance = difference_covariance(a.feature_set, one, b.feature_set, two)
        inside.append(d @ np.linalg.solve(covariance[:2, :2], d) < CHI2_2)
        relative.append(np.trace(covariance) / np.trace(one.covariance_enu_m2 + two.covariance_enu_m2))
    assert 0.86 < np.mean(inside) < 0.94
    assert least < np.mean(relative) < most


def test_windows_of_the_same_pictures_share_what_is_fresh_too() -> None:
    """Two pictures of one window half a second apart: the window's own errors are sampled once for both."""
    rng = np.random.default_rng(9)
    errors = Errors(shared=shared(span_s=9.0), feature_relative=1e-3, relief_relative=1e-3, roughness=1e-5)
    inside, apart = [], []
    for _ in range(300):
        draws, fresh, seed = rng.normal(size=NUISANCES), rng.normal(size=9), int(rng.integers(2**32))
        worlds = [
            # The same seed draws the same covariance, and so the same fresh errors.
            build(
                np.random.default_rng(seed),
                errors,
                features=50,
                draws=draws,
                fresh=fresh,
                yaw_rad=0.3,
                position_enu_m=(10.0 * k, 0.0, 250.0),
                capture_unix_ns=1_700_000_000_000_000_000 + 500_000_000 * k,
            )
            for k in range(2)
        ]
        one, two = answered(worlds[0], 0), answered(worlds[1], 1)
        d = (worlds[1].error(1, two) - worlds[0].error(0, one))[:2]
        covariance = difference_covariance(worlds[0].feature_set, one, worlds[1].feature_set, two)
        inside.append(d @ np.linalg.solve(covariance[:2, :2], d) < CHI2_2)
        apart.append(np.trace(covariance) / np.trace(one.covariance_enu_m2 + two.covariance_enu_m2))
    assert 0.85 < np.mean(inside) < 0.99
    assert 0.02 < np.mean(apart) < 0.4


def sets(gap_s: float, *errors: SharedErrors) -> list[FeatureSet]:
    world = build(np.random.default_rng(3)).feature_set
    return [
        dataclasses.replace(world, shared=e, capture_unix_ns=world.capture_unix_ns + round(k * gap_s * 1e9))
        for k, e in enumerate(errors)
    ]


def test_what_wanders_is_shared_by_its_age_and_a_mount_by_what_was_learned_since() -> None:
    one, two = sets(10.0, shared(), shared(alignment_scale=0.25))
    got = nuisance_correlations(one, two)
    assert got[POSITION] == pytest.approx(math.exp(-10.0 / POSITION_S), rel=1e-3)
    assert got[ATTITUDE] == pytest.approx(math.exp(-10.0 / ATTITUDE_S), rel=1e-3)
    assert got[ALIGNMENT] == pytest.approx(0.25)
    assert got[GROUND] == pytest.approx(1.0)


def test_averages_over_long_windows_change_less_than_what_they_average() -> None:
    short = nuisance_correlations(*sets(1.0, shared(span_s=0.1), shared(span_s=0.1)))
    long = nuisance_correlations(*sets(1.0, shared(span_s=9.0), shared(span_s=9.0)))
    assert np.all(long[ATTITUDE] > short[ATTITUDE]) and np.all(long[ATTITUDE] < 1.0)


def test_the_joint_covariance_of_two_sets_is_one() -> None:
    rng = np.random.default_rng(12)
    for gap_s in (0.0, 0.5, 4.0, 30.0):
        errors = Errors(shared=shared(span_s=9.0))
        a = build(rng, errors).feature_set
        b = build(rng, errors, position_enu_m=(15.0, -30.0, 255.0)).feature_set
        b = dataclasses.replace(b, capture_unix_ns=a.capture_unix_ns + round(gap_s * 1e9))
        X = common_cross_covariance(a, b)
        joint = np.block([[a.common_cov, X], [X.T, b.common_cov]])
        sigma = np.sqrt(np.diag(joint))
        assert np.linalg.eigvalsh(joint / np.outer(sigma, sigma))[0] > -1e-9
        if gap_s > 0.0:
            np.testing.assert_array_equal(common_cross_covariance(b, a), X.T)


def test_sets_of_other_sessions_share_nothing() -> None:
    world = build(np.random.default_rng(9), Errors(shared=shared()))
    other = dataclasses.replace(world.feature_set, session=8)
    fix = answered(world)
    total = difference_covariance(world.feature_set, fix, other, fix)
    np.testing.assert_allclose(total, 2.0 * fix.covariance_enu_m2)


def test_a_fix_of_another_revision_leaves_no_negative_variance() -> None:
    world = build(np.random.default_rng(10), Errors(shared=shared(span_s=9.0)))
    fix = answered(world)
    small = dataclasses.replace(fix, covariance_enu_m2=0.01 * fix.covariance_enu_m2)
    total = difference_covariance(world.feature_set, small, world.feature_set, small)
    assert np.linalg.eigvalsh(total)[0] >= -1e-9
