"""Things on the ground that move, or stand, with their truth: people, cars, and the shadows that they cast.

Rendered flat on the ground with soft edges, lit as it is; where two lie over each other the later one of the list is
seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from contract.errors import InputError

if TYPE_CHECKING:
    from simulation.trajectory import Pose

Array = NDArray[np.float64]
Image = NDArray[np.float32]

SPOTS = (5, 3)  # of brightness along and across a thing
SHADOW = 0.45  # of the ground's light, where something is in the way of it


STEP_S, LONGEST_S = 0.01, 60.0  # of the table of a thing with manoeuvres


@dataclass(frozen=True)
class Manoeuvre:
    """A while, s after a thing has set off, in which it speeds up, brakes (negative; at most to a stop) or turns."""

    from_s: float
    until_s: float
    acceleration_m_s2: float = 0.0
    turn_deg_s: float = 0.0


@dataclass(frozen=True)
class MoverSpec:
    """One thing. `start_m` east, north where it is at the first picture; `course_deg` clockwise from north.

    It goes at `speed_m_s` from `from_s` to `until_s` and turns at `turn_deg_s` as it goes, and does its `manoeuvres`
    besides, which count from the first picture or when it sets off later. `albedo`: its mean brightness (0.3 is the
    ground's), None: a shadow. `seed`: of its spots; two of the same look the same.
    """

    start_m: tuple[float, float]
    speed_m_s: float = 0.0
    course_deg: float = 0.0
    length_m: float = 0.5
    width_m: float = 0.5
    turn_deg_s: float = 0.0
    from_s: float = -1e9
    until_s: float = 1e9
    albedo: float | None = 0.6
    seed: int = 0
    manoeuvres: tuple[Manoeuvre, ...] = ()

    def __post_init__(self) -> None:
        if self.length_m <= 0.0 or self.width_m <= 0.0 or self.speed_m_s < 0.0 or self.until_s < self.from_s:
            raise InputError("mover: lengths must be positive, the speed not negative, and it begin before it ends")

    @classmethod
    def person(cls, start_m: tuple[float, float], speed_m_s: float = 1.4, course_deg: float = 0.0) -> MoverSpec:
        """Half a metre across, as seen from above."""
        return cls(start_m, speed_m_s, course_deg)

    @classmethod
    def car(cls, start_m: tuple[float, float], speed_m_s: float = 15.0, course_deg: float = 0.0) -> MoverSpec:
        """Four metres by one point eight."""
        return cls(start_m, speed_m_s, course_deg, 4.0, 1.8)

    def course_rad(self, time_s: ArrayLike) -> Array:
        """The direction in which it heads (...,), clockwise from north."""
        return self._driven(time_s)[1]

    def place_m(self, time_s: ArrayLike) -> Array:
        """East, north (..., 2), seconds after the first picture."""
        gone, turn, course = self._gone_s(time_s), np.radians(self.turn_deg_s), np.radians(self.course_deg)
        if self.manoeuvres:
            along = np.stack([np.interp(gone, _TIMES_S, column) for column in self._table()[2].T], axis=-1)
            return np.asarray(self.start_m + along, float)
        if abs(turn) < 1e-9:
            along = np.stack([gone * np.sin(course), gone * np.cos(course)], axis=-1)
        else:
            now = course + turn * gone
            along = np.stack([np.cos(course) - np.cos(now), np.sin(now) - np.sin(course)], axis=-1) / turn
        return np.asarray(self.start_m) + self.speed_m_s * along

    def velocity_m_s(self, time_s: ArrayLike) -> Array:
        """East, north (..., 2)."""
        time = np.asarray(time_s, float)
        speed, course = self._driven(time_s)
        speed = np.where((time >= self.from_s) & (time < self.until_s), speed, 0.0)
        return np.stack([speed * np.sin(course), speed * np.cos(course)], axis=-1)

    def _driven(self, time_s: ArrayLike) -> tuple[Array, Array]:
        """Speed, m/s, and course, rad (...,) each, while it is under way."""
        gone = self._gone_s(time_s)
        if not self.manoeuvres:
            return np.full_like(gone, self.speed_m_s), np.radians(self.course_deg + self.turn_deg_s * gone)
        speed, course, _ = self._table()
        return np.interp(gone, _TIMES_S, speed), np.interp(gone, _TIMES_S, course)

    def _table(self) -> tuple[Array, Array, Array]:
        return _driven_table(self.speed_m_s, self.course_deg, self.turn_deg_s, self.manoeuvres)

    def _gone_s(self, time_s: ArrayLike) -> Array:
        """The time for which it has moved since the first picture, s; negative before."""
        begin, time = (
            min(max(self.from_s, 0.0), self.until_s),
            np.clip(np.asarray(time_s, float), self.from_s, self.until_s),
        )
        out: Array = time - begin
        return out


_TIMES_S = STEP_S * np.arange(-round(LONGEST_S / STEP_S), round(LONGEST_S / STEP_S))


@lru_cache(maxsize=64)
def _driven_table(
    speed_m_s: float, course_deg: float, turn_deg_s: float, manoeuvres: tuple[Manoeuvre, ...]
) -> tuple[Array, Array, Array]:
    """Speed (n,), m/s, course (n,), rad, and way (n, 2), m, at _TIMES_S; the way is 0 at time 0."""
    rate = np.full(len(_TIMES_S), np.radians(turn_deg_s))
    change = np.zeros(len(_TIMES_S))
    for one in manoeuvres:
        during = (one.from_s <= _TIMES_S) & (one.until_s > _TIMES_S)
        change[during] += one.acceleration_m_s2 * STEP_S
        rate[during] += np.radians(one.turn_deg_s)
    speed = np.empty(len(_TIMES_S))
    now = speed_m_s
    for k, more in enumerate(change):
        speed[k] = now
        now = max(now + more, 0.0)
    middle = len(_TIMES_S) // 2
    turned = np.concatenate([[0.0], np.cumsum(rate[:-1] * STEP_S)])
    course = np.radians(course_deg) + turned - turned[middle]
    steps = STEP_S * speed[:, None] * np.stack([np.sin(course), np.cos(course)], axis=-1)
    way = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * (steps[1:] + steps[:-1]), axis=0)])
    return speed, course, way - way[middle]


class Movers:
    """Paints things into pictures. `first_s`: when the first picture is taken, on the pictures' clock."""

    def __init__(self, specs: tuple[MoverSpec, ...], first_s: float) -> None:
        self._specs, self._first_s = specs, first_s
        self._spots = [0.35 * np.random.default_rng([s.seed, 606]).uniform(-1.0, 1.0, SPOTS) for s in specs]

    def paint(self, light: Image, pose: Pose, east: Image, north: Image, footprint: Image, time_s: float) -> None:
        """Onto the ground's light (H, W), changed in place; `east`, `north` (H, W), m, count from the camera."""
        for spec, spots in zip(self._specs, self._spots, strict=True):
            place = spec.place_m(time_s - self._first_s) - pose.centre_m[:2]
            near = 0.5 * np.hypot(spec.length_m, spec.width_m) + 1.0
            hit = (np.abs(east - np.float32(place[0])) < near) & (np.abs(north - np.float32(place[1])) < near)
            rows, columns = np.nonzero(hit.any(axis=1))[0], np.nonzero(hit.any(axis=0))[0]
            if not len(rows):
                continue
            at = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
            course = float(spec.course_rad(time_s - self._first_s))
            e, n = east[at] - place[0], north[at] - place[1]
            along, across = e * np.sin(course) + n * np.cos(course), e * np.cos(course) - n * np.sin(course)
            cover = np.ones_like(e)
            for distance, size in ((along, spec.length_m), (across, spec.width_m)):
                cover = cover * np.clip((0.5 * size - np.abs(distance)) / footprint[at] + 0.5, 0.0, 1.0)
            if spec.albedo is None:
                own = SHADOW * light[at]
            else:
                i = np.clip((along / spec.length_m + 0.5) * SPOTS[0], 0, SPOTS[0] - 1).astype(int)
                j = np.clip((across / spec.width_m + 0.5) * SPOTS[1], 0, SPOTS[1] - 1).astype(int)
                own = spec.albedo * (1.0 + spots[i, j])
            light[at] += (cover * (own - light[at])).astype(np.float32)
