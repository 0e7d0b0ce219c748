"""The stated probability of detection against the share of people that was found.

    python -m benchmarks.detection [--flights 150] [--pictures 40] [--seed 0]

A thermal camera (320x256, 50 degrees, NETD 50 mK) passes over rendered ground at 2 pictures a second, a fifth of one to
the next, its poses known. Flights differ in ground (ten strips of each), height (80 to 150 m), how much the ground
varies (0.35 to 1 of 2 to 3 K) and how many rocks lie there that the sun has warmed. The search runs as on board, its
reports go over the wire; sets and reports go into `ground.seen`, which states for each cell the probability that a
person there (half a metre, 8 K above the ground as the camera sees it) is among what `pc-ground spots` lists.

Rendered: people strewn at random, two to a picture, each listed or not (a thing within 3 m). Nearly all of them are in
cells with nearly 0 or 1. Tried: of each tenth that a flight states, up to twelve more, anywhere in its cells and at
least 6 m from those who are rendered; whether each is found in a picture is asked of the search's own trial of that
picture at that pixel (25.23), and listed is who was in two of three pictures, and so twice. Of both, by tenths of what
is stated: the mean of that, and the share that is listed. A sigma is by the dispersion between flights, which share
their ground and thresholds. Goal: within 5 points in each tenth, never 5 points less found; it cannot be judged of
fewer than 60 people or with a sigma of more than 5 points.
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
from ground.seen.coverage import Coverage, coverage
from ground.seen.detection import detection
from ground.seen.tally import SeenGround
from ground.spots.merging import SpotMerger
from onboard.config.schema import parse_config
from onboard.events.types import Frame
from onboard.spots.contrast import contrast
from onboard.spots.detector import LEAST_PX, PARTS
from onboard.spots.ground_scale import ground_scale
from onboard.spots.spot_book import SpotBook
from onboard.spots.would_find import found_at
from simulation.heat_sources import HeatSource
from simulation.thermal import ThermalSpec
from simulation.trajectory import Pose
from tests.onboard.spots.scenes import ORIGIN, Scene, place_of

Array = NDArray[np.float64]

CAMERA = Camera.from_field_of_view(320, 256, 50.0)
STEP, PEOPLE = 0.2, 2.0  # of a picture's height, from picture to picture; people to a picture
HEIGHTS_M, CONTRASTS, ROCKS_KM2 = (80.0, 150.0), (0.35, 1.0), (0.0, 100.0, 300.0)
STRIPS, APART_M = 10, 400.0  # on each ground, which takes longer to draw than a flight to fly
SAME_M, CELL_M = 3.0, 2.0
CONFIG = parse_config("[thermal]\nenabled = true\nscale = 0.01\n")
TRIED, AWAY_M = 12, 6.0  # people in each tenth of a flight, and so far from those who are rendered
GOAL, ENOUGH = 0.05, 60
BETWEEN = 1, 9  # tenths between the first and the last, in which few stand who are rendered


@dataclass(frozen=True, eq=False)
class Person:
    """One person of a flight: what is stated for the cell, and whether it is listed."""

    stated: float
    is_found: bool


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture as it was searched, and what each size needed in it."""

    frame: Frame
    its_set: FeatureSet
    thresholds: dict[float, float]


@dataclass(frozen=True)
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


@dataclass(frozen=True, eq=False)
class Stated:
    """The probabilities that are stated of a flight's cells."""

    shown: Coverage
    probabilities: Array

    def at(self, place_m: Array) -> float | None:
        """Return that of the cell at a place (2,); None if it was not seen."""
        row, column = (int(n) for n in self.shown.cells.at(*place_of(float(place_m[0]), float(place_m[1]))))
        at = row - self.shown.row0, column - self.shown.column0
        is_inside = 0 <= at[0] < self.shown.seen.shape[0] and 0 <= at[1] < self.shown.seen.shape[1]
        return float(self.probabilities[at]) if is_inside and self.shown.seen[at] else None

    def places(self, rng: np.random.Generator) -> Array:
        """East and north (N, 2) of TRIED places, anywhere in cells of each tenth that is stated."""
        at = np.argwhere(self.shown.seen)
        tenth = np.array([tenth_of(p) for p in self.probabilities[self.shown.seen]])
        chosen = [rng.permutation(np.flatnonzero(tenth == k))[:TRIED] for k in range(10)]
        row, column = (at[np.concatenate(chosen)] + (self.shown.row0, self.shown.column0)).T
        down, across = rng.uniform(size=(2, len(row)))
        lat, lon = self.shown.cells.lat_deg(row + down), self.shown.cells.lon_deg(column + across)
        return np.asarray(ORIGIN.to_enu(lat, lon, ORIGIN.height_m)[:, :2])


def tenth_of(stated: float) -> int:
    return min(int(10.0 * stated + 1e-9), 9)


def fly(seed: int, flight: int, pictures: int) -> tuple[list[Person], list[Person]]:
    """One flight over its people, of whom those count whose cell was seen; and those who are tried besides."""
    rng = np.random.default_rng([seed, flight, 940])
    ground, strip = divmod(flight, STRIPS)
    east_m = APART_M * strip
    height_m = float(rng.uniform(*HEIGHTS_M))
    spec = ThermalSpec(contrast=float(rng.uniform(*CONTRASTS)), rocks_km2=float(rng.choice(ROCKS_KM2)))
    wide_m, high_m = (size * height_m / CAMERA.fx_px for size in CAMERA.size_px)
    count = round(pictures * STEP * PEOPLE)
    across = east_m + rng.uniform(-0.5 * wide_m, 0.5 * wide_m, count)
    at_m = np.column_stack([across, rng.uniform(0.0, STEP * pictures * high_m, count)])
    excess_k = PERSON_K * float(np.exp(height_m / spec.air_m))
    people = tuple(HeatSource.person((float(x), float(y)), excess_k) for x, y in at_m)
    of_heat = replace(spec, sources=people)
    scene = Strip(of_heat, CAMERA, height_m, STEP * high_m, seed=seed + ground, east_m=east_m)
    seen, reports, searched = search(scene, pictures)
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
    stated = Stated(shown, machine[0])
    rendered = [
        Person(p, bool(np.hypot(*(listed - place_m).T).min(initial=np.inf) < SAME_M))
        for place_m in at_m
        if (p := stated.at(place_m)) is not None
    ]
    places = stated.places(rng)
    places = places[np.hypot(*(places[:, None] - at_m).transpose(2, 0, 1)).min(axis=1) > AWAY_M]
    return rendered, people_tried(scene, searched, stated, places)


def search(scene: Scene, pictures: int) -> tuple[SeenGround, list[SpotReport], list[Picture]]:
    """The search on board, and what the ground receives of it."""
    book, seen, reports, searched = SpotBook("uav-1", CONFIG.spots, CONFIG.thermal), SeenGround(CELL_M), [], []
    for k in range(pictures):
        frame, its_set = scene.picture(k)
        received: FeatureSet = decode(encode(its_set))
        seen.add(received)
        report = book.picture(frame, its_set)
        searched.append(Picture(frame, its_set, book.thresholds))
        if report is not None:
            reports.append(decode_spots(encode_spots(report), "uav-1"))
    return seen, reports, searched


def people_tried(scene: Scene, searched: list[Picture], stated: Stated, places_m: Array) -> list[Person]:
    """People at places (N, 2) whom the search's own trial finds or not."""
    ground_m = scene.terrain.height_m(places_m[:, 0], places_m[:, 1])
    found = np.zeros((len(searched) + 2, len(places_m)), bool)  # two pictures before the first
    for k, picture in enumerate(searched):
        pose = scene.pose(k)
        rays = (np.column_stack([places_m, ground_m]) - pose.centre_m) @ pose.R_enu_cam
        at = (CAMERA.pixels(rays[:, :2] / rays[:, 2:])[:, ::-1] + 0.5) / CAMERA.size_px[::-1]
        shown = np.all((at >= 0.0) & (at < 1.0), axis=1)
        if shown.any():
            found[k + 2, shown] = found_in(picture, at[shown])
    is_listed = (found[2:] & (found[1:-1] | found[:-2])).sum(axis=0) >= 2
    people = zip(map(stated.at, places_m), is_listed, strict=True)
    return [Person(p, bool(is_one)) for p, is_one in people if p is not None]


def found_in(picture: Picture, at: Array) -> NDArray[np.bool_]:
    """Return whether a person at places (N, 2) in a picture, shares of its height and width, would be found in it."""
    ground = ground_scale(picture.its_set, PARTS)
    assert ground is not None and picture.frame.counts is not None and CONFIG.thermal.calibration is not None
    kelvin, pixel_m = CONFIG.thermal.calibration.kelvin(picture.frame.counts), ground.middle_m
    sizes = [side_m for side_m in picture.thresholds if 2.0 * side_m >= LEAST_PX * pixel_m]
    contrasts = [contrast(kelvin, ground.is_ground, side_m, pixel_m) for side_m in sizes]
    return found_at(kelvin, contrasts, picture.thresholds, pixel_m, at)[0]


def rows(rendered: list[list[Person]], tried: list[list[Person]]) -> list[tuple[str, ...]]:
    """The rows of the table: one for each tenth, and one for those between the first and the last."""
    out = []
    for low, high in [*((k, k + 1) for k in range(10)), BETWEEN]:
        of_both = [share_found(flights, low, high) for flights in (tried, rendered)]
        words = [cell for people in of_both for cell in (*people.words, people.judged)]
        out.append((f"{0.1 * low:.1f} to {0.1 * high:.1f}", *words))
    return out


@dataclass(frozen=True)
class ShareFound:
    """The mean of what is stated for `people` in some tenths, the share that was found, and one sigma of that."""

    people: int
    stated: float
    found: float
    sigma: float

    @property
    def words(self) -> tuple[str, ...]:
        if not self.people:
            return "0", "", "", ""
        points = f"{100.0 * (self.found - self.stated):+.1f}"
        return f"{self.people}", f"{self.stated:.3f}", f"{self.found:.3f} +- {self.sigma:.3f}", points

    @property
    def judged(self) -> str:
        """The goal's verdict, where it can be judged."""
        is_enough = self.people >= ENOUGH and self.sigma <= GOAL
        return verdict(abs(self.found - self.stated) <= GOAL) if is_enough else "too few"


def share_found(flights: list[list[Person]], low: int, high: int) -> ShareFound:
    """The share found of the people for whom from `low` to `high` tenths are stated."""
    of_flights = [[p for p in people if low <= tenth_of(p.stated) < high] for people in flights]
    people = [p for of_flight in of_flights for p in of_flight]
    if not people:
        return ShareFound(0, 0.0, 0.0, 0.0)
    stated, found = (float(np.mean([getattr(p, name) for p in people])) for name in ("stated", "is_found"))
    # Of a ratio of sums over flights: the flights' residuals, summed.
    residuals = [sum(p.is_found - found for p in of_flight) for of_flight in of_flights]
    return ShareFound(len(people), stated, found, float(np.sqrt(np.sum(np.square(residuals)))) / len(people))


HEAD = (
    "stated",
    *(f"{who}{what}" for who in ("tried", "rendered") for what in ("", ": mean", ", found", ", points", ", goal")),
)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=150)
    parser.add_argument("--pictures", type=int, default=40, help="of a flight")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print(f"{describe()}; {load()}; {args.flights} flights, seed {args.seed}\n")
    cv2.setNumThreads(1)
    began_s = time.monotonic()
    rendered, tried = zip(*(fly(args.seed, k, args.pictures) for k in range(args.flights)), strict=True)
    print(f"{time.monotonic() - began_s:.0f} s\n\n{table(HEAD, rows(list(rendered), list(tried)))}")
    everyone = share_found(list(rendered), 0, 10)
    print(f"\nall rendered: {everyone.people} people, stated {everyone.stated:.3f}, found {everyone.found:.3f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
