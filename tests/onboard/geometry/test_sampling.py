"""Some of many, evenly over all of them."""

import numpy as np
import pytest

from onboard.geometry.sampling import evenly


@pytest.mark.parametrize(("count", "most"), [(0, 5), (1, 5), (5, 5), (6, 5), (1000, 7)])
def test_no_more_than_asked_for_each_once_the_first_and_the_last_among_them(count: int, most: int) -> None:
    some = evenly(count, most)
    assert len(some) == len(np.unique(some)) == min(count, most)
    assert list(some[[0, -1]] if count else []) == ([0, count - 1] if count else [])
    gaps = np.diff(some)
    assert len(gaps) == 0 or gaps.max() - gaps.min() <= 1
