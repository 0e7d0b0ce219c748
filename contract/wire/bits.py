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

MAX_WIDTH = 44  # bits; wider values mean a sigma absurdly small relative to its depth
SHORT = 16  # bits a number that `fixed_to_bits` is quicker with
# Which of a 16-bit number's bits are its k lowest, most significant bit first.
LOWEST: Mask = np.arange(SHORT)[None, :] >= SHORT - np.arange(SHORT + 1)[:, None]


def zigzag(signed: Ints) -> Ints:
    """0, -1, 1, -2, ... -> 0, 1, 2, 3, ..."""
    return (signed << 1) ^ (signed >> 63)


def unzigzag(unsigned: Ints) -> Ints:
    """Inverse of `zigzag`."""
    return (unsigned >> 1) ^ -(unsigned & 1)


def rice_parameter(total: int, count: int) -> int:
    """The parameter for `count` numbers >= 0 of that sum: the bits of half their mean.

    Of numbers with a geometric distribution no other takes fewer bits, or next to none do (Kiely 2004).
    """
    return min((total // (2 * count)).bit_length(), MAX_WIDTH - 1)


def fixed_to_bits(values: Ints, ks: Ints) -> Bits:
    """The k (N,) lowest bits of values (N,), one after the other, most significant first."""
    if np.maximum.reduce(ks, initial=0) <= SHORT:
        table = np.unpackbits(values.astype(">u2").view(np.uint8)).reshape(-1, SHORT)
        return table[LOWEST.take(ks, axis=0)]
    table = np.unpackbits(values.astype(">u8").view(np.uint8)).reshape(-1, 64)
    return table[np.arange(64) >= 64 - ks[:, None]]


def windows(payload: bytes, position: int, first: int, ks: Ints) -> Ints:
    """Inverse of `fixed_to_bits`: numbers of k (N,) bits each, from bit `first` behind byte `position` on.

    k is up to 57; the payload holds that many bits.
    """
    held = payload[position:] + bytes(8)
    every = np.ndarray(len(held) - 7, ">u8", held, strides=(1,))  # the eight bytes from each byte on
    ends = ks.cumsum()
    ends += first
    starts = ends - ks
    words = every.take(starts >> 3).astype(np.uint64)
    words <<= (starts & 7).view(np.uint64)
    return (words >> (64 - ks).view(np.uint64)).view(np.int64)


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
