"""Scores of clicks of a flight with known truth: errors, coverage and sharpness, by bank and by minute of flight.

Sharpness is the 90th percentile of each click's error over its own 90 % ellipse, sqrt(Mahalanobis^2 / chi2_90): 1 is
right, 0.5 is an ellipse twice too wide, 2 one twice too small. Coverage alone cannot distinguish the first two.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from contract.answer import CHI2_2, Fix
from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.locate import Locator
from contract.wire.codec import decode, encode

Array = NDArray[np.float64]

BANKS_DEG = (0.0, 5.0, 15.0, 30.0, 180.0)
STEEP_DEG = BANKS_DEG[-2]
MINUTES = (0.0, 1.0, 2.0, 3.0, 60.0)
CHI2_99 = -2.0 * np.log(0.01)
FEWEST = 30  # clicks of a bin, below which it shows nothing
POOLED_GOAL, FLIGHT_GOAL, COVERAGE_GOAL = (0.85, 1.1), (0.7, 1.15), (0.85, 0.96)


@dataclass
class Score:
    """The score of one scene, one entry a click."""

    chi2: list[float] = field(default_factory=list)
    error_m: list[float] = field(default_factory=list)
    ratio: list[float] = field(default_factory=list)  # of the error to its own 90 % ellipse
    semi_m: list[float] = field(default_factory=list)
    bank_deg: list[float] = field(default_factory=list)
    flat_m: list[float] = field(default_factory=list)
    # The same two without the position's error at that moment, which no picture shows.
    beyond_m: list[float] = field(default_factory=list)
    flat_beyond_m: list[float] = field(default_factory=list)
    moment_s: list[float] = field(default_factory=list)
    asked: dict[str, int] = field(default_factory=lambda: {"all": 0, "bank": 0})
    answered: dict[str, int] = field(default_factory=lambda: {"all": 0, "bank": 0})
    refused: dict[str, int] = field(default_factory=dict)
    learned: str = ""
    learned_values: tuple[Array, Array] | None = None
    processor_s: float = 0.0  # of the estimator, without features and clicks


@dataclass(frozen=True)
class Bin:
    """Clicks of one kind: how many, the share inside the 90 % ellipse, the sharpness."""

    clicks: int
    coverage: float
    sharpness: float

    @classmethod
    def of(cls, ratio: Array) -> Bin | None:
        """Make a bin from errors over their own 90 % ellipse (N,); None where there are too few."""
        if len(ratio) < FEWEST:
            return None
        return cls(len(ratio), float(np.mean(ratio < 1.0)), float(np.quantile(ratio, 0.9)))

    def __str__(self) -> str:
        return f"{self.sharpness:4.2f} {100 * self.coverage:3.0f} %"


def _bins(value: Array, ratio: Array, edges: tuple[float, ...]) -> list[Bin | None]:
    return [Bin.of(ratio[(value >= low) & (value < high)]) for low, high in itertools.pairwise(edges)]


def _column(scores: list[Score], name: str) -> Array:
    return np.concatenate([np.array(getattr(s, name), float) for s in scores])


def sharpness_by_bank(scores: list[Score]) -> list[Bin | None]:
    """A bin for each of `BANKS_DEG`."""
    return _bins(_column(scores, "bank_deg"), _column(scores, "ratio"), BANKS_DEG)


def sharpness_by_minute(scores: list[Score]) -> list[Bin | None]:
    """A bin for each of `MINUTES` since the flight's begin."""
    return _bins(_column(scores, "moment_s") / 60.0, _column(scores, "ratio"), MINUTES)


def after_first_minute(scores: list[Score]) -> Bin | None:
    """All clicks after the first minute of their flights."""
    return Bin.of(_column(scores, "ratio")[_column(scores, "moment_s") >= 60.0])


def share_inside(scores: list[Score]) -> list[float | None]:
    """Share of errors inside the 90 % ellipse in each bin of bank; None where hardly any were asked."""
    chi2, bank = _column(scores, "chi2"), _column(scores, "bank_deg")
    out: list[float | None] = []
    for low, high in itertools.pairwise(BANKS_DEG):
        here = (bank >= low) & (bank < high)
        out.append(float(np.mean(chi2[here] < CHI2_2)) if here.sum() > 5 else None)
    return out


def row(name: str, scores: list[Score]) -> str:
    """One line of the table of errors."""
    chi2, error, flat, ratio = (_column(scores, c) for c in ("chi2", "error_m", "flat_m", "ratio"))
    if not len(chi2):
        return f"{name:<38} nothing"
    asked = {b: sum(s.asked[b] for s in scores) for b in ("all", "bank")}
    answered = {b: sum(s.answered[b] for s in scores) for b in ("all", "bank")}
    beyond = [np.median(_column(scores, c)) for c in ("beyond_m", "flat_beyond_m")]
    shares = ["   -" if share is None else f"{100 * share:4.0f}" for share in share_inside(scores)]
    answered_bank = 100 * answered["bank"] / max(asked["bank"], 1)
    q = np.quantile
    return (
        f"{name:<38} {100 * answered['all'] / max(asked['all'], 1):4.0f} {answered_bank:4.0f} |"
        f"{q(error, 0.5):5.2f} {q(error, 0.9):6.2f} | {q(flat, 0.5):5.2f} {q(flat, 0.9):6.2f} |{' '.join(shares)} |"
        f" {100 * np.mean(chi2 < CHI2_2):4.0f} {100 * np.mean(chi2 < CHI2_99):5.1f} {ratio.max():5.1f}"
        f" | {beyond[0]:5.2f} {beyond[1]:5.2f} {beyond[0] / beyond[1]:4.2f}"
    )


def sharpness_header() -> str:
    """The head of the table of sharpness."""
    banks = " ".join(f"{f'{low:.0f}-{high:.0f} deg':>10}" for low, high in itertools.pairwise(BANKS_DEG[:-1]))
    minutes = " ".join(f"{f'minute {low:.0f}-{high:.0f}':>10}" for low, high in itertools.pairwise(MINUTES[:-1]))
    last = f"{f'>{BANKS_DEG[-2]:.0f} deg':>10} |"
    return f"{'sharpness, coverage':<38} {'all':>10} |{banks} {last}{minutes} {'later':>10} | semi-axis after 1 min"


def sharpness_row(name: str, scores: list[Score], goal: tuple[float, float]) -> str:
    """One line of it: sharpness and coverage in every bin, and what of the goal is missed after the first minute."""

    def cells(bins: list[Bin | None]) -> str:
        return " ".join(f"{'-' if b is None else str(b):>10}" for b in bins)

    by_bank, by_minute, late = sharpness_by_bank(scores), sharpness_by_minute(scores), after_first_minute(scores)
    whole = Bin.of(_column(scores, "ratio"))
    semi = _column(scores, "semi_m")[_column(scores, "moment_s") >= 60.0]
    missed = []
    if late is not None and not goal[0] <= late.sharpness <= goal[1]:
        missed.append(f"sharpness {late.sharpness:.2f}")
    low, high = COVERAGE_GOAL
    worst = [b.coverage for b in (*by_bank, *by_minute) if b is not None and not low <= b.coverage <= high]
    if worst:
        missed.append("coverage " + ", ".join(f"{100 * c:.0f}" for c in sorted(worst)))
    width = f"{np.median(semi):6.1f} m" if len(semi) else "     -"
    head = f"{name:<38} {cells([whole])} |{cells(by_bank)} |{cells(by_minute)} | {width}"
    return f"{head}  missed: {'; '.join(missed)}" if missed else f"{head}  reached"


class Clicked(Protocol):
    """A flight with known truth and pictures to click: recorded telemetry with simulated ground, or all simulated."""

    times_s: Array
    place: LocalFrame
    bank_deg: Array

    def ground_points(self, frame: int, uv_px: Array) -> Array:
        """The ground (N, 3) that pixels (N, 2) of a picture show; nan where they show none."""


@dataclass(frozen=True, eq=False)
class Click:
    """A pixel of a picture, the ground that it truly shows (3,), and the answer: a fix, or why there is none."""

    frame: int
    uv_px: Array
    where_m: Array
    fix: Fix | str

    def error_m(self, place: LocalFrame) -> Array:
        """East and north (2,) of a fix's error."""
        fix = self.fix
        assert isinstance(fix, Fix) and fix.height_amsl_m is not None
        return (place.to_enu(fix.lat_deg, fix.lon_deg, fix.height_amsl_m) - self.where_m)[:2]


def clicks(
    flight: Clicked, sets: Mapping[int, FeatureSet], size_px: tuple[int, int], each: int, warm_s: float, seed: int
) -> Iterator[Click]:
    """`each` clicks all over every picture after `warm_s` that shows ground there, the sets over the wire."""
    rng = np.random.default_rng([seed, 912])
    for k, t in enumerate(flight.times_s):
        if t < warm_s:
            continue
        uv = rng.uniform(0.05, 0.95, (each, 2)) * (np.array(size_px) - 1)
        truth = flight.ground_points(k, uv)
        s = sets.get(k)
        locator = None if s is None or not s.is_ok else Locator(decode(encode(s)))
        for one, where in zip(uv, truth, strict=True):
            if not np.isfinite(where).all():
                continue
            if locator is None:
                yield Click(k, one, where, "none" if s is None else s.status.value)
            else:
                answer = locator.locate(one)
                yield Click(k, one, where, answer if isinstance(answer, Fix) else f"click {answer.status.value}")


def scored(flight: Clicked, asked: Iterable[Click]) -> Score:
    """The score of clicks, without what a flat ray gives."""
    score = Score()
    for click in asked:
        add(score, flight, click)
    return score


def add(score: Score, flight: Clicked, click: Click) -> bool:
    """One more click; True if it was answered."""
    bank_deg = float(flight.bank_deg[click.frame])
    bins = ["all"] + (["bank"] if bank_deg > STEEP_DEG else [])
    for b in bins:
        score.asked[b] += 1
    if not isinstance(click.fix, Fix):
        score.refused[click.fix] = score.refused.get(click.fix, 0) + 1
        return False
    for b in bins:
        score.answered[b] += 1
    error = click.error_m(flight.place)
    chi2 = float(error @ np.linalg.solve(click.fix.covariance_enu_m2[:2, :2], error))
    score.chi2.append(chi2)
    score.ratio.append(float(np.sqrt(chi2 / CHI2_2)))
    score.error_m.append(float(np.hypot(*error)))
    score.semi_m.append(click.fix.ellipse.semi_major_m)
    score.bank_deg.append(bank_deg)
    score.moment_s.append(float(flight.times_s[click.frame]))
    return True
