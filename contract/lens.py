"""The two lens models: undistorted image coordinates (x, y) = (X / Z, Y / Z) -> distorted ones, derivatives, inverse.

`Brown` is OpenCV's of five coefficients, a polynomial of the tangent of the angle off the axis: equations (2.1) to
(2.4) of docs/mathematics.md. `KannalaBrandt` is a fisheye's, a polynomial of that angle itself (OpenCV's `fisheye`,
Kalibr's `equidistant`, COLMAP's OPENCV_FISHEYE): (30.1) to (30.3) of docs/mathematics-camera.md. Both take the same
coordinates, so that everything else is the same for either; therefore a fisheye's rays end 80 degrees off its axis.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PINHOLE, FISHEYE = "pinhole", "fisheye"
# Where the radial polynomial's slope has fallen this low, a pixel of noise is three in its argument: the calibration
# is extrapolating towards its fold and is not used.
MIN_RADIAL_SLOPE = 0.3
MAX_RADIUS = 3.0  # undistorted, of a pinhole with distortion: 143 degrees wide
MAX_ANGLE = math.radians(80.0)  # off the axis of a fisheye's rays
NEWTON_STEP = 1e-7  # normalised, at which its square is nothing
NEWTON_STEPS = 12
# Of a lens's derivative, the least that is divided by: a fisheye's is 0.002 where its rays end on its least slope.
MIN_DETERMINANT = 1e-3
SMALL_RADIUS = 1e-6  # where the quotient of an angle and its tangent is its series


class Lens(ABC):
    """A lens model. Coordinates are rows x, y (2, N), normalised."""

    names: ClassVar[tuple[str, ...]]  # of its coefficients

    @property
    @abstractmethod
    def is_ideal(self) -> bool:
        """Return whether distorted coordinates are the undistorted ones."""

    @property
    @abstractmethod
    def max_radius(self) -> float:
        """The largest undistorted radius up to which the model is used. (2.3), (30.2)"""

    @abstractmethod
    def displacement(self, xy: Array) -> Array:
        """Return distorted less undistorted coordinates (2, N)."""

    @abstractmethod
    def linearised(self, xy: Array) -> tuple[Array, Array, Array]:
        """Return the distorted rows, and d x / d x and d y / d y (2, N) and d x / d y (N,) of their Jacobian, which is
        symmetric.
        """

    @abstractmethod
    def by_coefficients(self, xy: Array) -> Array:
        """Return the derivatives (2, 2, N) of the distorted rows by k1 and by k2."""

    @abstractmethod
    def undistorted(self, target: Array, near: Array | None, within: float) -> tuple[Array, Mask]:
        """Return rows that are distorted to `target`, and whether they are to `within`; `near` is where to begin."""


@dataclass(frozen=True)
class Brown(Lens):
    """OpenCV's polynomial of the tangent."""

    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    names: ClassVar[tuple[str, ...]] = ("k1", "k2", "p1", "p2", "k3")

    @cached_property
    def is_ideal(self) -> bool:
        return not any((self.k1, self.k2, self.p1, self.p2, self.k3))

    @cached_property
    def max_radius(self) -> float:
        """The largest radius up to which the radial polynomial's slope stays usable. (2.3)"""
        if (self.k1, self.k2, self.k3) == (0.0, 0.0, 0.0):
            return float("inf")
        r2 = np.linspace(0.0, MAX_RADIUS**2, 9001)
        slope = 1.0 + r2 * (3.0 * self.k1 + r2 * (5.0 * self.k2 + r2 * 7.0 * self.k3))
        bad = np.flatnonzero(slope < MIN_RADIAL_SLOPE)
        return float(np.sqrt(r2[max(bad[0] - 1, 0)])) if bad.size else MAX_RADIUS

    def displacement(self, xy: Array) -> Array:
        """Return (2.1) less its argument, (2, N)."""
        squares = xy * xy
        r2 = squares[0] + squares[1]
        along: Array = r2 * self.k3
        along += self.k2
        along *= r2
        along += self.k1
        along *= r2
        # The tangential part is 2 (p2 x + p1 y) (x, y) + r2 (p2, p1).
        tangential = np.array([[self.p2], [self.p1]])
        across = xy * (2.0 * tangential)
        along += across[0]
        along += across[1]
        out: Array = xy * along
        out += tangential * r2
        return out

    def linearised(self, xy: Array) -> tuple[Array, Array, Array]:
        """Return (2.1) and (2.2) at once."""
        k1, k2, k3, p1, p2 = self.k1, self.k2, self.k3, self.p1, self.p2
        squares = xy * xy
        r2 = squares[0] + squares[1]
        # The tangential part is 2 (p2 x + p1 y) (x, y) + r2 (p2, p1).
        tangential = np.array([[p2], [p1]])
        scale = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)) + 2.0 * (p2 * xy[0] + p1 * xy[1])
        slope = 2.0 * k1 + r2 * (4.0 * k2 + r2 * (6.0 * k3))
        there = xy * scale + r2 * tangential
        along = scale + squares * slope + 4.0 * tangential * xy
        cross = xy[0] * xy[1] * slope + 2.0 * (p1 * xy[0] + p2 * xy[1])
        return there, along, cross

    def by_coefficients(self, xy: Array) -> Array:
        """Return x r^2 and x r^4, (2, 2, N)."""
        r2 = xy[0] * xy[0] + xy[1] * xy[1]
        first = xy * r2
        return np.stack([first, first * r2])

    def undistorted(self, target: Array, near: Array | None, within: float) -> tuple[Array, Mask]:
        """Newton on (2.1) with (2.2). (2.4)"""
        limit = min(self.max_radius, MAX_RADIUS)
        xy = target if near is None else near
        for _ in range(NEWTON_STEPS):
            radius = np.hypot(*xy)
            if radius.max(initial=0.0) > limit:
                xy = xy * np.minimum(limit / np.maximum(radius, 1e-12), 1.0)
            there, along, cross = self.linearised(xy)
            off = there - target
            det = along[0] * along[1] - cross * cross
            det = np.where(np.abs(det) < 0.05, 0.05, det)
            step = (along[::-1] * off - cross * off[::-1]) / det
            xy = xy - step
            # What is left after a step is of the order of its square.
            if np.abs(step).max(initial=0.0) < NEWTON_STEP:
                break
        off = xy + self.displacement(xy) - target
        return xy, (np.hypot(*off) < within) & (np.hypot(*xy) <= limit)


@dataclass(frozen=True)
class KannalaBrandt(Lens):
    """A fisheye's polynomial of the angle off the axis."""

    k1: float
    k2: float
    k3: float
    k4: float
    names: ClassVar[tuple[str, ...]] = ("k1", "k2", "k3", "k4")

    @property
    def is_ideal(self) -> bool:
        """Return False: without coefficients, too, its radii are angles and not their tangents."""
        return False

    @cached_property
    def max_angle(self) -> float:
        """The largest angle off the axis, rad, up to which the polynomial's slope stays usable. (30.2)"""
        angle = np.linspace(0.0, MAX_ANGLE, 8001)
        bad = np.flatnonzero(self._slope(angle) < MIN_RADIAL_SLOPE)
        return float(angle[max(bad[0] - 1, 0)]) if bad.size else MAX_ANGLE

    @cached_property
    def max_radius(self) -> float:
        return math.tan(self.max_angle)

    def displacement(self, xy: Array) -> Array:
        """Return (30.1) less its argument, (2, N)."""
        radius = np.hypot(xy[0], xy[1])
        out: Array = xy * (self._quotient(radius, np.arctan(radius)) - 1.0)
        return out

    def linearised(self, xy: Array) -> tuple[Array, Array, Array]:
        """Return (30.1) and its Jacobian at once. (30.3)"""
        radius = np.hypot(xy[0], xy[1])
        angle = np.arctan(radius)
        scale = self._quotient(radius, angle)
        r2 = radius * radius
        is_small = radius < SMALL_RADIUS
        bend = (self._slope(angle) / (1.0 + r2) - scale) / np.where(is_small, 1.0, r2)
        bend = np.where(is_small, 2.0 * self.k1 - 2.0 / 3.0, bend)
        return xy * scale, scale + xy * xy * bend, xy[0] * xy[1] * bend

    def by_coefficients(self, xy: Array) -> Array:
        """Return (x / r) angle^3 and (x / r) angle^5, (2, 2, N)."""
        radius = np.hypot(xy[0], xy[1])
        angle = np.arctan(radius)
        share = np.where(radius < SMALL_RADIUS, 1.0, angle / np.maximum(radius, SMALL_RADIUS))
        first = xy * (share * angle * angle)
        return np.stack([first, first * (angle * angle)])

    def undistorted(self, target: Array, near: Array | None, within: float) -> tuple[Array, Mask]:
        """Newton on the polynomial of the angle alone: the direction about the axis is the same before and after."""
        wanted = np.hypot(target[0], target[1])
        angle = np.minimum(wanted if near is None else np.arctan(np.hypot(near[0], near[1])), self.max_angle)
        for _ in range(NEWTON_STEPS):
            step = (self._distorted(angle) - wanted) / np.maximum(self._slope(angle), MIN_RADIAL_SLOPE)
            angle = np.clip(angle - step, 0.0, self.max_angle)
            if np.abs(step).max(initial=0.0) < NEWTON_STEP:
                break
        is_small = wanted < SMALL_RADIUS
        xy = target * np.where(is_small, 1.0, np.tan(angle) / np.maximum(wanted, SMALL_RADIUS))
        return xy, np.abs(self._distorted(angle) - wanted) < within

    def _distorted(self, angle: Array) -> Array:
        a2 = angle * angle
        out: Array = angle * (1.0 + a2 * (self.k1 + a2 * (self.k2 + a2 * (self.k3 + a2 * self.k4))))
        return out

    def _slope(self, angle: Array) -> Array:
        a2 = angle * angle
        out: Array = 1.0 + a2 * (3.0 * self.k1 + a2 * (5.0 * self.k2 + a2 * (7.0 * self.k3 + a2 * 9.0 * self.k4)))
        return out

    def _quotient(self, radius: Array, angle: Array) -> Array:
        """Return distorted over undistorted radius; 1 on the axis."""
        is_small = radius < SMALL_RADIUS
        out: Array = np.where(is_small, 1.0, self._distorted(angle) / np.where(is_small, 1.0, radius))
        return out


MODELS: dict[str, type[Brown] | type[KannalaBrandt]] = {PINHOLE: Brown, FISHEYE: KannalaBrandt}
