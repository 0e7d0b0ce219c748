"""Estimate of the second camera's mount from its spots: a thing that stands is at one place from all directions.

(27.8) to (27.11)
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from contract.rotations import exp_so3
from onboard.spots.second_camera import STATES, Mount

Array = NDArray[np.float64]

VIEW_S = 10.0  # in which a pose's slow errors are the same: sightings of so long are one view
GATE = 18.4  # chi-square of two degrees of freedom at 1e-4
MOST_THINGS, MOST_VIEWS = 40, 20
LEAST_THINGS = 2  # that must agree
LEAST_OWN_M = 0.1  # one sigma of what is taken for a thing's middle
# The normal law's value that 1 of 1000 exceed gives chi-square's with n degrees of freedom (Wilson and Hilferty).
NORMAL_999 = 3.09


@dataclass(frozen=True, eq=False)
class Sighting:
    """A spot in one picture: place (2,), m, as the mount that was used has it, and d place / d mount (2, 4).

    `covariance` (2, 2) without the mount's errors; `own_share` of it is this picture's alone.
    """

    place_m: Array
    by_mount: Array
    covariance: Array
    own_share: float


@dataclass(eq=False)
class _View:
    """Sightings of one thing within VIEW_S, summed with their weights; places as the stated mount has them."""

    began_s: float
    weight: Array = field(default_factory=lambda: np.zeros((2, 2)))
    place: Array = field(default_factory=lambda: np.zeros(2))
    by_mount: Array = field(default_factory=lambda: np.zeros((2, STATES)))
    slow: Array = field(default_factory=lambda: np.zeros((2, 2)))
    seen_s: float = 0.0
    last: Sighting | None = None

    def add(self, now_s: float, sighting: Sighting) -> None:
        """One more."""
        w = np.linalg.inv(own_covariance(sighting))
        self.weight = self.weight + w
        self.place = self.place + w @ sighting.place_m
        self.by_mount = self.by_mount + w @ sighting.by_mount
        self.slow, self.seen_s, self.last = slow_covariance(sighting), now_s, sighting

    def mean(self) -> tuple[Array, Array, Array]:
        """Place (2,), its derivative (2, 4), and covariance (2, 2), what lasts a view included."""
        inverse = np.linalg.inv(self.weight)
        return inverse @ self.place, inverse @ self.by_mount, inverse + self.slow


@dataclass(eq=False)
class _Thing:
    views: list[_View]

    @property
    def newest(self) -> _View:
        return self.views[-1]


class MountEstimate:
    """Begins as the configuration states the mount. `mount` is the estimate now."""

    def __init__(self, stated: Mount) -> None:
        self._stated = self.mount = stated
        self._state, self._covariance = np.zeros(STATES), stated.covariance
        self._things: list[_Thing] = []
        self.things_used = 0

    def add(self, now_s: float, sightings: list[Sighting]) -> None:
        """All of a picture's, placed with `mount`."""
        corrected = [replace(s, place_m=s.place_m - s.by_mount @ self._state) for s in sightings]
        near = [self._near(now_s, one) for one in corrected]
        is_new_view = False
        for one, things in zip(corrected, near, strict=True):
            just = [thing for thing in things if now_s - thing.newest.seen_s <= VIEW_S]
            # It is of a thing seen earlier only if it is of no other, and no other spot is of that thing.
            if len(just or things) > 1 or sum(things[0] in other for other in near if things and not just) > 1:
                continue
            thing = (just or things or [self._new_thing(now_s)])[0]
            if now_s - thing.newest.began_s > VIEW_S:
                is_new_view = True
                thing.views = [*thing.views[1 - MOST_VIEWS :], _View(now_s)]
            thing.newest.add(now_s, one)
        if is_new_view:
            self._solve()

    def _new_thing(self, now_s: float) -> _Thing:
        if len(self._things) == MOST_THINGS:  # the one that was seen in the fewest views, the oldest of them
            self._things.remove(min(self._things, key=lambda thing: (len(thing.views), thing.newest.seen_s)))
        thing = _Thing([_View(now_s)])
        self._things.append(thing)
        return thing

    def _near(self, now_s: float, one: Sighting) -> list[_Thing]:
        return [thing for thing in self._things if self._distance(now_s, one, thing.newest) < GATE]

    def _distance(self, now_s: float, one: Sighting, view: _View) -> float:
        """Return the distance of a sighting from a view's last one, in sigmas squared; infinite without one. (27.8)"""
        other = view.last
        if other is None:
            return float("inf")
        moved = one.by_mount - other.by_mount
        changed = 1.0 - float(np.exp((view.seen_s - now_s) / VIEW_S))
        noise = own_covariance(one) + own_covariance(other) + changed * (slow_covariance(one) + view.slow)
        off = one.place_m - other.place_m + moved @ self._state
        return float(off @ np.linalg.solve(noise + moved @ self._covariance @ moved.T, off))

    def _solve(self) -> None:
        """Estimate the mount from all things seen in two views or more, without those that moved. (27.9) to (27.11)"""
        observed = [[view.mean() for view in thing.views] for thing in self._things if len(thing.views) > 1]
        while True:
            state, covariance = _adjusted(self._stated.covariance, observed)
            misfits = [_misfit(views, state) / _limit(2 * len(views) - 2) for views in observed]
            if not misfits or max(misfits) <= 1.0:
                break
            del observed[int(np.argmax(misfits))]
        if len(observed) < LEAST_THINGS:  # nothing that another thing confirms
            observed, (state, covariance) = [], _adjusted(self._stated.covariance, [])
        left = 2 * sum(len(views) - 1 for views in observed)
        worse = max(sum(_misfit(views, state) for views in observed) / left, 1.0) if left else 1.0
        self.things_used = len(observed)
        # No worse than what was stated, whatever the misfit.
        prior = np.linalg.inv(self._stated.covariance)
        information = prior + (np.linalg.inv(covariance) - prior) / worse
        self._state, self._covariance = state, np.asarray(np.linalg.inv(information), float)
        self.mount = Mount(
            self._stated.R_first_second @ exp_so3(state[:3]), self._stated.late_s + float(state[3]), self._covariance
        )


Views = list[tuple[Array, Array, Array]]


def own_covariance(one: Sighting) -> Array:
    """Return the covariance (2, 2) of the error that a picture adds by itself, m2."""
    return one.own_share * one.covariance + LEAST_OWN_M**2 * np.eye(2)


def slow_covariance(one: Sighting) -> Array:
    """Return the covariance (2, 2) of the error that it shares with the pictures about it, m2."""
    return (1.0 - one.own_share) * one.covariance


def _adjusted(prior: Array, observed: list[Views]) -> tuple[Array, Array]:
    """State (4,) and covariance (4, 4), each thing's place eliminated. (27.9), (27.10)"""
    information, right = np.linalg.inv(prior), np.zeros(STATES)
    for views in observed:
        y, G, W = _columns(views)
        total, by_place, place = np.linalg.inv(W.sum(axis=0)), (W @ G).sum(axis=0), (W @ y).sum(axis=0)
        GW = G.transpose(0, 2, 1) @ W
        information = information + (GW @ G).sum(axis=0) - by_place.T @ total @ by_place
        right = right - ((GW @ y).sum(axis=0) - by_place.T @ total @ place)[:, 0]
    covariance: Array = np.linalg.inv(information)
    return covariance @ right, covariance


def _misfit(views: Views, state: Array) -> float:
    """Return how far the views of one thing are from one place: chi-square of 2 n - 2 degrees of freedom. (27.11)"""
    y, G, W = _columns(views)
    places = y + G @ state[:, None]
    off = places - np.linalg.solve(W.sum(axis=0), (W @ places).sum(axis=0))
    return float((off.transpose(0, 2, 1) @ W @ off).sum())


def _columns(views: Views) -> tuple[Array, Array, Array]:
    """Places (n, 2, 1), derivatives (n, 2, 4) and weights (n, 2, 2) of a thing's views."""
    places, by_mount, covariances = (np.array(column) for column in zip(*views, strict=True))
    return places[:, :, None], by_mount, np.linalg.inv(covariances)


def _limit(degrees: int) -> float:
    part = 2.0 / (9.0 * degrees)
    return float(degrees * (1.0 - part + NORMAL_999 * np.sqrt(part)) ** 3)
