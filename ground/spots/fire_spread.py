"""The front of a fire by the distance of each of its parts from every picture's outline: how fast it moves, and by how
much each picture is off. (26.12) to (26.18)

No clock and no I/O.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.spots.motion import PICTURE_TIME_S
from ground.two_sets import symmetric_root

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_PARTS = 32  # of the front
LEAST_SPREAD_S = 10.0
SESSION_TIME_S = 60.0  # for which a receiver's error lasts, the part of a session's that moves
MISSED_SIGMAS = 3.0  # by which an outline is behind the others' front where it does not show that part
FITS = 8
MOST_BENDS, MOST_SIGMAS = 0.9, 1.645  # a share of normal variates, and what so many are within
STATED = 10.0  # degrees of freedom that the stated errors count as, against what the outlines show of them
RECEDES = 18.4  # chi-square of two, 1e-4, as of (26.9): what errors do not explain burns no longer
WORSE = 2.0  # times the usual sigma, above which a part is not known well enough to be the fastest
EDGE_SHARE, STRAIGHT = 0.02, 0.35  # of an outline's reach: how near to a line, and so long, is the picture's edge
ROUNDED = 1.0 / 127.0  # of an outline's reach: the step of its corners on the wire
LEAST_M = 0.01  # of a length
NODES = 16, 8  # directions and distances of (26.15)


@dataclass(frozen=True, eq=False)
class Front:
    """The outlines of one picture: closed rings (K, 2), east and north, m, whether the picture's edge cuts each, and
    the error that their places have: covariance (2, 2), m^2, and the shares of (25.12).
    """

    at_s: float
    session: tuple[str, int]
    rings_m: tuple[Array, ...]
    is_cut: tuple[bool, ...]
    covariance_m2: Array
    picture_share: float
    session_share: float


class _Errors:
    """The errors of all pictures' places (K), split by what is theirs alone and what lasts. (26.13)"""

    def __init__(self, fronts: Sequence[Front]) -> None:
        self._whole_m2 = np.array([front.covariance_m2 for front in fronts])
        self._picture = np.array([front.picture_share for front in fronts])
        self._session = np.minimum([front.session_share for front in fronts], self._picture)
        reach_m = [max(float(np.ptp(ring, axis=0).max()) for ring in front.rings_m) for front in fronts]
        self.corners_m2 = (0.5 * ROUNDED * np.array(reach_m)) ** 2 / 12.0 + LEAST_M**2
        times_s = np.array([front.at_s for front in fronts])
        lag_s = np.abs(times_s[:, None] - times_s[None])
        number = np.unique([f"{front.session}" for front in fronts], return_inverse=True)[1]
        is_same = number[:, None] == number[None]
        self._lasts = tuple(is_same * np.exp(-lag_s / time_s) for time_s in (PICTURE_TIME_S, SESSION_TIME_S))

    @property
    def mean_m2(self) -> Array:
        """(2, 2), of the usual picture's place."""
        out: Array = self._whole_m2.mean(axis=0)
        return out

    def along(self, normal: Array) -> Array:
        """(K, K), m^2, of the distances along a normal (2,)."""
        along = np.einsum("i,kij,j->k", normal, self._whole_m2, normal)
        out = np.diag(along * (1.0 - self._picture) + self.corners_m2)
        for share, lasts in zip((self._picture - self._session, self._session), self._lasts, strict=True):
            sigma = np.sqrt(along * share)
            out += lasts * np.outer(sigma, sigma)
        return out


@dataclass(frozen=True, eq=False)
class _Part:
    """One part of the front: its speed, m/s, with its variance, its outward normal (2,), the fit's misfit and freedom,
    the time over which pictures show it; how far (K,), m, it is from where the fit has it in each picture, with the
    normals (K, 2), and which (K,) show it.
    """

    speed_m_s: float
    variance: float
    outward: Array
    misfit: float
    freedom: float
    lasted_s: float
    away_m: Array
    normals: Array
    is_shown: Mask


@dataclass(frozen=True, eq=False)
class _Seen:
    """All outlines as one part of the front sees them: distances (K,), m, outward normals (K, 2), and which are of use
    (K,).
    """

    away_m: Array
    outward: Array
    is_shown: Mask


class FrontFit:
    """All outlines of a place's pictures, fitted to a front each part of which moves evenly."""

    def __init__(self, fronts: Sequence[Front], parts_m: Array) -> None:
        """`parts_m` (N, 2): places along the front."""
        self._fronts, self._errors = fronts, _Errors(fronts)
        each = (_part(fronts, self._errors, seen) for seen in _all_seen(fronts, parts_m))
        self._parts = [part for part in each if part is not None]

    def spread(self) -> tuple[float, float] | None:
        """The speed of the front's fastest part, m/s, and one sigma; None while too little is known."""
        known = [part for part in self._parts if part.lasted_s >= LEAST_SPREAD_S]
        return _fastest(*self._speeds(known)[:2]) if known else None

    def shifts(self) -> tuple[Array, float]:
        """The offsets (K, 2), m, of each picture's outlines from where all of them together have the fire, and one
        sigma of what is left of each part of them. (26.17), (26.18)
        """
        out = np.zeros((len(self._fronts), 2))
        variance = self._errors.corners_m2
        if not self._parts:
            return out, float(np.sqrt(variance.mean()))
        away, normals, shown = (
            np.stack([getattr(part, name) for part in self._parts]) for name in ("away_m", "normals", "is_shown")
        )
        for k, front in enumerate(self._fronts):
            n, r = normals[shown[:, k], k], away[shown[:, k], k]
            information = n.T @ n / variance[k] + np.linalg.inv(front.covariance_m2 + LEAST_M**2 * np.eye(2))
            out[k] = -np.linalg.solve(information, n.T @ r / variance[k])
        left = away + np.einsum("pki,ki->pk", normals, out)
        own_m = float(np.sqrt(variance.mean() + _own_m2(left, shown)))
        times_s = np.array([front.at_s for front in self._fronts])
        own_m_s = own_m * float(np.sqrt(12.0 / len(times_s))) / max(float(np.ptp(times_s)), 1e-9)
        drift_m_s = self._drift(own_m_s)
        if drift_m_s is None:  # what drives on is no front that moves evenly
            return np.zeros_like(out), own_m
        return out + np.outer(times_s - times_s.mean(), drift_m_s), own_m

    def _speeds(self, parts: Sequence[_Part]) -> tuple[Array, Array, Array]:
        """Speeds (N,) of the parts that are known well, and how they err together: (N, 2) times two normal variates;
        and their normals (N, 2).
        """
        variances = np.array([part.variance for part in parts])
        # All parts show the same errors of places, which have two axes.
        misfit, freedom = (float(np.mean([getattr(p, name) for p in parts])) for name in ("misfit", "freedom"))
        variances *= (STATED + 2.0 * misfit) / (STATED + 2.0 * freedom)
        is_good = np.sqrt(variances) <= WORSE * float(np.median(np.sqrt(variances)))
        outward = np.array([part.outward for part in parts])[is_good]
        along = outward @ symmetric_root(self._errors.mean_m2)
        length = np.maximum(np.hypot(*along.T), LEAST_M)
        per_sigma = (np.sqrt(variances[is_good]) / length)[:, None] * along
        return np.array([part.speed_m_s for part in parts])[is_good], per_sigma, outward

    def _drift(self, own_m_s: float) -> Array | None:
        """The speed (2,) at which the pictures' errors move: the least with which no part of the front recedes; None
        where errors explain nothing like it. (26.18)
        """
        speeds, per_sigma, outward = self._speeds(self._parts)
        zeta = _least_within(per_sigma, speeds, own_m_s)
        if zeta @ zeta >= RECEDES:
            return None
        # The drift that is so much along each normal.
        out: Array = np.asarray(np.linalg.lstsq(outward, per_sigma @ zeta, rcond=None)[0], float)
        return out


def _own_m2(left_m: Array, is_shown: Mask) -> float:
    """The variance of distances (N, K) from picture to picture: a part that moves unevenly is no error of outlines."""
    bends = np.diff(left_m, n=2, axis=1)[is_shown[:, 2:] & is_shown[:, 1:-1] & is_shown[:, :-2]]
    return float(np.quantile(np.abs(bends), MOST_BENDS) / MOST_SIGMAS) ** 2 / 6.0 if len(bends) else 0.0


def _least_within(normals: Array, limits: Array, sigma: float) -> Array:
    """The least (2,), in sigmas, whose products with normals (N, 2) are within limits (N,), of one sigma: (26.18)."""
    out, beyond = np.zeros(2), limits < 0.0
    for _ in range(FITS):
        n = normals[beyond] / sigma
        out = np.asarray(np.linalg.solve(np.eye(2) + n.T @ n, n.T @ limits[beyond] / sigma), float)
        before, beyond = beyond, normals @ out > limits
        if np.array_equal(before, beyond):
            break
    return out


def _fastest(speeds: Array, per_sigma: Array) -> tuple[float, float]:
    """The fastest of speeds (N,) that err together by (N, 2) times two normal variates, and one sigma. (26.15), (26.16)

    The greatest of erring values is too great in the mean: so the speeds differ by less, by as much as errors add, and
    what that leaves is taken off by what the same estimate makes of speeds that err once more.
    """
    angles = 2.0 * np.pi * (np.arange(NODES[0]) + 0.5) / NODES[0]
    far = np.sqrt(-2.0 * np.log(1.0 - (np.arange(NODES[1]) + 0.5) / NODES[1]))
    nodes = np.array([[r * np.cos(a), r * np.sin(a)] for r in far for a in angles])
    added = float(np.sum(per_sigma.var(axis=0)))
    without = _without(speeds, added)
    again = _without(without + nodes @ per_sigma.T, added).max(axis=1)
    found = 2.0 * float(without.max()) - float(again.mean())
    # How much is due depends on the errors that there were: it is as uncertain as it is large.
    return max(found, 0.0), float(np.hypot(again.std(), speeds.max() - found))


def _without(speeds: Array, added: float) -> Array:
    """Speeds (..., N) that differ by less: their variance has no longer what errors have added to it. (26.15)"""
    mean, variance = speeds.mean(axis=-1, keepdims=True), speeds.var(axis=-1, keepdims=True)
    share = np.sqrt(np.maximum(1.0 - added / np.maximum(variance, LEAST_M**2 * 1e-6), 0.0))
    out: Array = mean + share * (speeds - mean)
    return out


def _part(fronts: Sequence[Front], errors: _Errors, seen: _Seen) -> _Part | None:
    """The fit of one part of the front; None if too little is known. (26.14)

    Begins with the outlines that nothing cuts. One that is far behind the line does not show that part of the front.
    """
    times_s = np.array([front.at_s for front in fronts])
    whole = seen.is_shown & np.array([not any(front.is_cut) for front in fronts])
    used = whole if _lasted_s(times_s[whole]) >= LEAST_SPREAD_S else seen.is_shown
    for _ in range(FITS):
        lasted_s = _lasted_s(times_s[used])
        if not lasted_s:
            return None
        normal = seen.outward[used].sum(axis=0)
        normal /= max(float(np.hypot(*normal)), 1e-9)
        V = errors.along(normal)
        H = np.column_stack([np.ones(len(fronts)), times_s - times_s[used].mean()])
        weighed = np.linalg.solve(V[np.ix_(used, used)], np.column_stack([H, seen.away_m])[used])
        C = np.linalg.inv(H[used].T @ weighed[:, :2])
        fit = C @ (H[used].T @ weighed[:, 2])
        behind = (seen.away_m - H @ fit) / np.sqrt(np.diagonal(V) + np.sum((H @ C) * H, axis=1))
        agree = seen.is_shown & (behind <= MISSED_SIGMAS)
        if np.array_equal(agree, used):
            away_m, freedom = seen.away_m - H @ fit, np.count_nonzero(used) - 2.0
            misfit = float(away_m[used] @ (weighed[:, 2] - weighed[:, :2] @ fit))
            return _Part(-float(fit[1]), float(C[1, 1]), normal, misfit, freedom, lasted_s, away_m, seen.outward, used)
        used = agree
    return None


def _lasted_s(times_s: Array) -> float:
    return float(np.ptp(times_s)) if len(times_s) else 0.0


def _all_seen(fronts: Sequence[Front], parts_m: Array) -> list[_Seen]:
    """Each part of the front as all pictures have it."""
    chosen = parts_m[np.unique(np.linspace(0, len(parts_m) - 1, min(MOST_PARTS, len(parts_m))).astype(int))]
    found = [_distances(front, chosen) for front in fronts]
    away, outward, shown = (np.stack(column, axis=1) for column in zip(*found, strict=True))
    return [_Seen(*one) for one in zip(away, outward, shown, strict=True)]


def _distances(front: Front, points_m: Array) -> tuple[Array, Array, Mask]:
    """The distances (N,) of points (N, 2) from a picture's outlines, less than 0 inside, the nearest edges' outward
    normals (N, 2), and whether they are of the fire's own edge (N,): else the picture ends there. (26.12)
    """
    begin = np.concatenate(front.rings_m)
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in front.rings_m])
    of_picture = _picture_edges(front, begin, end)
    along = end - begin
    length2 = np.maximum(np.sum(along**2, axis=1), 1e-12)
    to = points_m[:, None] - begin
    share = np.clip(np.sum(to * along, axis=2) / length2, 0.0, 1.0)
    far = np.linalg.norm(to - share[..., None] * along, axis=2)
    nearest = np.argmin(far, axis=1)
    x, y = points_m[:, 0][:, None], points_m[:, 1][:, None]
    crosses = (begin[:, 1] > y) != (end[:, 1] > y)
    height = np.where(along[:, 1] == 0.0, 1.0, along[:, 1])
    inside = np.sum(crosses & (x < begin[:, 0] + (y - begin[:, 1]) / height * along[:, 0]), axis=1) % 2 == 1
    turns = np.concatenate([np.full(len(ring), np.sign(_turn(ring)) or 1.0) for ring in front.rings_m])
    normals = turns[:, None] * np.column_stack([along[:, 1], -along[:, 0]]) / np.sqrt(length2)[:, None]
    rows = np.arange(len(points_m))
    least = far[rows, nearest]
    by_picture = np.min(np.where(of_picture, far, np.inf), axis=1)
    return np.where(inside, -least, least), normals[nearest], by_picture > least + 1e-9


def _picture_edges(front: Front, begin: Array, end: Array) -> Mask:
    """Return a mask (M,) of the edges where the picture ends, in cut outlines: the long ones with nothing beyond."""
    out = np.zeros(len(begin), bool)
    at = 0
    for ring, is_cut in zip(front.rings_m, front.is_cut, strict=True):
        ours = slice(at, at + len(ring))
        at += len(ring)
        if is_cut:
            out[ours] = _straight(begin[ours], end[ours])
    return out


def _straight(begin: Array, end: Array) -> Mask:
    """Return a mask (M,) of an outline's edges along a line that it nowhere crosses and that has a good part of it."""
    out = np.zeros(len(begin), bool)
    along = end - begin
    length = np.hypot(*along.T)
    reach_m = float(np.max(np.ptp(begin, axis=0)))
    for k in np.flatnonzero(length > 0.0):
        e, n = along[k] / length[k]
        side = e * (begin[:, 1] - begin[k, 1]) - n * (begin[:, 0] - begin[k, 0])
        side = side if side.max() > -side.min() else -side
        if side.min() < -EDGE_SHARE * reach_m:
            continue
        on_it = (side < EDGE_SHARE * reach_m) & (np.roll(side, -1) < EDGE_SHARE * reach_m)
        if length[on_it].sum() > STRAIGHT * reach_m:
            out |= on_it
    return out


def _turn(ring: Array) -> float:
    """Above 0 if a ring (K, 2) runs anticlockwise."""
    x, y = (ring - ring.mean(axis=0)).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
