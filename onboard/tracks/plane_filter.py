"""Speed and course of a thing over the ground, from how it moves against the ground about it. (24.10) to (24.17)

What is measured in a picture is the way from the piece of ground where the thing was seen before to the thing, both
through the same picture's set: the pose's errors are the same at both ends and drop out but for how they stretch and
turn the way, which `Locator.difference_covariance` states and no number of pictures averages. How much a thing
accelerates, and how far the pictures' own errors are from what their sharpness suggests, is not assumed: several
constants of each run side by side and are weighed by how well they predict, along its way and across it.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numpy.typing import NDArray

from contract.velocity import Velocity

Array = NDArray[np.float64]

# Spectral densities of the acceleration, m^2/s^3: a walker who goes straight, one who does not, a car in traffic and in
# a bend.
DENSITIES = (0.002, 0.02, 0.2, 2.0, 20.0)
# Of the variance of a measurement: of a thing that is found exactly, and of one hardly found.
SCALES = (1.0 / 64.0, 1.0 / 16.0, 0.25, 1.0)
FORGET_S = 5.0  # over which it is forgotten how well each has predicted
FIRST_SPEED_M_S = 12.0  # one sigma, of either component
HEIGHT_SIGMA_M = 0.8  # of what is followed of a thing above its ground
DRIFT_PX = 0.2  # a root of a second: how far the box drifts over the thing, and the ground's motion is misjudged
GATE = 18.4  # of the squared innovation, chi-square with 2 degrees of freedom at 1e-4, above which it is no measurement
MISSED_IN_A_ROW = 3  # after so many they are accepted
MOVES = 13.8  # of the squared speed over its covariance, at 1e-3, above which a thing moves
LEAST_SPEED_M_S = 0.2  # below which a thing stands


class Motion(Velocity):
    """The velocity of a thing that may be at rest."""

    @property
    def is_moving(self) -> bool:
        """True if it cannot be a thing at rest. (24.17)"""
        v = self.velocity_m_s
        return bool(self.speed_m_s > LEAST_SPEED_M_S and v @ np.linalg.solve(self.cov, v) > MOVES)


class PlaneFilter:
    """Fed with each picture's way (m, east and north) from the landmark to the thing.

    Of each model the state (5,): way from the landmark (2), velocity (2), height of what is followed above the ground.
    `slant` (2,) is the horizontal offset from the camera over the height; `noise` (2, 2) what of a way is this
    picture's own.
    """

    def __init__(self, slant: Array, noise: Array) -> None:
        self._scale, self._q = np.array(list(product(SCALES, DENSITIES))).T
        self._x = np.zeros((len(self._q), 5))
        self._P = np.zeros((len(self._q), 5, 5))
        self._P[:, 2, 2] = self._P[:, 3, 3] = FIRST_SPEED_M_S**2
        self._P[:, 4, 4] = HEIGHT_SIGMA_M**2
        self._log_weight = np.zeros((len(self._q), 2))  # along its way, and across it
        self._axes = np.eye(2)  # unit vectors, rows: along its way, and across it
        self._shared = np.zeros((2, 2))
        self._missed = 0
        self.forget_place(slant, noise)

    def predict(self, dt: float, m_px: float) -> None:
        """`dt` seconds on; `m_px`: metres a pixel on the ground. (24.12)"""
        F = np.eye(5)
        F[0, 2] = F[1, 3] = dt
        self._x = self._x @ F.T
        self._P = F @ self._P @ F.T
        for i in (0, 1):
            self._P[:, i, i] += self._q * dt**3 / 3.0 + (DRIFT_PX * m_px) ** 2 * dt
            self._P[:, i, i + 2] += self._q * dt**2 / 2.0
            self._P[:, i + 2, i] += self._q * dt**2 / 2.0
            self._P[:, i + 2, i + 2] += self._q * dt

    def update(self, way_m: Array, slant: Array, noise: Array, dt: float) -> bool:
        """Take a measurement, `dt` after the last. Whether it was accepted. (24.11), (24.13), (24.14)"""
        H = np.zeros((2, 5))
        H[0, 0] = H[1, 1] = 1.0
        H[:, 4] = slant
        off = way_m - self._x @ H.T  # (M, 2)
        HP = H @ self._P
        R = self._scale[:, None, None] * noise
        S = HP @ H.T + R
        squared = np.einsum("mi,mi->m", off, np.linalg.solve(S, off[..., None])[..., 0])
        if squared[-1] > GATE and self._missed < MISSED_IN_A_ROW:  # by the one that predicts the least
            self._missed += 1
            return False
        self._missed = 0
        spread = (self._axes @ S @ self._axes.T)[:, (0, 1), (0, 1)]
        self._log_weight = math.exp(-dt / FORGET_S) * self._log_weight
        self._log_weight -= 0.5 * ((off @ self._axes.T) ** 2 / spread + np.log(spread))
        K = np.linalg.solve(S, HP).transpose(0, 2, 1)
        left = np.eye(5) - K @ H
        self._x = self._x + (K @ off[..., None])[..., 0]
        self._P = left @ self._P @ left.transpose(0, 2, 1) + K @ R @ K.transpose(0, 2, 1)
        self._x[:, :2] -= way_m
        self._turn_axes()
        return True

    def forget_place(self, slant: Array, noise: Array) -> None:
        """(24.15) where the old landmark was lost: the thing is seen at 0, so that its way is -h s; velocity and height
        stay what they are.
        """
        rest = -slant[:, None] * self._P[:, 4, None, 2:]  # what the way shares with velocity and height
        own = self._scale[:, None, None] * noise + np.outer(slant, slant) * self._P[:, 4, 4, None, None]
        self._x[:, :2] = -self._x[:, 4:] * slant
        self._P[:, :2, :2] = own
        self._P[:, :2, 2:], self._P[:, 2:, :2] = rest, rest.transpose(0, 2, 1)

    def stretched(self, way_cov: Array, since_s: float) -> None:
        """(24.16): what the poses' common errors do to a velocity: `way_cov` (2, 2) is of a way of `since_s`."""
        self._shared = way_cov / since_s**2

    def ahead(self, dt: float) -> Array:
        """Covariance (2, 2), m^2, of how far the thing will be from where its velocity takes it in `dt` seconds."""
        q = float(self._q @ self._weights()[:, 0])
        return self.motion.cov * dt**2 + q * dt**3 / 3.0 * np.eye(2)

    def _weights(self) -> Array:
        """Return the models' weights (M, 2), along its way and across it; how it accelerates is shared. (24.14)"""
        by_axis = np.exp(self._log_weight - self._log_weight.max(axis=0)).reshape(len(SCALES), len(DENSITIES), 2)
        weights = (by_axis * by_axis.sum(axis=0)[:, ::-1]).reshape(-1, 2)
        return np.asarray(weights / weights.sum(axis=0), float)

    def _turn_axes(self) -> None:
        """Along its way, as far as that is known, and across it."""
        east, north = (self._weights() * (self._x[:, 2:4] @ self._axes.T)).sum(axis=0) @ self._axes
        speed = math.hypot(east, north)
        if speed > 0.0:
            self._axes = np.array([[east, north], [north, -east]]) / speed

    @property
    def motion(self) -> Motion:
        """All models' velocities, by weight. (24.16)"""
        weights, axes = self._weights(), self._axes
        v = self._x[:, 2:4] @ axes.T
        mean, root = (weights * v).sum(axis=0), np.sqrt(weights)
        off = root * (v - mean)
        cov = off.T @ off + (root[:, :, None] * (axes @ self._P[:, 2:4, 2:4] @ axes.T) * root[:, None, :]).sum(axis=0)
        return Motion(np.asarray(mean @ axes, float), np.asarray(axes.T @ cov @ axes + self._shared, float))
