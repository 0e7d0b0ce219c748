"""The yield of each degeneracy: the table of docs/where-it-works.md. `python -m tests.scenarios.table`."""

from dataclasses import replace

import numpy as np

from contract.feature_set import Status
from simulation.flight import DescribedSpec
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from simulation.terrain import TerrainSpec
from simulation.texture import TextureSpec
from tests.scenarios.flights import CHI2_90, CHI2_99, play, simulated
from tests.scenarios.sessions import FAST, HOVER, LARGE, LOW, ROTATION
from tests.scenarios.spoiling import LevelTerrain

SEEDS = (0, 3, 7)
HOVER_PATH = DescribedSpec(PathSpec("hover", height_m=100.0))
SEED_SENSORS = (("solve.attitude", "none"), ("solve.level_ground", True))
Overrides = tuple[tuple[str, object], ...]


def ground(style: str, flight: DescribedSpec = LARGE.flight, **texture: int) -> SessionSpec:
    return replace(LARGE, flight=flight, texture=TextureSpec(style, **texture))


ROWS: dict[str, tuple[SessionSpec, Overrides, bool]] = {
    "level ground, a straight leg": (LARGE, (), False),
    "relief of 40 m": (replace(LARGE, terrain=TerrainSpec(relief_m=40.0)), (), False),
    "an exactly straight path, no shake": (
        replace(LARGE, flight=DescribedSpec(PathSpec("straight", wobble_deg=0.0))), (), False,
    ),
    "hover": (HOVER, (), False),
    "hover, home's level allowed": (HOVER, (("solve.home_level", True),), False),
    "hover over known terrain": (HOVER, (), True),
    "yaw on the spot": (ROTATION, (), False),
    "yaw on the spot over known terrain": (ROTATION, (), True),
    "hover over water": (ground("water", HOVER_PATH), (), False),
    "hover over the sea": (ground("sea", HOVER_PATH), (), False),
    "no texture": (ground("plain"), (), False),
    "water, 250 m, 20 m/s": (ground("water"), (), False),
    "water, 100 m, 12 m/s": (ground("water", LOW), (), False),
    "water, 250 m, 35 m/s": (ground("water", FAST), (), False),
    "sea, 250 m, 20 m/s": (ground("sea"), (), False),
    "sea, 100 m, 12 m/s": (ground("sea", LOW), (), False),
    "sea, 250 m, 35 m/s": (ground("sea", FAST), (), False),
    "rows 8 m apart": (ground("stripes"), (), False),
    "the same, no attitude": (ground("stripes"), SEED_SENSORS, False),
    "the same, a picture a second": (replace(ground("stripes"), rate_hz=1.0, seconds=12.0), (), False),
    "vehicles on 3 % of the ground": (ground("traffic", vehicle_spacing_m=128), (), False),
    "vehicles on 5 %": (ground("traffic"), (), False),
    "vehicles on 11 %": (ground("traffic", vehicle_spacing_m=32), (), False),
    "vehicles on 22 %": (ground("traffic", vehicle_spacing_m=16), (), False),
}  # fmt: skip


def row(name: str, spec: SessionSpec, overrides: Overrides, has_terrain: bool) -> str:
    """One line: pictures by status, and the clicks that were answered."""
    flights = [
        play(
            simulated(replace(spec, seed=seed, texture=replace(spec.texture, seed=seed))),
            *overrides,
            terrain=LevelTerrain() if has_terrain else None,
        )
        for seed in SEEDS
    ]
    pictures = sum(len(flight.sets) for flight in flights)
    shares = {status: sum(flight.statuses[status] for flight in flights) / pictures for status in Status}
    reported = ", ".join(f"{status.value} {100 * share:.0f} %" for status, share in shares.items() if share > 0.0)
    errors, chi2, semi = (
        np.concatenate([getattr(flight, field) for flight in flights]) for field in ("errors_m", "chi2", "semi_m")
    )
    if not len(errors):
        return f"| {name} | {reported} | - | - | - |"
    inside = f"{100 * np.mean(chi2 < CHI2_90):.0f} / {100 * np.mean(chi2 < CHI2_99):.0f} %"
    return f"| {name} | {reported} | {np.median(errors):.1f} | {np.median(semi):.1f} | {inside} |"


if __name__ == "__main__":
    print("| situation | pictures | median error (m) | 90 % semi-major (m) | inside 90 / 99 % |")
    print("|---|---|---|---|---|")
    for situation, (session, changes, known) in ROWS.items():
        print(row(situation, session, changes, known), flush=True)
