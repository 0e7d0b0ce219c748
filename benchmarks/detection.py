"""The stated probability of detection against the share of people that was found.

    python -m benchmarks.detection [--flights 150] [--pictures 40] [--seed 0]

People of half a metre, 8 K above their ground as the camera sees them, strewn at random over rendered ground, two to a
picture; a thermal camera (320x256, 50 degrees, NETD 50 mK) passes over them at 2 pictures a second, a fifth of one
to the next, its poses known. Flights differ in ground (ten strips of each), height (40 to 130 m), how much the
ground varies (0.35 to 1 of 2 to 3 K) and how many rocks lie there that the sun has warmed. The search runs as on board,
its reports go over the wire; sets and reports go into `ground.seen`, which states for each cell the probability that a
person there is among what `pc-ground spots` lists. Of all people, by tenths of what is stated for their cell: the mean
of that, and the share that is listed (a thing within 3 m). A sigma is by the dispersion between flights, which share
their ground and thresholds. Goal: within 5 points in each tenth, never 5 points less found; it cannot be judged of
fewer than 20 people or with a sigma of more than 5 points.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace

from benchmarks.machine import describe, load, table, verdict

# isort: split
import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.spot import PERSON_K, SpotReport
from contract.wire.codec import decode, encode
from contract.wire.spot_code import decode_spots, encode_spots
from ground.seen.coverage import coverage
from ground.seen.detection import detection
from ground.seen.tally import SeenGround
from ground.spots.merging import SpotMerger
from onboard.config.schema import parse_config
from onboard.spots.spot_book import SpotBook
from simulation.heat_sources import HeatSource
from simulation.thermal import ThermalSpec
from simulation.trajectory import Pose
from tests.onboard.spots.scenes import ORIGIN, Scene, place_of

Array = NDArray[np.float64]

CAMERA = Camera.from_field_of_view(320, 256, 50.0)
STEP, PEOPLE = 0.2, 2.0  # of a picture's height, from picture to picture; people to a picture
HEIGHTS_M, CONTRASTS, ROCKS_KM2 = (40.0, 130.0), (0.35, 1.0), (0.0, 100.0, 300.0)
STRIPS, APART_M = 10, 400.0  # on each ground, which takes longer to draw than a flight to fly
SAME_M, CELL_M = 3.0, 2.0
GOAL, ENOUGH = 0.05, 20
TOGETHER = (1, 5), (5, 9), (1, 9)  # tenths between the first and the last, in which few people stand


@dataclass(frozen=True, eq=False)
class Person:
    """One person of a flight: what is stated for the cell, from, to, and whether it is listed."""

    stated: float
    low: float
    high: float
    is_found: bool


@dataclass
class Strip(Scene):
    """A flight along a strip of the ground `east_m` of its middle."""

    east_m: float = 0.0

    def pose(self, frame: int) -> Pose:
        """Return the scene's pose, moved east."""
        pose = super().pose(frame)
        return replace(pose, centre_m=pose.centre_m + (self.east_m, 0.0, 0.0))

    def ground_m(self, frame: int) -> float:
        """Return the ground's height below that pose."""
        return float(self.terrain.height_m(self.east_m, self.step_m * frame))


def fly(seed: int, flight: int, pictures: int) -> list[Person]:
    """One flight over its people; of those whose cell was seen."""
    rng = np.random.default_rng([seed, flight, 940])
    ground, strip = divmod(flight, STRIPS)
    east_m = APART_M * strip
    height_m = float(rng.uniform(*HEIGHTS_M))
    spec = ThermalSpec(contrast=float(rng.uniform(*CONTRASTS)), rocks_km2=float(rng.choice(ROCKS_KM2)))
    wide_m, high_m = (size * height_m / CAMERA.fx_px for size in CAMERA.size_px)
    count = round(pictures * STEP * PEOPLE)
    across = east_m + rng.uniform(-0.5 * wide_m, 0.5 * wide_m, count)
    along = rng.uniform(0.0, STEP * pictures * high_m, count)
    excess_k = PERSON_K * float(np.exp(height_m / spec.air_m))
    people = tuple(HeatSource.person((float(x), float(y)), excess_k) for x, y in zip(across, along, strict=True))
    of_heat = replace(spec, sources=people)
    scene = Strip(of_heat, CAMERA, height_m, STEP * high_m, seed=seed + ground, east_m=east_m)
    seen, reports = search(scene, pictures)
    merger = SpotMerger()
    for report in reports:
        merger.add(report)
    listed = np.array(
        [ORIGIN.to_enu(t.place.lat_deg, t.place.lon_deg, ORIGIN.height_m)[:2] for t in merger.things() if t.is_sure]
    ).reshape(-1, 2)
    shown = coverage(seen)
    assert shown is not None
    machine = detection(seen.looks(), shown, reports).machine
    assert machine is not None
    out = []
    for x, y in zip(across, along, strict=True):
        row, column = (int(n) for n in shown.cells.at(*place_of(float(x), float(y))))
        at = row - shown.row0, column - shown.column0
        if not (0 <= at[0] < shown.seen.shape[0] and 0 <= at[1] < shown.seen.shape[1] and shown.seen[at]):
            continue
        away = np.hypot(*(listed - (x, y)).T)
        stated, low, high = (float(p) for p in machine[:, at[0], at[1]])
        out.append(Person(stated, low, high, bool(away.min(initial=np.inf) < SAME_M)))
    return out


def search(scene: Scene, pictures: int) -> tuple[SeenGround, list[SpotReport]]:
    """The search on board, and what the ground receives of it."""
    config = parse_config("[thermal]\nenabled = true\nscale = 0.01\n")
    book, seen, reports = SpotBook("uav-1", config.spots, config.thermal), SeenGround(CELL_M), []
    for k in range(pictures):
        frame, its_set = scene.picture(k)
        received: FeatureSet = decode(encode(its_set))
        seen.add(received)
        report = book.picture(frame, its_set)
        if report is not None:
            reports.append(decode_spots(encode_spots(report), "uav-1"))
    return seen, reports


def tenths(flights: list[list[Person]]) -> list[tuple[str, ...]]:
    """The rows of the table: one for each tenth that holds anyone, and those of TOGETHER."""
    parts = [(k, k + 1) for k in range(10)]
    rows = (part_row(flights, low, high) for low, high in [*parts, *TOGETHER])
    return [row for row in rows if row]


def part_row(flights: list[list[Person]], low: int, high: int) -> tuple[str, ...]:
    """A row of the people for whom from `low` to `high` tenths are stated; empty if there are none."""
    of_flights = [[p for p in people if low <= min(int(10.0 * p.stated), 9) < high] for people in flights]
    people = [p for of_flight in of_flights for p in of_flight]
    if not people:
        return ()
    stated, least, most, found = (
        float(np.mean([getattr(p, name) for p in people])) for name in ("stated", "low", "high", "is_found")
    )
    # Of a ratio of sums over flights: the flights' residuals, summed.
    residuals = [sum(p.is_found - found for p in of_flight) for of_flight in of_flights]
    sigma = float(np.sqrt(np.sum(np.square(residuals)))) / len(people)
    judged = verdict(abs(found - stated) <= GOAL) if len(people) >= ENOUGH and sigma <= GOAL else "too few"
    return (
        f"{0.1 * low:.1f} to {0.1 * high:.1f}", f"{len(people)}", f"{sum(map(bool, of_flights))}", f"{stated:.3f}",
        f"{least:.2f} to {most:.2f}", f"{found:.3f} +- {sigma:.3f}", f"{100.0 * (found - stated):+.1f}", judged,
    )  # fmt: skip


HEAD = ("stated", "people", "flights", "mean", "lowest to highest", "found", "points", "")


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=150)
    parser.add_argument("--pictures", type=int, default=40, help="of a flight")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print(f"{describe()}; {load()}; {args.flights} flights, seed {args.seed}\n")
    cv2.setNumThreads(1)
    began_s, flights = time.monotonic(), []
    for k in range(args.flights):
        flights.append(fly(args.seed, k, args.pictures))
    print(f"{time.monotonic() - began_s:.0f} s\n\n{table(HEAD, tenths(flights))}")
    everyone = [p for people in flights for p in people]
    stated, found = (float(np.mean([getattr(p, name) for p in everyone])) for name in ("stated", "is_found"))
    print(f"\nall: {len(everyone)} people, stated {stated:.3f}, found {found:.3f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
