"""Hot spots found on drawn thermal flights with truth, through the whole pipeline.

    python -m benchmarks.spots [--scenes calm,rocks,shutter,small,agc] [--flights 1] [--seconds 60] [--seed 0]

Each flight is drawn 100 m up (640x512, 50 degrees, NETD 50 mK, 5 pictures a second; `small` 160x120, `agc` 8 bits of
the camera's own gain, `rocks` 200 sun-warmed rocks a km2, `shutter` an event every 15 s) with people of half a metre,
8 K above the ground that they stand on, a cluster of grid places along the way. A person counts as found if a spot is
reported within the person's 90 % ellipse or 3 m in one picture at least of those that show it; a spot is false if
nothing warm lies there. False spots are counted as places, once each, on the ground flown over. Printed against the
goals of issue L: recall, false spots a km2, coverage of the 90 % ellipse, areas, and the processor's time a picture.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from benchmarks.machine import describe, load, table, verdict

# isort: split
import numpy as np
from numpy.typing import NDArray

from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.spot import Spot
from onboard.config.schema import Config, load_config
from onboard.events.types import Frame
from onboard.pipeline.pipeline import Pipeline
from onboard.replay.runner import Flight
from onboard.spots.due_pictures import DuePictures
from onboard.spots.spot_book import SpotBook
from simulation.flight import DescribedSpec
from simulation.heat_sources import HeatSource
from simulation.paths import PathSpec
from simulation.session import SessionSpec, fly
from simulation.texture import TextureSpec
from simulation.thermal import ThermalSpec
from simulation.truth import Truth

Array = NDArray[np.float64]

RATE_HZ, HEIGHT_M, SPEED_M_S = 5.0, 100.0, 12.0
BOSON, LEPTON = Camera.from_field_of_view(640, 512, 50.0), Camera.from_field_of_view(160, 120, 57.0)
EACH_M, ASIDE_M = 25.0, 25.0  # a person every so many metres of way, at most so far beside it
SAME_M = 3.0  # a spot so near to a person is that person, where its ellipse is smaller
RECALL_GOAL, FALSE_GOAL, INSIDE_GOAL = 0.95, 1.0, (0.85, 0.95)


@dataclass
class Scores:
    """Of all flights of a scene. `found` by person, and by picture that shows one."""

    found: list[bool] = field(default_factory=list)
    in_picture: list[bool] = field(default_factory=list)
    inside: list[bool] = field(default_factory=list)
    off_m: list[float] = field(default_factory=list)
    area: list[float] = field(default_factory=list)  # found over true
    false_places: int = 0
    searched_km2: float = 0.0
    ms: list[float] = field(default_factory=list)


SCENES: dict[str, tuple[Camera, ThermalSpec]] = {
    "calm": (BOSON, ThermalSpec()),
    "rocks": (BOSON, ThermalSpec(rocks_km2=200.0)),
    "shutter": (BOSON, ThermalSpec(shutter_s=(15.0, 30.0, 45.0))),
    "small": (LEPTON, ThermalSpec()),
    "agc": (BOSON, ThermalSpec(output="agc")),
}


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--flights", type=int, default=1, help="of each scene")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print(f"{describe()}; {load()}\n")
    rows = []
    for scene in args.scenes.split(","):
        scores, began_s = Scores(), time.monotonic()
        for k in range(args.flights):
            measure(*SCENES[scene], args.seconds, args.seed + k, scores)
        rows.append(row(scene, scores))
        print(f"{scene}: {len(scores.found)} people, {time.monotonic() - began_s:.0f} s", flush=True)
    print()
    print(table(HEAD, rows))
    return 0


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
        scores_of(list(reports(home, scores)), spec, truth, scores)


def reports(home: Path, scores: Scores) -> Sequence[tuple[int, tuple[Spot, ...]]]:
    """Frame and spots of each picture that was looked at."""
    config = load_config(home / "config.toml")
    book, due = SpotBook("uav", config.spots, config.thermal), DuePictures(config.spots.rate_hz, 256)
    out = []
    for frame, its_set in sets_of(home, config):
        due.event(frame)
        picture = due.take(its_set)
        if picture is None:
            continue
        began_s = time.thread_time()
        report = book.picture(picture, its_set)
        scores.ms.append(1e3 * (time.thread_time() - began_s))
        if report is not None and its_set.is_ok:
            out.append((picture.index, report.spots))
    scores.searched_km2 += max(tail.searched_km2 for tail in book._detector.tails.values())
    return out


def sets_of(home: Path, config: Config) -> list[tuple[Frame, FeatureSet]]:
    """Each picture with its first set, in the order of the sets."""
    flown = Flight.open(
        config, Camera.from_json(home / "camera.json"), home / "frames", home / "telemetry.tlog", home / "stamps.csv"
    )
    pipeline = Pipeline(config, flown.camera)
    frames: dict[int, Frame] = {}
    out: dict[int, tuple[Frame, FeatureSet]] = {}
    for _, event in flown.events():
        if isinstance(event, Frame):
            frames[event.index] = event
        for made in pipeline.handle(event):
            out.setdefault(made.frame, (frames[made.frame], made))
    return list(out.values())


def scores_of(looked: Sequence[tuple[int, tuple[Spot, ...]]], spec: SessionSpec, truth: Truth, scores: Scores) -> None:
    """One flight against the truth."""
    assert spec.thermal is not None
    found: dict[int, bool] = {}
    false: list[Array] = []
    sources = spec.thermal.sources
    places = np.array([source.place_m(0.0) for source in sources])
    points = np.column_stack([places, truth.terrain.height_m(places[:, 0], places[:, 1])])
    for frame, spots in looked:
        placed = [(spot, enu(spot, truth)) for spot in spots if spot.place is not None]
        for k in np.flatnonzero(truth.sees(frame, points)):
            near = [(spot, at) for spot, at in placed if is_same(spot, at, places[k])]
            found[k] = found.get(k, False) or bool(near)
            scores.in_picture.append(bool(near))
            for spot, at in near[:1]:
                scores.inside.append(mahalanobis(spot, at - places[k]) < 1.0)
                scores.off_m.append(float(np.hypot(*(at - places[k]))))
                scores.area.append(spot.area_m2 / sources[k].area_m2(0.0))
        for spot, at in placed:
            if not any(is_same(spot, at, place) for place in places) and all(
                np.hypot(*(at - other)) > 2.0 * SAME_M for other in false
            ):
                false.append(at)
    scores.found += found.values()
    scores.false_places += len(false)


def enu(spot: Spot, truth: Truth) -> Array:
    """East and north (2,) of a spot."""
    assert spot.place is not None
    at: Array = truth.origin.to_enu(spot.place.lat_deg, spot.place.lon_deg, truth.origin.height_m)[:2]
    return at


def mahalanobis(spot: Spot, off: Array) -> float:
    """Of an error, east and north (2,), in the spot's ellipse: 1 on it."""
    assert spot.place is not None
    e, a = spot.place.ellipse, np.radians(spot.place.ellipse.azimuth_deg)
    along, across = off @ [np.sin(a), np.cos(a)], off @ [np.cos(a), -np.sin(a)]
    return float((along / e.semi_major_m) ** 2 + (across / e.semi_minor_m) ** 2)


def is_same(spot: Spot, at: Array, place: Array) -> bool:
    """Whether a spot may be what is at a place: within three of its sigmas, or very near."""
    return bool(np.hypot(*(at - place)) < SAME_M) or mahalanobis(spot, at - place) < 2.0


HEAD = ("scene", "people", "recall", "of pictures", "false / km2", "km2", "inside 90 %", "off, m", "area", "ms", "")


def row(scene: str, s: Scores) -> tuple[str, ...]:
    """One line of the table."""
    recall = float(np.mean(s.found)) if s.found else 0.0
    rate = s.false_places / max(s.searched_km2, 1e-9)
    inside = float(np.mean(s.inside)) if s.inside else float("nan")
    is_good = recall >= RECALL_GOAL and rate <= FALSE_GOAL and INSIDE_GOAL[0] <= inside <= INSIDE_GOAL[1]
    return (
        scene, f"{len(s.found)}", f"{recall:.2f}", f"{np.mean(s.in_picture or [0.0]):.2f}", f"{rate:.1f}",
        f"{s.searched_km2:.3f}", f"{inside:.2f}", f"{np.median(s.off_m or [np.nan]):.2f}",
        f"{np.median(s.area or [np.nan]):.2f}", f"{np.median(s.ms):.1f}", verdict(is_good),
    )  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main())
