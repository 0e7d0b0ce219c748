"""How the errors of clicks go together: their joint covariance. Equation (17.1) of docs/mathematics.md."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ground.pins.model import PinClick
from ground.two_sets import common_cross_covariance, overlap, position_jacobian, symmetric_root

Array = NDArray[np.float64]

# Clicks, and ties, that are as stated disagree by more than is believed once in so many times.
CONTRADICTION = 1e-3


def joint_covariances(clicks: Sequence[PinClick], spots: Sequence[object]) -> tuple[Array, Array]:
    """(3 N, 3 N) twice, m^2, east, north, up, of N clicks with a covariance; `spots` says which are of the same thing.

    What clicks of one thing add by themselves may be alike in them or not: as if it were not, then as if it were. With
    the pointing errors, which nobody shares. What rounding and the approximations of (9.15) make negative is zero.
    """
    n = len(clicks)
    apart = np.zeros((3 * n, 3 * n))
    alike = np.zeros_like(apart)
    pointing = np.zeros_like(apart)
    roots = [np.zeros((3, 3)) if c.errors is None else symmetric_root(_rest(c)) for c in clicks]
    Js = [np.zeros((3, 9)) if c.errors is None else position_jacobian(c.errors, c.errors.offset_enu_m) for c in clicks]
    for i, a in enumerate(clicks):
        at = slice(3 * i, 3 * i + 3)
        assert a.covariance_enu_m2 is not None
        apart[at, at] = alike[at, at] = a.covariance_enu_m2
        if a.errors is not None:
            pointing[at, at] = a.errors.pointing_cov_m2
        for j in range(i):
            other = slice(3 * j, 3 * j + 3)
            if (one := clicks[j].errors) is None or (two := a.errors) is None:
                continue
            is_one_session = (clicks[j].vehicle, clicks[j].session) == (a.vehicle, a.session)
            common = Js[j] @ common_cross_covariance(one, two) @ Js[i].T if is_one_session else np.zeros((3, 3))
            own = np.zeros((3, 3))
            if spots[j] == spots[i]:
                # What lies between the features is the ground's, whoever looks; their noise, the window's.
                by_depth = one.between_features * two.between_features
                if is_one_session:
                    by_depth += overlap(one, two) * one.feature_noise * two.feature_noise
                    own = roots[j] @ roots[i]
                own = own + by_depth * np.outer(one.offset_enu_m, two.offset_enu_m)
            apart[other, at], alike[other, at] = common, common + own
            apart[at, other], alike[at, other] = apart[other, at].T, alike[other, at].T
    return _positive(apart) + pointing, _positive(alike) + pointing


def _positive(covariance: Array) -> Array:
    """The nearest covariance without negative eigenvalues; rounding is passed over."""
    try:
        np.linalg.cholesky(covariance + 1e-9 * np.diag(np.diag(covariance)))
        return covariance
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(covariance)
    out: Array = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return out


def _rest(click: PinClick) -> Array:
    """What a click's covariance has beyond the linear terms: the curvature of (9.17)."""
    e = click.errors
    assert e is not None and click.covariance_enu_m2 is not None
    J = position_jacobian(e, e.offset_enu_m)
    own = e.between_features**2 + e.feature_noise**2
    rest: Array = click.covariance_enu_m2 - J @ e.common_cov @ J.T - own * np.outer(e.offset_enu_m, e.offset_enu_m)
    return rest
