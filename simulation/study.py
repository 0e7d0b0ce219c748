"""The seed's error study (its section 3), reproduced, and what more views and sensors do to the same errors.

    python -m simulation.study fig6|fig7|fig8|all --out DIR

Each figure writes `figN.csv` and `figN.png` for the seed's own method, and `figN_windows.csv` and `figN_windows.png`
for windows of views, attitude and velocity. Discussed in docs/error-analysis.md. The `study*` files may import
onboard's packages, as nothing else in `simulation` does: they study those very functions.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from simulation import study_seed
from simulation.study_plot import Row, plot
from simulation.study_window import Setting, begin, draw, estimate
from simulation.study_world import AXES, two_views

SEEDS = 20
WINDOW_SEEDS = 10
PIXEL_NOISE_PX = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0)
GPS_NOISE_M = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
ANGLES_DEG = tuple(float(a) for a in range(-10, 11))
WINDOW_ANGLES_DEG = (-10.0, -5.0, 0.0, 5.0, 10.0)
# Noise of the windows' figures 7 and 8, white only: without noise every converged curve is zero.
WINDOW_PIXEL_PX = 0.3
WINDOW_GPS_M = 1.0
TINY_PX, TINY_M = 0.05, 0.01  # what stands for no noise: far less and the weights, not the flight, are examined
STAGES: dict[str, int | None] = {"initial": 0, "25": 25, "50": 50, "converged": None}


def fig6(seeds: int = SEEDS) -> list[Row]:
    """Mean error against the sigma of pixel noise and of GPS noise, initial and converged, over `seeds` samples."""
    scene = two_views()
    stages = ("initial", "converged")
    rows = []
    for panel, levels in (("pixel_noise_px", PIXEL_NOISE_PX), ("gps_noise_m", GPS_NOISE_M)):
        for level in levels:
            errors = []
            for seed in range(seeds):
                rng = np.random.default_rng(seed)
                pixel, gps = rng.standard_normal(scene.uv_px.shape), rng.standard_normal((2, 3))
                uv = scene.uv_px + (level * pixel if panel == "pixel_noise_px" else 0.0)
                centres = scene.centres_enu_m + (level * gps if panel == "gps_noise_m" else 0.0)
                errors.append(study_seed.errors(uv, centres, scene.points_enu_m, tuple(STAGES[s] for s in stages)))
            mean = np.mean(errors, axis=0)
            rows += [Row(panel, level, stage, float(m)) for stage, m in zip(stages, mean, strict=True)]
    return rows


def fig7() -> list[Row]:
    """Error against the first camera's misalignment with the travel; the second camera shares it. No noise."""
    return _angles("first")


def fig8() -> list[Row]:
    """Error against the change of orientation between the views; the first is aligned. No noise."""
    return _angles("second")


def _angles(turned: str) -> list[Row]:
    rows = []
    for axis in AXES:
        for angle in ANGLES_DEG:
            scene = two_views(**{turned: (axis, float(np.radians(angle)))})
            errors = study_seed.errors(scene.uv_px, scene.centres_enu_m, scene.points_enu_m, tuple(STAGES.values()))
            rows += [Row(axis, angle, stage, e) for stage, e in zip(STAGES, errors, strict=True)]
    return rows


def sensor_sets() -> dict[str, Setting]:
    """The windows' curves: white noise only and flat, level ground, as in the seed's world."""
    base = Setting(
        pixel_sigma_px=WINDOW_PIXEL_PX,
        gps_white_m=(WINDOW_GPS_M, WINDOW_GPS_M),
        gps_correlated_m=(0.0, 0.0),
        slope_sigma_deg=0.05,
        relief_sigma_m=1.0,
        boresight_sigma_deg=0.0,
        offset_sigma_s=0.0,
    )
    attitude = replace(base, attitude_correlated_deg=(0.0, 0.0), attitude_white_deg=1.0)
    return {
        "2 views, 40 m": replace(base, views=2, spacing_m=40.0),
        "5 views, 80 m": replace(base, views=5),
        "10 views, 180 m": base,
        "10 views + attitude": attitude,
        "10 views + attitude + velocity": replace(attitude, velocity_sigma_m_s=0.1),
    }


def fig6_windows(seeds: int = WINDOW_SEEDS) -> list[Row]:
    """Figure 6's inputs, one noisy and the other as good as exact, for windows and sensor sets."""
    rows = []
    for panel, levels in (("pixel_noise_px", PIXEL_NOISE_PX[1:]), ("gps_noise_m", GPS_NOISE_M[1:])):
        for level in levels:
            for name, setting in sensor_sets().items():
                at = (
                    replace(setting, pixel_sigma_px=level, gps_white_m=(TINY_M, TINY_M))
                    if panel == "pixel_noise_px"
                    else replace(setting, pixel_sigma_px=TINY_PX, gps_white_m=(level, level))
                )
                rows.append(Row(panel, level, name, _window_error(at, seeds)))
    return rows


def fig7_windows(seeds: int = WINDOW_SEEDS) -> list[Row]:
    """The camera turned away from the configured mount: the start is wrong, with attitude the boresight too."""
    rows = []
    for axis in AXES:
        for angle in WINDOW_ANGLES_DEG:
            for name, setting in sensor_sets().items():
                at = replace(setting, misaligned=(axis, float(np.radians(angle))))
                rows.append(Row(axis, angle, name, _window_error(at, seeds)))
    return rows


def fig8_windows(seeds: int = WINDOW_SEEDS) -> list[Row]:
    """Every second view of the window turned against the others."""
    rows = []
    for axis in AXES:
        for angle in WINDOW_ANGLES_DEG:
            for name, setting in sensor_sets().items():
                at = replace(setting, alternating=(axis, float(np.radians(angle))))
                rows.append(Row(axis, angle, name, _window_error(at, seeds)))
    return rows


def _window_error(setting: Setting, seeds: int) -> float:
    """Mean distance (m) of estimated features from the truth over `seeds` flights; nan if no flight could start."""
    errors = []
    for seed in range(seeds):
        flight = draw(setting, np.random.default_rng(seed))
        start = begin(flight)
        if start is not None:
            solution, kept = estimate(flight, start)
            used = np.count_nonzero(kept, axis=0) >= 2  # a point left with one observation is not published either
            miss = (solution.state.points_enu_m - flight.truth.points_enu_m)[used]
            errors.append(np.linalg.norm(miss, axis=1).mean())
    return float(np.mean(errors)) if errors else float("nan")


def write_csv(path: Path, header: tuple[str, str, str, str], rows: Iterable[Row]) -> None:
    """One line a row, six significant digits."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows([r.panel, f"{r.value:g}", r.curve, f"{r.mean_error_m:.6g}"] for r in rows)


FIGURES = {"fig6": (fig6, fig6_windows), "fig7": (fig7, fig7_windows), "fig8": (fig8, fig8_windows)}


def main(argv: list[str] | None = None) -> int:
    """Command line; 0 when written, 2 on wrong usage or a folder that cannot be written."""
    parser = argparse.ArgumentParser(prog="python -m simulation.study", description=__doc__.splitlines()[0])
    parser.add_argument("figure", choices=[*FIGURES, "all"])
    parser.add_argument("--out", type=Path, required=True, help="folder for CSV and PNG files")
    args = parser.parse_args(argv)
    try:
        args.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"study: {args.out}: {error.strerror}", file=sys.stderr)
        return 2
    for name in FIGURES if args.figure == "all" else (args.figure,):
        seed_study, window_study = FIGURES[name]
        panel = "input" if name == "fig6" else "axis"
        rows = seed_study()
        write_csv(args.out / f"{name}.csv", (panel, "value", "iterations", "mean_error_m"), rows)
        plot(args.out / f"{name}.png", name, rows)
        print(args.out / f"{name}.png", flush=True)
        rows = window_study()
        write_csv(args.out / f"{name}_windows.csv", (panel, "value", "sensors", "mean_error_m"), rows)
        plot(args.out / f"{name}_windows.png", f"{name}_windows", rows)
        print(args.out / f"{name}_windows.png", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
