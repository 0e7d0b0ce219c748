"""Things that brake, turn and stop, clicked and followed, on simulated flights 120 m up with truth.

    python -m benchmarks.manoeuvres [--scenes hover,orbit] [--flights 3] [--seed 0]

As benchmarks.tracks; the things of a flight do not meet: cars of 4 m that circle 10 m wide at 5 m/s, take a bend and a
corner, brake from 10 m/s to a stop at 4 m/s2, slow down for a corner and go on; a bicycle in bends; people who turn at
a corner and who stop and go on. Each is clicked twice, 1 s late. All reports count in which the thing is in the
picture: lost, off by more than 0.6 of its length (8 px at least), beyond three of its ellipses; from 3 s on the errors
of speed and course of those that move.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from dataclasses import dataclass, field, replace
from pathlib import Path

from benchmarks.machine import describe, load, table, verdict
from benchmarks.short_flight import first_sets

# isort: split
import numpy as np
from numpy.typing import NDArray

from benchmarks import tracks
from benchmarks.tracks import COURSE_GOAL_DEG, RATE_HZ, SPEED_GOAL_M_S, Thing, ground_of, place_from
from contract.track import TrackReport, TrackState
from onboard.config.schema import load_config
from onboard.tracks.track_book import TrackBook
from simulation.movers import Manoeuvre, MoverSpec
from simulation.session import fly
from simulation.truth import Truth

Array = NDArray[np.float64]

CLICKED, LATE = (30, 55), 10  # pictures: when is clicked, and how much later each track begins
SETTLED = 30  # pictures after the click, from which speed and course count
UNDER_WAY_M_S = 0.5
EDGE_PX = 8.0
CAR_M, BICYCLE_M, PERSON_M = (4.0, 1.8), (1.8, 0.6), (0.5, 0.5)


@dataclass
class Score:
    """The reports of one kind of thing, a number each."""

    lost: list[bool] = field(default_factory=list)
    off: list[bool] = field(default_factory=list)
    ratio: list[float] = field(default_factory=list)  # errors over the 90 % ellipse
    speed: list[float] = field(default_factory=list)
    course: list[float] = field(default_factory=list)
    sigmas: list[float] = field(default_factory=list)  # of the course's error


@dataclass(frozen=True)
class Way:
    """A thing's motion, seen from the place (ahead, right, m) at which it is at a time (s)."""

    name: str
    size_m: tuple[float, float]
    speed_m_s: float
    course_deg: float
    manoeuvres: tuple[Manoeuvre, ...]
    at_s: float
    ahead_m: float
    right_m: float


def turn(from_s: float, until_s: float, deg_s: float) -> Manoeuvre:
    return Manoeuvre(from_s, until_s, turn_deg_s=deg_s)


S_CURVES = tuple(turn(4.0 + 2.0 * k, 6.0 + 2.0 * k, 35.0 * (-1) ** k) for k in range(4))
SLOWER = Manoeuvre(5.0, 6.5, -2.0), turn(6.5, 8.5, -45.0), Manoeuvre(8.5, 11.0, 2.0)
CORNERS = turn(6.0, 6.7, 128.6), turn(10.0, 10.7, -128.6)
WAYS: tuple[tuple[Way, ...], ...] = (
    (
        Way("circles", CAR_M, 5.0, 0.0, (turn(-60.0, 60.0, 28.65),), 0.0, 0.0, -10.0),
        Way("brakes", CAR_M, 10.0, 270.0, (Manoeuvre(6.0, 9.0, -4.0),), 8.5, -2.0, -20.0),
        Way("walker at a corner", PERSON_M, 1.4, 30.0, CORNERS, 7.0, 10.0, 16.0),
    ),
    (
        Way("corner", CAR_M, 5.0, 180.0, (turn(6.0, 8.0, 45.0),), 7.0, -8.0, 14.0),
        Way("slows for a corner", CAR_M, 6.0, 0.0, SLOWER, 7.5, -16.0, -16.0),
        Way("walker who stops", PERSON_M, 1.5, 200.0,
            (Manoeuvre(6.0, 6.5, -3.0), Manoeuvre(9.0, 9.5, 3.0)), 7.5, -12.0, 4.0),
    ),
    (
        Way("bend", CAR_M, 5.0, 90.0, (turn(6.0, 12.0, -28.65),), 6.0, 14.0, 0.0),
        Way("bicycle", BICYCLE_M, 5.0, 120.0, S_CURVES, 7.0, 16.0, -16.0),
    ),
)  # fmt: skip


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default="hover,orbit", help="of those of benchmarks.tracks")
    parser.add_argument("--flights", type=int, default=3, help="of each scene and each group of things")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print(f"{describe()}; {load()}\n")
    scores: defaultdict[str, Score] = defaultdict(Score)
    for scene in args.scenes.split(","):
        for seed in range(args.seed, args.seed + args.flights):
            for group in range(len(WAYS)):
                measure(scene, group, seed, scores)
    show(scores)
    return 0


def measure(scene: str, group: int, seed: int, scores: defaultdict[str, Score]) -> None:
    """Render one flight over one group of things, click on each of them, and compare all reports with the truth."""
    spec, _, config_of = tracks.SCENES[scene](seed)
    centre = tracks.centre_of(spec, (8.0,) if scene == "hover" else np.arange(0.0, 11.5, 0.5))
    things = [placed(way, centre, 47.0 * seed, number) for number, way in enumerate(WAYS[group])]
    shown = replace(spec, movers=tuple(thing.mover for thing in things))
    with tempfile.TemporaryDirectory() as folder:
        flight = Path(folder) / "flight"
        truth = fly(shown, flight)
        pictures = list(first_sets(flight, config_of(load_config(flight / "config.toml"))))
        for clicked in CLICKED:
            rng, begun = np.random.default_rng([seed, clicked]), dict[int, Thing]()
            book = TrackBook("uav")
            for frame, its_set in pictures:
                book.picture(frame, its_set)
                if frame.index == clicked + LATE:
                    begun = tracks.click(book, things, truth, clicked, rng)
                for report in book.reports():
                    thing = begun[report.number]
                    compare(thing, report, truth, clicked, scores[thing.name])


def placed(way: Way, centre: Array, course_deg: float, seed: int) -> Thing:
    """Return the thing on its way about a place, all turned by a course."""
    length, width = way.size_m
    mover = MoverSpec((0.0, 0.0), way.speed_m_s, way.course_deg + course_deg, length, width, seed=seed,
                      manoeuvres=way.manoeuvres)  # fmt: skip
    start = np.array(place_from(centre, course_deg, way.ahead_m, way.right_m)) - mover.place_m(way.at_s)
    return Thing(way.name, replace(mover, start_m=(float(start[0]), float(start[1]))))


def compare(thing: Thing, report: TrackReport, truth: Truth, clicked: int, score: Score) -> None:
    """One report against the truth."""
    frame = report.frame
    uv, seen = truth.project(frame, ground_of(thing, truth, frame)[None])
    if not seen[0] or not (uv[0] > EDGE_PX).all() or not (uv[0] < (640.0 - EDGE_PX, 480.0 - EDGE_PX)).all():
        return
    score.lost.append(report.state is TrackState.LOST)
    if report.state is TrackState.LOST:
        return
    off_px = float(np.hypot(*(uv[0] - (report.u_px, report.v_px))))
    is_off = off_px > tracks.most_off_px(thing.mover)
    score.off.append(is_off)
    if report.place is not None:
        origin = truth.origin
        place = origin.to_enu(report.place.lat_deg, report.place.lon_deg, origin.height_m)[:2]
        score.ratio.append(tracks.over_ellipse(report.place.ellipse, place - thing.mover.place_m(frame / RATE_HZ)))
    true = thing.mover.velocity_m_s(frame / RATE_HZ)
    speed, c = float(np.hypot(*true)), report.course
    if c is None or frame - clicked < SETTLED or is_off:
        return
    score.speed.append(abs(c.speed_m_s - speed))
    if c.course_deg is not None and c.sigma_course_deg is not None and speed > UNDER_WAY_M_S:
        error = tracks.turned_deg(c.course_deg, float(np.degrees(np.arctan2(true[0], true[1]))))
        score.course.append(abs(error))
        score.sigmas.append(abs(error) / c.sigma_course_deg)


def show(scores: dict[str, Score]) -> None:
    """The table by thing, and all of them against the goals."""
    whole = Score()
    for score in scores.values():
        for name, values in vars(score).items():
            getattr(whole, name).extend(values)
    rows = [row(name, score) for name, score in [*scores.items(), ("all", whole)]]
    heads = "", "reports", "lost", "off", "> 3 ellipses", "speed 90 %", "course 90 %", "in its sigmas"
    print("\n" + table(heads, rows))
    speed, course = float(np.quantile(whole.speed, 0.9)), float(np.quantile(whole.course, 0.9))
    beyond = float(np.mean(np.array(whole.ratio) > 3.0))
    print(f"\nbeyond three ellipses {beyond:.2%} (goal 0): {verdict(beyond == 0.0)}")
    print(f"speed {speed:.2f} m/s (goal {SPEED_GOAL_M_S}): {verdict(speed <= SPEED_GOAL_M_S)}")
    print(f"course {course:.1f} deg (goal {COURSE_GOAL_DEG:g}): {verdict(course <= COURSE_GOAL_DEG)}")


def row(name: str, score: Score) -> tuple[str, ...]:
    """One thing's line."""
    quantile = [float(np.quantile(v, 0.9)) if v else float("nan") for v in (score.speed, score.course, score.sigmas)]
    beyond = float(np.mean(np.array(score.ratio) > 3.0)) if score.ratio else 0.0
    off = float(np.mean(score.off)) if score.off else 0.0
    return (name, f"{len(score.lost)}", f"{np.mean(score.lost):.1%}", f"{off:.1%}", f"{beyond:.2%}",
            f"{quantile[0]:.2f} m/s", f"{quantile[1]:.1f} deg", f"{quantile[2]:.2f}")  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main())
