"""The offset between a camera's clock and a log's: found over the whole log, or refused. (28.7), (28.8)

Photographs, videos and beginnings that a person states are one question here: moments by the camera's clock, what is
stated of it beforehand, how the pictures move, and which shots the autopilot has recorded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from onboard.foreign_clock.flight_parts import by_parts, first_of_parts, overstated, resampled
from onboard.foreign_clock.log_track import LogTrack
from onboard.foreign_clock.motion_cost import MotionCost, MotionNoise
from onboard.foreign_clock.picture_pairs import Pairs
from onboard.foreign_clock.shot_cost import shot_cost
from onboard.geometry.robust import median_chi2
from onboard.navigation.limits import CLEAR, MOST_OF
from onboard.telemetry.log_clocks import REACH_S

Array = NDArray[np.float64]

APART = "Import the pictures of before and of after by themselves"
STEP_S, FINE_S = 0.1, 0.02  # of the offsets compared, everywhere and about the best
CLOSE = np.linspace(-1.0, 1.0, 41)  # about a minimum, of as far as it reaches
NEAR_S = 1.0  # within which two offsets are the same minimum
ZONE_S = 900.0  # by which clocks of two zones differ, or a multiple
WIDEST_S = 1.1  # one sigma at most that the flight itself can resolve
ASTRAY = 1e-3  # how likely what is stated is wrong altogether
COARSE_PAIRS, KEPT = 40, 400  # in a first pass over all offsets, and how many of them all pairs judge then
# One sigma of how much later than its path a nose turns: rms of 40 minutes of recorded autopilots, planes and copters.
BEHIND_PATH_S = 0.2
MISFIT = 6.0  # times the variance expected, from which on a log is not that of the pictures


@dataclass(frozen=True)
class Stated:
    """The stated offset (s, to be added to the camera's time), one sigma, and by what."""

    offset_s: float
    sigma_s: float
    source: str


@dataclass(frozen=True)
class Clock:
    """The offset (s) to add to the camera's time, one sigma, and how it was found."""

    offset_s: float
    sigma_s: float
    text: str


@dataclass(frozen=True)
class Unknown:
    """The answer that no offset is known well enough, with the reason for people, and what helps if nothing usual."""

    reason: str
    advice: str = ""


@dataclass(frozen=True, eq=False)
class Evidence:
    """The data of a search: the log's path, the pictures' moments (ns) with one sigma (s) of each, motion, shots.

    `position_sigma_s`: one sigma of by how much the log's positions are older than its attitudes.
    """

    track: LogTrack
    moments_ns: Sequence[int]
    stamp_sigma_s: float
    pairs: Pairs
    noises: Sequence[MotionNoise]  # that may be true; the likeliest is taken
    shots_ns: Sequence[int] = ()
    position_sigma_s: float = 0.0


def search(evidence: Evidence, stated: Stated | None) -> Clock | Unknown:
    """The offset by all evidence, or why there is none."""
    offsets_s = _offsets(evidence, stated)
    if not len(offsets_s):
        return Unknown("no offset puts the pictures into the time of the log")
    tried = [_Cost(evidence, noise, stated) for noise in evidence.noises]
    everywhere = [cost.everywhere(offsets_s) for cost in tried]
    likeliest = int(np.argmin([costs.min() for costs, _ in everywhere]))
    cost, (costs, parts) = tried[likeliest], everywhere[likeliest]
    best_s = float(offsets_s[np.argmin(costs)])
    reach_s = NEAR_S if stated is None else max(NEAR_S, 4.0 * stated.sigma_s)
    fine_s = best_s + np.arange(-reach_s, reach_s + FINE_S / 2, FINE_S)
    fit = cost.of(fine_s)
    at = int(np.argmin(fit.total))
    mean_s, sigma_s, overstates = _estimate(cost, fine_s, fit.dispersion(at))
    far = np.abs(offsets_s - mean_s) > max(reach_s, 4.0 * sigma_s)
    if stated is not None and abs(mean_s - stated.offset_s) > reach_s:
        return _contradiction(stated, mean_s)
    rival_s = _rival(cost, fit, offsets_s[far & np.isfinite(costs)], costs[far & np.isfinite(costs)])
    if rival_s is not None:
        return Unknown(f"offsets of {mean_s:+.1f} s and {rival_s:+.1f} s fit equally")
    if sigma_s > WIDEST_S:
        return Unknown(f"nothing determines it better than +-{sigma_s:.1f} s")
    if stated is None and not cost.is_consistent(fit.square[at]):
        return Unknown("the pictures do not move as the log does at any time of it")
    step_s = _step(cost, offsets_s[far], parts[far], mean_s, fit.dispersion(at) * overstates)
    if step_s is not None:
        return Unknown(
            f"{mean_s:+.1f} s fits one part of the pictures, {step_s:+.1f} s another: a clock was set in flight", APART
        )
    return Clock(mean_s, sigma_s, cost.text(stated, fit.square[at]))


def _rival(cost: _Cost, near: _Fit, offsets_s: Array, costs: Array) -> float | None:
    """The likeliest of other offsets (s) that is not clearly worse than the best; None if all are. (28.8), (28.12)"""
    if not len(offsets_s):
        return None
    kept = np.argsort(costs)[:KEPT]
    fit, at = cost.of(offsets_s[kept]), int(np.argmin(near.total))
    by_pairs, dispersion = by_parts(fit.pairs - near.pairs[at]), near.dispersion(at)
    certain = by_pairs.sum(axis=1) / np.maximum(overstated(by_pairs), dispersion)
    certain += (fit.others - near.others[at]) / dispersion
    likeliest = int(np.argmin(certain))
    return float(offsets_s[kept][likeliest]) if certain[likeliest] < CLEAR else None


def _step(cost: _Cost, offsets_s: Array, parts: Array, mean_s: float, factor: float) -> float | None:
    """The other offset (s) of the flight's beginning or of its end, where these are clearly of another; None where the
    whole flight is of one. `parts` (T, B) are those of the other offsets; those of other zones are tried. `factor`:
    by which all costs overstate. Both offsets are compared with common states of that part alone: those of the whole
    flight are a compromise, and one that leaves out most of it is none. (28.13)
    """
    zones_s = mean_s + ZONE_S * np.arange(-round(REACH_S / ZONE_S), round(REACH_S / ZONE_S) + 1)
    zones_s = zones_s[np.abs(zones_s - mean_s) > 0.5 * ZONE_S]
    offsets_s, parts = np.concatenate([offsets_s, zones_s]), np.concatenate([parts, cost.parts(zones_s)])
    better = cost.parts(np.array([mean_s])) - parts
    count = better.shape[1]
    needed = CLEAR + 2.0 * np.log(2.0 * max(count * len(offsets_s), 1))  # a thousand to one, of all places and offsets
    found: tuple[float, float | None] = (1.0, None)
    for some in (part for split in range(1, count) for part in (slice(None, split), slice(split, None))):
        gain = better[:, some].sum(axis=1)
        large = np.flatnonzero(gain > needed * factor)
        certain = gain[large] / np.maximum(overstated(better[large, some]), factor) / needed
        if not len(large) or certain.max() <= found[0]:
            continue
        other_s = float(offsets_s[large[np.argmax(certain)]])
        by_itself = -np.diff(cost.parts_alone(np.array([mean_s, other_s]), some), axis=0)
        alone = float(by_itself.sum() / np.maximum(overstated(by_itself), factor)[0] / needed)
        if alone > found[0]:
            found = alone, other_s
    return found[1]


def _estimate(cost: _Cost, fine_s: Array, dispersion: float) -> tuple[float, float, float]:
    """Mean and sigma of the offset, and by how much its costs overstate. The age of the log's positions is estimated
    together with it, or where these are all that it has, by how much the nose follows the path. (28.9), (28.10)
    """
    age_sigma_s = cost.evidence.position_sigma_s if cost.evidence.track.has_attitude else BEHIND_PATH_S
    moments = _moments(cost, fine_s, dispersion)
    variance = moments.sigma_s**2 * cost.motion.stamp_inflation(moments.mean_s)
    variance = max(variance, moments.scatter_s**2)
    variance += cost.evidence.stamp_sigma_s**2 / len(cost.evidence.moments_ns)  # of the stamps' mean, at least
    if age_sigma_s <= 0.0:
        return moments.mean_s, float(np.sqrt(variance)), moments.overstates
    younger, older = (_moments(cost.with_age(age_s), fine_s, dispersion) for age_s in (-age_sigma_s, age_sigma_s))
    # A parabola through the least costs at -1, 0 and 1 sigma of the age, and what is known of it beforehand.
    slope, curvature = 0.5 * (older.least - younger.least), older.least + younger.least - 2.0 * moments.least
    precision = 1.0 + max(0.5 * curvature, 0.0)
    age = float(np.clip(-0.5 * slope / precision, -1.0, 1.0))
    by_age_s = 0.5 * (older.mean_s - younger.mean_s)
    sigma_s = float(np.sqrt(variance + by_age_s**2 / precision))
    return moments.mean_s + age * by_age_s, sigma_s, moments.overstates


@dataclass(frozen=True)
class _Moments:
    """The least cost, mean and sigma (s) of the offset by all costs, and its scatter (s) by parts of the flight."""

    least: float
    mean_s: float
    sigma_s: float
    scatter_s: float

    @property
    def overstates(self) -> float:
        """By how much (1 at least) the costs do, by the two variances of the offset."""
        return max(self.scatter_s / max(self.sigma_s, 1e-9), 1.0) ** 2


def _moments(cost: _Cost, fine_s: Array, dispersion: float) -> _Moments:
    """Return the moments by costs at these offsets, and then at offsets as close as the sigma found asks for."""
    offsets_s, found = fine_s, _Moments(0.0, 0.0, 0.0, 0.0)
    for _ in range(2):
        fit = cost.of(offsets_s)
        costs = fit.total / dispersion
        likely = np.exp(-0.5 * (costs - costs.min()))
        mean_s = float(np.average(offsets_s, weights=likely))
        sigma_s = float(np.sqrt(np.average(np.square(offsets_s - mean_s), weights=likely)))
        by_flight = resampled(offsets_s, by_parts(fit.pairs) / dispersion, fit.others / dispersion)
        mean_s, scatter_s = (mean_s, 0.0) if by_flight is None else by_flight
        found = _Moments(float(costs.min()), mean_s, sigma_s, scatter_s)
        offsets_s = mean_s + max(4.0 * max(sigma_s, scatter_s), 2.0 * FINE_S) * CLOSE
    return found


def _contradiction(stated: Stated, found_s: float) -> Unknown:
    return Unknown(
        f"{stated.source} states {stated.offset_s:+.2f} s, but the pictures move as the log does at {found_s:+.2f} s"
    )


def _offsets(evidence: Evidence, stated: Stated | None) -> Array:
    """(T,) to compare: all that leave most of the pictures within the log, and what is stated."""
    moments = np.sort(np.asarray(evidence.moments_ns, np.int64))
    middle = len(moments) // 2
    least_s = max((evidence.track.start_ns - int(moments[middle])) / 1e9, -REACH_S)
    most_s = min((evidence.track.end_ns - int(moments[middle])) / 1e9, REACH_S)
    everywhere = np.arange(least_s, most_s, STEP_S)
    if stated is None or not least_s <= stated.offset_s <= most_s:
        return everywhere
    about = stated.offset_s + stated.sigma_s * np.linspace(-4.0, 4.0, 33)
    return np.unique(np.concatenate([everywhere, about]))


@dataclass(frozen=True, eq=False)
class _Fit:
    """Costs of offsets: each pair's (T, K) with its squared sigmas, and what is no pair's (T,)."""

    pairs: Array
    square: Array
    others: Array

    @property
    def total(self) -> Array:
        out: Array = self.pairs.sum(axis=1) + self.others
        return out

    def dispersion(self, at: int) -> float:
        return _dispersion(self.square[at])


class _Cost:
    """All evidence of one flight at any offset. (28.7)"""

    def __init__(self, evidence: Evidence, noise: MotionNoise, stated: Stated | None) -> None:
        self.evidence, self._noise, self._stated = evidence, noise, stated
        pairs, self._every = evidence.pairs, max(-(-len(evidence.pairs) // COARSE_PAIRS), 1)
        self.motion = MotionCost(evidence.track, pairs, noise)

    @cached_property
    def _some(self) -> MotionCost:
        """The cost of some of many pairs, evenly over the flight."""
        pairs, every = self.evidence.pairs, self._every
        some = Pairs(pairs.moments_ns[::every], pairs.at[::every], pairs.to[::every])
        return self.motion if every == 1 else MotionCost(self.evidence.track, some, self._noise)

    def with_age(self, age_s: float) -> _Cost:
        """The same where the log's positions are older than its attitudes by so much; of what has no attitude, where
        the camera turns so much later than its path does.
        """
        track = self.evidence.track
        moved = track.with_positions(age_s) if track.has_attitude else track.with_attitudes(age_s)
        return _Cost(replace(self.evidence, track=moved), self._noise, self._stated)

    def of(self, offsets_s: Array) -> _Fit:
        fit = self.motion(offsets_s)
        return _Fit(fit.total, fit.square, self._others(offsets_s))

    def everywhere(self, offsets_s: Array) -> tuple[Array, Array]:
        """(T,) costs; of many pairs some judge all offsets, and all of them the best; inf where they did not. And those
        of the flight's parts (T, B), by some.
        """
        others, parts = self._others(offsets_s), self.parts(offsets_s)
        coarse = parts.sum(axis=1) + others
        if self._every <= 1:
            return coarse, parts
        out = np.full(len(offsets_s), np.inf)
        kept = np.sort(np.argsort(coarse)[:KEPT])
        out[kept] = self.motion(offsets_s[kept]).total.sum(axis=1) + others[kept]
        return out, parts

    def parts(self, offsets_s: Array) -> Array:
        """(T, B) costs of the flight's parts, by some of many pairs."""
        return by_parts(self._some(offsets_s).total) * self._every

    def parts_alone(self, offsets_s: Array, some: slice) -> Array:
        """(T, B) costs of some parts that follow one another, by all pairs, with common states of these parts alone."""
        pairs = self.evidence.pairs
        first = first_of_parts(len(pairs))
        edges = np.append(first, len(pairs))[some.start or 0 : None if some.stop is None else some.stop + 1]
        kept = slice(edges[0], edges[-1])
        alone = Pairs(pairs.moments_ns[kept], pairs.at[kept], pairs.to[kept])
        total = MotionCost(self.evidence.track, alone, self._noise)(offsets_s).total
        out: Array = np.add.reduceat(total, edges[:-1] - edges[0], axis=1)
        return out

    def _others(self, offsets_s: Array) -> Array:
        e, stated = self.evidence, self._stated
        out = shot_cost(e.moments_ns, e.shots_ns, offsets_s, e.stamp_sigma_s)
        if stated is not None:
            away = (offsets_s - stated.offset_s) / stated.sigma_s
            out = out - 2.0 * np.logaddexp(-0.5 * away**2 - np.log(stated.sigma_s), np.log(ASTRAY / REACH_S))
        return out

    def is_consistent(self, square: Array) -> bool:
        """Return whether pictures and log belong together at the best offset, by most of the pairs."""
        explained = np.isfinite(square)
        is_explained = bool(np.count_nonzero(explained) >= MOST_OF * len(square))
        return bool(self.evidence.shots_ns) or (is_explained and _dispersion(square) < MISFIT)

    def text(self, stated: Stated | None, square: Array) -> str:
        """The evidence that the offset is known by, in words."""
        by = []
        if stated is not None:
            by.append(stated.source)
        if self.evidence.shots_ns:
            by.append(f"{len(self.evidence.shots_ns)} recorded shots")
        if np.isfinite(square).any():
            by.append(f"the motion of {np.count_nonzero(np.isfinite(square))} pairs of pictures")
        return ", ".join(by)


def _dispersion(square: Array) -> float:
    """The ratio of the pairs' squared errors to the expected ones, by their medians; at least 1."""
    known = square[np.isfinite(square)]
    return max(float(np.median(known)) / median_chi2(4), 1.0) if len(known) else 1.0
