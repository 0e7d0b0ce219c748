"""The second of a window's two solves: without outliers, and weighted by the noise that the first found."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from onboard.estimation import camera_states
from onboard.estimation.bundle_adjustment import Problem, Solution, solve
from onboard.estimation.factors import State
from onboard.estimation.pixel_noise import fit_of
from onboard.estimation.window_acceptance import MIN_DEPTH_SHARE
from onboard.geometry.robust import OUTLIER_SIGMAS

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MIN_TRACK_INLIERS = 2.0 / 3.0  # of one track's measurements, (6.15)


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The second solve, the weights (K, P) that it kept, and the noise it found, relative to those weights."""

    solution: Solution
    kept: Array
    own: float


def lie_near(state: State, weight: Array) -> Mask:
    """A mask (P,) of points far nearer to a camera that saw them, by weight (K, P), than the others it saw. (6.16)

    A point at a camera's centre fits any measurement of that camera: a wrong track's may end there, and would then hold
    the camera to a place that nothing measured.
    """
    depth_m, seen = state.depths_m, weight > 0
    usual_m = np.array([np.median(d[s]) if s.any() else 0.0 for d, s in zip(depth_m, seen, strict=True)])
    out: Mask = np.any(seen & (depth_m < MIN_DEPTH_SHARE * usual_m[:, None]), axis=0)
    return out


def solve_again(problem: Problem, first: Solution, least_own: float, camera_file: Camera) -> Adjusted | None:
    """Solve without what lay beyond 4 sigma, weighted by the noise found, at least `least_own` of the stated.

    A track of which more than a third lay there is dropped: the rest agrees by chance, (6.15).

    Through the camera that the first found, which counts its states from `camera_file`. None where too little is left
    to estimate the noise from.
    """
    sigmas, layout = first.residual_sigmas, problem.layout
    kept = np.where(sigmas > OUTLIER_SIGMAS * max(fit_of(sigmas, layout), 1.0), 0.0, problem.weight)
    left, seen = np.count_nonzero(kept > 0, axis=0), np.count_nonzero(problem.weight > 0, axis=0)
    kept[:, left < np.maximum(2, MIN_TRACK_INLIERS * seen)] = 0.0
    # The window's own noise, not the flight's so far, is what its covariances must be built on.
    own = fit_of(np.where(kept > 0, sigmas, np.nan), layout)
    if not np.isfinite(own):
        return None
    own = max(own, least_own)
    if problem.camera is not None:
        camera, taken, xy = camera_states.seen_through(camera_file, problem.camera, first.state.camera, problem.xy)
        problem = replace(problem, camera=camera, camera_taken=taken, xy=xy)
    solution = solve(replace(problem, weight=kept / own), first.state, scale=6.0, tolerance=1e-5)
    near = lie_near(solution.state, kept)
    if near.any():
        kept[:, near] = 0.0
        solution = solve(replace(problem, weight=kept / own), solution.state, scale=6.0, tolerance=1e-5)
    return Adjusted(solution, kept, own)
