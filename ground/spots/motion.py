"""Place and motion of a thing from its places in the pictures of one session. Equations (26.1) to (26.6).

A place's error has three parts: one that all pictures of the session share, one that all spots of its picture share and
that lasts for some seconds, and its own. Only the last becomes less with the number of pictures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PICTURE_TIME_S = 10.0  # for which errors of neighbouring pictures are the same: they rest on the same window of them
STANDING_SPEED_M_S, WALKING_SPEED_M_S = 0.0, 1.5  # one sigma, along each axis, of the speed that a thing begins with
LEAST_SHARE = 1e-3  # of a place's covariance, that each of what the picture shares and what it does not share has
SEES = np.hstack([np.eye(2), np.zeros((2, 2)), np.eye(2)])  # (2, 6) of a state the place that a picture shows
WALKING_M_S2 = 0.15  # white acceleration, m/s^2 over the root of a hertz


@dataclass(frozen=True, eq=False)
class Sighting:
    """A spot's place in one picture: east, north (2,), m, and its error's three parts (2, 2): covariances, of what the
    session shares a root, m.
    """

    at_s: float
    place_m: Array
    session_root_m: Array
    picture_m2: Array
    own_m2: Array

    @classmethod
    def of(
        cls, at_s: float, place_m: Array, covariance_m2: Array, picture_share: float, session_share: float
    ) -> Sighting:
        """Split a covariance (2, 2) by the shares of it that are not the spot's own. (26.1)"""
        values, vectors = np.linalg.eigh(covariance_m2)
        root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
        session = min(max(session_share, 0.0), 1.0)
        whole, shared = np.asarray(covariance_m2, float), min(max(picture_share, session), 1.0)
        # A place is no better than it is stated: the shares are rounded.
        picture, own = max(shared - session, LEAST_SHARE), max(1.0 - shared, LEAST_SHARE)
        return cls(at_s, np.asarray(place_m, float), math.sqrt(session) * root, picture * whole, own * whole)

    @property
    def covariance_m2(self) -> Array:
        """The covariance (2, 2) of the whole error."""
        return self.session_root_m @ self.session_root_m.T + self.picture_m2 + self.own_m2


class Motion:
    """A filter of place (2), speed (2) and the slow error of the newest picture (2); east, north.

    What the session shares is considered, not estimated: `shared_m` is how it acts on the state. With a first speed of
    none the thing stands, for certain and for ever.
    """

    def __init__(self, first: Sighting, sigma_speed_m_s: float) -> None:
        self.at_s = self.began_s = first.at_s
        self._is_moving = sigma_speed_m_s > 0.0
        self._state = np.concatenate([first.place_m, np.zeros(4)])
        self._P = np.zeros((6, 6))
        self._picture_m2 = slow = first.picture_m2
        self._P[:2, :2] = first.own_m2 + slow
        self._P[2:4, 2:4] = sigma_speed_m_s**2 * np.eye(2)
        self._P[4:, 4:] = slow
        self._P[:2, 4:] = self._P[4:, :2] = -slow
        self._shared = np.vstack([first.session_root_m, np.zeros((4, 2))])
        self.count = 1

    def _before(self, seen: Sighting) -> tuple[Array, Array, Array]:
        """State (6,), its covariance (6, 6) without the shared part, and how that part acts on it (6, 2), when one more
        place is seen.
        """
        dt = max(seen.at_s - self.at_s, 0.0)
        F = np.eye(6)
        F[0, 2] = F[1, 3] = dt
        F[4:, 4:] = kept = math.exp(-dt / PICTURE_TIME_S) * _in_common(self._picture_m2, seen.picture_m2)
        Q = np.zeros((6, 6))
        if self._is_moving:
            q = WALKING_M_S2**2
            for k in range(2):
                Q[k, k], Q[k, k + 2], Q[k + 2, k], Q[k + 2, k + 2] = q * dt**3 / 3, q * dt**2 / 2, q * dt**2 / 2, q * dt
        Q[4:, 4:] = seen.picture_m2 - kept @ self._picture_m2 @ kept.T
        return F @ self._state, F @ self._P @ F.T + Q, F @ self._shared

    def distance2(self, seen: Sighting) -> float:
        """Squared Mahalanobis distance of a place of the same session: what both share takes no part. (26.4)"""
        innovation, S = self._innovation(seen)
        return float(innovation @ np.linalg.solve(S, innovation))

    def take(self, seen: Sighting) -> float:
        """One more place of the same thing; returns -2 ln of how likely it was there, but for a constant. (26.2),
        (26.3)
        """
        innovation, S = self._innovation(seen)
        state, P, shared = self._before(seen)
        # The gain is that of the part that is estimated; the shared part goes through it.
        C = SEES @ P @ SEES.T + seen.own_m2
        K = np.linalg.solve(C, SEES @ P).T
        A = np.eye(6) - K @ SEES
        self._state = state + K @ innovation
        self._P = A @ P @ A.T + K @ seen.own_m2 @ K.T
        self._shared = A @ shared + K @ seen.session_root_m
        self.at_s, self._picture_m2 = max(self.at_s, seen.at_s), seen.picture_m2
        self.count += 1
        return float(innovation @ np.linalg.solve(S, innovation)) + float(np.log(np.linalg.det(S)))

    @property
    def place_m(self) -> Array:
        """(2,) at its newest sighting."""
        return self._state[:2]

    @property
    def covariance_m2(self) -> Array:
        """(2, 2) of the place, with all that is shared. (26.5)"""
        out: Array = self.own_covariance_m2 + self.shared_root_m @ self.shared_root_m.T
        return out

    @property
    def own_covariance_m2(self) -> Array:
        """(2, 2) of the place, without what the session shares."""
        return self._P[:2, :2]

    @property
    def shared_root_m(self) -> Array:
        """(2, 2): the root of what the session shares, as it acts on the place."""
        return self._shared[:2]

    @property
    def velocity_m_s(self) -> Array:
        """(2,) east, north."""
        return self._state[2:4]

    @property
    def velocity_covariance(self) -> Array:
        """(2, 2), (m/s)^2."""
        out: Array = self._P[2:4, 2:4] + self._shared[2:4] @ self._shared[2:4].T
        return out

    def _innovation(self, seen: Sighting) -> tuple[Array, Array]:
        """The innovation (2,) of a place, and its covariance (2, 2)."""
        state, P, shared = self._before(seen)
        common = SEES @ shared - seen.session_root_m
        return seen.place_m - SEES @ state, SEES @ P @ SEES.T + seen.own_m2 + common @ common.T


def _in_common(before_m2: Array, now_m2: Array) -> Array:
    """The part (2, 2) of a picture's slow error that is in the next one's, by their covariances. (26.2)

    Along each direction the surer of the two is in the other, which has more of its own: were the wider one the same
    error but larger, the difference between two places would show it, and lead away from both.
    """
    L = np.linalg.cholesky(before_m2)
    half = np.linalg.solve(L, now_m2)
    values, V = np.linalg.eigh(np.linalg.solve(L, half.T))
    out: Array = L @ V * np.minimum(values, 1.0) @ np.linalg.inv(L @ V)
    return out
