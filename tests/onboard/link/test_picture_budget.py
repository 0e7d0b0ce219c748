"""What pictures may take of the link: what nothing else wants, and no moment of a set's time. No clock, no link."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.link.byte_budget import BURST_S, PACKET_BYTES, Budget, Kind, left_for_pictures
from tests.onboard.link.virtual import Radio, Sent, flight, heaviest, run

MIXTURES = {
    "max_bit_rate": st.floats(4000.0, 500_000.0),
    "set_bytes": st.integers(60, 1250),
    "status_bytes": st.sampled_from([0, 250, 300]),
    "replies_hz": st.sampled_from([0.0, 1.0, 10.0]),
    "rate_hz": st.sampled_from([1.0, 10.0]),
    "grounds": st.integers(1, 3),
}


def simulated(
    max_bit_rate: float, set_bytes: int, status_bytes: int, replies_hz: float, rate_hz: float, grounds: int, piece: int
) -> list[Sent]:
    budget = Budget(max_bit_rate, 0.2, 5.0, 0.0)
    budget.connected(grounds, 0.0)
    return run(budget, flight(6.0, rate_hz), 6.0, set_bytes, status_bytes, replies_hz, piece_bytes=piece)


def others(sent: list[Sent]) -> list[tuple[float, Kind, float, str]]:
    return [(s.at_s, s.kind, s.wire_bytes, s.offer.item if s.offer else "") for s in sent if s.kind is not Kind.PICTURE]


@settings(deadline=None, max_examples=10)
@given(piece=st.integers(100, 1250), **MIXTURES)
def test_everything_else_goes_out_at_the_same_moments_with_pictures_as_without(
    piece: int, max_bit_rate: float, set_bytes: int, status_bytes: int, replies_hz: float, rate_hz: float, grounds: int
) -> None:
    mixture = (max_bit_rate, set_bytes, status_bytes, replies_hz, rate_hz, grounds)
    assert others(simulated(*mixture, piece)) == others(simulated(*mixture, 0))


@settings(deadline=None, max_examples=10)
@given(piece=st.integers(100, 1250), window_s=st.floats(0.1, 8.0), **MIXTURES)
def test_with_pictures_no_window_of_time_carries_more_than_the_cap_one_burst_and_one_packet(
    piece: int,
    window_s: float,
    max_bit_rate: float,
    set_bytes: int,
    status_bytes: int,
    replies_hz: float,
    rate_hz: float,
    grounds: int,
) -> None:
    sent = simulated(max_bit_rate, set_bytes, status_bytes, replies_hz, rate_hz, grounds, piece)
    largest = max((s.wire_bytes for s in sent), default=0.0)
    burst = max(PACKET_BYTES, BURST_S * max_bit_rate / 8.0, largest) + max(PACKET_BYTES, largest)
    assert heaviest(sent, window_s) <= window_s * max_bit_rate / 8.0 + burst + 1e-6


@pytest.mark.parametrize(
    ("bit_rate", "least", "most"),
    # Sets take 41.4 kbit/s, status 3.1, keep-alives 1.1: of the rest pictures get most, and of nothing nothing.
    [(32_000.0, 0.0, 0.05), (64_000.0, 0.25, 1.0), (128_000.0, 0.45, 1.0), (500_000.0, 0.6, 1.0)],
)
def test_pictures_get_most_of_what_is_left_and_no_more(bit_rate: float, least: float, most: float) -> None:
    budget = Budget(bit_rate, 0.2, 5.0, 0.0)
    sent = run(budget, flight(12.0, 10.0), 12.0, 600, 300, piece_bytes=budget.piece_bytes(1250))
    got = 8.0 / 12.0 * sum(s.wire_bytes for s in sent if s.kind is Kind.PICTURE)
    left = max(left_for_pictures(bit_rate, 5.0), 1000.0)
    assert least <= got / left <= most
    assert 55 <= sum(s.kind is Kind.SET for s in sent) <= 61


def test_while_no_set_comes_pictures_have_the_whole_link_and_a_set_goes_before_the_next_of_them() -> None:
    budget = Budget(64_000.0, 0.2, 5.0, 0.0)
    took = [s for s in run(budget, flight(4.0, 2.0), 20.0, 600, piece_bytes=1250) if s.kind is Kind.PICTURE]
    assert sum(s.wire_bytes for s in took if s.at_s > 12.0) > 0.7 * 8.0 * 8000


@pytest.mark.parametrize("bit_rate", [64_000.0, 128_000.0, 256_000.0])
@pytest.mark.parametrize("carries", [1.0, 1.5])
def test_through_a_radio_no_faster_than_the_cap_the_newest_set_is_no_older_with_pictures(
    bit_rate: float, carries: float
) -> None:
    """A radio carries one packet after the other: a set that finds a piece under way would wait for it."""
    ages = []
    for is_on in (False, True):
        budget, radio = Budget(bit_rate, 0.2, 5.0, 0.0), Radio(carries * bit_rate)
        piece = budget.piece_bytes(1250) if is_on else 0
        sent = run(budget, flight(20.0, 10.0), 20.0, 600, 300, 0.0, radio, piece)
        ages.append(sorted(radio.ages_s(5.0, 20.0)))
        assert any(s.kind is Kind.PICTURE for s in sent) == is_on
    without, with_pictures = ages
    assert with_pictures[len(with_pictures) // 2] <= without[len(without) // 2] + 0.02
    assert with_pictures[-1] <= without[-1] + 0.04  # two looks of the virtual loop


def test_on_a_radio_half_as_fast_as_configured_pictures_give_way() -> None:
    """What is unacknowledged says so: sets are as late as they are without pictures, which is late enough."""
    ages = []
    for piece in (0, 1250):
        budget, radio = Budget(128_000.0, 0.2, 5.0, 0.0), Radio(30_000.0)
        run(budget, flight(20.0, 10.0), 20.0, 600, 300, 0.0, radio, piece)
        ages.append(sorted(radio.ages_s(5.0, 20.0)))
    assert ages[1][len(ages[1]) // 2] <= ages[0][len(ages[0]) // 2] + 0.9
    assert ages[1][-1] <= ages[0][-1] + 0.9
