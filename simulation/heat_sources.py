"""Warm things on the ground with their truth: people, cars, rocks that the sun has warmed, and fires that spread.

A shape states, for places on the ground, how much above the ground's own radiant temperature it is. Temperatures are
apparent ones, of a black body that looks the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.errors import InputError
from simulation.movers import MoverSpec

Array = NDArray[np.float64]

CELL_M = 50.0  # at most one rock in each
ROCK_M = (0.3, 1.2)
OUTLINE_STEPS = 24  # of each half circle of a fire's outline


@dataclass(frozen=True)
class HeatSource:
    """A thing of one temperature, `excess_k` above the ground that it is on, shaped and moved as its mover."""

    mover: MoverSpec
    excess_k: float
    kind: str = "person"

    @classmethod
    def person(cls, start_m: tuple[float, float], excess_k: float = 8.0, speed_m_s: float = 0.0) -> HeatSource:
        """Half a metre across."""
        return cls(MoverSpec.person(start_m, speed_m_s), excess_k)

    @classmethod
    def car(cls, start_m: tuple[float, float], excess_k: float = 15.0, speed_m_s: float = 0.0) -> HeatSource:
        """A car whose engine has run: four metres by one point eight."""
        return cls(MoverSpec.car(start_m, speed_m_s), excess_k, "car")

    @property
    def narrow_m(self) -> float:
        """Its narrower side."""
        return min(self.mover.length_m, self.mover.width_m)

    def reach_m(self, time_s: float) -> float:
        """No part of it is farther from its place."""
        return 0.5 * float(np.hypot(self.mover.length_m, self.mover.width_m))

    def place_m(self, time_s: float) -> Array:
        """East, north (2,), seconds after the first picture."""
        return self.mover.place_m(time_s)

    def warmth_k(self, east: Array, north: Array, ground_k: float, time_s: float) -> Array:
        """Its temperature where it is, NaN elsewhere, at places (...) from its own, m. `ground_k` is that below it."""
        course = float(self.mover.course_rad(time_s))
        along, across = east * np.sin(course) + north * np.cos(course), east * np.cos(course) - north * np.sin(course)
        inside = (np.abs(along) <= 0.5 * self.mover.length_m) & (np.abs(across) <= 0.5 * self.mover.width_m)
        return np.where(inside, ground_k + self.excess_k, np.nan)

    def area_m2(self, time_s: float) -> float:
        """The area of the ground that it covers."""
        return self.mover.length_m * self.mover.width_m

    def perimeter_m(self, time_s: float) -> float:
        """The length of its outline."""
        return 2.0 * (self.mover.length_m + self.mover.width_m)

    def hottest_k(self, ground_k: float, time_s: float) -> float:
        """Its highest temperature."""
        return ground_k + self.excess_k


@dataclass(frozen=True)
class Fire:
    """A fire from a line on: what is within `rate_m_s` times its age of the line has caught.

    `line_m`: two ends, east and north. The outer `depth_m` are flames; behind them embers cool from `ember_k` with the
    time constant `cooling_s`.
    """

    line_m: tuple[tuple[float, float], tuple[float, float]]
    rate_m_s: float = 0.1
    from_s: float = 0.0
    first_m: float = 0.5  # from the line, at `from_s`
    depth_m: float = 1.0
    flame_k: float = 700.0
    ember_k: float = 420.0
    cooling_s: float = 120.0
    kind: str = "fire"

    def __post_init__(self) -> None:
        if self.rate_m_s <= 0.0 or self.depth_m <= 0.0 or self.first_m <= 0.0 or self.cooling_s <= 0.0:
            raise InputError("fire: rate, depth, first width and cooling time must be positive")

    @property
    def narrow_m(self) -> float:
        """The size of its finest part."""
        return min(self.depth_m, self.first_m)

    def spread_m(self, time_s: float) -> float:
        """The distance that it has come from its line; 0 before it burns."""
        return 0.0 if time_s < self.from_s else self.first_m + self.rate_m_s * (time_s - self.from_s)

    def reach_m(self, time_s: float) -> float:
        """No part of it is farther from its place."""
        return 0.5 * self.length_m + self.spread_m(time_s)

    @property
    def length_m(self) -> float:
        """The length of the line that it began as."""
        (e0, n0), (e1, n1) = self.line_m
        return float(np.hypot(e1 - e0, n1 - n0))

    def place_m(self, time_s: float) -> Array:
        """East, north (2,) of its middle."""
        out: Array = np.mean(np.asarray(self.line_m, float), axis=0)
        return out

    def warmth_k(self, east: Array, north: Array, ground_k: float, time_s: float) -> Array:
        """Its temperature where it has burned, NaN elsewhere, at places (...) from its middle, m."""
        distance, spread = self._from_line(east, north), self.spread_m(time_s)
        age_s = np.maximum((spread - self.depth_m - distance) / self.rate_m_s, 0.0)
        embers = ground_k + (self.ember_k - ground_k) * np.exp(-age_s / self.cooling_s)
        warm = np.where(distance > spread - self.depth_m, self.flame_k, embers)
        return np.where(distance <= spread if spread > 0.0 else False, warm, np.nan)

    def _from_line(self, east: Array, north: Array) -> Array:
        half = 0.5 * (np.asarray(self.line_m[1]) - np.asarray(self.line_m[0]))
        share = np.clip((east * half[0] + north * half[1]) / max(float(half @ half), 1e-12), -1.0, 1.0)
        out: Array = np.hypot(east - share * half[0], north - share * half[1])
        return out

    def area_m2(self, time_s: float) -> float:
        """The area of what has burned or burns."""
        r = self.spread_m(time_s)
        return float(np.pi * r * r + 2.0 * r * self.length_m) if r else 0.0

    def perimeter_m(self, time_s: float) -> float:
        """The length of its outline."""
        r = self.spread_m(time_s)
        return float(2.0 * np.pi * r + 2.0 * self.length_m) if r else 0.0

    def outline_m(self, time_s: float) -> Array:
        """East, north (N, 2) around what has burned, anticlockwise and not closed; (0, 2) before it burns."""
        r = self.spread_m(time_s)
        if not r:
            return np.zeros((0, 2))
        ends = np.asarray(self.line_m)
        bearing = float(np.arctan2(*(ends[1] - ends[0])[::-1]))
        turn = bearing + np.linspace(-0.5, 0.5, OUTLINE_STEPS + 1) * np.pi
        arc = r * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        return np.concatenate([ends[1] + arc, ends[0] - arc])

    def hottest_k(self, ground_k: float, time_s: float) -> float:
        """Its highest temperature; the ground's before it burns."""
        return self.flame_k if self.spread_m(time_s) else ground_k


def rocks_near(place_m: Array, radius_m: float, per_km2: float, excess_k: float, seed: int) -> list[HeatSource]:
    """The rocks within a distance of a place (2,): the same wherever one looks from. At most 400 a km2.

    Their excess is exponential with the mean `excess_k`, four times that at most; their sides are 0.3 to 1.2 m.
    """
    low = np.floor((place_m - radius_m) / CELL_M).astype(int)
    high = np.floor((place_m + radius_m) / CELL_M).astype(int)
    share = min(per_km2 * CELL_M**2 / 1e6, 1.0)
    found = []
    for i in range(low[0], high[0] + 1):
        for j in range(low[1], high[1] + 1):
            rng = np.random.default_rng([seed, 911, i + 2**20, j + 2**20])
            if rng.uniform() >= share:
                continue
            east, north = (np.array([i, j]) + rng.uniform(size=2)) * CELL_M
            sides = rng.uniform(*ROCK_M, 2)
            warmth = min(float(rng.exponential(excess_k)), 4.0 * excess_k)
            if np.hypot(east - place_m[0], north - place_m[1]) <= radius_m:
                mover = MoverSpec((east, north), 0.0, rng.uniform(0.0, 360.0), max(sides), min(sides))
                found.append(HeatSource(mover, warmth, "rock"))
    return found
