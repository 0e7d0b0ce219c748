"""The worth of a score: how often things have such a peak, and how many false peaks of it a picture has.

For each kind and bin of the score, `found` is the share of labelled things with such a peak and `false_per_mpx` the
number of false peaks on a million pixels. Their ratio is a look's likelihood ratio, up to how many things a million
pixels hold. It never falls as the score rises: neighbours that disagree are pooled (isotonic regression).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from training.labelled_pictures import KINDS
from training.peaks import LEAST_SCORE, Flags
from training.score import Looks

Array = NDArray[np.float64]

EACH_LOGIT, MOST_SCORE = 0.25, 0.97
LEAST_COUNT = 24  # peaks of a bin
SIZES_PX = (0.0, 8.0, 16.0, 1000.0)  # the root of a box's area
LEAST_OF_SIZE = 60  # things of a size, to have a row of their own
RESAMPLED, RUN = 200, 20  # times; consecutive pictures that show much the same
MEGA = 1e6


@dataclass(frozen=True, eq=False)
class Counted:
    """Peaks by bin: at things and false (K,) each, and what of both there is: things, megapixels."""

    edges: Array
    true: Array
    false: Array
    things: int
    megapixels: float

    @property
    def found(self) -> Array:
        return self.true / max(self.things, 1)

    @property
    def false_per_mpx(self) -> Array:
        return self.false / self.megapixels

    @property
    def log_ratio(self) -> Array:
        """Log of the ratio of both densities, for things in a megapixel, (K,)."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self.found) - np.log(self.false_per_mpx))


def logit(score: Array) -> Array:
    s = np.clip(score, 1e-6, 1.0 - 1e-6)
    return np.asarray(np.log(s / (1.0 - s)))


def edges_for(score: Array) -> Array:
    """Return edges of bins (K + 1,), evenly by the logit, joined from the top on until each has `LEAST_COUNT` peaks."""
    low, high = logit(np.array([LEAST_SCORE, MOST_SCORE]))
    even = 1.0 / (1.0 + np.exp(-np.arange(low, high, EACH_LOGIT)))
    counts = np.histogram(score, [*even, 1.0])[0]
    edges, collected = [1.0], 0
    for edge, count in zip(even[::-1], counts[::-1], strict=True):
        collected += count
        if collected >= LEAST_COUNT:
            edges.append(float(edge))
            collected = 0
    if len(edges) == 1:
        edges.append(LEAST_SCORE)
    edges[-1] = LEAST_SCORE  # too few are left for a bin of their own
    return np.array(edges[::-1])


def isotonic(share: Array, weight: Array) -> NDArray[np.int64]:
    """Return which block each bin belongs to (K,), so that the weighted mean share rises from each to the next."""
    blocks: list[tuple[float, float, int]] = []  # mean, weight, bins
    for value, of in zip(share, weight, strict=True):
        blocks.append((float(value), float(of), 1))
        while len(blocks) > 1 and blocks[-2][0] >= blocks[-1][0]:
            (a, m, i), (b, n, j) = blocks[-2:]
            blocks[-2:] = [((a * m + b * n) / (m + n), m + n, i + j)]
    return np.repeat(np.arange(len(blocks)), [bins for _, _, bins in blocks])


def smoothed(true: Array, false: Array) -> tuple[Array, Array]:
    """Return the counts (K,) of true and false peaks with a ratio that never falls, nor is none or infinite.

    The ratio of a block of bins has Jeffreys' prior: half a peak of either kind more. What all bins of a block have
    together stays.
    """
    block = isotonic((true + 0.5) / (true + false + 1.0), true + false + 1.0)
    t, f = np.bincount(block, true), np.bincount(block, false)
    share = ((t + 0.5) / (t + f + 1.0))[block]
    both = true + false
    return share * both, (1.0 - share) * both


def chosen_peaks(looks: Looks, kind: int) -> tuple[Array, Flags, NDArray[np.int64]]:
    of = looks.peak_kind == kind
    return looks.peak_score[of], looks.peak_true[of], looks.peak_picture[of]


def counted(looks: Looks, kind: int) -> Counted:
    """Return the calibrated bins of one kind."""
    score, is_true, _ = chosen_peaks(looks, kind)
    edges = edges_for(score)
    true, false = (np.histogram(score[f], edges)[0].astype(np.float64) for f in (is_true, ~is_true))
    things, megapixels = int((looks.thing_kind == kind).sum()), float(looks.pixels.sum()) / MEGA
    return Counted(edges, *smoothed(true, false), things, megapixels)


def log_ratio_sigma(looks: Looks, kind: int, edges: Array, rng: np.random.Generator) -> Array:
    """Return how sure the log ratio of each bin is (K,): its spread over resampled runs of pictures.

    Neighbouring pictures show the same things, so runs of them are drawn, not pictures.
    """
    score, is_true, picture = chosen_peaks(looks, kind)
    runs = len(looks.pixels) // RUN + 1
    bins = np.clip(np.searchsorted(edges, score, "right") - 1, 0, len(edges) - 2)
    tables = np.zeros((2, runs, len(edges) - 1))
    np.add.at(tables, (is_true.astype(int), picture // RUN, bins), 1.0)
    things = np.bincount(looks.thing_picture[looks.thing_kind == kind] // RUN, minlength=runs)
    pixels = np.bincount(np.arange(len(looks.pixels)) // RUN, looks.pixels, minlength=runs)
    ratios = []
    for _ in range(RESAMPLED):
        w = np.bincount(rng.integers(runs, size=runs), minlength=runs).astype(np.float64)
        true, false = smoothed(w @ tables[1], w @ tables[0])
        share = (true + 1e-9) / max(float(w @ things), 1.0), (false + 1e-9) / (w @ pixels) * MEGA
        ratios.append(np.where(true + false > 0.0, np.log(share[0]) - np.log(share[1]), np.nan))
    return np.asarray(np.nanstd(np.array(ratios), 0))


def by_size(looks: Looks, kind: int, edges: Array) -> list[dict[str, object]]:
    """Return, for sizes with enough things, the share of them in each bin and the share without any peak."""
    rows: list[dict[str, object]] = []
    of = looks.thing_kind == kind
    for least, most in pairwise(SIZES_PX):
        score = looks.thing_score[of & (looks.thing_size_px >= least) & (looks.thing_size_px < most)]
        if len(score) >= LEAST_OF_SIZE:
            found = np.histogram(score, edges)[0] / len(score)
            row = {"from_px": least, "to_px": most, "things": len(score), "found": rounded(found)}
            rows.append({**row, "missed": round(1.0 - float(found.sum()), 4)})
    return rows


def table(looks: Looks, half: Looks, kind: int, rng: np.random.Generator) -> dict[str, object]:
    """Return a kind's part of `thermal_things.json`; its rows by size also count `half`, pictures of half the size."""
    bins = counted(looks, kind)
    return {
        "things": bins.things, "megapixels": round(bins.megapixels, 1),
        "edges": [round(float(e), 5) for e in bins.edges],
        "found": rounded(bins.found), "missed": round(max(0.0, 1.0 - float(bins.found.sum())), 4),
        "false_per_mpx": rounded(bins.false_per_mpx),
        "log_ratio_sigma": [round(float(s), 3) for s in log_ratio_sigma(looks, kind, bins.edges, rng)],
        "by_size": by_size(looks, kind, bins.edges), "by_size_half": by_size(half, kind, bins.edges),
    }  # fmt: skip


def rounded(values: Array) -> list[float]:
    return [float(f"{v:.5g}") for v in values]


def reliability(calibrated: Counted, looks: Looks, kind: int, parts: int = 10) -> list[dict[str, float]]:
    """Return, for ranges of the score, the log ratio as calibrated and as it is in other pictures.

    Ranges are bins together, each with about a tenth of the other pictures' peaks at things.
    """
    score, is_true, _ = chosen_peaks(looks, kind)
    true, false = (np.histogram(score[f], calibrated.edges)[0].astype(np.float64) for f in (is_true, ~is_true))
    things, megapixels = max(int((looks.thing_kind == kind).sum()), 1), looks.pixels.sum() / MEGA
    part = np.minimum((np.cumsum(true) - true / 2) * parts // max(true.sum(), 1.0), parts - 1)
    rows = []
    for bins in (part == i for i in np.unique(part)):
        stated = calibrated.found[bins].sum() / calibrated.false_per_mpx[bins].sum()
        measured = ((true[bins].sum() + 0.5) / things) / ((false[bins].sum() + 0.5) / megapixels)
        first, last = np.flatnonzero(bins)[[0, -1]]
        least, most = calibrated.edges[[first, last + 1]]
        rows.append(
            {"from_score": round(float(least), 3), "to_score": round(float(most), 3), "true": int(true[bins].sum()),
             "false": int(false[bins].sum()), "stated": round(float(np.log(stated)), 2),
             "measured": round(float(np.log(measured)), 2)}
        )  # fmt: skip
    return rows


def tables(looks: Looks, half: Looks, seed: int = 0) -> dict[str, dict[str, object]]:
    """Return the table of each kind that is labelled, by its name."""
    rng = np.random.default_rng(seed)
    present = [kind for kind in range(len(KINDS)) if (looks.thing_kind == kind).any()]
    return {KINDS[kind]: table(looks, half, kind, rng) for kind in present}
