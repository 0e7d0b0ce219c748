"""Nine true errors of ten lie inside the stated ellipse: of one click, of a pair in one set, of a pair in two sets.

Whole flights with every error drawn from the configured priors; `benchmarks.coverage` prints the table. A flight is
one sample of all slow errors, so that the share of single clicks has a sigma of 5 % over thirty flights.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.coverage import Counts, judge, rows
from ground.answer import CHI2_2

FLIGHTS = 30


@pytest.mark.parametrize("row", ["attitude + velocity", "seed (GPS + camera + level)"])
def test_nine_of_ten_errors_lie_inside_their_ellipses_within_a_set_and_between_sets(row: str) -> None:
    counts = [judge(rows()[row], seed) for seed in range(500, 500 + FLIGHTS)]
    flown = [c for c in counts if isinstance(c, Counts)]
    assert len(flown) == FLIGHTS

    def share(kind: str) -> float:
        return float(np.mean([np.mean(np.array(getattr(c, kind)) < CHI2_2) for c in flown if getattr(c, kind)]))

    assert 0.76 < share("clicks") < 0.99
    assert 0.82 < share("one_set") < 0.98
    assert 0.82 < share("two_near") < 0.99
    assert 0.78 < share("two_far") < 0.985
    assert 0.7 < np.mean([np.mean(c.pose) for c in flown]) < 1.4
    # What two sets share takes most of their ellipses away: without it this is 0.1.
    difference = np.concatenate([c.two_near for c in flown])
    assert 0.35 < np.mean(difference) / 2 < 1.3
