"""Vibration in pictures that are read row by row: what propeller or engine swing the camera by while it is read.

All features of a row are moved by the same, those of the next rows differently: residuals that are a wave of the row,
each picture with its own phase. No pose and no steady rate can follow it, so it looks like noise of the tracks. (18.6)
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from onboard.estimation.bundle_adjustment import Problem, Solution, image_residuals
from onboard.estimation.factors import WAVES
from onboard.navigation.limits import FALSE_ALARM

Array = NDArray[np.float64]

# Swings in the time of a readout: fewer are for poses and rates to follow, more than twenty no features distinguish.
CYCLES = np.arange(2.0, 20.0, 0.125)
ROWS = 256  # bands that a picture's rows are gathered into: thirteen to the shortest wave
_PHASE = 2.0 * np.pi * CYCLES[:, None] * ((np.arange(ROWS) + 0.5) / ROWS - 0.5)
_TABLE, _TABLE_TWICE = np.exp(1j * _PHASE), np.exp(2j * _PHASE)
DRIFT = 0.75  # swings by which one picture's may differ from the window's: engines change their speed


@dataclass(frozen=True, eq=False)
class Waves:
    """Swings of each picture's rows in its readout (K,), and one sigma (rad) of the angles that it swings by."""

    cycles: Array
    sigma_rad: float


def seen(problem: Problem, solution: Solution) -> Waves | None:
    """The vibration in a solution's residuals, with what it has made a wave of; its rows must have been read in turn.

    One wave in each picture, of any phase and amplitude in x and y; about as many swings in all of them. None if it may
    be chance.
    """
    assert problem.sweep is not None
    still = replace(solution.state, own=solution.state.own.copy())
    still.own[:, problem.layout.part(WAVES)] = 0.0
    weight = problem.weight * np.sqrt(solution.robust_weight)
    residual = np.where(weight[:, None] > 0.0, image_residuals(problem, still), 0.0)
    share, squared, K = problem.sweep.share, weight**2, len(weight)
    # Wrong rates and accelerations bend rows too, once: what a cubic of the row can be is no vibration.
    powers = np.stack([share**i for i in range(4)])
    normal = np.einsum("ikp,jkp,kp->kij", powers, powers, squared)
    normal += 1e-9 * np.eye(4) * (1e-12 + np.trace(normal, axis1=1, axis2=2))[:, None, None]
    bent = np.linalg.solve(normal, np.einsum("ikp,kap,kp->kia", powers, residual, squared))
    residual = residual - np.einsum("ikp,kia->kap", powers, bent)
    # Gathered by rows, a few hundred of them, all sums over features become one product with a table of waves.
    row = np.clip(((share + 0.5) * ROWS).astype(np.intp), 0, ROWS - 1) + ROWS * np.arange(K)[:, None]
    summed = (squared, squared * residual[:, 0], squared * residual[:, 1])
    held, *pull = (np.bincount(row.ravel(), each.ravel(), K * ROWS).reshape(K, ROWS) for each in summed)
    total, twice = held.sum(axis=1), _TABLE_TWICE @ held.T  # (G, K)
    cc, ss, cs = 0.5 * (total + twice.real), 0.5 * (total - twice.real), 0.5 * twice.imag
    along = np.stack([_TABLE @ each.T for each in pull])  # (2, G, K)
    bc, bs = along.real, along.imag
    determinant = np.maximum(cc * ss - cs * cs, 1e-9 * (cc * ss + 1e-12))
    # (G, K) by how much the sum of squares falls.
    gain = ((ss * bc * bc - 2.0 * cs * bc * bs + cc * bs * bs) / determinant).sum(axis=0)
    together = gain.sum(axis=1)
    best = int(np.argmax(together))
    freedom = 2 * np.count_nonzero(weight) - 12 * K
    left = float((squared[:, None] * residual**2).sum() - together[best])
    if freedom <= 4 * K or left <= 0.0 or together[best] * freedom / left < chdtri(4 * K, FALSE_ALARM):
        return None
    near = np.abs(CYCLES - CYCLES[best]) <= DRIFT
    own = np.argmax(np.where(near[:, None], gain, -np.inf), axis=0)
    # A wave of one sigma along each axis, in cosine and sine, takes off twice its square for each feature.
    sigma_rad = float(np.sqrt(gain[own, np.arange(K)].sum() / (2.0 * squared.sum())))
    return Waves(_between(gain, own), sigma_rad)


def _between(gain: Array, own: NDArray[np.intp]) -> Array:
    """(K,) cycles at the vertex of the parabola through each picture's best of `gain` (G, K) and its neighbours."""
    middle = np.clip(own, 1, len(CYCLES) - 2)
    before, at, after = (gain[middle + i, np.arange(len(own))] for i in (-1, 0, 1))
    bend = np.maximum(2.0 * at - before - after, np.abs(after - before) + 1e-12)  # half a step at most
    out: Array = CYCLES[middle] + 0.5 * (after - before) / bend * (CYCLES[1] - CYCLES[0])
    return out


def swing_rad(waves_rad: Array) -> float:
    """One sigma (rad) by which waves (K, 6) move features along x or y; 0 for none (K, 0)."""
    across = waves_rad.reshape(-1, 2, 3)[:, :, :2]  # about the axis the camera looks along they move little
    return float(np.sqrt(np.mean(across**2))) if waves_rad.size else 0.0
