"""Next to the edge of what stands on smooth ground: (29.12), (29.13)."""

import math

import numpy as np
import pytest

from contract.feature_set import Measured
from onboard.measured.edge import Ground, behind
from onboard.measured.patches import Patch
from onboard.measured.views import Features, View, relative_pose, view_of
from tests.onboard.measured.step_world import CAMERA, CLICKED, World
from tests.onboard.measured.test_measuring import off_in_sigmas

ALL = np.ones(225, bool)
GROUND = Ground(0.0100, 0.0001, np.zeros(2), 0.0001, 1.0 / 0.003)


def views(world: World) -> tuple[Patch, list[View]]:
    """A click in the middle and the pictures about it."""
    clicked, out = world.kept(CLICKED), []
    for number in (1, 2, 6, 7):
        other = world.kept(number)
        start = relative_pose(clicked.its_set, other.its_set)
        view = view_of(clicked.image, Features.of(clicked.its_set), other.image, other.its_set, start)
        assert view is not None
        out.append(view)
    patch = Patch.at(clicked.image, CAMERA, np.array([150.0, 110.0]))
    assert patch is not None
    return patch, out


def test_the_odds_of_an_edge_are_those_of_places_counted() -> None:
    """Half of all places on the ground, half anywhere between 0.0095 and 0.0125, every other of these at an edge."""
    rng = np.random.default_rng(1)
    on_ground = rng.normal(GROUND.per_m, GROUND.sigma_per_m, 2_000_000)
    standing = rng.uniform(0.0095, 0.0125, 2_000_000)
    at_edge = rng.uniform(size=2_000_000) < 0.5
    for w in (0.0100, 0.0102, 0.01024, 0.0104):
        near = [np.abs(places - w) < 1e-5 for places in (on_ground, standing)]
        edges = np.count_nonzero(near[1] & at_edge)
        odds = edges / (np.count_nonzero(near[0]) + np.count_nonzero(near[1]) - edges)
        assert GROUND.edge_odds(w) == pytest.approx(odds, rel=0.06)


def test_what_no_pixel_contradicts_is_as_likely_as_an_edge_is_and_what_all_do_is_not() -> None:
    """A surface far above the ground: in plain pictures the variance is half of its height's square."""
    patch, seen = views(World(seed=7))
    w = 0.0112
    textured = behind(patch, seen, (w, np.zeros(2)), ALL, GROUND)
    plain = Patch(patch.rays, np.full_like(patch.values, 90.0), patch.by_camera)
    for view in seen:
        object.__setattr__(view, "image", np.full_like(view.image, 90))
    found = behind(plain, seen, (w, np.zeros(2)), ALL, GROUND)
    assert GROUND.edge_odds(w) == pytest.approx(1.0)
    assert math.sqrt(found) == pytest.approx(
        math.sqrt(0.5 * ((w - GROUND.per_m) ** 2 + GROUND.sigma_per_m**2)), rel=0.02
    )
    # The picture shows the ground: texture that is at the ground's depth contradicts nothing but the surface.
    assert math.sqrt(textured) == pytest.approx(math.sqrt(found), rel=0.2)
    above = behind(patch, views(World(seed=7))[1], (GROUND.per_m, np.zeros(2)), ALL, GROUND)
    assert math.sqrt(above) < 0.1 * GROUND.sigma_per_m
    assert behind(patch, seen, (0.009, np.zeros(2)), ALL, GROUND) == 0.0  # nothing is farther


@pytest.mark.parametrize("seed", [3, 4])
def test_next_to_a_roof_s_edge_plain_ground_is_not_the_roof_for_sure(seed: int) -> None:
    """Up to five pixels off the edge the roof's depth is found, off by all its height. Without (29.13) that is 9 to 110
    of its sigmas.
    """
    world = World(roof_m=8.0, seed=seed, plain_m=6.0)
    row = np.stack([np.arange(120.0, 300.0), np.full(180, 85.0)], axis=1)
    edge_px = float(row[np.flatnonzero(world.depths(CLICKED, row)[2])[0], 0])

    def off_edge(*px: float) -> np.ndarray:
        return np.array([[edge_px + d, 85.0 + dv] for d in px for dv in (-5.0, 0.0, 5.0)])

    errors, z, _ = off_in_sigmas(world, off_edge(-1.5, -2.0, -2.5, -3.0, -4.0, -5.0))
    assert len(errors) >= 8 and np.abs(errors).min() > 0.08
    assert np.median(np.abs(z)) < 2.0 and np.mean(np.abs(z) > 3.0) < 0.15 and np.abs(z).min() > 1.0
    # The roof has texture: its own clicks are as sure as they were.
    errors, z, words = off_in_sigmas(world, off_edge(4.0, 6.0, 8.0, 10.0))
    assert words.count(Measured.MEASURED) == 12
    assert np.abs(z).max() < 3.5 and np.median(np.abs(errors / z)) < 0.0025
