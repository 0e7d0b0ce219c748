"""Peaks of the net's maps, and which of them are at labelled things."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from onboard.spots.thing_net import SIZE_UNIT_PX, STRIDE, are_peaks
from training.labelled_pictures import KINDS

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

LEAST_SCORE = 0.02
ASIDE_PX = 4.0  # a peak is a thing's if it lies so far from its box, or nearer


class Peaks(NamedTuple):
    """Peaks of one picture: kind (N,), middle (N, 2) px, width and height (N, 2) px, score (N,)."""

    kind: NDArray[np.int64]
    middle_px: Array
    size_px: Array
    score: Array


class Judged(NamedTuple):
    """Peaks and labels compared, in the order of both.

    `thing` (N,): the index of the thing that a peak is at, -1 at none. `counts` (N,): false where the labels leave
    open what is there. `found_by` (M,): the peak at each thing, -1 where it has none.
    """

    thing: NDArray[np.int64]
    counts: Flags
    found_by: NDArray[np.int64]


def peaks_of(maps: NDArray[np.float32], least: float = LEAST_SCORE) -> Peaks:
    """Return the peaks of 5 x 5 cells of the heat in maps (7, h, w), with score `least` or more."""
    found: list[NDArray[np.int64]] = []
    for kind in range(len(KINDS)):
        heat = maps[kind]
        cells = np.argwhere(are_peaks(heat) & (heat >= least))
        found.append(np.c_[np.full(len(cells), kind), cells].astype(np.int64))
    kind, row, column = np.vstack(found).T
    offset = maps[len(KINDS) :, row, column].astype(np.float64)
    middle = (np.stack([column, row], 1) + offset[:2].T + 0.5) * STRIDE - 0.5
    return Peaks(kind, middle, SIZE_UNIT_PX * np.exp(offset[2:4].T), maps[kind, row, column].astype(np.float64))


def judge(peaks: Peaks, things: Array, left_open: Array) -> Judged:
    """Return which peak is at which thing of its kind: the peak with the greater score chooses first.

    things (M, 5), left_open (K, 4) as in `Labelled`. One peak for a thing: a second one at it is false.
    """
    thing = np.full(len(peaks.score), -1, dtype=np.int64)
    found_by = np.full(len(things), -1, dtype=np.int64)
    reach = things[:, 3:5] / 2 + ASIDE_PX
    for i in np.argsort(-peaks.score, kind="stable"):
        off = np.abs(peaks.middle_px[i] - things[:, 1:3]) / reach
        far = np.where((things[:, 0] == peaks.kind[i]) & (found_by < 0), off.max(1, initial=0.0), np.inf)
        if len(far) and far.min() <= 1.0:
            thing[i] = np.argmin(far)
            found_by[thing[i]] = i
    u, v = peaks.middle_px[:, :1], peaks.middle_px[:, 1:]
    left, top, right, bottom = left_open.T
    is_open = (u > left - ASIDE_PX) & (u < right + ASIDE_PX) & (v > top - ASIDE_PX) & (v < bottom + ASIDE_PX)
    return Judged(thing, (thing >= 0) | ~is_open.any(1), found_by)
