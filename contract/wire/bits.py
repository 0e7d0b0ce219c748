"""Integers <-> bits, many at a time: Rice codes split into a fixed-width stream and a unary stream.

A Rice code with parameter k writes n as its k low bits and, in unary, n >> k. Interleaved, such codes can only be read
one after the other. Kept apart, every low part has a known place, and the unary parts end at the ones of one bit array:
both sides are a handful of NumPy calls (docs/wire-format.md, section 5). A set has a few hundred numbers, so the time
goes into the number of calls and not into their work.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
Bits = NDArray[np.uint8]
Mask = NDArray[np.bool_]

MAX_WIDTH = 44  # bits; wider values mean a sigma absurdly small beside its depth
SHORT = 16  # bits of a number in `short_to_bits`, at most
_WORD = 63  # bits of neighbouring columns that are put together before they are taken apart into bits
# Which of a 16-bit number's bits are its k lowest, most significant bit first.
LOWEST: Mask = np.arange(SHORT)[None, :] >= SHORT - np.arange(SHORT)[:, None]


def zigzag(signed: Ints) -> Ints:
    """0, -1, 1, -2, ... -> 0, 1, 2, 3, ..."""
    out: Ints = (signed << 1) ^ (signed >> 63)
    return out


def unzigzag(unsigned: Ints) -> Ints:
    """Inverse of `zigzag`."""
    out: Ints = (unsigned >> 1) ^ -(unsigned & 1)
    return out


def rice_parameters(columns: Ints) -> list[int]:
    """Of each of the columns (C, N), numbers >= 0: the parameter of the fewest bits, the smallest of equals.

    Beyond the bits of the largest number a parameter costs a bit a number more for nothing, so none is tried.
    """
    ks = np.arange(min(int(columns.max(initial=0)).bit_length() + 1, MAX_WIDTH))[:, None]
    cost = np.add.reduce(columns >> ks[:, :, None], axis=2) + columns.shape[1] * ks
    out: list[int] = cost.argmin(axis=0).tolist()
    return out


def _words(widths: list[int]) -> list[tuple[list[int], int]]:
    """Neighbouring widths that fit one word together, and their sums."""
    out: list[tuple[list[int], int]] = []
    for width in widths:
        if out and out[-1][1] + width <= _WORD:
            held, total = out[-1]
            out[-1] = ([*held, width], total + width)
        else:
            out.append(([width], width))
    return out


def fixed_to_bits(columns: list[tuple[Ints, int]]) -> Bits:
    """Columns of (values (N,), width) -> bits (N * sum of widths,), row by row, most significant bit first."""
    rest = iter(columns)
    rows = []
    for widths, total in _words([width for _, width in columns]):
        word, _ = next(rest)
        for width in widths[1:]:
            word = word << width | next(rest)[0]
        rows.append(np.unpackbits(word.astype(">i8").view(np.uint8)).reshape(-1, 64)[:, 64 - total :])
    return (rows[0] if len(rows) == 1 else np.concatenate(rows, axis=1)).ravel()


def bits_to_fixed(bits: Bits, widths: list[int]) -> list[Ints]:
    """Inverse of `fixed_to_bits`; the number of rows follows from the number of bits."""
    table = bits.reshape(-1, sum(widths))
    out: list[Ints] = []
    start = 0
    for group, total in _words(widths):
        padded = np.zeros((len(table), 64), np.uint8)
        padded[:, 64 - total :] = table[:, start : start + total]
        word = np.packbits(padded.ravel()).view(">i8").astype(np.int64)
        start, below = start + total, total
        for width in group:
            below -= width
            out.append((word >> below) & ((1 << width) - 1))
    return out


def short_to_bits(values: Ints, ks: Ints) -> Bits:
    """The k (N,) lowest bits of values (N,) below 2^16, k below 16, one after the other."""
    out: Bits = np.unpackbits(values.astype(">u2").view(np.uint8)).reshape(-1, SHORT)[LOWEST.take(ks, axis=0)]
    return out


def bits_to_short(bits: Bits, ks: Ints) -> Ints:
    """Inverse of `short_to_bits`: bits (sum of ks,) -> values (N,)."""
    table = np.zeros((len(ks), SHORT), np.uint8)
    table[LOWEST.take(ks, axis=0)] = bits
    return np.packbits(table.ravel()).view(">u2").astype(np.int64)


def with_unary(fixed: list[Bits], quotients: Ints) -> bytes:
    """Bits, then each quotient as that many zeros and a one, then zeros to the next full byte."""
    start = sum(map(len, fixed))
    ends = (quotients + 1).cumsum()
    stream = np.zeros(start + (int(ends[-1]) if len(ends) else 0), np.uint8)
    np.concatenate(fixed, out=stream[:start])
    stream[ends + (start - 1)] = 1
    return np.packbits(stream).tobytes()


def bits_to_unary(bits: Bits, count: int) -> tuple[Ints, int] | None:
    """The first `count` quotients and how many bits they took; None if the bits hold fewer."""
    if not count:
        return np.zeros(0, np.int64), 0
    ones = bits.view(np.bool_).nonzero()[0][:count]
    if len(ones) < count:
        return None
    quotients = ones.copy()
    quotients[1:] -= ones[:-1] + 1
    return quotients, int(ones[-1]) + 1
