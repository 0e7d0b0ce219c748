"""Errors over the Cramer-Rao bound, honesty of the stated covariances, for each sensor set.

    python -m benchmarks.accuracy [--flights 200] [--seed 0] [--rows TEXT]

A flight is 250 m over the ground, 40 degrees, 640x480, 0.3 px, ten views over 180 m; GPS error is a Gauss-Markov part
(1.5 m horizontal, 2.5 m vertical, 60 s) and a white part (0.3 m). Truth is sampled from exactly the model that the
priors state, so the bound from the Fisher information is the bound of these flights. Outliers: a fifth of the tracks
jump, drift or follow a vehicle; errors count over the right tracks, and the bound is that of one who knows which those
are.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

from benchmarks.machine import describe
from benchmarks.monte_carlo import run
from simulation.study_window import Setting

GOAL_CLEAN, GOAL_OUTLIERS = 1.10, 1.25


def settings() -> dict[str, Setting]:
    """Rows of the table by name; those that add a state add it to "+ attitude + velocity"."""
    seed = Setting(boresight_sigma_deg=0.0)
    level = replace(seed, slope_sigma_deg=0.05)
    attitude = replace(seed, attitude_correlated_deg=(0.5, 2.0), boresight_sigma_deg=1.0)
    velocity = replace(attitude, velocity_sigma_m_s=0.1)
    terrain = replace(velocity, terrain_sigma_m=(2.0, 2.0))
    white = replace(level, gps_white_m=(1.0, 1.0), gps_correlated_m=(0.0, 0.0), offset_sigma_s=0.0)
    white_attitude = replace(white, attitude_correlated_deg=(0.0, 0.0), attitude_white_deg=1.0, slope_sigma_deg=1.0)
    rows = {
        "seed, ground sloped 2 deg": seed,
        "seed, ground level": level,
        "+ attitude": attitude,
        "+ attitude + velocity": velocity,
        "+ attitude + velocity + terrain": terrain,
    }
    out = dict(rows)
    out |= {f"{name}, 20 % outliers": replace(setting, outlier_share=0.2) for name, setting in rows.items()}
    ordinary = replace(velocity, delay_sigma_s=0.1, velocity_delay_sigma_s=0.1)
    ordinary = replace(ordinary, heading_sigma_deg=2.0, lens_sigma=(0.01, 0.01, 0.01, 0.05, 0.05))
    out |= {
        "+ a delay of the position": replace(velocity, delay_sigma_s=0.1),
        "+ a delay of the velocity": replace(velocity, velocity_delay_sigma_s=0.1),
        "+ a heading error by heading": replace(velocity, heading_sigma_deg=2.0),
        "+ an unsure focal length": replace(velocity, lens_sigma=(0.02, 1e-5, 1e-5, 1e-5, 1e-5)),
        "+ an unsure camera": replace(velocity, lens_sigma=ordinary.lens_sigma),
        "+ all of these": ordinary,
        "+ all of these, no attitude, no velocity": replace(
            ordinary, attitude_correlated_deg=None, velocity_sigma_m_s=None, boresight_sigma_deg=0.0
        ),
        "+ all of these, 20 % outliers": replace(ordinary, outlier_share=0.2),
    }
    out |= {
        "white: two views 40 m, level": replace(white, views=2, spacing_m=40.0),
        "white: seed, sloped 1 deg": replace(white, slope_sigma_deg=1.0),
        "white: + attitude 1 deg": white_attitude,
        "white: + attitude + velocity": replace(white_attitude, velocity_sigma_m_s=0.1),
        "white: + attitude + velocity + terrain": replace(
            white_attitude, velocity_sigma_m_s=0.1, terrain_sigma_m=(2.0, 0.01)
        ),
    }
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rows", default="", help="only rows whose name holds this text")
    args = parser.parse_args()
    print(f"{describe()}; {args.flights} flights a row, seed {args.seed}\n")
    print(
        f"{'sensors':<42} {'rmse m':>7} {'bound m':>8} {'ratio':>12} {'of best':>8} {'goal':>5}"
        f" {'shape m':>8} {'ratio':>6} {'NEES pose/6':>12} {'point/3':>8} {'in 90 %':>8}"
        f" {'no start':>9} {'wrong':>6} {'ms':>5}"
    )
    for name, setting in settings().items():
        if args.rows not in name:
            continue
        begin = time.perf_counter()
        row = run(setting, args.flights, args.seed)
        took_ms = (time.perf_counter() - begin) / args.flights * 1e3
        goal = GOAL_OUTLIERS if setting.outlier_share else GOAL_CLEAN
        print(
            f"{name:<42} {row.rmse_m:7.2f} {row.bound_m:8.2f} {row.rmse_m / row.bound_m:6.3f}+-{row.spread:4.2f}"
            f" {row.against_best:8.3f} {goal:5.2f} {row.shape_rmse_m:8.2f} {row.shape_rmse_m / row.shape_bound_m:6.3f}"
            f" {row.pose_nees / 6:12.2f} {row.point_nees / 3:8.2f} {100 * row.coverage_90:7.1f}%"
            f" {row.no_start:9d} {row.failed:6d} {took_ms:5.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
