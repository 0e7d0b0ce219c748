"""The fit of a window's orientations to the autopilot's attitudes at other time offsets than it was solved at.

(5.7)'s derivative, taken at the wrong offset, leads to a wrong minimum or to a sigma that is too small; a profile over
whole offsets needs no derivative. It decides where the next solve begins, limits what a window may teach, and gives the
offset itself where it is wider than the derivative holds. Equations (10.3) to (10.6) of docs/mathematics.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.rotations import log_so3
from onboard.geometry.robust import OUTLIER_SIGMAS, robust_cost
from onboard.navigation.limits import CLEAR

Array = NDArray[np.float64]

STEP_S = 0.05
NEAR_S = 1.5 * STEP_S  # a window's derivative holds over as much of a roll
RESOLVED = (0.1 * STEP_S) ** 2  # of a variance (s^2): what is sharper falls between the steps
REACH_S = 0.5  # at least
MIN_PICTURES = 4
COMMON = 4  # mount and heading, which every picture shares
ROUNDS = 4


@dataclass(frozen=True)
class ClockProfile:
    """The offset that fits best, what it leaves of what was known, and from where to where others may be right too.

    `kept_s` is None where what fits about as well as the best is not one run of offsets that ends within reach.
    """

    best_s: float
    precision: float  # that the profile adds to what was known of the offset (1/s^2)
    mean_s: float  # of the offset, by both
    variance: float  # of that (s^2)
    kept_s: tuple[float, float] | None
    compared_s: tuple[float, float] = (-np.inf, np.inf)  # the reach

    def rejects(self, offset_s: float) -> bool:
        """Return whether this offset is excluded by others that fit; False for one outside the compared range."""
        if self.kept_s is None or not self.compared_s[0] <= offset_s <= self.compared_s[1]:
            return False
        return not self.kept_s[0] - NEAR_S < offset_s < self.kept_s[1] + NEAR_S

    @property
    def is_wide(self) -> bool:
        """True if the offsets that fit about equally well span more than a window's derivative holds over."""
        return self.precision < NEAR_S**-2


def offsets_about(offset_s: float, sigma_s: float) -> Array:
    """(T,) offsets to compare, about the one used."""
    steps = np.ceil(max(REACH_S, 2.0 * sigma_s) / STEP_S)
    return offset_s + STEP_S * np.arange(-steps, steps + 1.0)


def clock_profile(
    R_cam_enu: Array, R_enu_cam: Array, offsets_s: Array, known: tuple[float, float], sigma_rad: Array
) -> ClockProfile | None:
    """The profile over offsets (T,); None from too few pictures. (10.5)

    `R_cam_enu` (K, 3, 3): the window's own orientations. `R_enu_cam` (T, K, 3, 3): the autopilot's through the nominal
    mount, at every offset. `known`: the offset's mean and variance before (s, s^2). `sigma_rad` (3,): of one attitude;
    of mount and heading, which all pictures share.
    """
    K = len(R_cam_enu)
    if K < MIN_PICTURES:
        return None
    cost = _costs(log_so3(R_cam_enu @ R_enu_cam), R_cam_enu[:, :, 2], sigma_rad)
    best = int(np.argmin(cost))
    freedoms = 3 * K - COMMON
    excess = (cost - cost[best]) / max(float(cost[best]) / freedoms, 1.0)
    found = _upon(excess, offsets_s, *known)
    clear = np.flatnonzero(excess < CLEAR)
    is_one_run = clear[-1] - clear[0] == len(clear) - 1 and clear[0] > 0 and clear[-1] < len(cost) - 1
    # Other offsets meet other errors of the attitudes: by so much costs scatter however equal the rotations are.
    chance = 2.0 * np.sqrt(freedoms)
    kept = offsets_s[excess < OUTLIER_SIGMAS * chance]
    kept_s = (float(kept[0]), float(kept[-1])) if is_one_run else None
    return ClockProfile(float(offsets_s[best]), *found, kept_s, (float(offsets_s[0]), float(offsets_s[-1])))


def _upon(excess: Array, offsets_s: Array, mean_s: float, variance: float) -> tuple[float, float, float]:
    """Precision (1/s^2) that a profile adds to what was known of the offset; mean and variance by both. (10.5), (10.6)

    By how much it narrows that over the offsets compared: a level one by nothing, though they end.
    """
    before = np.square((offsets_s - mean_s) / max(np.sqrt(variance), STEP_S))
    means, variances = [], []
    for cost in (before, before + excess):
        likely = np.exp(-0.5 * (cost - cost.min()))
        means.append(float(np.average(offsets_s, weights=likely)))
        variances.append(max(float(np.average(np.square(offsets_s - means[-1]), weights=likely)), RESOLVED))
    precision = max(1.0 / variances[1] - 1.0 / variances[0], 0.0)
    pull = (means[1] - means[0]) / variances[1] + precision * (means[0] - mean_s)
    out = 1.0 / (1.0 / variance + precision)
    return precision, mean_s + out * pull, out


def _costs(apart: Array, up_cam: Array, sigma_rad: Array) -> Array:
    """(T,) costs of rotations (T, K, 3), what mount and heading explain of them taken out robustly. (10.4)"""
    K = len(up_cam)
    A = np.concatenate([np.broadcast_to(np.eye(3), (K, 3, 3)), up_cam[:, :, None]], axis=2)
    weight = np.ones(apart.shape[:2])
    prior = np.diag(sigma_rad[0] ** 2 / np.square(sigma_rad[[1, 1, 1, 2]]))
    for _ in range(ROUNDS):
        N = np.einsum("tk,kri,krj->tij", weight, A, A) + prior
        common = np.linalg.solve(N, np.einsum("tk,kri,tkr->ti", weight, A, apart)[..., None])[..., 0]
        left = apart - np.einsum("kri,ti->tkr", A, common)
        cost, weight = robust_cost(np.square(left).sum(axis=2) / sigma_rad[0] ** 2, OUTLIER_SIGMAS)
    out: Array = cost.sum(axis=1) + np.einsum("ti,ij,tj->t", common, prior, common) / sigma_rad[0] ** 2
    return out
