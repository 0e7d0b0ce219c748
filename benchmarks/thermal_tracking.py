"""Poses from thermal pictures: simulated flights with a fixed pattern, little contrast, a shutter event, 16 bits or 8.

    python -m benchmarks.thermal_tracking [--rows TEXT] [--seconds 14] [--seed 5]

100 m up over 6 m of relief at 12 m/s, with turns; noise 50 mK; the shutter closes in the middle for 0.4 s. Each flight
is replayed twice: its counts reduced to grey picture by picture (`thermal.enabled = false`), and as docs/thermal.md has
it. Printed: pictures that answer of those that were not frozen, the median and largest error of clicks, how many are
inside their 90 % ellipse.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

from benchmarks.machine import describe, load

# isort: split
import numpy as np

from contract.camera import Camera
from contract.feature_set import Status
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec, fly
from simulation.terrain import TerrainSpec
from simulation.texture import TextureSpec
from simulation.thermal import ThermalSpec
from tests.scenarios.flights import CHI2_90, Outcome, play

LEPTON, BOSON = Camera.from_field_of_view(160, 120, 57.0), Camera.from_field_of_view(640, 512, 50.0)
ROWS = {
    "160x120, pattern 50 mK": (LEPTON, 8.0, ThermalSpec()),
    "160x120, pattern 300 mK": (LEPTON, 8.0, ThermalSpec(pattern_k=0.3)),
    "160x120, a third of the contrast": (LEPTON, 8.0, ThermalSpec(contrast=0.3)),
    "160x120, 8 bits": (LEPTON, 8.0, ThermalSpec(output="agc")),
    "160x120, 8 bits, pattern 200 mK": (LEPTON, 8.0, ThermalSpec(output="agc", pattern_k=0.2)),
    "640x512, pattern 300 mK": (BOSON, 6.0, ThermalSpec(pattern_k=0.3)),
    "640x512, a quarter of the contrast": (BOSON, 6.0, ThermalSpec(contrast=0.25, pattern_k=0.1)),
}


def spec_of(name: str, seconds: float, seed: int) -> SessionSpec:
    """The flight of a row."""
    camera, rate_hz, thermal = ROWS[name]
    return SessionSpec(
        DescribedSpec(PathSpec("turns", height_m=100.0, speed_m_s=12.0, leg_m=150.0), seed=seed),
        seconds=seconds,
        rate_hz=rate_hz,
        camera=camera,
        terrain=TerrainSpec(relief_m=6.0),
        texture=TextureSpec(seed=seed),
        thermal=replace(thermal, shutter_s=(0.5 * seconds,)),
    )


def line_of(outcome: Outcome) -> str:
    """The outcome of a flight in a line."""
    live = len(outcome.sets) - outcome.statuses[Status.BAD_PICTURE]
    said = f"{outcome.statuses[Status.OK]:4d} of {live}"
    if not len(outcome.errors_m):
        return said
    inside = float(np.mean(outcome.chi2 < CHI2_90))
    return f"{said}; {np.median(outcome.errors_m):.1f} m, at most {outcome.errors_m.max():.1f} m; {inside:.0%} inside"


def main() -> int:
    """Print a line for each row and way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", default="", help="only those whose names hold this")
    parser.add_argument("--seconds", type=float, default=14.0, help="of flight")
    parser.add_argument("--seed", type=int, default=5)
    args = parser.parse_args()
    print(f"{describe()}; {load()}\n")
    for name in ROWS:
        if args.rows not in name:
            continue
        with tempfile.TemporaryDirectory() as folder:
            fly(spec_of(name, args.seconds, args.seed), Path(folder) / "flight")
            for enabled in (False, True):
                outcome = play(Path(folder) / "flight", ("thermal.enabled", enabled))
                print(f"{name:36} {'as thermal' if enabled else 'as grey':11} {line_of(outcome)}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
