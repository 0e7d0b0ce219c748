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

from contract.track_age import ACCELERATION_M_S2
from contract.velocity import Velocity
from onboard.tracks.manner import UNSTEADY_S, on_both_axes, pushed, transition

Array = NDArray[np.float64]

# One sigma of the acceleration, m/s^2: of what goes evenly, of walkers, of cars in traffic, in a corner.
MANNERS = ACCELERATION_M_S2 * 5.0 ** np.arange(-3.0, 2.0)
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

    Of each model the state (7,): way from the landmark (2), velocity (2), acceleration (2), height of what is followed
    above the ground.
    `slant` (2,) is the horizontal offset from the camera over the height; `noise` (2, 2) what of a way is this
    picture's own.
    """

    def __init__(self, slant: Array, noise: Array) -> None:
        self._scale, self._manner = np.array(list(product(SCALES, MANNERS))).T
        self._x = np.zeros((len(self._manner), 7))
        self._P = np.zeros((len(self._manner), 7, 7))
        self._P[:, 2, 2] = self._P[:, 3, 3] = FIRST_SPEED_M_S**2
        self._P[:, 4, 4] = self._P[:, 5, 5] = self._manner**2
        self._P[:, 6, 6] = HEIGHT_SIGMA_M**2
        self._log_weight = np.zeros((len(self._manner), 2))  # along its way, and across it
        self._axes = np.eye(2)  # unit vectors, rows: along its way, and across it
        self._shared = np.zeros((2, 2))
        self._missed = 0
        self.forget_place(slant, noise)

    def predict(self, dt: float, m_px: float) -> None:
        """`dt` seconds on; `m_px`: metres a pixel on the ground. (24.12)"""
        F, g = np.eye(7), pushed(dt)
        F[:6, :6] = on_both_axes(transition(dt))
        push = np.outer(g, g)
        push[:2, :2] += UNSTEADY_S * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
        self._x = self._x @ F.T
        self._P = F @ self._P @ F.T
        self._P[:, :6, :6] += self._manner[:, None, None] ** 2 * on_both_axes(push)
        self._P[:, (0, 1), (0, 1)] += (DRIFT_PX * m_px) ** 2 * dt

    def update(self, way_m: Array, slant: Array, noise: Array, dt: float) -> bool:
        """Take a measurement, `dt` after the last. Whether it was accepted. (24.11), (24.13), (24.14)"""
        H = np.zeros((2, 7))
        H[0, 0] = H[1, 1] = 1.0
        H[:, 6] = slant
        off = way_m - self._x @ H.T  # (M, 2)
        HP = H @ self._P
        R = self._scale[:, None, None] * noise
        S = HP @ H.T + R
        squared = np.einsum("mi,mi->m", off, np.linalg.solve(S, off[..., None])[..., 0])
        if squared.min() > GATE and self._missed < MISSED_IN_A_ROW:
            self._missed += 1
            return False
        self._missed = 0
        spread = (self._axes @ S @ self._axes.T)[:, (0, 1), (0, 1)]
        self._log_weight = math.exp(-dt / FORGET_S) * self._log_weight
        self._log_weight -= 0.5 * ((off @ self._axes.T) ** 2 / spread + np.log(spread))
        K = np.linalg.solve(S, HP).transpose(0, 2, 1)
        left = np.eye(7) - K @ H
        self._x = self._x + (K @ off[..., None])[..., 0]
        self._P = left @ self._P @ left.transpose(0, 2, 1) + K @ R @ K.transpose(0, 2, 1)
        self._x[:, :2] -= way_m
        self._turn_axes()
        return True

    def forget_place(self, slant: Array, noise: Array) -> None:
        """(24.15) where the old landmark was lost: the thing is seen at 0, so that its way is -h s; velocity and height
        stay what they are.
        """
        rest = -slant[:, None] * self._P[:, 6, None, 2:]  # what the way shares with velocity and height
        own = self._scale[:, None, None] * noise + np.outer(slant, slant) * self._P[:, 6, 6, None, None]
        self._x[:, :2] = -self._x[:, 6:] * slant
        self._P[:, :2, :2] = own
        self._P[:, :2, 2:], self._P[:, 2:, :2] = rest, rest.transpose(0, 2, 1)

    def stretched(self, way_cov: Array, since_s: float) -> None:
        """(24.16): what the poses' common errors do to a velocity: `way_cov` (2, 2) is of a way of `since_s`."""
        self._shared = way_cov / since_s**2

    def ahead(self, dt: float) -> tuple[Array, Array]:
        """Return how far (2,), m, it goes in `dt` seconds, and the covariance (2, 2). (24.18)"""
        return self._in(dt, 0)

    def motion(self, dt: float = 0.0) -> Motion:
        """Return its velocity in `dt` seconds. (24.16)"""
        return Motion(*self._in(dt, 1))

    def _in(self, dt: float, row: int) -> tuple[Array, Array]:
        """Return the mean and covariance of a row of the transition, of place or velocity, in `dt` seconds. (24.18)"""
        T, unsteady = transition(dt)[row], UNSTEADY_S * (dt**3 / 3.0, dt)[row]
        by = np.concatenate([T[1] * np.eye(2), T[2] * np.eye(2)], axis=1)  # of velocity and acceleration
        push = self._manner**2 * (pushed(dt)[row] ** 2 + unsteady)
        P = by @ self._P[:, 2:6, 2:6] @ by.T + push[:, None, None] * np.eye(2)
        return self._mixed(self._x[:, 2:6] @ by.T, P, float(T[1]) ** 2)

    def _weights(self) -> Array:
        """Return the models' weights (M, 2), along its way and across it; how it accelerates is shared. (24.14)"""
        by_axis = np.exp(self._log_weight - self._log_weight.max(axis=0)).reshape(len(SCALES), len(MANNERS), 2)
        weights = (by_axis * by_axis.sum(axis=0)[:, ::-1]).reshape(-1, 2)
        return np.asarray(weights / weights.sum(axis=0), float)

    def _turn_axes(self) -> None:
        """Along its way, as far as that is known, and across it."""
        east, north = (self._weights() * (self._x[:, 2:4] @ self._axes.T)).sum(axis=0) @ self._axes
        speed = math.hypot(east, north)
        if speed > 0.0:
            self._axes = np.array([[east, north], [north, -east]]) / speed

    def _mixed(self, each: Array, P: Array, shares: float) -> tuple[Array, Array]:
        """The mean (2,) and covariance (2, 2) of what the models give, (M, 2) with their own (M, 2, 2), by weight.
        `shares`: how many times what the poses share is in it.
        """
        weights, axes = self._weights(), self._axes
        each = each @ axes.T
        mean, root = (weights * each).sum(axis=0), np.sqrt(weights)
        off = root * (each - mean)
        cov = off.T @ off + (root[:, :, None] * (axes @ P @ axes.T) * root[:, None, :]).sum(axis=0)
        return np.asarray(mean @ axes, float), np.asarray(axes.T @ cov @ axes + shares * self._shared, float)
