"""Bits against the slow and obvious way to write them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.wire import bits


@given(
    st.sampled_from([16, 17, 43]).flatmap(
        lambda most: st.lists(st.tuples(st.integers(0, 2**most - 1), st.integers(0, most)), max_size=60)
    ),
    st.integers(0, 30),
)
def test_fixed_parts_are_the_lowest_bits_one_after_the_other(numbers: list[tuple[int, int]], first: int) -> None:
    values, ks = np.array(numbers, np.int64).reshape(-1, 2).T
    written = bits.fixed_to_bits(values, ks)
    text = "".join(f"{v & (1 << k) - 1:0{k}b}" for v, k in numbers if k)
    assert "".join(map(str, written)) == text
    payload = b"?" + np.packbits(np.concatenate([np.ones(first, np.uint8), written])).tobytes()
    np.testing.assert_array_equal(bits.windows(payload, 1, first, ks), values & ((1 << ks) - 1))


@given(st.lists(st.integers(0, 1), max_size=20), st.lists(st.integers(0, 30), max_size=40))
def test_quotients_are_zeros_and_a_one_behind_what_is_fixed(fixed: list[int], quotients: list[int]) -> None:
    text = "".join(map(str, fixed)) + "".join("0" * q + "1" for q in quotients)
    payload = bits.with_unary([np.array(fixed, np.uint8)], np.array(quotients, np.int64))
    stream = np.unpackbits(np.frombuffer(payload, np.uint8))
    assert "".join(map(str, stream)) == text + "0" * (-len(text) % 8)
    got = bits.bits_to_unary(stream[len(fixed) :], len(quotients))
    assert got[0].tolist() == quotients and got[1] == len(text) - len(fixed)
    assert bits.bits_to_unary(stream[len(fixed) :], len(quotients) + 1) is None


@pytest.mark.parametrize("mean", [0.0, 0.4, 3.0, 70.0, 1e4, 1e9])
def test_the_rice_parameter_is_within_two_per_cent_of_the_cheapest(mean: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        numbers = rng.geometric(1.0 / (1.0 + mean), 100) - 1
        cost = [int((numbers >> k).sum()) + len(numbers) * (k + 1) for k in range(bits.MAX_WIDTH)]
        assert cost[bits.rice_parameter(int(numbers.sum()), len(numbers))] <= 1.02 * min(cost) + 2


@pytest.mark.parametrize("most", [5, 2**41])
def test_zigzag_counts_from_nought_outwards(most: int) -> None:
    signed = np.array([0, -1, 1, -2, 2, most, -most], np.int64)
    np.testing.assert_array_equal(bits.zigzag(signed), [0, 1, 2, 3, 4, 2 * most, 2 * most - 1])
    np.testing.assert_array_equal(bits.unzigzag(bits.zigzag(signed)), signed)
