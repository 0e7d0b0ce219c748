"""All numbers of a set <-> bits, as Rice codes in groups with a parameter each: section 5 of docs/wire-format.md.

The groups are those of the common errors (correlations, then columns), whose parameters take four bits, and the three
of the features. One stream holds them all, so that both sides handle some 450 numbers in a handful of NumPy calls.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from contract.errors import CorruptPayload
from contract.wire import bits
from contract.wire.byte_cursor import ByteCursor
from contract.wire.common_code import SIZES

Ints = NDArray[np.int64]

EMPTY = 15  # the parameter of a group of zeros among the common errors, which is left out
COLUMNS = 3  # of numbers that a feature has
_SHORT, _LONG = 4, 6  # bits of a parameter, of the common errors' groups and of the features'
_COMMON = len(SIZES)
_PARAMETERS = _SHORT * _COMMON + _LONG * COLUMNS
_PARAMETER_BYTES = -(-_PARAMETERS // 8)
_SHIFTS = [
    (8 * _PARAMETER_BYTES - _SHORT * (i + 1), 15) for i in range(_COMMON)
] + [(8 * _PARAMETER_BYTES - _SHORT * _COMMON - _LONG * (i + 1), 63) for i in range(COLUMNS)]  # fmt: skip


@lru_cache(maxsize=256)
def _groups(features: int) -> tuple[list[int], Ints, Ints]:
    """The groups of a set of so many features: numbers in each, where each starts, and the group of each number."""
    sizes = SIZES + ([features] * COLUMNS if features else [])
    starts: Ints = np.cumsum(sizes) - np.array(sizes)
    return sizes, starts, np.repeat(np.arange(len(sizes)), sizes)


def encode_numbers(common: Ints, columns: Ints) -> bytes:
    """Numbers of the common errors and columns (3, n) of the features, all >= 0."""
    numbers = np.concatenate([common, columns.ravel()])
    sizes, starts, group = _groups(columns.shape[1])
    totals = np.add.reduceat(numbers, starts).tolist()
    ks = [bits.rice_parameter(total, count) for total, count in zip(totals, sizes, strict=True)]
    ks += [0] * (_COMMON + COLUMNS - len(ks))
    is_sparse = 0 in totals[:_COMMON]
    if is_sparse:
        ks[:_COMMON] = [k if total else EMPTY for k, total in zip(ks, totals[:_COMMON], strict=False)]
    word = 0
    for k, (shift, _) in zip(ks, _SHIFTS, strict=True):
        word |= k << shift
    parameters = np.unpackbits(np.frombuffer(word.to_bytes(_PARAMETER_BYTES, "big"), np.uint8))[:_PARAMETERS]
    widths = np.array(ks).take(group)
    if is_sparse:
        written = (widths != EMPTY) | (group >= _COMMON)
        numbers, widths = numbers[written], widths[written]
    return bits.with_unary([parameters, bits.fixed_to_bits(numbers, widths)], numbers >> widths)


def decode_numbers(cursor: ByteCursor, features: int) -> tuple[Ints, Ints]:
    """Inverse of `encode_numbers`. Raises CorruptPayload."""
    begin, size = cursor.position, cursor.end - cursor.position
    if size < _PARAMETER_BYTES:
        raise CorruptPayload("content ends within the parameters of the numbers")
    word = int.from_bytes(cursor.payload[begin : begin + _PARAMETER_BYTES], "big")
    ks = [word >> shift & mask for shift, mask in _SHIFTS]
    if max(ks[_COMMON:]) >= bits.MAX_WIDTH:
        raise CorruptPayload(f"numbers of features are {ks[_COMMON:]} bits wide")
    _, _, group = _groups(features)
    k = np.array(ks).take(group)
    count = len(group)
    written = None
    if EMPTY in ks[:_COMMON]:
        written = (k != EMPTY) | (group >= _COMMON)
        k = k[written]
    fixed_end = _PARAMETERS + int(np.add.reduce(k))
    if fixed_end >= 8 * size:
        raise CorruptPayload("content ends within the numbers")
    whole, part = divmod(fixed_end, 8)
    stream = np.unpackbits(np.frombuffer(cursor.payload, np.uint8, size - whole, begin + whole))[part:]
    unary = bits.bits_to_unary(stream, len(k))
    if unary is None:
        raise CorruptPayload(f"the numbers of {features} features do not fit into the {size} bytes that are there")
    quotients, unary_bits = unary
    used = fixed_end + unary_bits
    end = -(-used // 8)
    if cursor.payload[begin + end - 1] & ((1 << 8 * end - used) - 1):
        raise CorruptPayload("padding bits are not zero")
    numbers = (quotients << k) + bits.windows(cursor.payload, begin, _PARAMETERS, k)
    cursor.take(end)
    if written is not None:
        packed, numbers = numbers, np.zeros(count, np.int64)
        numbers[written] = packed
    split = count - COLUMNS * features
    return numbers[:split], numbers[split:].reshape(COLUMNS, features)
