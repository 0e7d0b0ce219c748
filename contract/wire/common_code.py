"""The errors that all points of a set have in common <-> numbers: section 4.4 of docs/wire-format.md.

What is fresh is written as sigmas and partial correlations. What is shared with other sets is written in sigmas of what
is fresh, decorrelated, in steps of a sixteenth: sets of the same pictures share what is fresh too, so that rounding is
most of what is left between them. Any numbers give a covariance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.errors import CorruptPayload
from contract.feature_set import COMMON_STATES, NUISANCES, SharedErrors
from contract.wire import bits
from contract.wire.covariance_code import (
    MAX_CORRELATION_CODE,
    covariance_codes,
    factor_from_codes,
    inverse_of_factor,
    sigma_code,
    sigma_from_code,
)

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

STEP = 1 / 16  # of a sigma of what is fresh
MAX_STEPS = 16380
SPAN_STEPS = 100  # a second
MAX_SPAN_STEPS = 2**15 - 1
CORRELATIONS = COMMON_STATES * (COMMON_STATES - 1) // 2
SIZES = [CORRELATIONS] + [COMMON_STATES] * NUISANCES  # numbers a group


def common_numbers(common_cov: Array, shared: SharedErrors) -> tuple[list[int], Ints]:
    """Sigma codes of the fresh states, and the numbers in zigzag: correlations, then columns. Raises ValueError."""
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
    return sigmas, bits.zigzag(np.concatenate([correlations, _steps(by_nuisance, factor).T.ravel()]))


def common_from_numbers(sigmas: list[int], numbers: Ints) -> dict[str, Array]:
    """The fields common_cov and by_nuisance; the inverse of `common_numbers`. Raises CorruptPayload."""
    # In zigzag a number within a limit is one up to twice the limit.
    most = 2 * MAX_CORRELATION_CODE, 2 * MAX_STEPS
    largest = np.maximum.reduceat(numbers, [0, CORRELATIONS]).tolist()
    if largest[0] > most[0] or largest[1] > most[1]:
        raise CorruptPayload("a correlation or a shared error is larger than can be written")
    signed = bits.unzigzag(numbers)
    correlations, steps = signed[:CORRELATIONS].tolist(), signed[CORRELATIONS:].reshape(NUISANCES, COMMON_STATES)
    rows = factor_from_codes(sigmas, correlations)
    if rows is None:
        raise CorruptPayload(f"correlations {correlations} mean nothing")
    factor = np.array(rows)
    by_nuisance = factor @ (steps.T * STEP)
    both = np.concatenate([factor, by_nuisance], axis=1)
    return {"common_cov": both @ both.T, "by_nuisance": by_nuisance}


def _steps(by_nuisance: Array, factor: list[list[float]]) -> Ints:
    """Columns (9, NUISANCES) in steps. `factor`: rows of the lower Cholesky factor of the fresh part, decoded."""
    known = [i for i, row in enumerate(factor) if row[i] == 0.0]
    if known:  # a state that is known exactly has no nuisance error either
        factor, by_nuisance = [row.copy() for row in factor], by_nuisance.copy()
        by_nuisance[known] = 0.0
        for i in known:
            factor[i][i] = 1.0
    in_sigmas = np.array(inverse_of_factor(factor)) @ by_nuisance / STEP
    out: Ints = np.maximum(np.minimum(np.rint(in_sigmas), MAX_STEPS), -MAX_STEPS).astype(np.int64)
    return out


def shared_codes(shared: SharedErrors) -> list[int]:
    """Sigma codes of correlation times and alignment, then the span in steps. Raises ValueError."""
    alignment = np.asarray(shared.alignment_sigma, float)
    if alignment.shape != (4,):
        raise ValueError(f"alignment_sigma must be four numbers, not {alignment.tolist()}")
    if not all(map(math.isfinite, shared.span_s)):
        raise ValueError(f"span_s must be finite, not {shared.span_s}")
    most = MAX_SPAN_STEPS / SPAN_STEPS
    return [
        sigma_code(shared.position_time_s, "position_time_s"),
        sigma_code(shared.attitude_time_s, "attitude_time_s"),
        *(sigma_code(value, "alignment_sigma") for value in alignment.tolist()),
        *(round(min(max(float(s), -most), most) * SPAN_STEPS) for s in shared.span_s),
    ]


def shared_from_codes(by_nuisance: Array, codes: Sequence[int]) -> dict[str, Any]:
    """Field `shared`; the inverse of `shared_codes`."""
    position_s, attitude_s, *alignment = map(sigma_from_code, codes[:6])
    span_s = codes[6] / SPAN_STEPS, codes[7] / SPAN_STEPS
    return {"shared": SharedErrors(by_nuisance, position_s, attitude_s, np.array(alignment), span_s)}
