"""Integers <-> bits, many at a time: Rice codes split into a fixed-width stream and a unary stream.

A Rice code with parameter k writes n as its k low bits and, in unary, n >> k. Interleaved, such codes can only be read
one after the other. Kept apart, every low part has a known place, and the unary parts end at the ones of one bit array:
both sides are a handful of NumPy calls (docs/wire-format.md, section 5).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
Bits = NDArray[np.uint8]

MAX_WIDTH = 44  # bits; wider values mean a sigma absurdly small beside its depth


def zigzag(signed: Ints) -> Ints:
    """0, -1, 1, -2, ... -> 0, 1, 2, 3, ..."""
    out: Ints = np.where(signed < 0, -2 * signed - 1, 2 * signed)
    return out


def unzigzag(unsigned: Ints) -> Ints:
    """Inverse of `zigzag`."""
    out: Ints = np.where(unsigned & 1, -((unsigned + 1) >> 1), unsigned >> 1)
    return out


def rice_parameter(values: Ints) -> int:
    """The parameter that codes these non-negative values in the fewest bits, the smallest one if several do."""
    ks = np.arange(MAX_WIDTH)
    cost = (values[:, None] >> ks).sum(axis=0) + len(values) * ks
    return int(np.argmin(cost))


def fixed_to_bits(columns: list[tuple[Ints, int]]) -> Bits:
    """Columns of (values (N,), width) -> bits (N * sum of widths,), row by row, most significant bit first."""
    rows = [(values[:, None] >> np.arange(width - 1, -1, -1)) & 1 for values, width in columns]
    return np.concatenate(rows, axis=1).astype(np.uint8).ravel()


def bits_to_fixed(bits: Bits, widths: list[int]) -> list[Ints]:
    """Inverse of `fixed_to_bits`; the number of rows follows from the number of bits."""
    table = bits.reshape(-1, sum(widths)).astype(np.int64)
    edges = np.concatenate([[0], np.cumsum(widths)])
    out: list[Ints] = []
    for start, end in pairwise(edges):
        out.append(table[:, start:end] @ (np.int64(1) << np.arange(end - start - 1, -1, -1, dtype=np.int64)))
    return out


def unary_to_bits(quotients: Ints) -> Bits:
    """Each value as that many zeros and a one."""
    ends = np.cumsum(quotients + 1)
    bits = np.zeros(int(ends[-1]) if len(ends) else 0, np.uint8)
    bits[ends - 1] = 1
    return bits


def bits_to_unary(bits: Bits, count: int) -> tuple[Ints, int] | None:
    """The first `count` values and how many bits they took; None if the bits hold fewer."""
    ones = np.flatnonzero(bits)[:count]
    if len(ones) < count:
        return None
    if not count:
        return np.zeros(0, np.int64), 0
    return np.diff(ones, prepend=-1) - 1, int(ones[-1]) + 1
