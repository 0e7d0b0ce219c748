"""The truth of a simulated thermal camera's pictures, written down: each warm thing in each picture that shows it."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulation.thermal import ThermalRenderer
from simulation.truth import Truth

Array = NDArray[np.float64]

HEAT_COLUMNS = (
    "frame", "kind", "lat_deg", "lon_deg", "height_amsl_m", "u", "v", "area_m2", "kelvin", "ground_kelvin",
    "perimeter_m",
)  # fmt: skip


def write_heat(path: Path, renderer: ThermalRenderer, truth: Truth, times_s: Array) -> None:
    """One row for each thing whose middle a picture shows; `times_s` (N,) are those of the pictures after the first.

    A fire's row counts for the whole of it, its place is the middle of the line that it began as.
    """
    with path.open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(HEAT_COLUMNS)
        for frame, time_s in enumerate(map(float, times_s)):
            sources = renderer.sources_near(truth.poses[frame].centre_m[:2])
            if not sources:
                continue
            places = np.array([source.place_m(time_s) for source in sources])
            points = np.column_stack([places, truth.terrain.height_m(places[:, 0], places[:, 1])])
            uv, _ = truth.project(frame, points)
            for k in np.flatnonzero(truth.sees(frame, points)):
                seen = renderer.seen(sources[k], time_s)
                lat, lon, height = (float(c) for c in truth.origin.to_geodetic(points[k]))
                round_m = sources[k].perimeter_m(time_s)
                rows.writerow(
                    [frame, sources[k].kind, f"{lat:.10f}", f"{lon:.10f}", f"{height - truth.undulation_m:.4f}"]
                    + [f"{uv[k, 0]:.2f}", f"{uv[k, 1]:.2f}", f"{seen.area_m2:.3f}", f"{seen.kelvin:.3f}"]
                    + [f"{seen.ground_k:.3f}", f"{round_m:.2f}"]
                )
