"""What is said to have been seen was seen, and nearly all that was: rendered flights against rays cast to the truth."""

import pytest

from benchmarks.seen import Judged, judge, rows, seeded
from tests.scenarios.flights import play, simulated
from tests.scenarios.sessions import ordinary_turns


@pytest.mark.long  # short: tests/ground/seen
def test_of_an_ordinary_flight_with_turns_next_to_nothing_is_overstated_and_a_tenth_understated() -> None:
    folder = simulated(ordinary_turns(1, 45.0))
    found = judge(folder, play(folder).sets.values(), per_cell=1)
    assert found.answered > 0.8 * found.pictures
    assert found.over <= 0.01, found
    assert 0.02 < found.under <= 0.12, found


@pytest.mark.long
@pytest.mark.parametrize("name", rows())
def test_kind_by_kind_of_flight_the_seen_area_is_right(name: str) -> None:
    """Three sampled flights together overstate at most 1 % and understate at most 12 %; without attitude, a quarter."""
    total = Judged()
    for seed in range(50, 53):
        folder = simulated(seeded(rows()[name], seed))
        total += judge(folder, play(folder).sets.values(), per_cell=1)
    assert total.over <= 0.01, total
    assert 0.02 < total.under <= (0.25 if "without" in name else 0.12), total
