"""What has been seen, against the truth; and how long it takes to count a picture and to find those of a place.

    python -m benchmarks.seen [--flights 1] [--rows TEXT]

Rendered flights over simulated ground go through the pipeline, their sets into the map of what was seen. The truth is
cast ray by ray: a place was seen if any picture shows it with no hill between. Overstated: share of the claimed area
that no picture shows. Understated: share of what the pictures that answer show, and is not claimed; and of what all
pictures show, those before the first answer too. In brackets the worst flight. Last: an hour of flight at five sets a
second over one place, the hardest case for the question which pictures show it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import describe, load, table, verdict
from contract.feature_set import FeatureSet
from contract.wire.codec import decode, encode
from ground.seen.tally import TILE, SeenGround
from ground.web.seen_map import LISTED, SeenMap
from simulation.flight import DescribedSpec
from simulation.ordinary import ordinary
from simulation.paths import PathSpec
from simulation.session import SessionSpec
from simulation.terrain import TerrainSpec
from simulation.truth import Truth
from tests.ground.seen.levels import HOUR_PICTURES, PLACE, an_hour_over_a_place, level_set
from tests.scenarios.flights import CAMERA, play, simulated
from tests.web.rendered import FlyingSource

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

OVER, UNDER, QUERY_MS = 0.01, 0.10, 50.0
ABOUT = 40  # cells next to what is claimed in which the truth is looked for
TURNS = PathSpec("turns", leg_m=200.0)


@dataclass(frozen=True)
class Judged:
    """The judgement of one flight, or of several together: areas in cells."""

    claimed: float = 0.0
    wrongly: float = 0.0
    shown: float = 0.0  # by the pictures that answer
    missed: float = 0.0
    shown_by_all: float = 0.0
    missed_of_all: float = 0.0
    pictures: int = 0
    answered: int = 0

    def __add__(self, other: Judged) -> Judged:
        return Judged(**{name: value + getattr(other, name) for name, value in vars(self).items()})

    @property
    def over(self) -> float:
        """Share of what is claimed."""
        return self.wrongly / max(self.claimed, 1.0)

    @property
    def under(self) -> float:
        """Share of what the pictures that answer show."""
        return self.missed / max(self.shown, 1.0)

    @property
    def under_all(self) -> float:
        """Share of what all pictures show."""
        return self.missed_of_all / max(self.shown_by_all, 1.0)


def rows() -> dict[str, SessionSpec]:
    """Kinds of flights: straight and in banked turns, on flat and hilly ground, with and without attitude."""
    flight = DescribedSpec(PathSpec())
    spec = SessionSpec(flight, seconds=30.0, rate_hz=2.0, camera=CAMERA, clicks_per_frame=1)
    hills = TerrainSpec(relief_m=40.0, wavelength_m=300.0)
    turns = replace(spec, flight=replace(flight, path=TURNS), seconds=45.0)
    return {
        "flat, straight": spec,
        "flat, turns": turns,
        "hills 40 m, straight": replace(spec, terrain=hills),
        "hills 40 m, turns": replace(turns, terrain=hills),
        "hills 40 m, turns, banked 40 deg": replace(
            turns, flight=replace(flight, path=replace(TURNS, bank_deg=40.0)), terrain=hills
        ),
        "hills 40 m, turns, without attitude": replace(turns, terrain=hills, attitude="none"),
        "flat, oblique -60": replace(turns, mount_deg=(0.0, -60.0, 0.0)),
    }


def seeded(spec: SessionSpec, seed: int) -> SessionSpec:
    """The same kind of flight with an autopilot, a ground and a heading of its own."""
    assert isinstance(spec.flight, DescribedSpec)
    path = replace(spec.flight.path, heading_deg=float(np.random.default_rng([seed, 11]).uniform(0.0, 360.0)))
    flight = replace(spec.flight, telemetry=ordinary(seed), path=path, seed=seed)
    return replace(spec, flight=flight, terrain=replace(spec.terrain, seed=seed), seed=seed)


def judge(folder: Path, sets: Iterable[FeatureSet], cell_m: float | None = None, per_cell: int = 2) -> Judged:
    """A flight's map against its truth, looked at `per_cell` squared places a cell."""
    truth, seen, answered = Truth.load(folder), SeenGround(cell_m), []
    for s in sets:
        seen.add(decode(encode(s)))  # as the ground receives it
        answered += [s.frame] if s.is_ok else []
    cells = seen.cells
    assert cells is not None
    tiles = {at: tile["count"] > 0 for at, tile in seen.all_tiles()}
    corners = np.array(sorted(tiles)) * TILE
    low, high = corners.min(axis=0) - ABOUT, corners.max(axis=0) + TILE + ABOUT
    claimed = np.zeros(high - low, bool)
    for (row, column), tile in tiles.items():
        y, x = row * TILE - low[0], column * TILE - low[1]
        claimed[y : y + TILE, x : x + TILE] = tile
    fine = np.repeat(np.repeat(claimed, per_cell, axis=0), per_cell, axis=1).ravel()
    rows_at, columns_at = ((n + 0.5) / per_cell for n in np.indices((high - low) * per_cell))
    lat = cells.lat_deg(low[0] + rows_at.ravel())
    lon = cells.lon_deg(low[1] + columns_at.ravel())
    places = truth.origin.to_enu(lat, lon, truth.origin.height_m)
    places[:, 2] = truth.terrain.height_m(places[:, 0], places[:, 1])
    shown = visible(truth, answered, places)
    rest = sorted(set(range(len(truth))) - set(answered))
    by_all = shown | visible(truth, rest, places)
    share = 1.0 / per_cell**2
    return Judged(
        float(fine.sum()) * share,
        float((fine & ~by_all).sum()) * share,
        float(shown.sum()) * share,
        float((shown & ~fine).sum()) * share,
        float(by_all.sum()) * share,
        float((by_all & ~fine).sum()) * share,
        len(truth),
        len(answered),
    )


def visible(truth: Truth, frames: Iterable[int], places: Array) -> Mask:
    """Mask (N,) of the places (N, 3) that any of these pictures shows."""
    out = np.zeros(len(places), bool)
    for frame in frames:
        _, on_picture = truth.project(frame, places)
        new = np.flatnonzero(on_picture & ~out)
        if len(new):
            out[new] = truth.sees(frame, places[new])
    return out


def areas(flights: int, wanted: str) -> str:
    """The table of claims against truth."""
    lines = []
    for name, spec in rows().items():
        if wanted not in name:
            continue
        each = []
        for seed in range(flights):
            folder = simulated(seeded(spec, 40 + seed))
            each.append(judge(folder, play(folder).sets.values()))
        total = sum(each, Judged())
        worst = max(one.over for one in each), max(one.under for one in each)
        is_reached = total.over <= OVER and total.under <= UNDER
        shares = [
            f"{100.0 * total.over:.2f} ({100.0 * worst[0]:.2f})",
            f"{100.0 * total.under:.1f} ({100.0 * worst[1]:.1f})",
        ]
        answered = f"{100 * total.answered // total.pictures}"
        lines.append([name, str(flights), answered, *shares, f"{100.0 * total.under_all:.1f}", verdict(is_reached)])
    head = [
        "",
        "flights",
        "answered %",
        "overstated % (worst)",
        "understated % (worst)",
        "of all pictures %",
        "goal 1, 10",
    ]
    return table(head, lines)


def times() -> str:
    """Milliseconds to count a picture, by its cells, and to answer which pictures show a place after an hour."""
    lines = []
    for cell_m in (5.0, 2.0, 1.0):
        seen = SeenGround(cell_m)
        made = [level_set(k, east_m=1.5 * k, height_m=250.0, sigma_m=1.0) for k in range(60)]
        began = time.process_time()
        for s in made:
            seen.add(s)
        took_ms = 1000.0 * (time.process_time() - began) / len(made)
        lines.append([f"count a picture from 250 m, cells of {cell_m:g} m", f"{took_ms:.1f}", "", ""])
    held = SeenMap(FlyingSource())
    held._seen = an_hour_over_a_place()
    took = []
    for k in range(50):
        lat, lon, _ = (float(c) for c in PLACE.to_geodetic((0.1 * k, 0.1 * k, 0.0)))
        began = time.perf_counter()
        said = held.at(lat, lon)
        took.append(1000.0 * (time.perf_counter() - began))
        assert len(str(said["pictures"])) > LISTED
    took.sort()
    line = f"which of {HOUR_PICTURES} pictures show a place"
    lines.append([line, f"{took[25]:.1f}", f"{took[47]:.1f}", verdict(took[47] <= QUERY_MS)])
    return table(["ms", "median", "95 %", f"goal {QUERY_MS:g}"], lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flights", type=int, default=1, help="of each kind (default 1)")
    parser.add_argument("--rows", default="", help="only the kinds with this text in their name")
    args = parser.parse_args()
    print(f"{describe()}; {load()}\n")
    print(areas(args.flights, args.rows))
    print("\n" + times())


if __name__ == "__main__":
    main()
