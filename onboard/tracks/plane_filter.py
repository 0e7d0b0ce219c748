"""Speed and course of a thing over the ground, from how it moves against the ground about it. (22.10) to (22.17)

What is measured in a picture is the way from a piece of ground where the thing once was to the thing, both through the
same picture's set: the pose's errors are the same at both ends and drop out but for how they stretch and turn the way,
which `Locator.difference_covariance` states and no number of pictures averages. How much a thing accelerates is not
assumed: several constants run side by side and are weighed by how well they foretell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Spectral densities of the acceleration, m^2/s^3: a walker who goes straight, one who does not, a car in traffic and in
# a bend.
DENSITIES = (0.02, 0.2, 2.0, 20.0)
FORGET_S = 5.0  # over which it is forgotten how well each has foretold
FIRST_SPEED_M_S = 12.0  # one sigma, of either component
HEIGHT_SIGMA_M = 0.8  # of what is followed of a thing above its ground
DRIFT_PX = 0.2  # a root of a second: how far the box wanders over the thing, and the ground's motion is misjudged
GATE = 18.4  # of the squared innovation, chi-square with 2 degrees of freedom at 1e-4, above which it is no measurement
MISSED_IN_A_ROW = 3  # after so many they are believed
MOVES = 13.8  # of the squared speed over its covariance, at 1e-3, above which a thing moves
LEAST_SPEED_M_S = 0.2  # below which a thing stands


@dataclass(frozen=True, eq=False)
class Motion:
    """Velocity east and north (2,), m/s, and its covariance; whether the thing moves at all."""

    velocity_m_s: Array
    cov: Array

    @property
    def is_moving(self) -> bool:
        """(22.17): whether it is no thing at rest."""
        v = self.velocity_m_s
        return bool(self.speed_m_s > LEAST_SPEED_M_S and v @ np.linalg.solve(self.cov, v) > MOVES)

    @property
    def speed_m_s(self) -> float:
        """Over the ground."""
        return float(np.hypot(*self.velocity_m_s))

    @property
    def sigma_speed_m_s(self) -> float:
        """One sigma along the way; across it too where that is not known."""
        speed = self.speed_m_s
        if speed < 1e-6:
            return math.sqrt(0.5 * float(np.trace(self.cov)))
        along = self.velocity_m_s / speed
        return math.sqrt(float(along @ self.cov @ along))

    @property
    def course_deg(self) -> float:
        """Clockwise from north, in [0, 360)."""
        return math.degrees(math.atan2(self.velocity_m_s[0], self.velocity_m_s[1])) % 360.0

    @property
    def sigma_course_deg(self) -> float:
        """One sigma, at most half a turn."""
        speed = max(self.speed_m_s, 1e-6)
        across = np.array([self.velocity_m_s[1], -self.velocity_m_s[0]]) / speed
        return min(math.degrees(math.sqrt(float(across @ self.cov @ across)) / speed), 180.0)


class _Kalman:
    """One constant of acceleration. State: way from the landmark (2), velocity (2), height above the ground."""

    def __init__(self, density: float, slant: Array, noise: Array) -> None:
        self._q = density
        self.x = np.zeros(5)
        self.P = np.diag([0.0, 0.0, FIRST_SPEED_M_S**2, FIRST_SPEED_M_S**2, HEIGHT_SIGMA_M**2])
        self.P[:2, :2] = noise + HEIGHT_SIGMA_M**2 * np.outer(slant, slant)
        self.P[:2, 4] = self.P[4, :2] = -(HEIGHT_SIGMA_M**2) * slant
        self.log_weight = 0.0

    def predict(self, dt: float, drift_m2: float) -> None:
        """(22.12)"""
        F = np.eye(5)
        F[0, 2] = F[1, 3] = dt
        Q = np.zeros((5, 5))
        Q[:4, :4] = self._q * np.kron(np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]]), np.eye(2))
        Q[0, 0] += drift_m2 * dt
        Q[1, 1] += drift_m2 * dt
        self.x, self.P = F @ self.x, F @ self.P @ F.T + Q

    def innovation(self, way_m: Array, slant: Array, noise: Array) -> tuple[Array, Array, Array]:
        """Of a measurement (22.11): itself, its covariance, and the measurement's matrix (2, 5)."""
        H = np.zeros((2, 5))
        H[0, 0] = H[1, 1] = 1.0
        H[:, 4] = slant
        return way_m - H @ self.x, H @ self.P @ H.T + noise, H

    def update(self, way_m: Array, slant: Array, noise: Array, kept: float) -> None:
        """`kept`: the share of what was known of its foretelling that is not forgotten. (22.13), (22.14)"""
        off, S, H = self.innovation(way_m, slant, noise)
        self.log_weight = (
            kept * self.log_weight
            - 0.5 * float(off @ np.linalg.solve(S, off))
            - 0.5 * math.log(float(np.linalg.det(S)))
        )
        K = np.linalg.solve(S, H @ self.P).T
        left = np.eye(5) - K @ H
        self.x, self.P = self.x + K @ off, left @ self.P @ left.T + K @ noise @ K.T


class PlaneFilter:
    """Fed with each picture's way (m, east and north) from the landmark to the thing."""

    def __init__(self, slant: Array, noise: Array) -> None:
        self._models = [_Kalman(density, slant, noise) for density in DENSITIES]
        self._shared = np.zeros((2, 2))
        self._missed = 0

    def predict(self, dt: float, m_px: float) -> None:
        """`dt` seconds on; `m_px`: metres a pixel on the ground."""
        for model in self._models:
            model.predict(dt, (DRIFT_PX * m_px) ** 2)

    def update(self, way_m: Array, slant: Array, noise: Array, dt: float) -> bool:
        """Take a measurement, `dt` after the last: `slant` (2,) is the horizontal offset from the camera over the
        height, `noise` (2, 2) what of it is this picture's own. Whether it was believed.
        """
        off, S, _ = self._models[-1].innovation(way_m, slant, noise)  # by the one that foretells the least
        if float(off @ np.linalg.solve(S, off)) > GATE and self._missed < MISSED_IN_A_ROW:
            self._missed += 1
            return False
        self._missed = 0
        kept = math.exp(-dt / FORGET_S)
        for model in self._models:
            model.update(way_m, slant, noise, kept)
        return True

    def new_landmark(self, way_m: Array) -> None:
        """(22.15): ways count from where the thing was just seen, `way_m` (2,) from the old landmark."""
        for model in self._models:
            model.x[:2] -= way_m

    def forget_place(self, slant: Array, noise: Array) -> None:
        """As `new_landmark`, where the old one was lost: the way is known no more, the velocity is."""
        for model in self._models:
            model.x[:2] = 0.0
            model.P[:2, :] = 0.0
            model.P[:, :2] = 0.0
            model.P[:2, :2] = noise + model.P[4, 4] * np.outer(slant, slant)
            model.P[:2, 4] = model.P[4, :2] = -model.P[4, 4] * slant

    def stretched(self, way_cov: Array, since_s: float) -> None:
        """(22.16): what the poses' common errors do to a velocity: `way_cov` (2, 2) is of a way of `since_s`."""
        self._shared = way_cov / since_s**2

    def ahead(self, dt: float) -> Array:
        """Covariance (2, 2), m^2, of how far the thing will be from where its velocity takes it in `dt` seconds."""
        density = sum(w * q for w, q in zip(self._weights(), DENSITIES, strict=True))
        out: Array = self.motion.cov * dt**2 + float(density) * dt**3 / 3.0 * np.eye(2)
        return out

    def _weights(self) -> Array:
        logs = np.array([model.log_weight for model in self._models])
        weights: Array = np.exp(logs - logs.max())
        weights /= weights.sum()
        return weights

    @property
    def motion(self) -> Motion:
        """All models' velocities, by weight."""
        weights = self._weights()
        mean = sum(w * m.x[2:4] for w, m in zip(weights, self._models, strict=True))
        cov = sum(
            w * (m.P[2:4, 2:4] + np.outer(m.x[2:4] - mean, m.x[2:4] - mean))
            for w, m in zip(weights, self._models, strict=True)
        )
        return Motion(np.asarray(mean, float), np.asarray(cov, float) + self._shared)
