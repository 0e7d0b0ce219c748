"""Small dense linear algebra, straight from LAPACK where NumPy's checks cost more than the work."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

Array = NDArray[np.float64]


def solve_small(H: Array, right: Array) -> Array:
    """H x = right for a small symmetric positive definite H, in a fifth of `numpy.linalg.solve`'s time.

    Raises numpy.linalg.LinAlgError where H is not positive definite.
    """
    _, x, info = lapack.dposv(H, right)
    if info != 0:
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    out: Array = x
    return out


def solve_positive(S: Array, right: Array) -> Array | None:
    """S x = right for a symmetric positive definite S; None where it is not."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(S), 1e-300))
    factor, info = lapack.dpotrf(S * scale[:, None] * scale[None, :], lower=1)
    if info != 0:
        return None
    x, info = lapack.dpotrs(factor, right * scale if right.ndim == 1 else right * scale[:, None], lower=1)
    if info != 0:
        return None
    out: Array = x * (scale if right.ndim == 1 else scale[:, None])
    return out
