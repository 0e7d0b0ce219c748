"""By how much the clocks of two logs of one flight differ, by their positions; or that they are not of one flight.

Nothing is assumed of either clock: one may show local time, or be minutes off. Attitudes are not compared, because a
log may have none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.geodesy import LocalFrame
from onboard.events.types import GpsQuality, PositionFix
from onboard.telemetry.telemetry_log import MAX_GAP_S, NS_PER_S, TelemetryLog

Array = NDArray[np.float64]

REACH_S = 15.0 * 3600.0  # of clocks: any zone
STEP_S = 0.2  # of the offsets compared
COARSE_M = 10.0  # one sigma of a position then: receivers' errors, and how far an aircraft travels in a step
MOST_PROBES = 400  # positions that judge all offsets
OUTLIERS = 0.05  # density of a position that fits nothing, as a share of a good one's
RIVALS, APART_S = 12, 1.0  # offsets that are refined; closer ones are the same
ANNEALING = (4.0, 2.0, 1.5, 1.0, 1.0, 1.0, 1.0, 1.0)
BIAS_M = (3.0, 3.0, 300.0)  # one sigma, east, north, up: of two receivers and datums, and where heights count from
USUAL_M, MISFIT = (2.1, 2.1, 3.5), 6.0  # of two receivers; times that variance, from which on a log is another's
LEAST_M = 0.02  # steps of positions
CLEAR = 2.0 * np.log(1000.0)  # of the cost: a thousand to one
MOST_OF = 0.5  # of the shorter log, that the other explains
WIDEST_S = 1.0  # one sigma at most
BLOCKS = 12  # of a flight, whose errors are taken as independent of one another's
LEAST_POSITIONS = 10
SLOPE_NS = 50_000_000  # to either side, where a velocity is taken


@dataclass(frozen=True)
class Tie:
    """The offset (s) to add to the other log's stamps, one sigma, and over how long (s) both have positions."""

    offset_s: float
    sigma_s: float
    common_s: float


@dataclass(frozen=True)
class Untied:
    """The answer that no offset makes them one flight, or more than one does, with the reason for people."""

    reason: str


def tie(reference: TelemetryLog, other: TelemetryLog) -> Tie | Untied:
    """Return the offset of the other log's clock against the reference's. (32.1) to (32.5)"""
    logs = reference, other
    paths = [_Path.of(log, reference) for log in logs]
    if min(len(path.since_ns) for path in paths) < LEAST_POSITIONS:
        return Untied(f"one of them has fewer than {LEAST_POSITIONS} positions")
    usual_m = np.maximum(USUAL_M, np.hypot(*(_claimed_m(log) for log in logs)))
    short, long = sorted(paths, key=lambda path: int(path.since_ns[-1]))
    sign = 1.0 if short is paths[1] else -1.0  # of what is added to the shorter one's stamps
    starts = _starts(short, long)
    if not len(starts):
        return Untied("no offset of their clocks, of up to 15 hours, joins their times")
    fits = [_fit(short, long, start_s) for start_s in starts]
    best = min(fits, key=lambda fit: fit.cost(fit.sigma_m))
    if best.explained < MOST_OF * best.probes or np.any(best.sigma_m**2 > MISFIT * usual_m**2):
        return Untied(f"their positions differ at any offset of their clocks ({best.words})")
    least, likeness, sigma_s = best.cost(best.sigma_m), best.correlation, best.sigma_s()
    for fit in fits:
        is_other = abs(fit.offset_s - best.offset_s) > max(APART_S, 4.0 * sigma_s)
        if is_other and fit.cost(best.sigma_m) - least < CLEAR * likeness:
            rivals = ", ".join(f"{sign * one.offset_s:+.1f} s" for one in (best, fit))
            return Untied(f"their positions fit equally at several offsets of their clocks ({rivals})")
    if sigma_s > WIDEST_S:
        return Untied(f"their positions determine the offset of their clocks to no better than +-{sigma_s:.1f} s")
    return Tie(sign * best.offset_s, sigma_s, best.common_s)


@dataclass(frozen=True, eq=False)
class _Path:
    """A log's positions: moments (N,) after `start_ns`, places (N, 3) and velocities (N, 3), ENU m of one frame."""

    start_ns: int
    since_ns: NDArray[np.int64]
    enu_m: Array
    velocity_m_s: Array

    @classmethod
    def of(cls, log: TelemetryLog, frame_of: TelemetryLog) -> _Path:
        fixes = {e.stamp_ns: e for e in log.events if isinstance(e, PositionFix)}
        stamps_ns = np.array(sorted(fixes), np.int64)
        geodetic = np.array([(f.lat_deg, f.lon_deg, f.height_amsl_m) for f in (fixes[t] for t in stamps_ns.tolist())])
        about = [e for e in frame_of.events if isinstance(e, PositionFix)]
        middle = about[len(about) // 2]  # before its receiver has a fix an autopilot may send any place
        enu_m = LocalFrame(middle.lat_deg, middle.lon_deg, middle.height_amsl_m).to_enu(*geodetic.T)
        since_s = (stamps_ns - stamps_ns[0]) / NS_PER_S
        slopes = np.gradient(enu_m, since_s, axis=0) if len(since_s) > 1 else np.zeros_like(enu_m)
        return cls(int(stamps_ns[0]), stamps_ns - stamps_ns[0], enu_m, slopes)

    def at(self, since_ns: NDArray[np.int64]) -> Array:
        """Places (M, 3) on cubics between positions; nan before the first, after the last and in gaps."""
        right = np.clip(np.searchsorted(self.since_ns, since_ns, side="right"), 1, len(self.since_ns) - 1)
        left = right - 1
        gap_ns = self.since_ns[right] - self.since_ns[left]
        s = ((since_ns - self.since_ns[left]) / gap_ns)[:, None]
        known = (s[:, 0] >= 0.0) & (s[:, 0] <= 1.0) & (gap_ns <= MAX_GAP_S * NS_PER_S)
        a, b, gap_s = self.enu_m[left], self.enu_m[right], (gap_ns / NS_PER_S)[:, None]
        place = (1 + 2 * s) * (1 - s) ** 2 * a + s * s * (3 - 2 * s) * b
        place += gap_s * (s * (1 - s) ** 2 * self.velocity_m_s[left] - s * s * (1 - s) * self.velocity_m_s[right])
        return np.where(known[:, None], place, np.nan)


def claimed(log: TelemetryLog, which: Callable[[GpsQuality], float | None], unstated: float) -> float:
    """Return the median of what a log's receiver claims of itself; `unstated` where it claims nothing."""
    claims = [which(event) for event in log.events if isinstance(event, GpsQuality)]
    known = [value for value in claims if value is not None]
    return float(np.median(known)) if known else unstated


def _claimed_m(log: TelemetryLog) -> Array:
    """One sigma (3,) of a position, east, north, up, as the log claims in the middle; 0 where it does not."""
    horizontal_m = claimed(log, lambda c: c.sigma_horizontal_m, 0.0)
    return np.array([horizontal_m, horizontal_m, claimed(log, lambda c: c.sigma_vertical_m, 0.0)])


def _starts(short: _Path, long: _Path) -> Array:
    """Offsets (s) to add to the shorter one's stamps, the likeliest by horizontal places first. (32.1)"""
    every = -(-len(short.since_ns) // MOST_PROBES)
    probes_s, places_m = short.since_ns[::every] / NS_PER_S, short.enu_m[::every, :2]
    grid_ns = np.arange(0, int(long.since_ns[-1]) + 1, round(STEP_S * NS_PER_S))
    grid_m = np.nan_to_num(long.at(grid_ns)[:, :2], nan=np.inf)
    ahead_s = (long.start_ns - short.start_ns) / NS_PER_S
    least_s = max(ahead_s - probes_s[-1], -REACH_S)
    most_s = min(ahead_s + grid_ns[-1] / NS_PER_S, REACH_S)
    offsets_s = np.arange(least_s, most_s, STEP_S)
    costs = np.empty(len(offsets_s))
    for i, offset_s in enumerate(offsets_s):
        index = np.rint((probes_s + offset_s - ahead_s) / STEP_S).astype(np.intp)
        inside = (index >= 0) & (index < len(grid_m))
        apart_m = places_m[inside] - grid_m[index[inside]]
        good = np.exp(-0.5 * np.square(apart_m / COARSE_M).sum(axis=1))
        costs[i] = -2.0 * np.log(good + OUTLIERS).sum() - 2.0 * np.log(OUTLIERS) * np.count_nonzero(~inside)
    chosen: list[float] = []
    for i in np.argsort(costs, kind="stable"):
        if len(chosen) == RIVALS or costs[i] >= -2.0 * np.log(OUTLIERS) * len(probes_s) - 1e-9:
            break
        if all(abs(offsets_s[i] - one_s) > APART_S for one_s in chosen):
            chosen.append(float(offsets_s[i]))
    return np.array(chosen)


@dataclass(frozen=True, eq=False)
class _Fit:
    """The offset (s), with what is left of every probe's place (N, 3), how the offset moves it (N, 3), and weights.

    Only probes that the other log covers are in `left_m`; `probes` are all.
    """

    offset_s: float
    left_m: Array
    by_offset: Array
    weight: Array
    sigma_m: Array
    moments_s: Array
    probes: int

    @property
    def explained(self) -> int:
        return int(np.count_nonzero(self.weight > 0.5))

    @property
    def common_s(self) -> float:
        return float(np.ptp(self.moments_s)) if len(self.moments_s) else 0.0

    @property
    def words(self) -> str:
        at_best = f"at the best one by {np.hypot(*self.sigma_m[:2]):.0f} m"
        return f"{at_best}, {self.explained} of {self.probes} fit"

    def cost(self, sigma_m: Array) -> float:
        """-2 times the logarithm of a likelihood; a probe that the other log does not cover fits nothing. (32.2)"""
        good = np.exp(-0.5 * np.square(self.left_m / sigma_m).sum(axis=1))
        missing = self.probes - len(self.left_m)
        scale = 2.0 * self.probes * float(np.log(sigma_m).sum())
        return float(-2.0 * np.log(good + OUTLIERS).sum() - 2.0 * missing * np.log(OUTLIERS)) + scale

    @property
    def correlation(self) -> float:
        """The number of probes with the information of one, by their neighbours' correlation; 1 at least."""
        r = self.left_m / self.sigma_m * np.sqrt(self.weight)[:, None]
        power = float(np.square(r).sum())
        if power == 0.0:
            return 1.0
        total = 1.0
        for lag in range(1, len(r) // 4):
            correlated = float((r[lag:] * r[:-lag]).sum()) / power
            if correlated <= 0.0:
                break
            total += 2.0 * correlated
        return total

    def sigma_s(self) -> float:
        """One sigma of the offset. (32.4), (32.5)"""
        J = _columns(self.by_offset) / self.sigma_m[None, :, None]  # (N, 3, 4)
        r, w = self.left_m / self.sigma_m, self.weight
        N = np.einsum("n,nij,nik->jk", w, J, J) + _prior(np.zeros(3))[0]
        inverse = np.linalg.inv(N)
        block = np.minimum((BLOCKS * np.arange(len(r))) // max(len(r), 1), BLOCKS - 1)
        each = np.einsum("n,nij,ni->nj", w, J, r)
        gains = np.stack([np.bincount(block, each[:, j], BLOCKS) for j in range(J.shape[2])], axis=1) @ inverse
        by_blocks = float(np.square(gains[:, 0]).sum()) * BLOCKS / (BLOCKS - J.shape[2])
        weights = np.stack([np.bincount(block, w * np.square(J[..., 0]).sum(axis=1), BLOCKS)], axis=1)[:, 0]
        own = np.bincount(block, each[:, 0], BLOCKS) / np.maximum(weights, 1e-12)
        wander = float(np.average(np.square(own), weights=np.maximum(weights, 1e-12)))
        return float(np.sqrt(max(by_blocks, float(inverse[0, 0]) * self.correlation) + wander))


def _fit(short: _Path, long: _Path, start_s: float) -> _Fit:
    """Refine an offset together with a constant difference of the places. (32.2), (32.3)"""
    ahead_ns, probes = long.start_ns - short.start_ns, short.since_ns
    offset_s, bias_m = start_s, np.zeros(3)
    sigma_m = np.array([COARSE_M, COARSE_M, COARSE_M])
    left, slope, weight = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    known: NDArray[np.bool_] = np.zeros(len(probes), bool)
    for turn, factor in enumerate(ANNEALING):
        since_ns = probes + round(offset_s * NS_PER_S) - ahead_ns
        place, after, before = (long.at(since_ns + d) for d in (0, SLOPE_NS, -SLOPE_NS))
        slope = (after - before) / (2.0 * SLOPE_NS / NS_PER_S)
        known = np.asarray(np.isfinite(slope).all(axis=1), bool)
        if np.count_nonzero(known) < LEAST_POSITIONS:
            break
        slope, apart = slope[known], short.enu_m[known] - place[known]
        if turn == 0:
            bias_m[2] = float(np.median(apart[:, 2]))
        left = apart - bias_m
        sigma_m = np.maximum(_spread_m(left), LEAST_M) if turn else sigma_m
        good = np.exp(-0.5 * np.square(left / (factor * sigma_m)).sum(axis=1))
        weight = good / (good + OUTLIERS)
        if turn == len(ANNEALING) - 1:
            break
        J = _columns(slope) / sigma_m[None, :, None]
        precision, pull = _prior(bias_m)
        N = np.einsum("n,nij,nik->jk", weight, J, J) + precision
        step = np.linalg.solve(N, np.einsum("n,nij,ni->j", weight, J, left / sigma_m) + pull)
        offset_s += float(np.clip(step[0], -1.0, 1.0))
        bias_m = bias_m + step[1:]
    moments_s = probes[known] / NS_PER_S if len(left) else np.zeros(0)
    return _Fit(offset_s, left, slope, weight, sigma_m, moments_s, len(probes))


def _columns(slope: Array) -> Array:
    """(N, 3, 4): what is left of a place by the offset, and by a constant difference of the places."""
    return np.concatenate([slope[..., None], np.broadcast_to(np.eye(3), (len(slope), 3, 3))], axis=-1)


def _prior(bias_m: Array) -> tuple[Array, Array]:
    """Precision (4, 4) and pull (4,) of what is known of the constant difference; of the offset hardly anything."""
    precision = np.diag([1e-6, *(1.0 / np.square(BIAS_M))])
    return precision, -precision @ np.array([0.0, *bias_m])


def _spread_m(left_m: Array) -> Array:
    """One sigma (3,) by medians; both horizontal axes have one between them."""
    spread = 1.4826 * np.median(np.abs(left_m), axis=0)
    horizontal = float(np.hypot(spread[0], spread[1]) / np.sqrt(2.0))
    return np.array([horizontal, horizontal, float(spread[2])])
