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
    for i, a in enumerate(clicks):
        at = slice(3 * i, 3 * i + 3)
        assert a.covariance_enu_m2 is not None
        apart[at, at] = alike[at, at] = a.covariance_enu_m2
        if a.errors is not None:
            pointing[at, at] = a.errors.pointing_cov_m2
        for j in range(i):
            other = slice(3 * j, 3 * j + 3)
            common = _from_common(clicks[j], a)
            own = _own_alike(clicks[j], a) if spots[j] == spots[i] else np.zeros((3, 3))
            apart[other, at], alike[other, at] = common, common + own
            apart[at, other], alike[at, other] = apart[other, at].T, alike[other, at].T
    return _positive(apart) + pointing, _positive(alike) + pointing


def _positive(covariance: Array) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    if values[0] >= 0.0:
        return covariance
    out: Array = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return out


def _from_common(one: PinClick, two: PinClick) -> Array:
    """(3, 3) between two clicks' answers, by what their sets share. (17.1)"""
    a, b = one.errors, two.errors
    if a is None or b is None or (one.vehicle, one.session) != (two.vehicle, two.session):
        return np.zeros((3, 3))
    J1, J2 = position_jacobian(a, a.offset_enu_m), position_jacobian(b, b.offset_enu_m)
    out: Array = J1 @ common_cross_covariance(a, b) @ J2.T
    return out


def _own_alike(one: PinClick, two: PinClick) -> Array:
    """(3, 3) between two clicks of one thing, by what each adds itself, as far as that may be alike. (17.1)"""
    a, b = one.errors, two.errors
    if a is None or b is None:
        return np.zeros((3, 3))
    out = np.zeros((3, 3))
    by_depth = a.between_features * b.between_features
    if (one.vehicle, one.session) == (two.vehicle, two.session):
        by_depth += overlap(a, b) * a.feature_noise * b.feature_noise
        out = symmetric_root(_rest(one)) @ symmetric_root(_rest(two))
    return out + by_depth * np.outer(a.offset_enu_m, b.offset_enu_m)


def _rest(click: PinClick) -> Array:
    """What a click's covariance has beyond the linear terms: the curvature of (9.17)."""
    e = click.errors
    assert e is not None and click.covariance_enu_m2 is not None
    J = position_jacobian(e, e.offset_enu_m)
    own = e.between_features**2 + e.feature_noise**2
    rest: Array = click.covariance_enu_m2 - J @ e.common_cov @ J.T - own * np.outer(e.offset_enu_m, e.offset_enu_m)
    return rest
