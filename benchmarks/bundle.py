"""The window solve against GTSAM's Levenberg-Marquardt on the same numbers to the same optimum, one thread.

    python -m benchmarks.bundle [--repeat 30] [--out benchmarks/out] [--profile]

Ten views, 126 points, about 941 observations; image, GPS and attitude residuals, white, nothing robust. GTSAM is timed
from a ready graph to the optimum (building the graph from Python is printed apart); ours from arrays to the optimum
with the covariances of everything, which GTSAM's time does not hold. Needs `pip install gtsam`. Also draws how our time
grows with views and points.
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import describe
from onboard.estimation.bundle_adjustment import Problem, Solution, evaluate, solve
from onboard.estimation.factors import AttitudePrior, Layout, PositionPrior, SharedPrior, State
from simulation.study_window import Setting, begin, draw

Array = NDArray[np.float64]

VIEWS, POINTS, OBSERVATIONS = 10, 126, 941
GPS_SIGMA_M = 1.0
ATTITUDE_SIGMA_RAD = float(np.radians(1.0))
GOAL = 1.0 / 3.0


def numbers(views: int, points: int, seed: int = 1) -> tuple[Problem, State]:
    """A white problem with as many points, each seen by about 7.5 views of ten, and a start from its measurements."""
    setting = Setting(
        views=views,
        spacing_m=8.0 if views >= 10 else 80.0 / views,  # short enough for points to stay in the picture
        features_per_view=3 * points,
        gps_white_m=(GPS_SIGMA_M, GPS_SIGMA_M),
        gps_correlated_m=(0.0, 0.0),
        attitude_correlated_deg=(0.0, 0.0),
        attitude_white_deg=float(np.degrees(ATTITUDE_SIGMA_RAD)),
        boresight_sigma_deg=0.0,
        offset_sigma_s=0.0,
    )
    flight = draw(setting, np.random.default_rng(seed))
    start = begin(flight)
    assert start is not None
    if (views, points) == (VIEWS, POINTS):
        pick = _pick(flight.seen.sum(axis=0), points, OBSERVATIONS)
    else:
        pick = np.sort(np.random.default_rng(seed).permutation(flight.seen.shape[1])[:points])
    layout = Layout(views)
    held = SharedPrior(layout, np.zeros(11), np.diag([1e6] * 8 + [1.0] * 3))
    priors = [p for p in flight.problem.priors if isinstance(p, PositionPrior | AttitudePrior)]
    problem = Problem(layout, flight.problem.xy[:, pick], flight.problem.weight[:, pick], [*priors, held])
    return problem, replace(start, points_enu_m=start.points_enu_m[pick])


def _pick(counts: NDArray[np.intp], points: int, observations: int) -> NDArray[np.intp]:
    """Columns of `points` points that have `observations` together, by exchanging one at a time."""
    rng = np.random.default_rng(0)
    chosen = rng.permutation(len(counts))
    inside, outside = chosen[:points].copy(), chosen[points:].copy()
    for _ in range(20000):
        surplus = int(counts[inside].sum()) - observations
        if surplus == 0:
            break
        i, j = rng.integers(len(inside)), rng.integers(len(outside))
        change = int(counts[outside[j]] - counts[inside[i]])
        if abs(surplus + change) < abs(surplus):
            inside[i], outside[j] = outside[j], inside[i]
    return np.sort(inside)


def gtsam_graph(problem: Problem, state: State) -> tuple[Any, Any]:
    """The same cost as a GTSAM factor graph, and its initial values."""
    import gtsam  # noqa: PLC0415 (a dependency of this benchmark alone)

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    calibration = gtsam.Cal3_S2(1.0, 1.0, 0.0, 0.0, 0.0)
    gps, attitude = (next(p for p in problem.priors if isinstance(p, kind)) for kind in (PositionPrior, AttitudePrior))
    gps_noise = gtsam.noiseModel.Isotropic.Sigma(3, GPS_SIGMA_M)
    turn_noise = gtsam.noiseModel.Isotropic.Sigma(3, ATTITUDE_SIGMA_RAD)
    assert isinstance(gps, PositionPrior)
    assert isinstance(attitude, AttitudePrior)
    for k in range(problem.layout.keyframes):
        key = gtsam.symbol("x", k)
        values.insert(key, gtsam.Pose3(gtsam.Rot3(state.R_cam_enu[k].T), state.centres_enu_m[k]))
        graph.add(gtsam.GPSFactor(key, gps.measured[k], gps_noise))
        graph.add(gtsam.PoseRotationPrior3D(key, gtsam.Rot3(attitude.measured[k]), turn_noise))
    for j, point in enumerate(state.points_enu_m):
        values.insert(gtsam.symbol("l", j), point)
    noise = gtsam.noiseModel.Isotropic.Sigma(2, 1.0 / float(problem.weight.max()))
    for k, j in np.argwhere(problem.weight > 0):
        graph.add(
            gtsam.GenericProjectionFactorCal3_S2(
                problem.xy[k, j], noise, gtsam.symbol("x", int(k)), gtsam.symbol("l", int(j)), calibration
            )
        )
    return graph, values


def gtsam_solve(graph: Any, values: Any) -> tuple[float, int, Any]:
    """Cost, iterations and values at GTSAM's optimum, default parameters."""
    import gtsam  # noqa: PLC0415

    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, gtsam.LevenbergMarquardtParams())
    result = optimizer.optimize()
    return float(optimizer.error()), int(optimizer.iterations()), result


def _with_covariances(solution: Solution) -> tuple[Array, Array, Array]:
    """Everything a window asks of its solution: computed when asked for, so it must be."""
    return solution.covariance, solution.point_gain, solution.point_covariance


def best_of(repeat: int, run: Callable[[], object]) -> float:
    """Least time of one call, ms: what else the machine does only adds to it."""
    times = []
    for _ in range(repeat):
        begin_s = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin_s)
    return 1e3 * min(times)


def compare(repeat: int) -> None:
    """Print the comparison of the middle problem."""
    import gtsam  # noqa: PLC0415

    problem, start = numbers(VIEWS, POINTS)
    began = time.perf_counter()
    graph, values = gtsam_graph(problem, start)
    built_ms = 1e3 * (time.perf_counter() - began)
    their_cost, their_iterations, result = gtsam_solve(graph, values)
    ours = solve(problem, start, scale=None, tolerance=1e-5)
    apart = max(
        float(np.linalg.norm(result.atPoint3(gtsam.symbol("l", j)) - p)) for j, p in enumerate(ours.state.points_enu_m)
    )

    def theirs() -> object:
        return gtsam_solve(graph, values)

    def ours_again() -> object:
        return _with_covariances(solve(problem, start, scale=None, tolerance=1e-5))

    # In turns, so that both have the same load.
    pairs = [(best_of(1, theirs), best_of(1, ours_again)) for _ in range(3 * repeat)]
    theirs_ms, ours_ms = (min(column) for column in zip(*pairs, strict=True))
    print(f"{VIEWS} views, {problem.weight.shape[1]} points, {np.count_nonzero(problem.weight)} observations")
    print(f"start cost {evaluate(problem, start, None):.1f}; optima {apart * 1e3:.2f} mm apart at most")
    print(f"{'':<10} {'ms':>8} {'iterations':>11} {'cost':>12}")
    print(
        f"{'GTSAM':<10} {theirs_ms:8.2f} {their_iterations:11d} {their_cost:12.5f}   (graph built in {built_ms:.1f} ms)"
    )
    print(f"{'ours':<10} {ours_ms:8.2f} {ours.iterations:11d} {ours.cost:12.5f}   (with covariances)")
    print(f"ratio {ours_ms / theirs_ms:.2f}, goal {GOAL:.2f}")


def growth(out: Path, repeat: int) -> None:
    """Print and plot our time against views and points."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(8, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    by_views, by_points = figure.subplots(1, 2)
    for axis, label, cases in (
        (by_views, "views (126 points)", [(k, POINTS) for k in (3, 5, 10, 15, 20, 30)]),
        (by_points, "points (10 views)", [(VIEWS, p) for p in (30, 60, 126, 250, 500, 1000)]),
    ):
        sizes, times = [], []
        for views, points in cases:
            problem, start = numbers(views, points)
            solution = solve(problem, start, scale=None, tolerance=1e-5)
            ms = best_of(
                repeat,
                lambda p=problem, s=start: _with_covariances(solve(p, s, scale=None, tolerance=1e-5)),  # type: ignore[misc]
            )
            sizes.append(views if axis is by_views else points)
            times.append(ms / (solution.iterations + 1))
            print(
                f"{views:3d} views {problem.weight.shape[1]:5d} points: {ms:7.2f} ms, {solution.iterations} iterations"
            )
        axis.loglog(sizes, times, marker="o")
        axis.set_xlabel(label)
        axis.set_ylabel("ms an iteration")
        axis.grid(True, which="both", alpha=0.3)
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "bundle_growth.png", dpi=110)
    print(out / "bundle_growth.png")


def profile(repeat: int) -> None:
    """Print where our time goes."""
    problem, start = numbers(VIEWS, POINTS)
    profiler = cProfile.Profile()
    profiler.enable()
    for _ in range(repeat):
        _with_covariances(solve(problem, start, scale=None, tolerance=1e-5))
    profiler.disable()
    pstats.Stats(profiler).sort_stats("tottime").print_stats(14)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=30)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "out")
    parser.add_argument("--profile", action="store_true")
    args = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    print(describe() + "; one core\n")
    compare(args.repeat)
    print()
    growth(args.out, max(args.repeat // 3, 3))
    if args.profile:
        profile(args.repeat)


if __name__ == "__main__":
    main()
