"""Crops of training pictures, turned, scaled, mirrored and toned at random, with their labels moved along."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from onboard.spots.thing_net import LOCAL_PX, Image
from training.labelled_pictures import Grey, Labelled
from training.net_input import WHITE, level_of_histogram, net_input

Array = NDArray[np.float64]

SIDE_PX = 256
MARGIN_PX = LOCAL_PX // 2  # the means of 33 x 33 pixels at a crop's edge see what lies outside
LOG_SCALE = (-0.35, 0.45)
TURN_RAD = 0.3
ASIDE = 0.42  # of a crop's side: so far from its middle may lie what it is taken for
AT_A_THING, AT_A_FALSE_PEAK = 0.72, 0.14  # shares of the crops; the others are taken anywhere
LOG_GAMMA, INVERTED, BLURRED = 0.5, 0.1, 0.3
MOST_NOISE = 0.025  # of the picture's range of grey
LEAST_INSIDE_PX = 2.0


@dataclass(frozen=True, eq=False)
class Crop:
    """A crop's input (2, S, S), its things (N, 5) as in `Labelled`, and where its labels count: `counts` (S, S)."""

    channels: Image
    things: Array
    counts: NDArray[np.uint8]


def moved(things: Array, M: Array) -> Array:
    """Return things (N, 5) as they lie in a picture that `M` (2, 3) has been warped to, in the picture of `M`."""
    out = things.copy()
    out[:, 1:3] = things[:, 1:3] @ M[:, :2].T + M[:, 2]
    out[:, 3:5] = things[:, 3:5] @ np.abs(M[:, :2]).T
    return out


def warp_around(middle: Array, rng: np.random.Generator) -> Array:
    """Return a random similarity (2, 3), mirrored in half of cases, from the picture to a crop with its margin.

    `middle` (2,) px of the picture comes to lie up to `ASIDE` of the crop's side from the crop's middle.
    """
    scale = math.exp(rng.uniform(*LOG_SCALE))
    angle = rng.uniform(-TURN_RAD, TURN_RAD) + rng.integers(4) * math.pi / 2
    c, s = scale * math.cos(angle), scale * math.sin(angle)
    A = np.array([[c, -s], [s, c]]) @ np.diag([rng.choice([-1.0, 1.0]), 1.0])
    to = SIDE_PX / 2 + MARGIN_PX + rng.uniform(-ASIDE, ASIDE, 2) * SIDE_PX
    return np.hstack([A, (to - A @ middle)[:, None]])


def tone(rng: np.random.Generator) -> Array:
    """Return what each of the 256 grey values becomes: another gamma, in some cases black for hot."""
    x = np.linspace(0.0, 1.0, 256) ** math.exp(rng.uniform(-LOG_GAMMA, LOG_GAMMA))
    return WHITE * (1.0 - x if rng.random() < INVERTED else x)


@dataclass(eq=False)
class Crops:
    """Random crops of pictures in memory; `false_peaks` holds (picture, u, v) where the net is wrong so far."""

    pictures: Sequence[Labelled]
    rng: np.random.Generator
    false_peaks: list[tuple[int, float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._greys: list[Grey] = [p.grey() for p in self.pictures]
        self._histograms = [np.bincount(g.ravel(), minlength=256).astype(np.float64) for g in self._greys]
        self._noise = self.rng.standard_normal((1024, 1024)).astype(np.float32)
        self._rows = [np.c_[np.full(len(p.things), i), p.things[:, :3]] for i, p in enumerate(self.pictures)]
        all_things = np.vstack(self._rows)
        # The kinds take turns by the square root of how many there are, so that the rare ones are not lost.
        counts = np.sqrt(np.bincount(all_things[:, 1].astype(int), minlength=3).astype(np.float64))
        self._kind_shares = counts / counts.sum()
        self._by_kind = [all_things[all_things[:, 1] == kind] for kind in range(len(counts))]

    def draw(self) -> Crop:
        """Return one more crop."""
        index, middle = self._somewhere()
        picture, grey = self.pictures[index], self._greys[index]
        M = warp_around(middle, self.rng)
        side = SIDE_PX + 2 * MARGIN_PX
        warped = cv2.warpAffine(grey, M, (side, side), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        known = np.ones_like(grey)
        for left, top, right, bottom in picture.left_open.astype(int):
            known[max(top, 0) : bottom + 1, max(left, 0) : right + 1] = 0
        counts = cv2.warpAffine(known, M, (side, side), flags=cv2.INTER_NEAREST)
        inner = slice(MARGIN_PX, MARGIN_PX + SIDE_PX)
        things = moved(picture.things, M)
        things[:, 1:3] -= MARGIN_PX
        inside = ((things[:, 1:3] > LEAST_INSIDE_PX) & (things[:, 1:3] < SIDE_PX - LEAST_INSIDE_PX)).all(1)
        channels = self._toned(np.asarray(warped, dtype=np.uint8), self._histograms[index])[:, inner, inner]
        return Crop(channels, things[inside], np.asarray(counts, dtype=np.uint8)[inner, inner])

    def _somewhere(self) -> tuple[int, Array]:
        """Return a picture's index and a place in it: at a thing, at a false peak, or anywhere."""
        share = self.rng.random()
        if share < AT_A_THING:
            rows = self._by_kind[self.rng.choice(len(self._by_kind), p=self._kind_shares)]
            row = rows[self.rng.integers(len(rows))]
            return int(row[0]), row[2:4]
        if share < AT_A_THING + AT_A_FALSE_PEAK and self.false_peaks:
            index, u, v = self.false_peaks[self.rng.integers(len(self.false_peaks))]
            return index, np.array([u, v])
        index = int(self.rng.integers(len(self.pictures)))
        height, width = self._greys[index].shape
        return index, self.rng.uniform(0.15, 0.85, 2) * (width, height)

    def _toned(self, warped: Grey, histogram: Array) -> Image:
        greys = tone(self.rng)
        grey = np.asarray(cv2.LUT(warped, greys.astype(np.float32)), dtype=np.float32)
        if self.rng.random() < BLURRED:
            grey = np.asarray(cv2.blur(grey, (3, 3)), dtype=np.float32)
        top, left = self.rng.integers(1024 - grey.shape[0], size=2)
        noise = self._noise[top : top + grey.shape[0], left : left + grey.shape[1]]
        grey = grey + np.float32(self.rng.uniform(0.0, MOST_NOISE) * WHITE) * noise
        return net_input(grey, level_of_histogram(histogram, greys))
