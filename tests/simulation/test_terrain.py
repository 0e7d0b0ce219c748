"""The ground: heights and the first point where a ray meets it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.errors import InputError
from simulation.terrain import EARTH_RADIUS_M, Terrain, TerrainSpec

HILLS = Terrain(TerrainSpec(relief_m=30.0, wavelength_m=200.0, seed=3))
BOXES = Terrain(TerrainSpec(obstacles="boxes", obstacle_height_m=12.0, seed=5))


def _downward_rays(rng: np.random.Generator, count: int, steepest: float) -> np.ndarray:
    across = rng.uniform(-steepest, steepest, (count, 2))
    return np.column_stack([across, -np.ones(count)])


def test_level_ground_follows_the_curve_of_the_earth() -> None:
    flat = Terrain(TerrainSpec())
    assert float(flat.height_m(0.0, 0.0)) == 0.0
    assert float(flat.height_m(3000.0, 4000.0)) == pytest.approx(-(5000.0**2) / (2 * EARTH_RADIUS_M))


@pytest.mark.parametrize("relief_m", [5.0, 40.0])
def test_relief_is_the_difference_between_hill_and_valley(relief_m: float) -> None:
    terrain = Terrain(TerrainSpec(relief_m=relief_m, seed=8))
    x, y = np.meshgrid(np.linspace(-1500, 1500, 151), np.linspace(-1500, 1500, 151))
    z = terrain.height_m(x, y)
    assert 0.85 * relief_m < z.max() - z.min() < 1.1 * relief_m
    assert terrain.lowest_m <= z.min() and z.max() <= terrain.highest_m


@given(seed=st.integers(0, 2**32 - 1), height=st.floats(60.0, 400.0), steepest=st.floats(0.1, 3.0))
@settings(max_examples=25, deadline=None)
def test_a_ray_ends_on_the_hills_and_passes_above_them_before(seed: int, height: float, steepest: float) -> None:
    rng = np.random.default_rng(seed)
    centre = np.array([rng.uniform(-500, 500), rng.uniform(-500, 500), height])
    rays = _downward_rays(rng, 40, steepest)
    depth, hit = HILLS.cast(centre, rays)
    assert hit.all()
    point = centre + rays * depth[:, None]
    assert np.abs(point[:, 2] - HILLS.height_m(point[:, 0], point[:, 1])).max() < 1e-5
    for part in (0.3, 0.7, 0.95, 0.999):
        before = centre + rays * (part * depth)[:, None]
        assert np.all(before[:, 2] > HILLS.height_m(before[:, 0], before[:, 1]))


def test_a_ray_at_a_roof_does_not_reach_the_ground_behind_it() -> None:
    rng = np.random.default_rng(1)
    centre = np.array([3.0, 7.0, 120.0])
    rays = _downward_rays(rng, 4000, 1.2)
    depth, hit = BOXES.cast(centre, rays)
    point = centre + rays * depth[:, None]
    assert hit.all()
    assert np.abs(point[:, 2] - BOXES.height_m(point[:, 0], point[:, 1])).max() < 1e-4
    on_roof = BOXES.obstacle_m(point[:, 0], point[:, 1]) > 1.0
    assert 0.04 < on_roof.mean() < 0.5


def test_rays_at_the_sky_meet_nothing() -> None:
    depth, hit = HILLS.cast([0.0, 0.0, 250.0], [[1.0, 0.0, 0.0], [0.3, 0.2, 0.5], [0.0, 0.0, -1.0]])
    assert hit.tolist() == [False, False, True]
    assert 200.0 < depth[2] < 300.0


def test_a_camera_below_the_ground_sees_none() -> None:
    _, hit = HILLS.cast([0.0, 0.0, -200.0], [[0.0, 0.0, -1.0]])
    assert not hit.any()


def test_slope_is_the_gradient_of_height() -> None:
    x, y, h = np.array([12.0, -300.0]), np.array([77.0, 40.0]), 1e-3
    flat = Terrain(TerrainSpec())
    numeric = [
        (HILLS.height_m(x + dx, y + dy) - HILLS.height_m(x - dx, y - dy)) / (2 * h) for dx, dy in ((h, 0.0), (0.0, h))
    ]
    curve = [
        (flat.height_m(x + dx, y + dy) - flat.height_m(x - dx, y - dy)) / (2 * h) for dx, dy in ((h, 0.0), (0.0, h))
    ]
    np.testing.assert_allclose(HILLS.slope(x, y).T, np.subtract(numeric, curve), atol=1e-6)


def test_an_unknown_obstacle_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"'rocks'.*boxes"):
        TerrainSpec(obstacles="rocks")
