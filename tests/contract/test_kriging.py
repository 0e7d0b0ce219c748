"""Kriging against Delaunay, and its stated variance against what happens."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import ConvexHull

from contract import kriging as of_kriging
from contract.kriging import Kriging, convex_hull, distances_outside, hull_area, on_plane, stretch
from contract.rotations import exp_so3

Array = NDArray[np.float64]

BELOW = np.array([1.0, 0.0, 0.0])  # a plane straight below, whose inverse depths are counted in its own
ASLANT = np.array([0.5, 0.3, 0.7])


def rolling_ground(xy: Array, phase: float) -> Array:
    """Relative inverse depth of hills 60 m across seen from 250 m: smooth, and no sample of kriging's own model."""
    return 0.02 * np.sin(24.0 * xy[:, 0] + phase) * np.cos(20.0 * xy[:, 1] - 2.0 * phase)


def trial(rng: np.random.Generator, noise: float) -> tuple[Array, Array, Array, Array]:
    """Truth, Delaunay's and kriging's answer and kriging's sigma at 40 points inside the features."""
    xy = rng.uniform(-0.36, 0.36, (100, 2)) * [1.0, 0.75]
    phase = rng.uniform(0.0, 6.28)
    sigma = noise * np.exp(rng.normal(0.0, 0.3, 100))
    r = rolling_ground(xy, phase) + sigma * rng.normal(size=100)
    at = rng.uniform(-0.28, 0.28, (40, 2)) * [1.0, 0.75]
    kriging = Kriging(xy, r, sigma**2, BELOW, slope=0.0014, sill_sigma=0.011)
    predicted, covariance = kriging.predict(at)
    return rolling_ground(at, phase), LinearNDInterpolator(xy, r)(at), predicted, np.sqrt(np.diag(covariance))


@pytest.mark.parametrize(("noise", "at_most"), [(0.002, 1.0), (0.01, 0.9), (0.03, 0.8)])
def test_kriging_beats_delaunay_on_rolling_ground(noise: float, at_most: float) -> None:
    rng = np.random.default_rng(1)
    delaunay, kriging = [], []
    for _ in range(60):
        truth, barycentric, predicted, _ = trial(rng, noise)
        inside = np.isfinite(barycentric)
        delaunay.append(np.mean((barycentric - truth)[inside] ** 2))
        kriging.append(np.mean((predicted - truth)[inside] ** 2))
    ratio = float(np.sqrt(np.mean(kriging) / np.mean(delaunay)))
    assert 0.2 < ratio <= at_most


@pytest.mark.parametrize("noise", [0.002, 0.01, 0.03])
def test_the_stated_sigma_covers_rolling_ground(noise: float) -> None:
    rng = np.random.default_rng(2)
    z = np.concatenate([(p - t) / s for t, _, p, s in (trial(rng, noise) for _ in range(60))])
    assert 0.85 < np.mean(np.abs(z) < 1.645) < 0.97


def test_without_relief_it_is_the_weighted_fit_of_a_plane() -> None:
    rng = np.random.default_rng(3)
    xy = rng.uniform(-0.4, 0.4, (50, 2))
    sigma = rng.uniform(0.002, 0.01, 50)
    F = np.concatenate([np.ones((50, 1)), xy], axis=1)
    r = F @ [0.01, -0.02, 0.03] + sigma * rng.normal(size=50)
    normal = F.T @ (F / sigma[:, None] ** 2)
    beta = np.linalg.solve(normal, F.T @ (r / sigma**2))
    predicted, covariance = Kriging(xy, r, sigma**2, BELOW, 0.0, 0.0).predict(xy[:5])
    np.testing.assert_allclose(predicted, F[:5] @ beta, rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(covariance, F[:5] @ np.linalg.inv(normal) @ F[:5].T, rtol=1e-3, atol=1e-10)


def as_written(xy: Array, r: Array, nugget: Array, slope: float, sill: float, at: Array) -> tuple[Array, Array]:
    """Universal kriging as it is written down, (9.8), by the inverse of the covariance; the trend from six on.

    Over the plane `ASLANT`, `slope` per camera height.
    """

    def covariance(a: Array, b: Array) -> Array:
        return sill * np.exp(-slope / sill * np.linalg.norm(a[:, None] - b[None], axis=-1))

    height = 1.0 / np.linalg.norm(ASLANT)
    H, h = (np.concatenate([np.ones((len(p), 1)), p], axis=1) for p in (xy, at))
    F, f = H / (H @ ASLANT * height)[:, None], h / (h @ ASLANT * height)[:, None]
    inverse = np.linalg.inv(covariance(F, F) + np.diag(nugget + 1e-16))
    k = covariance(f, F)
    trend = np.linalg.inv(F.T @ inverse @ F + np.eye(3)) if len(xy) >= 6 else np.zeros((3, 3))
    beta = trend @ F.T @ inverse @ r
    left = f - k @ inverse @ F
    predicted: Array = f @ beta + k @ inverse @ (r - F @ beta)
    return predicted, covariance(f, f) - k @ inverse @ k.T + left @ trend @ left.T


@pytest.mark.parametrize("features", [3, 31, 33, 100, 255])
def test_it_is_what_the_inverse_of_the_covariance_says(features: int) -> None:
    """To 1e-9, between the features, and beyond them times what the outermost show. (9.8), (9.19)"""
    rng = np.random.default_rng(features)
    xy, at = rng.uniform(-0.4, 0.4, (features, 2)), rng.uniform(-0.5, 0.5, (9, 2))
    r, nugget = rng.normal(0.0, 0.04, features), rng.uniform(1e-5, 1e-4, features)
    slope, sill = 0.004, 0.02**2
    kriging = Kriging(xy, r, nugget, ASLANT, slope, np.sqrt(sill))
    predicted, stated = kriging.predict(at)
    value, expected = as_written(xy, r, nugget, slope, sill, at)
    squares = []
    for angle in 0.25 * np.pi * np.arange(8):
        along = xy @ [np.cos(angle), np.sin(angle)]
        out = along >= np.quantile(along, 0.8)
        there, variance = as_written(xy[~out], r[~out], nugget[~out], slope, sill, xy[out])
        squares.append(np.mean((r[out] - there) ** 2 / (np.diag(variance) + nugget[out])))
    grown = max(1.0, (2.0 + sum(squares)) / 10.0) if features >= 10 else 1.0
    assert grown > 1.1 or features == 3
    root = np.where(ConvexHull(xy).equations @ np.append(at, np.ones((9, 1)), axis=1).T > 0.0, np.sqrt(grown), 1.0).max(
        0
    )
    np.testing.assert_allclose(predicted, value, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(stated, expected * np.outer(root, root), rtol=1e-9, atol=1e-9 * np.max(expected))
    np.testing.assert_allclose(kriging.predict_each(at)[1], np.diag(stated), rtol=1e-9)


def test_the_answer_is_the_ground_s_whichever_way_the_camera_is_turned() -> None:
    """Straight down and 50 degrees aside: the same features, the same prediction, the same variance. (9.20)"""
    rng = np.random.default_rng(8)
    xy, at = rng.uniform(-0.3, 0.3, (60, 2)), rng.uniform(-0.25, 0.25, (7, 2))
    r, nugget, slope = rng.normal(0.0, 0.03, 60), rng.uniform(1e-6, 1e-4, 60), 0.004

    def seen(turn_rad: Array) -> tuple[Array, Array]:
        R = exp_so3(turn_rad)
        features, clicks = (np.append(p, np.ones((len(p), 1)), axis=1) @ R.T for p in (xy, at))
        features, clicks = features[:, :2] / features[:, 2:], clicks[:, :2] / clicks[:, 2:]
        plane = R[:, 2][[2, 0, 1]]
        kriging = Kriging(features, r, nugget, plane, slope, 0.02)
        return kriging.predict_each(clicks)

    for straight, aside in zip(seen(np.zeros(3)), seen(np.radians([40.0, -30.0, 100.0])), strict=True):
        np.testing.assert_allclose(aside, straight, rtol=1e-9, atol=1e-13)


def test_a_small_square_of_rays_is_as_large_on_the_plane_as_the_stretch_states() -> None:
    """(9.20) by finite differences."""
    step = 1e-4
    corner, right, up = on_plane(np.array([[0.1, -0.2], [0.1 + step, -0.2], [0.1, -0.2 + step]]), ASLANT)
    area = np.linalg.norm(np.cross(right - corner, up - corner))
    assert np.sqrt(area) / step == pytest.approx(stretch(np.array([[0.1, -0.2]]), ASLANT), rel=1e-3)


def test_beyond_features_that_agree_with_their_variances_nothing_is_added() -> None:
    """Of the model itself: 40 fields, where the factor's excess over 1 is by chance."""
    rng = np.random.default_rng(11)
    slope, sill, excess = 0.004, 0.02**2, []
    for _ in range(40):
        xy = rng.uniform(-0.4, 0.4, (80, 2))
        places = on_plane(xy, ASLANT)
        apart = np.linalg.norm(places[:, None] - places, axis=-1)
        root = np.linalg.cholesky(sill * np.exp(-slope / sill * apart) + 1e-4 * np.eye(80))
        r = root @ rng.normal(size=80)
        plain = as_written(xy, r, np.full(80, 1e-4), slope, sill, np.array([[0.55, 0.0]]))[1][0, 0]
        kriging = Kriging(xy, r, np.full(80, 1e-4), ASLANT, slope, np.sqrt(sill))
        beyond = kriging.predict_each(np.array([[0.55, 0.0]]))[1][0]
        excess.append(beyond / plain - 1.0)
    assert 0.0 <= np.median(excess) < 0.15
    assert np.max(excess) < 2.0


def test_beyond_the_features_hills_are_extrapolated_as_badly_as_stated() -> None:
    """Long smooth hills, which features within a quarter of one hardly show to leave their plane."""
    rng = np.random.default_rng(12)
    z: list[Array] = []
    for _ in range(80):
        xy = rng.uniform(-0.3, 0.3, (80, 2))
        phase, sigma = rng.uniform(0.0, 6.28), 0.002
        truth = [0.1 * np.sin(5.0 * p[:, 0] + phase) * np.cos(4.0 * p[:, 1] - 2.0 * phase) for p in (xy, 1.35 * xy)]
        r = truth[0] + sigma * rng.normal(size=80)
        flat = np.concatenate([np.ones((80, 1)), xy], axis=1)
        spread = float(np.std(r - flat @ np.linalg.lstsq(flat, r, rcond=None)[0]))
        kriging = Kriging(xy, r, np.full(80, sigma**2), BELOW, spread**2 / 0.3, spread)
        predicted, variance = kriging.predict_each(1.35 * xy)
        beyond = np.array([distances_outside(kriging.hull, p[None])[0] > 0.0 for p in 1.35 * xy])
        z.append(((predicted - truth[1]) / np.sqrt(variance))[beyond])
    assert 0.8 < np.mean(np.abs(np.concatenate(z)) < 1.645) < 0.99


@pytest.mark.parametrize("nugget", [0.0, 1e-18, 1e-12])
def test_features_in_one_place_with_next_to_no_noise_are_survived(nugget: float) -> None:
    xy = np.repeat([[0.1, 0.0], [0.0, 0.1], [0.2, 0.2]], 40, axis=0)
    predicted, covariance = Kriging(xy, np.full(120, 0.01), np.full(120, nugget), BELOW, 0.5, 30.0).predict(xy[::40])
    np.testing.assert_allclose(predicted, 0.01, rtol=1e-3)
    assert np.all(np.isfinite(covariance)) and np.all(np.diag(covariance) > -1e-9)


@pytest.mark.parametrize("power", [0, 3, 6])
def test_features_get_as_much_more_noise_as_a_factor_takes_and_no_more(power: int) -> None:
    """The noise added to six in one place leaves a difference of at most ten times what the factor lacked."""
    one_place = np.full((6, 6), 900.0)
    rounding = np.finfo(float).eps * np.trace(one_place)
    lacking = 0.5 * rounding * 10.0**power
    whiten = of_kriging._whitening(one_place - lacking * np.eye(6))
    left = 2.0 / float(np.sum((whiten[:, 0] - whiten[:, 1]) ** 2))
    assert 0.0 < left < 10.0 * lacking
    with pytest.raises(np.linalg.LinAlgError, match="far from positive definite"):
        of_kriging._whitening(one_place - 1e9 * rounding * np.eye(6))


def test_a_feature_without_noise_is_met_exactly_and_known() -> None:
    rng = np.random.default_rng(4)
    xy = rng.uniform(-0.4, 0.4, (30, 2))
    r = rng.normal(0.0, 0.02, 30)
    predicted, covariance = Kriging(xy, r, np.zeros(30), ASLANT, 0.004, 0.02).predict(xy)
    np.testing.assert_allclose(predicted, r, atol=1e-9)
    assert np.abs(covariance).max() < 1e-9


def test_variance_grows_with_the_distance_to_the_features() -> None:
    rng = np.random.default_rng(5)
    xy = rng.uniform(-0.2, 0.2, (40, 2))
    kriging = Kriging(xy, np.zeros(40), np.full(40, 1e-5), BELOW, 0.004, 0.02)
    _, covariance = kriging.predict(np.array([[0.0, 0.0], [0.25, 0.0], [0.4, 0.0], [0.8, 0.0]]))
    variances = np.diag(covariance)
    assert np.all(np.diff(variances) > 0.0)


def test_features_on_a_line_leave_the_other_direction_to_the_prior() -> None:
    xy = np.stack([np.linspace(-0.3, 0.3, 20), np.zeros(20)], axis=1)
    _, covariance = Kriging(xy, np.zeros(20), np.full(20, 1e-5), BELOW, 0.0, 0.0).predict(
        np.array([[0.0, 0.0], [0.0, 0.3]])
    )
    assert covariance[0, 0] < 1e-5
    assert covariance[1, 1] == pytest.approx(0.3**2, rel=0.01)


@given(arrays(float, st.tuples(st.integers(3, 40), st.just(2)), elements=st.floats(-1, 1).map(lambda x: round(x, 3))))
def test_the_hull_is_scipys(points: Array) -> None:
    hull = convex_hull(points)
    if hull_area(hull) < 1e-4:
        return
    assert hull_area(hull) == pytest.approx(ConvexHull(points).volume, rel=1e-9)
    assert all(distances_outside(hull, p[None])[0] < 1e-9 for p in points)


def test_distance_to_a_square() -> None:
    square = convex_hull(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5]]))
    assert len(square) == 4
    assert distances_outside(square, np.array([[0.5, 0.9]]))[0] == 0.0
    assert distances_outside(square, np.array([[1.5, 0.5]]))[0] == pytest.approx(0.5)
    assert distances_outside(square, np.array([[2.0, 2.0]]))[0] == pytest.approx(np.sqrt(2.0))
    assert distances_outside(convex_hull(np.zeros((2, 2))), np.zeros((1, 2)))[0] == np.inf
