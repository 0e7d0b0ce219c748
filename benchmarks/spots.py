"""Hot spots found on rendered thermal pictures with truth.

    python -m benchmarks.spots [--scenes calm,rocks,shutter,small,agc,team] [--flights 3] [--seconds 40] [--pictures N]

Everything is rendered 100 m up (640x512, 50 degrees, NETD 50 mK; `small` 160x120, `agc` 8 bits of the camera's own
gain, `rocks` 200 rocks a km2 that the sun has warmed by 2 K in the mean, some by 8, `shutter` an event every 15 s,
`team` twelve others at take-off, surveyed only) with people of half a metre, 8 K above the ground that they stand on.

First each scene's ground is surveyed: pictures side by side whose poses are known, a person in every third, so that
recall and false spots are counted on enough of it; the first 20 pictures are for learning the ground. A false spot is
one where no one is: rocks count. Then flights through the whole pipeline, with ordinary errors: there a person is
found if any picture has a spot within 3 m or twice its ellipse, and places, areas and the processor's time are
measured. Whether ellipses are right is asked by `benchmarks.found_coverage`: here the camera is mounted and timed
without an error and the receiver is better than declared, so that all places are far inside. Printed against the goals
of issue L.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from benchmarks.machine import describe, load, table, verdict
from benchmarks.short_flight import first_sets

# isort: split
import cv2
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.spot import Spot
from onboard.config.schema import SpotsConfig, load_config
from onboard.spots.detector import Detector
from onboard.spots.due_pictures import DuePictures
from onboard.spots.spot_book import SpotBook
from simulation.flight import DescribedSpec
from simulation.heat_sources import HeatSource
from simulation.paths import PathSpec
from simulation.session import SessionSpec, fly
from simulation.texture import TextureSpec
from simulation.thermal import ThermalSpec
from simulation.truth import Truth
from tests.onboard.spots.scenes import Scene

Array = NDArray[np.float64]

RATE_HZ, HEIGHT_M, SPEED_M_S = 5.0, 100.0, 12.0
BOSON, LEPTON = Camera.from_field_of_view(640, 512, 50.0), Camera.from_field_of_view(160, 120, 57.0)
EACH_M, ASIDE_M = 120.0, 25.0  # a person every so many metres of way (90 a km2), at most so far from it
LEARNING, AT_M, EDGE_PX = 20, 2.0, 4.0  # pictures; from a person; a person nearer to the edge is not looked for
SAME_M = 3.0  # a spot so near to a person is that person, where its ellipse is smaller
RECALL_GOAL, FALSE_GOAL = 0.95, 1.0

SCENES: dict[str, tuple[Camera, ThermalSpec]] = {
    "calm": (BOSON, ThermalSpec()),
    "rocks": (BOSON, ThermalSpec(rocks_km2=200.0)),
    "shutter": (BOSON, ThermalSpec(shutter_s=(15.0, 30.0))),
    "small": (LEPTON, ThermalSpec()),
    "agc": (BOSON, ThermalSpec(output="agc")),
    "team": (BOSON, ThermalSpec()),
}
TEAM, TEAM_M = 12, 100.0  # as hot as the people who are looked for, within so many metres of take-off, in `team`


@dataclass
class Survey:
    """Counts after the learning, and spots where no one is before."""

    people: int = 0
    found: int = 0
    false: int = 0
    first_false: int = 0
    km2: float = 0.0


@dataclass
class Scores:
    """Scores of all flights of a scene: by person, and by picture that shows one."""

    found: list[bool] = field(default_factory=list)
    in_picture: list[bool] = field(default_factory=list)
    inside: list[bool] = field(default_factory=list)
    off_m: list[float] = field(default_factory=list)
    area: list[float] = field(default_factory=list)  # found over true
    ms: list[float] = field(default_factory=list)


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--flights", type=int, default=3, help="of each scene")
    parser.add_argument("--seconds", type=float, default=40.0, help="of a flight")
    parser.add_argument("--pictures", type=int, default=150, help="of each survey")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print(f"{describe()}; {load()}\n")
    cv2.setNumThreads(1)
    rows, surveyed = [], []
    for scene in args.scenes.split(","):
        scores, began_s = Scores(), time.monotonic()
        if args.pictures and not SCENES[scene][1].shutter_s:  # which changes nothing in pictures by themselves
            team = TEAM if scene == "team" else 0
            surveyed.append(survey_row(scene, survey(*SCENES[scene], args.pictures, args.seed, team)))
        for k in range(args.flights if scene != "team" else 0):
            measure(*SCENES[scene], args.seconds, args.seed + k, scores)
        if scores.found:
            rows.append(row(scene, scores))
        print(f"{scene}: {time.monotonic() - began_s:.0f} s", flush=True)
    print(f"\n{table(SURVEY_HEAD, surveyed)}\n\n{table(HEAD, rows)}")
    return 0


def survey(camera: Camera, heat: ThermalSpec, pictures: int, seed: int, team: int = 0) -> Survey:
    """Pictures side by side from poses that are known. So many of a `team` count neither as people nor as false."""
    rng = np.random.default_rng([seed, 78])
    pixel_m = HEIGHT_M / camera.fx_px
    step_m = 1.02 * camera.height_px * pixel_m
    aside, along = rng.uniform(-ASIDE_M, ASIDE_M, (2, len(range(0, pictures, 3))))
    places = np.column_stack([aside, along + 3.0 * step_m * np.arange(len(along))])
    others = rng.uniform((-0.5 * TEAM_M, 0.0), (0.5 * TEAM_M, TEAM_M), (team, 2))
    every = np.concatenate([places, others])
    warm = tuple(HeatSource.person((float(east), float(north))) for east, north in every)
    scene = Scene(replace(heat, sources=warm), camera, HEIGHT_M, step_m, seed=seed)
    detector, out = Detector(SpotsConfig(), scene.spec.scale if scene.spec.is_radiometric else None), Survey()
    for k in range(pictures):
        frame, its_set = scene.picture(k)
        assert frame.counts is not None
        centre = scene.pose(k).centre_m[:2]
        found = detector.look(frame.counts, its_set, centre, None)
        middles = np.array([region.uv_px for region in found]).reshape(-1, 2)
        spots = centre + (middles - (camera.cx_px, camera.cy_px)) * pixel_m * (1.0, -1.0)
        apart = np.hypot(*(spots[:, None] - places[None]).transpose(2, 0, 1))
        off = np.abs(places - centre) / pixel_m
        in_view = (off < 0.5 * np.array(camera.size_px) - EDGE_PX).all(axis=1)
        from_any = np.hypot(*(spots[:, None] - every[None]).transpose(2, 0, 1)).min(axis=1, initial=np.inf)
        false = int(np.count_nonzero(from_any > AT_M))
        if k < LEARNING:
            out.first_false += false
            continue
        out.people += int(in_view.sum())
        out.found += int(np.count_nonzero(apart[:, in_view].min(axis=0, initial=np.inf) < AT_M))
        out.false += false
        out.km2 += 1e-6 * camera.width_px * camera.height_px * pixel_m**2
    return out


def people(seconds: float, seed: int) -> tuple[HeatSource, ...]:
    """Along the way north, from where the pipeline has begun to answer on."""
    rng = np.random.default_rng([seed, 77])
    along = np.arange(100.0, SPEED_M_S * seconds - 40.0, EACH_M)
    return tuple(HeatSource.person((float(rng.uniform(-ASIDE_M, ASIDE_M)), float(north))) for north in along)


def measure(camera: Camera, heat: ThermalSpec, seconds: float, seed: int, scores: Scores) -> None:
    """Draw a flight, fly it, and compare what is reported with the truth."""
    spec = SessionSpec(
        DescribedSpec(path=PathSpec("straight", height_m=HEIGHT_M, speed_m_s=SPEED_M_S, heading_deg=0.0), seed=seed),
        seconds=seconds, rate_hz=RATE_HZ, camera=camera, texture=TextureSpec(seed=seed),
        thermal=replace(heat, sources=people(seconds, seed)), seed=seed,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder) / "flight"
        truth = fly(spec, home)
        compare(reports(home, scores), spec, truth, scores)


def reports(home: Path, scores: Scores) -> list[tuple[int, tuple[Spot, ...]]]:
    """Frame and spots of each picture that was looked at and has a set with an answer."""
    config = load_config(home / "config.toml")
    book, due = SpotBook("uav", config.spots, config.thermal), DuePictures(config.spots.rate_hz, 256)
    out = []
    for frame, its_set in first_sets(home, config):
        due.event(frame)
        picture = due.take(its_set)
        if picture is None:
            continue
        began_s = time.thread_time()
        report = book.picture(picture, its_set)
        scores.ms.append(1e3 * (time.thread_time() - began_s))
        if report is not None and its_set.is_ok:
            out.append((picture.index, report.spots))
    return out


def compare(looked: Sequence[tuple[int, tuple[Spot, ...]]], spec: SessionSpec, truth: Truth, scores: Scores) -> None:
    """One flight against the truth. People who are never in a picture that was looked at do not count."""
    assert spec.thermal is not None
    found: dict[int, bool] = {}
    sources = spec.thermal.sources
    places = np.array([source.place_m(0.0) for source in sources])
    points = np.column_stack([places, truth.terrain.height_m(places[:, 0], places[:, 1])])
    for frame, spots in looked:
        placed = [(spot, enu(spot, truth)) for spot in spots if spot.place is not None]
        for k in map(int, np.flatnonzero(truth.sees(frame, points))):
            near = [(spot, at) for spot, at in placed if is_same(spot, at, places[k])]
            found[k] = found.get(k, False) or bool(near)
            scores.in_picture.append(bool(near))
            for spot, at in near[:1]:
                scores.inside.append(in_ellipses(spot, at - places[k]) < 1.0)
                scores.off_m.append(float(np.hypot(*(at - places[k]))))
                scores.area.append(spot.area_m2 / sources[k].area_m2(0.0))
    scores.found += found.values()


def enu(spot: Spot, truth: Truth) -> Array:
    """East and north (2,) of a spot."""
    assert spot.place is not None
    return truth.origin.to_enu(spot.place.lat_deg, spot.place.lon_deg, truth.origin.height_m)[:2]


def in_ellipses(spot: Spot, off: Array) -> float:
    """The square of an error, east and north (2,), in the spot's ellipse: 1 on it."""
    assert spot.place is not None
    e, a = spot.place.ellipse, np.radians(spot.place.ellipse.azimuth_deg)
    along, across = off @ [np.sin(a), np.cos(a)], off @ [np.cos(a), -np.sin(a)]
    return float((along / e.semi_major_m) ** 2 + (across / e.semi_minor_m) ** 2)


def is_same(spot: Spot, at: Array, place: Array) -> bool:
    """Return whether a spot may be what is at a place: within twice its ellipse, or very near."""
    return bool(np.hypot(*(at - place)) < SAME_M) or in_ellipses(spot, at - place) < 4.0


SURVEY_HEAD = ("surveyed", "km2", "people", "recall", "false", "a km2", "while learning", "")
HEAD = ("flown", "people", "recall", "of pictures", "inside 90 %", "off, m", "area", "ms", "")


def survey_row(scene: str, s: Survey) -> tuple[str, ...]:
    """One line of the survey's table."""
    recall, rate = s.found / max(s.people, 1), s.false / max(s.km2, 1e-9)
    return (
        scene, f"{s.km2:.2f}", f"{s.people}", f"{recall:.2f}", f"{s.false}", f"{rate:.1f}", f"{s.first_false}",
        verdict(recall >= RECALL_GOAL and rate <= FALSE_GOAL),
    )  # fmt: skip


def row(scene: str, s: Scores) -> tuple[str, ...]:
    """One line of the flights' table."""
    recall = float(np.mean(s.found)) if s.found else 0.0
    inside = float(np.mean(s.inside)) if s.inside else float("nan")
    pictures = float(np.mean(s.in_picture)) if s.in_picture else 0.0
    return (
        scene, f"{len(s.found)}", f"{recall:.2f}", f"{pictures:.2f}", f"{inside:.2f}",
        f"{np.median(s.off_m or [np.nan]):.2f}", f"{np.median(s.area or [np.nan]):.2f}", f"{np.median(s.ms):.1f}",
        verdict(recall >= RECALL_GOAL),
    )  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main())
