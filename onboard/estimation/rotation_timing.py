"""Camera-to-autopilot time offset from rotations alone: pairs of pictures against the autopilot's attitudes.

Two pictures and the direction of travel between them give the camera's rotation by the epipolar constraint, without
points, ground or positions. The autopilot's attitudes, looked up at another time offset, give another rotation wherever
the angular rate changes. The offset at which both agree best over many pairs is the estimate. It does not depend on how
late positions are, needs no window, and is found from half a second away, where a window's linearised effect of the
offset on a roll is only the beginning of the truth. Equations (10.3) to (10.6) of docs/mathematics.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.rotations import exp_so3
from onboard.geometry.robust import median_chi2

Array = NDArray[np.float64]

FEATURES = 32  # of a pair: a rotation needs no more
REACH_S = 0.5  # about the estimated offset, within which one is looked for
COARSE_S, FINE_S = 0.05, 0.01  # the first is also the step of a `Course`
FINE_STEPS = 3
MIN_PAIRS = 6
FREEDOMS = 5  # of a pair: rotation and direction of travel
TAIL = 12.0  # chi-square of a pair, in units of the usual one, from which it counts for less
DIRECTION_SIGMA_RAD = 0.06  # of the travel's direction against the attitude: what heading, wind and delays leave
NUISANCE_SIGMA_RAD = 0.06  # of mount and heading together, which turn all pairs by the same
FARTHEST_RAD = 0.5  # a rotation or direction may deviate so far: what no ray shows of a pair stays a number
MIN_SPEED_M_S, SPEED_SIGMA_M_S = 0.5, 0.5
ASIDE = 2  # coarse steps from the minimum: far enough that errors of single attitudes are others
RIVAL = 9.0  # of chi-square by which any other offset must be worse
MIN_BLOCKS = 3.0  # seconds that tell of the offset, in effect: what one second says has nothing to be held against
BLOCK_NS = 1_000_000_000  # errors of attitudes between their messages last shorter
LEAST_SIGMA_S = 0.005  # of attitudes' stamps, the same for all: a share of a turn of an autopilot's loop (2.5 to 20 ms)
ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Pair:
    """Two pictures by their stamps, and the same features' rays in both (FEATURES, 3), z = 1; `weight` 0 is none."""

    start_ns: int
    end_ns: int
    rays1: Array
    rays2: Array
    weight: Array  # (FEATURES,) 1 / sigma of a ray's direction


@dataclass(frozen=True, eq=False)
class Course:
    """The autopilot's motion at even steps: R_enu_cam (T, 3, 3) by the nominal mount, velocity (T, 3) ENU, and one
    sigma (T,) of the attitude's interpolation.
    """

    start_ns: int
    step_ns: int
    R_enu_cam: Array
    velocity_enu_m_s: Array
    sigma_rad: Array

    def at(self, moments_ns: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """R_enu_cam, velocity and sigma at moments (N,), joined linearly."""
        x = np.clip((moments_ns - self.start_ns) / self.step_ns, 0.0, len(self.sigma_rad) - 1.000001)
        k = x.astype(np.intp)
        s = x - k
        R = self.R_enu_cam[k] + s[:, None, None] * (self.R_enu_cam[k + 1] - self.R_enu_cam[k])
        v = self.velocity_enu_m_s[k] + s[:, None] * (self.velocity_enu_m_s[k + 1] - self.velocity_enu_m_s[k])
        return R, v, np.maximum(self.sigma_rad[k], self.sigma_rad[k + 1])


@dataclass(frozen=True)
class Timing:
    """A time offset with its sigma, what span of pictures it rests on, and how many pairs."""

    offset_s: float
    sigma_s: float
    start_ns: int
    end_ns: int
    pairs: int


def timing(pairs: list[Pair], course: Course, centre_s: float, boresight_rad: Array, sigma_rad: float) -> Timing | None:
    """The offset within REACH_S of `centre_s` at which rotations agree best; None where they do not single one out.

    `boresight_rad` (3,): the mount as it is known; `sigma_rad`: one sigma of the attitude's rotation over one pair.
    """
    if len(pairs) < MIN_PAIRS:
        return None
    problem = _Problem(pairs, course, boresight_rad, sigma_rad)
    taus = centre_s + np.arange(-REACH_S, REACH_S + 0.5 * COARSE_S, COARSE_S)
    coarse = problem.chi2(taus)
    scale2 = _scale2(coarse[int(np.argmin(_cost(coarse).sum(axis=1)))])
    best = int(np.argmin(_cost(coarse, scale2).sum(axis=1)))
    if best in (0, len(taus) - 1):
        return None
    fine = taus[best] + FINE_S * np.arange(-2 * FINE_STEPS, 2 * FINE_STEPS + 1)
    chi2 = problem.chi2(fine)
    each = _cost(chi2, scale2)
    at = int(np.clip(np.argmin(each.sum(axis=1)), FINE_STEPS, len(fine) - 1 - FINE_STEPS))
    here = slice(at - FINE_STEPS, at + FINE_STEPS + 1)
    offset_s, sigma_s = _minimum(fine[here], each[here], np.array([p.start_ns for p in pairs]))
    if not np.isfinite(sigma_s) or not fine[0] < offset_s < fine[-1]:
        return None
    # Every offset meets other errors of the attitudes, and chi-squares scatter by that however equal the rotations are.
    # Whole steps away interpolation is the same: between two attitudes their mean is off by less than either.
    chance = np.sqrt(2.0 * FREEDOMS * len(pairs))
    steps = np.arange(-round(REACH_S / COARSE_S), round(REACH_S / COARSE_S) + 1)
    around_s: Array = np.asarray(offset_s + COARSE_S * steps, np.float64)
    around = _cost(problem.chi2(around_s), scale2).sum(axis=1)
    around -= around[steps == 0]
    rise = float(around[np.abs(steps) == ASIDE].min() - chance)
    if around[np.abs(steps) >= ASIDE].min() < RIVAL + chance or rise <= 0.0:
        return None
    sigma_s = float(np.hypot(max(sigma_s, ASIDE * COARSE_S / np.sqrt(rise)), LEAST_SIGMA_S))
    return Timing(offset_s, sigma_s, pairs[0].start_ns, max(p.end_ns for p in pairs), len(pairs))


def _minimum(taus: Array, cost: Array, starts_ns: NDArray[np.int64]) -> tuple[float, float]:
    """Where the sum of costs (T, P) is least, and one sigma of it: infinite where too few seconds tell. (10.5), (10.6)

    The larger of what the curvature says and of what the scatter from second to second says.
    """
    middle = taus[len(taus) // 2]
    curve, slope, _ = np.polyfit(taus - middle, cost, 2)  # of each pair
    if curve.sum() <= 0.0:
        return float(middle), float("inf")
    moved = -0.5 * slope.sum() / curve.sum()
    blocks = (starts_ns - starts_ns.min()) // BLOCK_NS
    pulls = np.bincount(blocks, slope + 2.0 * curve * moved)
    tells = np.maximum(np.bincount(blocks, curve), 0.0)
    effective = float(tells.sum() ** 2 / max(np.sum(tells**2), 1e-300))
    if effective < MIN_BLOCKS:
        return float(middle + moved), float("inf")
    scatter = np.sum(pulls**2) / (2.0 * curve.sum()) ** 2 * effective / (effective - 1.0)
    return float(middle + moved), float(np.sqrt(max(scatter, 1.0 / curve.sum())))


def _scale2(chi2: Array) -> float:
    """By how much pairs' chi-squares (P,) exceed what they should be; at least 1."""
    return max(float(np.median(chi2)) / median_chi2(FREEDOMS), 1.0)


def _cost(chi2: Array, scale2: float = 1.0) -> Array:
    """Cost (T, P) of pairs' chi-squares with a tail that grows as a logarithm, as Student's t. (10.5)"""
    out: Array = TAIL * np.log1p(chi2 / (scale2 * TAIL))
    return out


class _Problem:
    """Pairs as arrays."""

    def __init__(self, pairs: list[Pair], course: Course, boresight_rad: Array, sigma_rad: float) -> None:
        self._course, self._sigma_rad = course, sigma_rad
        self._turn = exp_so3(boresight_rad)
        self._x1 = np.stack([p.rays1 for p in pairs])
        self._x2 = np.stack([p.rays2 for p in pairs])
        self._w = np.stack([p.weight for p in pairs])
        self._start = np.array([p.start_ns for p in pairs], np.int64)
        self._end = np.array([p.end_ns for p in pairs], np.int64)

    def chi2(self, taus_s: Array) -> Array:
        """(T, P) chi-square of every pair at every offset, the mount's common error taken out at each offset."""
        out: Array = np.empty((len(taus_s), len(self._start)))
        for row, tau in enumerate(taus_s):
            found, covariance, by_mount = self._deviations(round(float(tau) * 1e9))
            weight: Array = np.asarray(np.linalg.inv(covariance), np.float64)
            out[row] = _without_common(found, weight, by_mount)
        return out

    def _deviations(self, tau_ns: int) -> tuple[Array, Array, Array]:
        """How far each pair's pictures deviate from the autopilot in rotation and direction of travel. (10.3), (10.4)

        (P, 5), its covariance (P, 5, 5), and its derivative (P, 5, 3) by the mount.
        """
        R1, v1, sigma1 = self._course.at(self._start + tau_ns)
        R2, v2, sigma2 = self._course.at(self._end + tau_ns)
        R1, R2 = R1 @ self._turn, R2 @ self._turn
        Q = R2.transpose(0, 2, 1) @ R1
        speed = np.linalg.norm(v1 + v2, axis=1) / 2.0
        # Where nothing moves any direction holds: half of the constraints are then left.
        towards = np.where((speed > MIN_SPEED_M_S)[:, None], v1 + v2, [1.0, 0.0, 0.0])
        t = np.einsum("pji,pj->pi", R1, towards)
        t /= np.linalg.norm(t, axis=1, keepdims=True)
        across = _across(t)
        J, right = _rows(self._x1, self._x2, Q, t, across)
        direction = np.hypot(DIRECTION_SIGMA_RAD, SPEED_SIGMA_M_S / np.maximum(speed, SPEED_SIGMA_M_S))
        own = self._sigma_rad**2 + sigma1**2 + sigma2**2
        prior = np.stack([own, own, own, direction**2, direction**2], axis=1)
        loose = np.eye(FREEDOMS) / FARTHEST_RAD**2
        w = self._w
        for _ in range(ROUNDS):
            weighted = J * (w**2)[..., None]
            N = weighted.transpose(0, 2, 1) @ J + loose
            found = np.linalg.solve(N, (weighted * right[..., None]).sum(axis=1)[..., None])[..., 0]
            miss = (right - np.einsum("pmf,pf->pm", J, found)) * self._w
            w = self._w / np.sqrt(1.0 + (miss / 3.0) ** 2)
        covariance: Array = np.asarray(np.linalg.inv(N) + prior[:, :, None] * np.eye(FREEDOMS), np.float64)
        return found, covariance, np.concatenate([Q - np.eye(3), -across], axis=1)


def _across(t: Array) -> Array:
    """Two unit vectors (P, 2, 3) across each direction (P, 3)."""
    a = np.cross(t, np.eye(3)[np.argmin(np.abs(t), axis=1)])
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    return np.stack([a, np.cross(t, a)], axis=1)


def _rows(x1: Array, x2: Array, Q: Array, t: Array, across: Array) -> tuple[Array, Array]:
    """(P, M, 5) derivatives of (3.4) by (3.5)'s rotation and (3.6)'s direction, and its value (P, M), negative."""
    back = x2 @ Q
    n2 = np.cross(t[:, None], x1) @ Q.transpose(0, 2, 1)
    n_back = np.cross(back, t[:, None])
    length = np.sqrt(n2[..., 0] ** 2 + n2[..., 1] ** 2 + n_back[..., 0] ** 2 + n_back[..., 1] ** 2)
    scale = 1.0 / np.maximum(length, 1e-9)
    turned = [np.cross(np.cross(across[:, i], t)[:, None], x1) for i in range(2)]
    by_direction = np.stack([np.sum(back * normal, axis=-1) for normal in turned], axis=-1)
    J = np.concatenate([np.cross(n2, x2), by_direction], axis=-1) * scale[..., None]
    return J, -np.sum(n2 * x2, axis=-1) * scale


def _without_common(found: Array, weight: Array, by_mount: Array) -> Array:
    """Chi-squares (P,) after the three angles that all pairs share have been fitted, robustly."""
    chi2: Array = np.einsum("pf,pfg,pg->p", found, weight, found)
    for _ in range(ROUNDS):
        scale2 = _scale2(chi2)
        share = 1.0 / ((1.0 + chi2 / (TAIL * scale2)) * scale2)
        GW = np.einsum("pfi,pfg->pig", by_mount, weight) * share[:, None, None]
        N = np.einsum("pig,pgj->ij", GW, by_mount) + np.eye(3) / NUISANCE_SIGMA_RAD**2
        left = found - by_mount @ np.linalg.solve(N, np.einsum("pig,pg->i", GW, found))
        chi2 = np.einsum("pf,pfg,pg->p", left, weight, left)
    return chi2
