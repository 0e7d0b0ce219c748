"""The errors that all points of a set have in common <-> bytes: section 4.4 of docs/wire-format.md.

What is fresh is written as sigmas and partial correlations. What is shared with other sets is written in sigmas of what
is fresh, decorrelated, in steps as fine as there is room for: sets of the same pictures share what is fresh too, so
that rounding is most of what is left between them. Any numbers give a covariance.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
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
_PARAMETERS = 4 * (2 + NUISANCES)  # bits: halvings, then Rice parameters
_SIZES = np.array([_CORRELATIONS] + [COMMON_STATES] * NUISANCES)
_WIDTHS = np.arange(_EMPTY)
_POWERS = np.arange(_EMPTY - 1, -1, -1)  # of a number's bits, most significant first


def encode_common(common_cov: Array, shared: SharedErrors, room: int) -> bytes:
    """Their bytes, in the finest steps that keep to `room` bytes, or else in the coarsest. Raises ValueError."""
    common, by_nuisance = np.asarray(common_cov, float), np.asarray(shared.by_nuisance, float)
    if common.shape != (COMMON_STATES, COMMON_STATES) or not np.all(np.isfinite(common)):
        raise ValueError(f"common_cov must be {COMMON_STATES} x {COMMON_STATES} finite numbers, not {np.shape(common)}")
    if by_nuisance.shape != (COMMON_STATES, NUISANCES) or not np.all(np.isfinite(by_nuisance)):
        raise ValueError(f"by_nuisance must be {COMMON_STATES} x {NUISANCES} and finite, not {np.shape(by_nuisance)}")
    try:
        sigmas, correlations = covariance_codes(common - by_nuisance @ by_nuisance.T)
    except ValueError as error:
        raise ValueError(f"common_cov less what is shared: {error}") from error
    factor = factor_from_codes(sigmas, correlations)
    assert factor is not None
    head, codes = _encode_head(sigmas, shared), _Group.of(bits.zigzag(np.array(correlations, np.int64))[None])
    finest = _steps(by_nuisance, factor).T
    columns = _Group.of(bits.zigzag(_coarser(finest, MAX_HALVINGS)))
    room_bits = 8 * (room - len(head)) - _PARAMETERS - codes.bits - columns.bits
    # A bit a number and halving; told from what a decoded set has exactly too, so that it takes the same steps again.
    halvings = min(max(room_bits // finest.size, 0), MAX_HALVINGS)
    if halvings:
        columns = _Group.of(bits.zigzag(_coarser(finest, MAX_HALVINGS - halvings)))
    return head + _encode_groups(halvings, codes, columns)


def decode_common(cursor: ByteCursor) -> dict[str, Any]:
    """common_cov and shared. Raises CorruptPayload."""
    numbers = cursor.unpack(_HEAD)
    sigmas, codes, span = list(numbers[:COMMON_STATES]), numbers[COMMON_STATES:-2], numbers[-2:]
    halvings, *groups = _decode_groups(cursor)
    correlations, steps = (bits.unzigzag(numbers) for numbers in groups)
    if np.any(np.abs(correlations) > MAX_CORRELATION_CODE) or np.any(np.abs(steps) > MAX_STEPS << halvings):
        raise CorruptPayload("a correlation or a shared error is larger than can be written")
    factor = factor_from_codes(sigmas, correlations.tolist())
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
    """Columns (9, DRAWS) in the finest steps. `factor` (9, 9): lower Cholesky factor of what is fresh, as decoded."""
    # A state that is known exactly errs by no draw either.
    known = np.diag(factor) == 0.0
    in_sigmas = np.linalg.solve(factor + np.diag(known.astype(float)), np.where(known[:, None], 0.0, by_nuisance))
    most = MAX_STEPS << MAX_HALVINGS
    out: Ints = np.clip(np.rint(in_sigmas * (2**MAX_HALVINGS / STEP)), -most, most).astype(np.int64)
    return out


def _coarser(steps: Ints, halvings: int) -> Ints:
    """The nearest in steps doubled so many times; halves upwards."""
    half = (1 << halvings) >> 1
    out: Ints = (steps + half) >> halvings
    return out


def _encode_head(sigmas: list[int], shared: SharedErrors) -> bytes:
    alignment = np.asarray(shared.alignment_sigma, float)
    if alignment.shape != (4,):
        raise ValueError(f"alignment_sigma must be four numbers, not {alignment.tolist()}")
    codes = [
        sigma_code(shared.position_time_s, "position_time_s"),
        sigma_code(shared.attitude_time_s, "attitude_time_s"),
        *(sigma_code(float(value), "alignment_sigma") for value in alignment),
    ]
    if not np.all(np.isfinite(shared.span_s)):
        raise ValueError(f"span_s must be finite, not {shared.span_s}")
    span = np.clip(np.rint(np.array(shared.span_s) * SPAN_STEPS), -MAX_SPAN_STEPS, MAX_SPAN_STEPS)
    return _HEAD.pack(*sigmas, *codes, *(int(n) for n in span))


@dataclass(frozen=True, eq=False)
class _Group:
    """Rows of numbers (N, M), the Rice parameter (N,) of each, and the bits that they take."""

    rows: Ints
    ks: Ints
    bits: int

    @classmethod
    def of(cls, rows: Ints) -> _Group:
        """With the parameters that code each row in the fewest bits, the smallest if several do."""
        cost = (rows[:, :, None] >> _WIDTHS).sum(axis=1) + rows.shape[1] * (_WIDTHS + 1)
        some = rows.any(axis=1)
        return cls(rows, np.where(some, cost.argmin(axis=1), _EMPTY), int(cost.min(axis=1)[some].sum()))


def _encode_groups(halvings: int, correlations: _Group, columns: _Group) -> bytes:
    """Rice codes, a parameter a group: parameters, then all fixed parts, then all unary parts."""
    ks = np.concatenate([correlations.ks, columns.ks])
    k = np.repeat(ks, _SIZES)
    written = k != _EMPTY
    values, k = np.concatenate([correlations.rows.ravel(), columns.rows.ravel()])[written], k[written]
    low = ((values[:, None] >> _POWERS) & 1)[k[:, None] > _POWERS].astype(np.uint8)
    parameters = bits.fixed_to_bits([(np.append(halvings, ks), 4)])
    return np.packbits(np.concatenate([parameters, low, bits.unary_to_bits(values >> k)])).tobytes()


def _decode_groups(cursor: ByteCursor) -> tuple[int, Ints, Ints]:
    """Inverse of `_encode_groups`. Raises CorruptPayload."""
    stream = np.unpackbits(np.frombuffer(cursor.payload, np.uint8, cursor.end - cursor.position, cursor.position))
    if len(stream) < _PARAMETERS:
        raise CorruptPayload("content ends within the common errors")
    (parameters,) = bits.bits_to_fixed(stream[:_PARAMETERS], [4])
    halvings, ks = int(parameters[0]), parameters[1:]
    if halvings > MAX_HALVINGS:
        raise CorruptPayload(f"steps of shared errors halved {halvings} times")
    written = np.repeat(ks != _EMPTY, _SIZES)
    k = np.repeat(ks, _SIZES)[written]
    fixed_end = _PARAMETERS + int(k.sum())
    unary = bits.bits_to_unary(stream[fixed_end:], len(k))
    if unary is None:
        raise CorruptPayload("content ends within the common errors")
    quotients, unary_bits = unary
    used = fixed_end + unary_bits
    if np.any(stream[used : -(-used // 8) * 8]):
        raise CorruptPayload("padding bits behind the common errors are not zero")
    cursor.take(-(-used // 8))
    low = np.zeros((len(k), len(_POWERS)), np.int64)
    low[k[:, None] > _POWERS] = stream[_PARAMETERS:fixed_end]
    values = np.zeros(len(written), np.int64)
    values[written] = (quotients << k) + low @ (np.int64(1) << _POWERS)
    return halvings, values[:_CORRELATIONS], values[_CORRELATIONS:].reshape(NUISANCES, COMMON_STATES)
