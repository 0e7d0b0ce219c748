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


def joint_covariance(clicks: Sequence[PinClick], spots: Sequence[object]) -> Array:
    """(3 N, 3 N), m^2, east, north, up, of N clicks with a covariance; `spots` says which are of the same thing.

    With the pointing errors, which nobody shares. What rounding and the approximations of (9.15) make negative is zero.
    """
    n = len(clicks)
    out = np.zeros((3 * n, 3 * n))
    pointing = np.zeros_like(out)
    for i, a in enumerate(clicks):
        at = slice(3 * i, 3 * i + 3)
        assert a.covariance_enu_m2 is not None
        out[at, at] = a.covariance_enu_m2
        if a.errors is not None:
            pointing[at, at] = a.errors.pointing_cov_m2
        for j in range(i):
            cross = cross_covariance(clicks[j], a, is_same_spot=spots[j] == spots[i])
            out[3 * j : 3 * j + 3, at] = cross
            out[at, 3 * j : 3 * j + 3] = cross.T
    if n > 1:
        values, vectors = np.linalg.eigh(out)
        if values[0] < 0.0:
            out = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return out + pointing


def cross_covariance(one: PinClick, two: PinClick, *, is_same_spot: bool) -> Array:
    """(3, 3) between the answers of two clicks, without their pointing. (17.1)"""
    a, b = one.errors, two.errors
    if a is None or b is None:
        return np.zeros((3, 3))
    is_same_session = (one.vehicle, one.session) == (two.vehicle, two.session)
    out = np.zeros((3, 3))
    if is_same_session:
        J1, J2 = position_jacobian(a, a.offset_enu_m), position_jacobian(b, b.offset_enu_m)
        out = J1 @ common_cross_covariance(a, b) @ J2.T
    if is_same_spot:
        alike = a.between_features * b.between_features
        if is_same_session:
            alike += overlap(a, b) * a.feature_noise * b.feature_noise
            out = out + symmetric_root(_rest(one)) @ symmetric_root(_rest(two))
        out = out + alike * np.outer(a.offset_enu_m, b.offset_enu_m)
    return out


def _rest(click: PinClick) -> Array:
    """What a click's covariance has beyond the linear terms: the curvature of (9.17)."""
    e = click.errors
    assert e is not None and click.covariance_enu_m2 is not None
    J = position_jacobian(e, e.offset_enu_m)
    own = e.between_features**2 + e.feature_noise**2
    rest: Array = click.covariance_enu_m2 - J @ e.common_cov @ J.T - own * np.outer(e.offset_enu_m, e.offset_enu_m)
    return rest
