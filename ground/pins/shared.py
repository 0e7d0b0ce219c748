"""The correlation of clicks' errors: their joint covariance. Equation (17.1) of docs/mathematics-pins.md."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ground.pins.model import ClickErrors, PinClick
from ground.two_sets import (
    common_cross_covariance,
    covariance_between_sessions,
    overlap,
    position_jacobian,
    symmetric_root,
)

Array = NDArray[np.float64]

# Clicks and ties with correct sigmas disagree by more than the accepted limit once in so many times.
CONTRADICTION = 1e-3

# Covariances between two sets that are kept, 700 bytes each: a pin that is clicked once more, and all pins of a picture
# after a tie, ask for the same ones again.
KEPT_PAIRS = 20_000


class _Pairs:
    """`common_cross_covariance`, computed once for two sets, with all that it depends on as the key. Of two sessions
    `covariance_between_sessions`. Thread-safe.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[bytes, bytes, bool, bool], Array] = OrderedDict()

    def of(
        self,
        one: ClickErrors,
        one_key: bytes,
        two: ClickErrors,
        two_key: bytes,
        is_one_session: bool = True,
        is_one_vehicle: bool = True,
    ) -> Array:
        """(9, 9)."""
        key = one_key, two_key, is_one_session, is_one_vehicle
        with self._lock:
            held = self._kept.get(key)
            if held is not None:
                self._kept.move_to_end(key)
                return held
        if is_one_session:
            made = common_cross_covariance(one, two)
        else:
            made = covariance_between_sessions(one, two, is_one_vehicle)
        with self._lock:
            self._kept[key] = made
            while len(self._kept) > KEPT_PAIRS:
                self._kept.popitem(last=False)
        return made


_PAIRS = _Pairs()


def _key(e: ClickErrors) -> bytes:
    """All of a click's set that `common_cross_covariance` reads, in 16 bytes."""
    s = e.shared
    numbers = (
        e.camera_lat_deg, e.camera_lon_deg, e.camera_height_m, s.position_time_s, s.attitude_time_s, *s.span_s,
    )  # fmt: skip
    digest = hashlib.blake2b(f"{e.session} {e.capture_unix_ns} {numbers!r}".encode(), digest_size=16)
    for array in (e.R_enu_cam, e.common_cov, s.by_nuisance, s.alignment_sigma):
        digest.update(np.asarray(array, np.float64).tobytes())
    return digest.digest()


def joint_covariances(clicks: Sequence[PinClick], spots: Sequence[object]) -> tuple[Array, Array]:
    """(3 N, 3 N) twice, m^2, east, north, up, of N clicks with a covariance; `spots`: which are of one thing.

    The own errors of clicks of one thing may be correlated or not: first as if they were not, then as if they were.
    With the pointing errors, which no two clicks share. What rounding and the approximations of (9.15) make negative
    is zero.
    """
    n = len(clicks)
    apart = np.zeros((3 * n, 3 * n))
    same = np.zeros_like(apart)
    pointing = np.zeros_like(apart)
    roots = [np.zeros((3, 3)) if c.errors is None else symmetric_root(_rest(c)) for c in clicks]
    Js = [np.zeros((3, 9)) if c.errors is None else position_jacobian(c.errors, c.errors.offset_enu_m) for c in clicks]
    keys = [b"" if c.errors is None else _key(c.errors) for c in clicks]
    for i, a in enumerate(clicks):
        at = slice(3 * i, 3 * i + 3)
        assert a.covariance_enu_m2 is not None
        apart[at, at] = same[at, at] = a.covariance_enu_m2
        if a.errors is not None:
            pointing[at, at] = a.errors.pointing_cov_m2
        for j in range(i):
            other = slice(3 * j, 3 * j + 3)
            if (one := clicks[j].errors) is None or (two := a.errors) is None:
                continue
            is_one_vehicle = clicks[j].vehicle == a.vehicle
            is_one_session = is_one_vehicle and clicks[j].session == a.session
            common = np.zeros((3, 3))
            if is_one_session:
                common = Js[j] @ _PAIRS.of(one, keys[j], two, keys[i]) @ Js[i].T
            own = np.zeros((3, 3))
            if spots[j] == spots[i]:
                # The error between the features belongs to the ground, for every observer; the features' noise to the
                # window.
                by_depth = one.between_features * two.between_features
                if is_one_session:
                    by_depth += overlap(one, two) * one.feature_noise * two.feature_noise
                    own = roots[j] @ roots[i]
                else:
                    own = Js[j] @ _PAIRS.of(one, keys[j], two, keys[i], False, is_one_vehicle) @ Js[i].T
                own = own + by_depth * np.outer(one.offset_enu_m, two.offset_enu_m)
            apart[other, at], same[other, at] = common, common + own
            apart[at, other], same[at, other] = apart[other, at].T, same[other, at].T
    return _positive(apart) + pointing, _positive(same) + pointing


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
    """The part of a click's covariance beyond the linear terms: the curvature of (9.17)."""
    e = click.errors
    assert e is not None and click.covariance_enu_m2 is not None
    J = position_jacobian(e, e.offset_enu_m)
    own = e.between_features**2 + e.feature_noise**2
    return click.covariance_enu_m2 - J @ e.common_cov @ J.T - own * np.outer(e.offset_enu_m, e.offset_enu_m)
