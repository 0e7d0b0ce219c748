"""Monte Carlo over simulated flights: errors over the Cramer-Rao bound, NEES and coverage, one row a kind of flight."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from contract.rotations import log_so3
from onboard.estimation.bundle_adjustment import Solution, solve
from simulation.study_window import Flight, Setting, begin, bound, draw, estimate, point_covariance

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

ELLIPSE_90 = 4.60517  # chi-square, two degrees of freedom
FAILED = 20.0  # a flight whose error exceeds its own bound this many times has gone wrong and is counted apart


@dataclass(frozen=True)
class Row:
    """One row of the table. Errors are root mean squares (m) over features and flights."""

    flights: int
    no_start: int
    failed: int
    rmse_m: float
    bound_m: float
    spread: float  # one sigma of rmse / bound from the finite number of flights
    shape_rmse_m: float  # after the features' common shift is taken out of each flight
    shape_bound_m: float
    against_best: float  # rmse over that of least squares begun at the truth, on the same samples
    pose_nees: float  # newest view, 6 expected
    point_nees: float  # median flight's mean over its features, 3 expected of the mean
    coverage_90: float  # share of features inside their stated horizontal ellipse


@dataclass(frozen=True, eq=False)
class _Trial:
    squared: float
    bound: float
    best: float
    shape_squared: float
    shape_bound: float
    pose_nees: float
    point_nees: float
    inside: float


def run(setting: Setting, flights: int, seed: int = 0) -> Row:
    """Simulate `flights` flights. The same seed gives the same flights."""
    trials: list[_Trial] = []
    no_start = failed = 0
    for number in range(flights):
        flight = draw(setting, np.random.default_rng([seed, number]))
        start = begin(flight)
        if start is None:
            no_start += 1
            continue
        solution, kept = estimate(flight, start)
        trial = _judge(flight, solution, kept)
        if trial.squared > FAILED**2 * trial.bound:
            failed += 1
        else:
            trials.append(trial)
    if not trials:
        raise RuntimeError("no flight of this setting was solved")
    squared, bounds = np.array([t.squared for t in trials]), np.array([t.bound for t in trials])
    ratio = float(np.sqrt(squared.mean() / bounds.mean()))
    return Row(
        flights=flights,
        no_start=no_start,
        failed=failed,
        rmse_m=float(np.sqrt(squared.mean())),
        bound_m=float(np.sqrt(bounds.mean())),
        spread=ratio * 0.5 * float(squared.std() / squared.mean()) / np.sqrt(len(trials)),
        shape_rmse_m=float(np.sqrt(np.mean([t.shape_squared for t in trials]))),
        shape_bound_m=float(np.sqrt(np.mean([t.shape_bound for t in trials]))),
        against_best=float(np.sqrt(squared.mean() / np.mean([t.best for t in trials]))),
        pose_nees=float(np.mean([t.pose_nees for t in trials])),
        point_nees=float(np.mean([t.point_nees for t in trials])),
        coverage_90=float(np.mean([t.inside for t in trials])),
    )


def _judge(flight: Flight, solution: Solution, kept: Array) -> _Trial:
    """Errors of the features whose tracks are right and were kept, and what was claimed of them."""
    ideal = bound(flight)
    counted = ~flight.is_outlier & (np.count_nonzero(kept > 0, axis=0) >= 2)
    error = (solution.state.points_enu_m - flight.truth.points_enu_m)[counted]
    best = (_best(flight, ideal) - flight.truth.points_enu_m)[counted]
    claimed = point_covariance(solution)[counted]
    horizontal = np.einsum("pi,pij,pj->p", error[:, :2], np.linalg.inv(claimed[:, :2, :2]), error[:, :2])
    return _Trial(
        squared=float(np.mean(np.sum(error**2, axis=1))),
        bound=float(np.mean(np.trace(point_covariance(ideal)[counted], axis1=1, axis2=2))),
        best=float(np.mean(np.sum(best**2, axis=1))),
        shape_squared=float(np.mean(np.sum((error - error.mean(axis=0)) ** 2, axis=1))),
        shape_bound=_shape_bound(ideal, counted),
        pose_nees=_pose_nees(flight, solution),
        point_nees=float(np.mean(np.einsum("pi,pij,pj->p", error, np.linalg.inv(claimed), error))),
        inside=float(np.mean(horizontal <= ELLIPSE_90)),
    )


def _best(flight: Flight, ideal: Solution) -> Array:
    """Points (P, 3) of plain least squares from the truth by one who knows which tracks are wrong, run to its end."""
    problem = replace(flight.problem, weight=np.where(flight.is_outlier, 0.0, flight.problem.weight))
    return solve(problem, ideal.state, scale=None, max_iterations=60, tolerance=1e-9).state.points_enu_m


def _shape_bound(ideal: Solution, counted: Mask) -> float:
    """Bound (m^2) of the features' errors less their mean, each flight."""
    gain = ideal.point_gain[counted]
    gain = gain - gain.mean(axis=0)
    own = np.trace(ideal.point_covariance[counted], axis1=1, axis2=2)
    common = np.einsum("pid,de,pie->p", gain, ideal.covariance, gain, optimize=True)
    return float(np.mean(common) + np.mean(own) * (1.0 - 1.0 / len(own)))


def _pose_nees(flight: Flight, solution: Solution) -> float:
    """Normalised squared error of the newest view's six unknowns."""
    last = len(flight.truth.R_cam_enu) - 1
    turn = log_so3(flight.truth.R_cam_enu[last] @ solution.state.R_cam_enu[last].T)
    error = np.concatenate([turn, flight.truth.centres_enu_m[last] - solution.state.centres_enu_m[last]])
    at = slice(6 * last, 6 * last + 6)
    return float(error @ np.linalg.solve(solution.covariance[at, at], error))
