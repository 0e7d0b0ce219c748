"""What would make a radius smaller, in a line for an operator."""

import pytest

from contract.error_sources import ABOUT, Cause, in_a_line
from contract.vehicle_status import MAX_CODE


@pytest.mark.parametrize(
    ("shares", "line"),
    [
        ({"mount": 0.6, "gps": 0.21}, "mostly the camera's mount (60 %): fly one circle"),
        ({"gps": 0.38}, "mainly the GPS (38 %): click the same thing again minutes later"),
        ({"gps": 0.12}, "many small causes, none above 12 %"),
        ({"moonlight": 0.7}, "mostly moonlight (70 %)"),  # of a later version
        ({}, ""),
    ],
)
def test_the_largest_cause_and_one_thing_to_do(shares: dict[str, float], line: str) -> None:
    assert in_a_line(shares) == line


def test_every_cause_has_words_and_a_code_that_a_status_takes() -> None:
    assert set(ABOUT) == set(Cause)
    assert len({about.name for about in ABOUT.values()}) == len(Cause)
    for code in Cause:
        assert len(code) <= MAX_CODE and code.isalnum()


def test_no_receiver_is_advised_where_the_positions_are_a_filter_s() -> None:
    """A recorded filter is 2 to 4 m off beside a receiver that reports RTK and 0.3 m."""
    assert not any(word in ABOUT[Cause.GPS_SLOW].in_full for word in ("RTK", "receiver"))
