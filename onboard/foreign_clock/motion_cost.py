"""The fit of pictures' motion to a log's at any time offset between them. Section 28 of docs/mathematics-clock.md.

The motion from one picture to the next is taken as four numbers, those of a similarity: shift (2), turn, scale. Each
offset predicts them over level ground; what is common to the flight (mount, height of the ground) is estimated with it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from onboard.foreign_clock.log_track import STEP_NS, LogTrack
from onboard.foreign_clock.picture_pairs import Pairs

Array = NDArray[np.float64]

MIN_HEIGHT_M = 5.0
COMMON = 5  # mount (3), logarithms of the height over the ground and of the focal length
OUTLIERS = 0.05  # share of pairs to be left out: wrong matches, no ground plane
# Outliers may lie anywhere: shifts and turns of a radian, a scale by a factor of e.
LOG_BROAD = float(np.log(OUTLIERS / 2.0))
ANNEALING = (8.0, 3.0, 1.0, 1.0)  # the sigmas' factors, from round to round
MIN_DEPTH = 0.05  # of a direction in the second picture, in heights
SLIGHT_NS = 20_000_000  # by which moments are moved for a derivative
CHUNK = 40_000  # pairs times offsets at once


@dataclass(frozen=True)
class MotionNoise:
    """One sigma of what common states do not explain; and of these: `mount`, `height` and `focal` as shares."""

    tilt_rad: float  # of the turn between two attitudes about level axes
    heading_rad: float
    place_m: float  # of the distance between two positions
    relief: float  # of the ground, as a share of the height
    stamp_s: float  # of one stamp
    match_rad: float
    mount_rad: float
    height: float
    focal: float
    base_m: float = 0.0  # that heights are higher over the ground than the log has them


def summary(at: Array, to: Array) -> Array:
    """Shift, turn and logarithm of the scale (..., 4) that take four points (..., 4, 2) to others. (28.1)"""
    middle_at, middle_to = at.mean(axis=-2, keepdims=True), to.mean(axis=-2, keepdims=True)
    a, b = at - middle_at, to - middle_to
    size = np.square(a).sum(axis=(-1, -2))
    along = (a * b).sum(axis=(-1, -2)) / size
    across = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(axis=-1) / size
    shift = (middle_to - middle_at)[..., 0, :]
    turn, scale = np.arctan2(across, along), 0.5 * np.log(np.maximum(along**2 + across**2, 1e-12))
    return np.concatenate([shift, turn[..., None], scale[..., None]], axis=-1)


@dataclass(frozen=True, eq=False)
class MotionFit:
    """(T, K) costs of each pair at each offset, and squared sigmas of those that it explains, else nan."""

    total: Array
    square: Array


class MotionCost:
    """The cost of offsets, as -2 times the logarithm of a likelihood, profiled over what is common. (28.5)"""

    def __init__(self, track: LogTrack, pairs: Pairs, noise: MotionNoise) -> None:
        self.track, self.pairs, self.noise = track, pairs, noise
        self._height_m = track.height_m + noise.base_m
        self._measured = summary(pairs.at, pairs.to)
        self._since_s = (pairs.moments_ns - track.start_ns) / 1e9
        self._rays = np.concatenate([pairs.at, np.ones((len(pairs), 4, 1))], axis=-1)
        self._precision = np.diag([noise.mount_rad**-2.0] * 3 + [noise.height**-2.0, max(noise.focal, 1e-3) ** -2.0])

    def __call__(self, offsets_s: Array) -> MotionFit:
        """The cost that every offset leaves, by the hypothesis of the mount that leaves least."""
        step = max(CHUNK // max(len(self.pairs), 1), 1)
        parts = []
        for begin in range(0, len(offsets_s), step):
            part = offsets_s[begin : begin + step]
            fits = [self._fit(part, hypothesis) for hypothesis in range(len(self.track.R_cam_enu))]
            best = np.argmin([fit.total.sum(axis=1) for fit in fits], axis=0)
            rows = np.arange(len(part))
            parts.append(
                MotionFit(
                    *(np.stack(each)[best, rows] for each in zip(*((f.total, f.square) for f in fits), strict=True))
                )
            )
        return MotionFit(*(np.concatenate(each) for each in zip(*((f.total, f.square) for f in parts), strict=True)))

    def stamp_inflation(self, offset_s: float) -> float:
        """The factor, 1 at least, by which the offset's variance exceeds that of pairs whose errors are independent.

        A stamp's error moves all four values of both pairs that have the picture, together. (28.10)
        """
        offsets_s, n = np.array([offset_s]), self.noise
        hypotheses = range(len(self.track.R_cam_enu))
        hypothesis = int(np.argmin([self._fit(offsets_s, one).total.sum() for one in hypotheses]))
        views = self._views(offsets_s, hypothesis)
        known = views.known[0]
        if not known.any():
            return 1.0
        A, variance = self._predicted(views)[1][0, known], self._variance(views)[0, known]
        alone = MotionCost(self.track, self.pairs, replace(n, stamp_s=0.0))._variance(views)[0, known]
        by_stamp = np.stack([self._by_stamp(offsets_s, hypothesis, side)[known] for side in (0, 1)])  # (2, K, 4)
        X = np.concatenate([by_stamp.sum(axis=0)[..., None], A], axis=-1).reshape(-1, 1 + COMMON)
        weighted = X / variance.reshape(-1, 1)
        N = weighted.T @ X
        N[1:, 1:] += self._precision
        gain = np.linalg.solve(N, weighted.T)[0].reshape(-1, 4)
        shown = (gain[None] * by_stamp).sum(axis=-1)  # (2, K): the offset by each stamp's error
        moments, picture = np.unique(self.pairs.moments_ns[known], return_inverse=True)
        by_picture = np.bincount(picture.reshape(-1), shown.T.reshape(-1), len(moments))
        shared = float(np.sum(gain**2 * alone) + n.stamp_s**2 * np.sum(by_picture**2))
        return max(shared / float(np.sum(gain**2 * variance)), 1.0)

    def _by_stamp(self, offsets_s: Array, hypothesis: int, side: int) -> Array:
        """The derivative (K, 4) of the summary by the moment of the first or the second picture, per s."""
        apart = [0, 0]
        apart[side] = SLIGHT_NS
        before, after = (
            MotionCost(
                self.track, replace(self.pairs, moments_ns=self.pairs.moments_ns + sign * np.array(apart)), self.noise
            )
            for sign in (-1, 1)
        )
        there, here = (cost._predicted(cost._views(offsets_s, hypothesis))[0][0] for cost in (after, before))
        out: Array = (there - here) / (2e-9 * SLIGHT_NS)
        return out

    def _fit(self, offsets_s: Array, hypothesis: int) -> MotionFit:
        views = self._views(offsets_s, hypothesis)
        mean, A = self._predicted(views)
        variance = self._variance(views)
        apart = self._measured - mean
        apart[..., 2] = (apart[..., 2] + np.pi) % (2.0 * np.pi) - np.pi
        log_norm = np.log(2.0 * np.pi * variance).sum(axis=-1)
        common: Array = np.zeros((len(offsets_s), COMMON), np.float64)
        for factor in ANNEALING:
            square = _squares(apart, A, common, variance) / factor**2
            log_good = np.log1p(-OUTLIERS) - 0.5 * (square + log_norm) - 4.0 * np.log(factor)
            weight = np.where(views.known, 1.0 / (1.0 + np.exp(np.clip(LOG_BROAD - log_good, -50.0, 50.0))), 0.0)
            rows: Array = (A * (weight[..., None] / (factor**2 * variance))[..., None]).reshape(len(A), -1, COMMON)
            columns: Array = np.swapaxes(rows, 1, 2)
            N = columns @ A.reshape(len(A), -1, COMMON) + self._precision
            right = columns @ apart.reshape(len(A), -1, 1)
            common = np.asarray(np.linalg.solve(N, right)[..., 0], np.float64)
        square = _squares(apart, A, common, variance)
        log_good = np.log1p(-OUTLIERS) - 0.5 * (square + log_norm)
        cost = -2.0 * np.where(views.known, np.logaddexp(log_good, LOG_BROAD), LOG_BROAD)
        prior = np.einsum("ti,ij,tj->t", common, self._precision, common)
        cost += prior[:, None] / max(len(self.pairs), 1)
        return MotionFit(cost, np.where(views.known & (log_good > LOG_BROAD), square, np.nan))

    def _views(self, offsets_s: Array, hypothesis: int) -> _Views:
        step_s, last = STEP_NS / 1e9, len(self.track.height_m) - 1
        place = (self._since_s + offsets_s[:, None, None]) / step_s
        inside = ((place >= 0.0) & (place < last)).all(axis=-1)
        left = np.clip(np.floor(place).astype(np.intp), 0, max(last - 1, 0))
        share = place - left

        def joined(values: Array) -> Array:
            part = share.reshape(*share.shape, *(1,) * (values.ndim - 1))
            before = values[left]
            out: Array = before + part * (values[left + 1] - before)
            return out

        turned = joined(self.track.R_cam_enu[hypothesis])
        centres, heights = joined(self.track.centre_enu_m), joined(self._height_m)[..., 0]
        rates = np.nan_to_num(np.square(self.track.rate_rad_s[hypothesis])[left].sum(axis=-2))
        moved = centres[..., 1, :] - centres[..., 0, :]
        known = inside & np.isfinite(turned.sum(axis=(-1, -2, -3)) + moved.sum(axis=-1))
        known &= np.nan_to_num(heights) > MIN_HEIGHT_M
        first, second = (np.where(known[..., None, None], turned[:, :, i], np.eye(3)) for i in (0, 1))
        moved = np.where(known[..., None], moved, 0.0)
        return _Views(first, second, moved, np.where(known, heights, 100.0), rates, known)

    def _predicted(self, views: _Views) -> tuple[Array, Array]:
        """(T, K, 4) by (28.2), and its derivatives by what is common (T, K, 4, 5), (28.3)."""
        turn = views.second @ np.swapaxes(views.first, -1, -2)
        shift = (views.second @ views.moved_m[..., None])[..., 0] / views.height_m[..., None]
        H = turn + shift[..., :, None] * views.first[..., None, :, 2]
        rays = np.swapaxes(self._rays, -1, -2)
        to, at = _divided(H @ rays), self.pairs.at
        mean = summary(at, to)
        A = np.zeros((*mean.shape, COMMON))
        middle_at, middle_to = at.mean(axis=1), to.mean(axis=2)
        c, s = np.exp(mean[..., 3]) * np.cos(mean[..., 2]), np.exp(mean[..., 3]) * np.sin(mean[..., 2])
        similar = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
        A[..., :2, :3] = _turning(middle_to) - similar @ _turning(middle_at)
        still = _divided(turn @ rays.mean(axis=-1, keepdims=True))[..., 0, :]
        A[..., :2, 3] = still - middle_to
        A[..., 3, 3] = -mean[..., 3]
        A[..., :2, 4] = self._measured[:, :2]
        return mean, A

    def _variance(self, views: _Views) -> Array:
        """(T, K, 4) of what is left, by (28.4)."""
        n = self.noise
        travelled = np.linalg.norm(views.moved_m, axis=-1) / views.height_m
        apart_s = np.maximum(np.diff(self._since_s, axis=1)[:, 0], 1e-3)
        flow = (n.relief * travelled) ** 2 + 2.0 * (n.stamp_s * travelled / apart_s) ** 2
        flow += (n.place_m / views.height_m) ** 2 + n.match_rad**2
        stamp = n.stamp_s**2 * views.square_rates
        level = n.tilt_rad**2 + flow
        heading = n.heading_rad**2 + flow + stamp[..., 2]
        return np.stack([level + stamp[..., 1], level + stamp[..., 0], heading, level], axis=-1)


def _squares(apart: Array, A: Array, common: Array, variance: Array) -> Array:
    left = apart - (A @ common[:, None, :, None])[..., 0]
    out: Array = (left**2 / variance).sum(axis=-1)
    return out


def _divided(p: Array) -> Array:
    """(..., 3, P) -> (..., P, 2); behind the camera anywhere far off."""
    xy = p[..., :2, :] / np.maximum(p[..., 2:, :], MIN_DEPTH)
    return np.swapaxes(xy, -1, -2)


def _turning(xy: Array) -> Array:
    """(..., 2, 3): how a direction moves as the camera turns, (5.2)."""
    x, y = xy[..., 0], xy[..., 1]
    rows = [np.stack([-x * y, 1.0 + x * x, -y], -1), np.stack([-1.0 - y * y, x * y, x], -1)]
    return np.stack(rows, -2)


@dataclass(frozen=True, eq=False)
class _Views:
    """(T, K): the attitudes of both pictures (3, 3), the way between (3), height, the sum of squared rates (3)."""

    first: Array
    second: Array
    moved_m: Array
    height_m: Array
    square_rates: Array
    known: NDArray[np.bool_]
