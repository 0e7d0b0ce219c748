"""The search's trial of a person at a place: put into the picture itself, found or not. (25.23)"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from contract.spot import PERSON_K, PERSON_M2
from onboard.spots.contrast import WINDOW, Contrast, Image, contrast, stretched
from onboard.spots.regions import LENS_PX, about_peak, size_limits

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

SIDE_PX = 96  # of the picture of level ground that shows how a person stands out
PIXEL_STEP = 0.05  # of a pixel, by which sizes differ that are computed by themselves
CLOSE = 1.25  # of what is needed, up to which a person is put into the picture itself
# Where in a pixel a person may stand: evenly over it (Hammersley), for much depends on it where a pixel is as large.
PHASES = np.array([(k, int(f"{k:04b}"[::-1], 2)) for k in range(16)]) / 16.0 + 1.0 / 32.0


def found_at(
    kelvin: Image, contrasts: Sequence[Contrast], thresholds: Mapping[float, float], pixel_m: float, at: Array
) -> tuple[Mask, Mask]:
    """The masks (N,) of the places at which PERSON_K above the ground and PERSON_M2 large is found by any of the sizes,
    and of those that show ground.

    `kelvin` is the picture (H, W) and `contrasts` its own, by size; `thresholds` what each size must have, in sigmas of
    the clutter; `pixel_m` the ground that the usual pixel shows; `at` (N, 2) the places, in shares of the picture's
    height and width.
    """
    found, is_ground = np.zeros(len(at), bool), np.zeros(len(at), bool)
    for c in contrasts:
        shown = c.in_clutter[_pixels(c.values, at)] != 0.0
        trial = Trial(kelvin, c, thresholds[c.side_m], pixel_m)
        is_ground |= shown
        found[shown & ~found] = trial.found(at[shown & ~found])
    return found, is_ground


def _pixels(values: Image, at: Array) -> tuple[Index, Index]:
    """Rows and columns (N,) in a picture (H, W) of places (N, 2), shares of its height and width."""
    row, column = (at * values.shape).astype(np.int64).T
    return row, column


class Trial:
    """One size's search of a picture into which people are put, each as if alone. (25.23)"""

    def __init__(self, kelvin: Image, c: Contrast, threshold: float, pixel_m: float) -> None:
        self._kelvin, self._c, self._threshold, self._pixel_m = kelvin, c, threshold, pixel_m
        self._limits = size_limits(c, pixel_m)
        self._radius = self._limits[0] + 2  # a peak next to the middle has its reach within
        self._step_m = float(np.exp(round(np.log(pixel_m) / PIXEL_STEP) * PIXEL_STEP))

    def found(self, at: Array) -> Mask:
        """The mask (N,) of the places (N, 2), shares of height and width, at which a person is found."""
        c, radius = self._c, self._radius
        persons = np.float32(PERSON_K) * _persons(c.side_m, self._step_m, radius)
        row, column = _pixels(c.values, at)
        must = self._threshold * self._clutter_with_person(row, column)
        within = at * c.values.shape - np.column_stack([row, column])
        which = np.square(within[:, None] - PHASES).sum(axis=2).argmin(axis=1)
        around = np.pad(c.excess, radius)
        out = np.zeros(len(at), bool)
        # Not tried where its middle and the pixels about it, all at their largest, are too little.
        for k in np.flatnonzero(_largest_near(c.excess)[row, column] + persons.max() > must):
            i, j = row[k], column[k]
            shown = around[i : i + 2 * radius + 1, j : j + 2 * radius + 1] + persons[which[k]]
            if self._is_close(shown, must[k]):
                shown = self._with_person(at[k] * self._kelvin.shape)
            out[k] = self._is_thing(shown, must[k], (int(i), int(j)))
        return out

    def _clutter_with_person(self, row: Index, column: Index) -> Image:
        """The clutter (N,) at pixels with a person there: of the 25 parts of the median his own is now the largest."""
        c = self._c
        next_up = np.sqrt(_one_above_median(c.power))
        height, width = c.power.shape
        own = row * height // c.values.shape[0], column * width // c.values.shape[1]
        is_raised = np.sqrt(c.power[own]) <= c.clutter[own]
        alone = stretched(c.clutter, c.values)[row, column]
        raised = stretched(np.maximum(next_up, c.clutter), c.values)[row, column]
        return np.asarray(np.where(is_raised, raised, alone), np.float32)

    def _is_close(self, shown: Image, must: float) -> bool:
        """Return whether it matters that a person also lifts the median that is his background."""
        return bool(must < _middle(shown, self._radius).max() < CLOSE * must)

    def _with_person(self, middle: Array) -> Image:
        """Return the excess about a place (2,), row and column from the picture's corner, the person put into the
        picture itself: exact, and slower.
        """
        c, reach = self._c, self._radius
        half = int(np.ceil((reach + WINDOW * c.side_m / self._pixel_m / c.times) * c.times))
        low = np.maximum(middle.astype(int) - half, 0)
        crop = self._kelvin[low[0] : int(middle[0]) + half, low[1] : int(middle[1]) + half]
        person = _person(crop.shape, middle - low, self._pixel_m)
        found = contrast(crop + np.float32(PERSON_K) * person, np.ones((4, 4), bool), c.side_m, self._pixel_m)
        i, j = ((middle - low) / found.times).astype(int)
        excess = np.pad(found.excess, reach)
        return np.asarray(excess[i : i + 2 * reach + 1, j : j + 2 * reach + 1], np.float32)

    def _is_thing(self, shown: Image, must: float, at: tuple[int, int]) -> bool:
        """Return whether a peak by the middle, the pixel `at`, is above what it must have, of the thing's
        size, and whole.
        """
        middle = _middle(shown, self._radius)
        y, x = divmod(int(middle.argmax()), 3)
        peak = self._radius - 1 + y, self._radius - 1 + x
        part = about_peak(shown, peak, *self._limits) if middle[y, x] > must else None
        if part is None or self._is_far_inside(at):
            return part is not None
        pixels = np.argwhere(part.level > 0.0) + (part.up, part.left) + at - self._radius
        return bool((pixels > 0).all() and (pixels < np.array(self._c.values.shape) - 1).all())

    def _is_far_inside(self, at: tuple[int, int]) -> bool:
        """Return whether nothing about a pixel is at the border."""
        return all(self._radius < k < n - 1 - self._radius for k, n in zip(at, self._c.values.shape, strict=True))


def _middle(shown: Image, radius: int) -> Image:
    return shown[radius - 1 : radius + 2, radius - 1 : radius + 2]


def _largest_near(values: Image) -> Image:
    return np.asarray(cv2.dilate(values, np.ones((3, 3), np.uint8)), np.float32)


def _person(shape: tuple[int, ...], middle_px: Array, pixel_m: float) -> Image:
    """A person of 1 K in a picture (H, W), through the lens, with its middle so far from the picture's corner."""
    half_px = 0.5 * np.sqrt(PERSON_M2) / pixel_m
    cover = [
        np.clip(np.minimum(np.arange(n) + 1.0, m + half_px) - np.maximum(np.arange(n), m - half_px), 0.0, 1.0)
        for n, m in zip(shape, middle_px, strict=True)
    ]
    return np.asarray(cv2.GaussianBlur(np.outer(*cover).astype(np.float32), (0, 0), LENS_PX), np.float32)


@lru_cache(maxsize=64)
def _persons(side_m: float, pixel_m: float, radius: int) -> Image:
    """The excess of persons of 1 K over level ground for things of `side_m`, one for each of PHASES. (25.3)

    (P, 2 radius + 1, 2 radius + 1), K, about the pixel that a person stands in.
    """
    is_ground = np.ones((4, 4), bool)
    times = contrast(np.zeros((SIDE_PX, SIDE_PX), np.float32), is_ground, side_m, pixel_m).times
    persons = []
    for phase in PHASES:
        middle = times * (SIDE_PX // (2.0 * times) + phase)
        shown = contrast(_person((SIDE_PX, SIDE_PX), middle, pixel_m), is_ground, side_m, pixel_m)
        i, j = (middle / times).astype(int)
        persons.append(np.pad(shown.excess, radius)[i : i + 2 * radius + 1, j : j + 2 * radius + 1])
    return np.array(persons)


def _one_above_median(values: Image) -> Image:
    """The value next above the median (H, W) of the WINDOW x WINDOW parts about each; the border's are repeated."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(values, WINDOW // 2, mode="edge"), (WINDOW, WINDOW))
    rank = WINDOW * WINDOW // 2 + 1
    out: Image = np.partition(around.reshape(*values.shape, WINDOW * WINDOW), rank, axis=-1)[..., rank]
    return out
