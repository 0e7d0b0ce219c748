"""Outlines go around the marked cells and nothing else."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray

from ground.seen.outline import cells_inside, hull, patches, ring_area

MASKS = arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.booleans())


def parts(mask: NDArray[np.bool_]) -> int:
    """How many groups of cells that touch along edges, by flooding."""
    left, found = set(map(tuple, np.argwhere(mask).tolist())), 0
    while left:
        found += 1
        ahead = [left.pop()]
        while ahead:
            r, c = ahead.pop()
            for near in ((r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)):
                if near in left:
                    left.remove(near)
                    ahead.append(near)
    return found


@given(MASKS)
def test_polygons_hold_the_marked_cells_each_once(mask: NDArray[np.bool_]) -> None:
    found = patches(mask)
    assert len(found) == parts(mask)
    total = np.zeros(mask.shape, int)
    for patch in found:
        inside = cells_inside([patch.outer, *patch.holes], *mask.shape)
        total += inside
        assert ring_area(patch.outer) > 0.0 and all(ring_area(hole) < 0.0 for hole in patch.holes)
        assert inside.sum() == ring_area(patch.outer) + sum(map(ring_area, patch.holes))
    assert np.array_equal(total, mask)


@given(MASKS.filter(np.any))
def test_the_hull_holds_all_that_is_marked_and_is_convex(mask: NDArray[np.bool_]) -> None:
    ring = hull(mask)
    assert np.all(cells_inside([ring], *mask.shape)[mask])
    ahead, next_ahead = np.roll(ring, -1, axis=0) - ring, np.roll(ring, -2, axis=0) - np.roll(ring, -1, axis=0)
    assert np.all(ahead[:, 0] * next_ahead[:, 1] - ahead[:, 1] * next_ahead[:, 0] > 0.0)


def test_an_island_in_a_lake_is_a_part_of_its_own() -> None:
    mask = np.ones((7, 7), bool)
    mask[1:6, 1:6] = False
    mask[3, 3] = True
    small, large = sorted(patches(mask), key=lambda patch: ring_area(patch.outer))
    assert (ring_area(small.outer), len(small.holes)) == (1.0, 0)
    assert (ring_area(large.outer), [ring_area(hole) for hole in large.holes]) == (49.0, [-25.0])


def test_cells_of_a_slanting_triangle_are_those_with_their_middles_inside() -> None:
    triangle = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
    expected = np.add.outer(np.arange(10), np.arange(10)) + 1.0 < 10.0
    assert np.array_equal(cells_inside([triangle], 10, 10), expected)
    beyond = triangle + (-3.0, -4.0)
    assert np.array_equal(cells_inside([beyond], 6, 7), expected[4:, 3:])


def test_nothing_marked_is_no_polygon() -> None:
    assert patches(np.zeros((3, 4), bool)) == []
    assert ring_area(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]])) == pytest.approx(1.0)
