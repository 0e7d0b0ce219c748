"""Scores over many pictures: average precision, and recall at a number of false peaks on a square kilometre."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from training.labelled_pictures import Grey, Labelled
from training.peaks import Flags, judge, peaks_of
from training.run_onnx import Maps

Array = NDArray[np.float64]

FALSE_PER_KM2 = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0)


@dataclass(frozen=True, eq=False)
class Looks:
    """Peaks and labelled things of many pictures, without what the labels leave open.

    `peak_*` (N,): picture (index), kind, score, and whether it is at a thing. `thing_*` (M,): picture, kind, score of
    its peak (0 where it has none), size (the root of its box's area, px). What they were looked for in: `pixels` and
    `ground_m2` of each picture (P,).
    """

    peak_picture: NDArray[np.int64]
    peak_kind: NDArray[np.int64]
    peak_score: Array
    peak_true: Flags
    thing_picture: NDArray[np.int64]
    thing_kind: NDArray[np.int64]
    thing_score: Array
    thing_size_px: Array
    pixels: Array
    ground_m2: Array


def look_at(pictures: Iterable[Labelled], maps_of: Callable[[Grey], Maps], shrink: int = 1) -> Looks:
    """Return what a net finds in pictures; each is made so many times smaller first."""
    peaks_rows, thing_rows, areas = [], [], []
    for i, picture in enumerate(pictures):
        grey, things = picture.grey(), picture.things.copy()
        if shrink > 1:
            smaller = (grey.shape[1] // shrink, grey.shape[0] // shrink)
            grey = np.asarray(cv2.resize(grey, smaller, interpolation=cv2.INTER_AREA), dtype=np.uint8)
            things[:, 1:] /= shrink
        peaks = peaks_of(maps_of(grey))
        judged = judge(peaks, things, picture.left_open / shrink)
        rows = np.c_[np.full(len(peaks.kind), i), peaks.kind, peaks.score, judged.thing >= 0]
        peaks_rows.append(rows[judged.counts])
        score = np.where(judged.found_by >= 0, np.r_[peaks.score, 0.0][judged.found_by], 0.0)
        thing_rows.append(np.c_[np.full(len(things), i), things[:, 0], score, np.sqrt(things[:, 3] * things[:, 4])])
        areas.append((grey.size, picture.ground_m2(grey.size) * shrink**2))
    p, t, a = np.vstack(peaks_rows), np.vstack(thing_rows), np.array(areas, dtype=np.float64).reshape(-1, 2)
    return Looks(
        p[:, 0].astype(np.int64), p[:, 1].astype(np.int64), p[:, 2], p[:, 3] > 0.5,
        t[:, 0].astype(np.int64), t[:, 1].astype(np.int64), t[:, 2], t[:, 3], a[:, 0], a[:, 1],
    )  # fmt: skip


def of_pictures(looks: Looks, chosen: Flags) -> Looks:
    """Return the looks at some of the pictures alone, `chosen` (P,)."""
    p, t = chosen[looks.peak_picture], chosen[looks.thing_picture]
    return Looks(
        looks.peak_picture[p], looks.peak_kind[p], looks.peak_score[p], looks.peak_true[p],
        looks.thing_picture[t], looks.thing_kind[t], looks.thing_score[t], looks.thing_size_px[t],
        np.where(chosen, looks.pixels, 0.0), np.where(chosen, looks.ground_m2, 0.0),
    )  # fmt: skip


def joined(one: Looks, other: Looks) -> Looks:
    """Return the looks at the pictures of both, those of `other` counted on from those of `one`."""
    more = len(one.pixels)
    moved = replace(other, peak_picture=other.peak_picture + more, thing_picture=other.thing_picture + more)
    return Looks(*(np.concatenate([getattr(looks, f.name) for looks in (one, moved)]) for f in fields(Looks)))


def average_precision(score: Array, is_true: Flags, things: int) -> float:
    """Return the area below the curve of precision over recall, each precision the best at that recall or more."""
    if things == 0:
        return float("nan")
    true = is_true[np.argsort(-score, kind="stable")]
    precision = np.cumsum(true) / np.arange(1, len(true) + 1)
    best = np.maximum.accumulate(precision[::-1])[::-1]
    return float(best[true].sum() / things)


def recall_at(score: Array, is_true: Flags, things: int, false: float) -> tuple[float, float]:
    """Return the recall with at most so many false peaks, and the least score that is then taken."""
    order = np.argsort(-score, kind="stable")
    allowed = np.flatnonzero(np.cumsum(~is_true[order]) <= false)
    if things == 0 or len(allowed) == 0:
        return 0.0, 1.0
    last = int(allowed[-1])
    return float(is_true[order][: last + 1].sum() / things), float(score[order][last])


def figures(looks: Looks, kind: int) -> dict[str, object]:
    """Return the figures of a kind, as they are written to `figures.json`."""
    of_kind, km2 = looks.peak_kind == kind, float(looks.ground_m2.sum()) / 1e6
    score, is_true, things = looks.peak_score[of_kind], looks.peak_true[of_kind], int((looks.thing_kind == kind).sum())
    at = {f"{per:g}": recall_at(score, is_true, things, per * km2) for per in FALSE_PER_KM2}
    return {
        "things": things, "km2": round(km2, 3),
        "average_precision": round(average_precision(score, is_true, things), 4),
        "recall_and_threshold_at_false_per_km2": {per: [round(x, 3) for x in both] for per, both in at.items()},
    }  # fmt: skip
