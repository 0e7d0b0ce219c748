"""The errors that all points of a set have in common <-> bytes: section 4.4 of docs/wire-format.md.

What is fresh is written as sigmas and partial correlations. What is shared with other sets is written in sigmas of what
is fresh, decorrelated, in steps as fine as there is room for: sets of the same pictures share what is fresh too, so
that rounding is most of what is left between them. Any numbers give a covariance.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.errors import CorruptPayload
from contract.feature_set import COMMON_STATES, NUISANCES, SharedErrors
from contract.wire import bits
from contract.wire.byte_cursor import ByteCursor
from contract.wire.covariance_code import (
    MAX_CORRELATION_CODE,
    covariance_codes,
    factor_from_codes,
    sigma_code,
    sigma_from_code,
)

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

STEP = 0.25  # the coarsest
MAX_HALVINGS = 2  # of the step
MAX_STEPS = 2**12 - 1  # of the coarsest
SPAN_STEPS = 100  # a second
MAX_SPAN_STEPS = 2**15 - 1
_CORRELATIONS = COMMON_STATES * (COMMON_STATES - 1) // 2
_EMPTY = 15  # the Rice parameter of a column of zeros
_HEAD = struct.Struct(f"<{COMMON_STATES}H6H2h")
_PLACES = np.array([8, 4, 2, 1])
_NIBBLES = ((np.arange(16)[:, None] & _PLACES) > 0).astype(np.uint8)  # the four bits of each parameter
_PARAMETERS = 4 * (2 + NUISANCES)  # bits: halvings, then Rice parameters
_SIZES = np.array([_CORRELATIONS] + [COMMON_STATES] * NUISANCES)
_GROUP = np.repeat(np.arange(len(_SIZES)), _SIZES)  # of each number
_WIDTHS = np.arange(_EMPTY)[:, None]
# Where groups start in what is priced at once: the correlations, the columns in the coarsest steps and in the finest.
_PRICED = np.concatenate([[_CORRELATIONS], [COMMON_STATES] * 2 * NUISANCES])
_STARTS = np.cumsum(_PRICED) - _PRICED


def encode_common(common_cov: Array, shared: SharedErrors, room: int) -> bytes:
    """Their bytes, in the finest steps that keep to `room` bytes, or else in the coarsest. Raises ValueError."""
    common, by_nuisance = np.asarray(common_cov, float), np.asarray(shared.by_nuisance, float)
    if common.shape != (COMMON_STATES, COMMON_STATES):
        raise ValueError(f"common_cov must be {COMMON_STATES} x {COMMON_STATES} numbers, not {np.shape(common)}")
    if by_nuisance.shape != (COMMON_STATES, NUISANCES):
        raise ValueError(f"by_nuisance must be {COMMON_STATES} x {NUISANCES} numbers, not {np.shape(by_nuisance)}")
    try:
        sigmas, correlations, factor = covariance_codes(common - by_nuisance @ by_nuisance.T)
    except ValueError as error:
        for name, values in (("common_cov", common), ("by_nuisance", by_nuisance)):
            if not np.isfinite(values).all():
                raise ValueError(f"{name} must be finite, not {values.tolist()}") from error
        raise ValueError(f"common_cov less what is shared: {error}") from error
    head = _encode_head(sigmas, shared)
    finest = _steps(by_nuisance, factor).T.ravel()
    coarsest = (finest + (1 << MAX_HALVINGS >> 1)) >> MAX_HALVINGS
    numbers = bits.zigzag(np.concatenate([correlations, coarsest, finest]))
    ks, cost = _rice(numbers, _PRICED, _STARTS)
    room_bits = 8 * (room - len(head)) - _PARAMETERS - sum(cost[: 1 + NUISANCES])
    # A bit a number and halving; from what a decoded set has exactly too, so that it takes the same steps again.
    halvings = min(max(room_bits // finest.size, 0), MAX_HALVINGS)
    if halvings == MAX_HALVINGS:
        columns, column_ks = numbers[-finest.size :], ks[-NUISANCES:]
    elif halvings == 0:
        columns, column_ks = numbers[_CORRELATIONS : -finest.size], ks[1:-NUISANCES]
    else:
        left = MAX_HALVINGS - halvings
        columns = bits.zigzag((finest + (1 << left >> 1)) >> left)
        column_ks = _rice(columns, _PRICED[1 : 1 + NUISANCES], _STARTS[1 : 1 + NUISANCES] - _CORRELATIONS)[0]
    written = np.concatenate([numbers[:_CORRELATIONS], columns])
    return head + _encode_groups(halvings, [ks[0], *column_ks], written)


def decode_common(cursor: ByteCursor) -> dict[str, Any]:
    """common_cov and shared. Raises CorruptPayload."""
    numbers = cursor.unpack(_HEAD)
    sigmas, codes, span = list(numbers[:COMMON_STATES]), numbers[COMMON_STATES:-2], numbers[-2:]
    halvings, written = _decode_groups(cursor)
    # In zigzag a number within a limit is one up to twice the limit.
    most = 2 * MAX_CORRELATION_CODE, 2 * MAX_STEPS << halvings
    if written[:_CORRELATIONS].max() > most[0] or written[_CORRELATIONS:].max() > most[1]:
        raise CorruptPayload("a correlation or a shared error is larger than can be written")
    signed = bits.unzigzag(written)
    correlations, steps = signed[:_CORRELATIONS], signed[_CORRELATIONS:].reshape(NUISANCES, COMMON_STATES)
    factor = factor_from_codes(sigmas, correlations)
    if factor is None:
        raise CorruptPayload(f"correlations {correlations.tolist()} mean nothing")
    by_nuisance = factor @ (steps.T * (STEP / 2**halvings))
    position_s, attitude_s, *alignment = (sigma_from_code(code) for code in codes)
    span_s = (span[0] / SPAN_STEPS, span[1] / SPAN_STEPS)
    return {
        "common_cov": factor @ factor.T + by_nuisance @ by_nuisance.T,
        "shared": SharedErrors(by_nuisance, position_s, attitude_s, np.array(alignment), span_s),
    }


def _steps(by_nuisance: Array, factor: Array) -> Ints:
    """Columns (9, NUISANCES) in the finest steps. `factor` (9, 9): lower Cholesky factor of the fresh part, decoded."""
    diagonal = factor.diagonal()
    if not diagonal.all():  # a state that is known exactly errs by no nuisance either
        known = diagonal == 0.0
        factor, by_nuisance = factor + np.diag(known.astype(float)), np.where(known[:, None], 0.0, by_nuisance)
    in_sigmas = np.linalg.solve(factor, by_nuisance) * (2**MAX_HALVINGS / STEP)
    most = MAX_STEPS << MAX_HALVINGS
    out: Ints = np.maximum(np.minimum(np.rint(in_sigmas), most), -most).astype(np.int64)
    return out


def _encode_head(sigmas: list[int], shared: SharedErrors) -> bytes:
    alignment = np.asarray(shared.alignment_sigma, float)
    if alignment.shape != (4,):
        raise ValueError(f"alignment_sigma must be four numbers, not {alignment.tolist()}")
    codes = [
        sigma_code(shared.position_time_s, "position_time_s"),
        sigma_code(shared.attitude_time_s, "attitude_time_s"),
        *(sigma_code(value, "alignment_sigma") for value in alignment.tolist()),
    ]
    if not all(map(math.isfinite, shared.span_s)):
        raise ValueError(f"span_s must be finite, not {shared.span_s}")
    most = MAX_SPAN_STEPS / SPAN_STEPS
    span = (round(min(max(float(s), -most), most) * SPAN_STEPS) for s in shared.span_s)
    return _HEAD.pack(*sigmas, *codes, *span)


def _rice(numbers: Ints, sizes: Ints, starts: Ints) -> tuple[list[int], list[int]]:
    """Of each group of numbers: the parameter that takes the fewest bits, the smallest of equals, and those bits."""
    widths = _WIDTHS[: int(np.maximum.reduce(numbers)).bit_length() + 1]  # wider ones cost more
    cost = np.add.reduceat(numbers >> widths, starts, axis=1)
    some = cost[0] > 0
    cost += sizes * (widths + 1)
    ks = np.where(some, cost.argmin(axis=0), _EMPTY)
    return ks.tolist(), (np.minimum.reduce(cost) * some).tolist()


def _encode_groups(halvings: int, ks: list[int], numbers: Ints) -> bytes:
    """Rice codes, a parameter a group: parameters, then all fixed parts, then all unary parts."""
    parameters = np.array([halvings, *ks])
    k = parameters[1:].take(_GROUP)
    if _EMPTY in ks:
        written = k != _EMPTY
        numbers, k = numbers[written], k[written]
    return bits.with_unary([_NIBBLES.take(parameters, axis=0).ravel(), bits.short_to_bits(numbers, k)], numbers >> k)


def _decode_groups(cursor: ByteCursor) -> tuple[int, Ints]:
    """Inverse of `_encode_groups`: halvings, and all numbers. Raises CorruptPayload."""
    stream = np.unpackbits(np.frombuffer(cursor.payload, np.uint8, cursor.end - cursor.position, cursor.position))
    if len(stream) < _PARAMETERS:
        raise CorruptPayload("content ends within the common errors")
    parameters = stream[:_PARAMETERS].reshape(-1, 4) @ _PLACES
    halvings = int(parameters[0])
    if halvings > MAX_HALVINGS:
        raise CorruptPayload(f"steps of shared errors halved {halvings} times")
    k = parameters[1:].take(_GROUP)
    written = k != _EMPTY
    k = k[written]
    fixed_end = _PARAMETERS + int(k.sum())
    unary = bits.bits_to_unary(stream[fixed_end:], len(k))
    if unary is None:
        raise CorruptPayload("content ends within the common errors")
    quotients, unary_bits = unary
    used = fixed_end + unary_bits
    if stream[used : -(-used // 8) * 8].any():
        raise CorruptPayload("padding bits behind the common errors are not zero")
    cursor.take(-(-used // 8))
    numbers = np.zeros(len(written), np.int64)
    numbers[written] = (quotients << k) + bits.bits_to_short(stream[_PARAMETERS:fixed_end], k)
    return halvings, numbers
