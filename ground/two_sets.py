"""The vector between clicks of two sets of one session: how much of their errors is the same.

Each set states how the slow errors act on its nine common states, one column of F for each nuisance parameter. Two sets
share these as far as they last, so with their correlations P the common states' covariance between sets a and b is

    X = F_a P F_b' + fresh

What is left of each set's covariance is fresh, and shared as far as the pictures behind both sets are the same.
Equations (9.13) to (9.15) of docs/mathematics.md.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contract.answer import Fix
from contract.error_correlation import LEAST_SPAN_S, Span, slow_error_correlations
from contract.feature_set import COMMON_STATES, GROUND, NUISANCES, FeatureSet, SharedErrors
from contract.geodesy import LocalFrame
from contract.rotations import skew

Array = NDArray[np.float64]


class SetErrors(Protocol):
    """The fields by which two sets are compared: of a FeatureSet, or of what is kept of one with a click."""

    @property
    def session(self) -> int: ...
    @property
    def capture_unix_ns(self) -> int: ...
    @property
    def camera_lat_deg(self) -> float: ...
    @property
    def camera_lon_deg(self) -> float: ...
    @property
    def camera_height_m(self) -> float: ...
    @property
    def R_enu_cam(self) -> Array: ...
    @property
    def common_cov(self) -> Array: ...
    @property
    def shared(self) -> SharedErrors: ...


def difference_covariance(one: FeatureSet, fix_one: Fix, two: FeatureSet, fix_two: Fix) -> Array:
    """Covariance (3, 3), m^2, of the vector between clicks of two different sets, in the first's ENU axes.

    Sets of other vehicles or sessions share nothing.
    """
    total: Array = fix_one.covariance_enu_m2 + fix_two.covariance_enu_m2
    if (one.vehicle, one.session) != (two.vehicle, two.session):
        return total
    J1, J2 = position_jacobian(one, fix_one.offset_enu_m), position_jacobian(two, fix_two.offset_enu_m)
    cross = J1 @ common_cross_covariance(one, two) @ J2.T
    # Rounding, and a fix made on another revision of its set, may leave too little.
    values, vectors = np.linalg.eigh(total - cross - cross.T)
    out: Array = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return out


def common_cross_covariance(one: SetErrors, two: SetErrors) -> Array:
    """Covariance (9, 9) between the common states of two sets of a session."""
    if two.capture_unix_ns < one.capture_unix_ns:
        return common_cross_covariance(two, one).T
    F1, F2 = one.shared.by_nuisance, two.shared.by_nuisance
    slow = (F1 * nuisance_correlations(one, two)) @ F2.T
    share = overlap(one, two)
    if share == 0.0:
        return slow
    R1, R2 = one.common_cov - F1 @ F1.T, two.common_cov - F2 @ F2.T
    M = _transport(one, two)
    moved = M @ R1 @ M.T
    # Symmetric roots, in units of both sets' own sigmas: equal errors are taken as fully correlated.
    scale = np.sqrt(np.maximum(np.diag(moved) * np.diag(R2), 0.0) ** 0.5)
    scale = np.where(scale > 0.0, scale, 1.0)
    both = (
        symmetric_root(moved / np.outer(scale, scale))
        @ symmetric_root(R2 / np.outer(scale, scale))
        * np.outer(scale, scale)
    )
    return slow + share * np.linalg.solve(M, both)


def covariance_between_sessions(one: SetErrors, two: SetErrors, is_one_vehicle: bool) -> Array:
    """Covariance (9, 9) between the common states of sets of two sessions, at most: of one place's ground, and with
    that of one vehicle's receiver, attitude, mount and clock. (17.8)
    """
    correlations = np.zeros(NUISANCES)
    if is_one_vehicle:
        later_s = (two.capture_unix_ns - one.capture_unix_ns) / 1e9
        correlations = slow_error_correlations(one.shared, _about(one, 0.0), two.shared, _about(two, later_s))
    correlations[GROUND] = 1.0
    out: Array = (one.shared.by_nuisance * correlations) @ two.shared.by_nuisance.T
    return out


def overlap(one: SetErrors, two: SetErrors) -> float:
    """The share, 0 to 1, of pictures common to the windows of two sets of a session: o of (9.15)."""
    a, b = _span(one), _span(two)
    return max(min(a[1], b[1]) - max(a[0], b[0]), 0.0) / math.sqrt((a[1] - a[0]) * (b[1] - b[0]))


def nuisance_correlations(one: SetErrors, two: SetErrors) -> Array:
    """(NUISANCES,) between the two sets' nuisance parameters. (9.13)"""
    return slow_error_correlations(one.shared, _span(one), two.shared, _span(two))


def _span(s: SetErrors) -> Span:
    """First and last moment behind a set, s after its session began; at least a little apart."""
    return _about(s, (s.capture_unix_ns - s.session * 1_000_000_000) / 1e9)


def _about(s: SetErrors, at: float) -> Span:
    """The same about the moment at which its picture was taken."""
    first, last = at + s.shared.span_s[0], at + s.shared.span_s[1]
    grow = max(LEAST_SPAN_S - (last - first), 0.0) / 2.0
    return first - grow, last + grow


def _transport(one: SetErrors, two: SetErrors) -> Array:
    """The matrix that maps the first set's common states to the second's camera. (9.14)"""
    d = LocalFrame(one.camera_lat_deg, one.camera_lon_deg, one.camera_height_m).to_enu(
        two.camera_lat_deg, two.camera_lon_deg, two.camera_height_m
    )
    M = np.eye(COMMON_STATES)
    M[:3, 3:6] = -skew(d)
    M[:3, 6] = -d
    M[7:, 7:] = (two.R_enu_cam.T @ one.R_enu_cam)[:2, :2]
    return M


def symmetric_root(covariance: Array) -> Array:
    """The symmetric root of a covariance; what rounding made negative in it is zero."""
    values, vectors = np.linalg.eigh(covariance)
    out: Array = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return out


def position_jacobian(s: SetErrors, offset_enu_m: Array) -> Array:
    """d X / d common states, (3, 9), of a point so far from the set's camera. (9.9)"""
    X = offset_enu_m
    x, y, z = s.R_enu_cam.T @ X
    return np.concatenate([np.eye(3), -skew(X), -np.outer(X, [1.0, x / z, y / z])], axis=1)
