"""Are the ellipses of hot spots, of what they are merged into, and of tracks right? Flights of declared errors.

    python -m benchmarks.found_coverage [--flights 40] [--seed 0] [--rows TEXT]

A flight shares its slow errors, so one tells nothing however long it is: these are many short ones, each with every
error sampled as the configuration declares it (`sampled_flight`: GPS, attitude, heading, mount, stamps, ground). What a
tracker sees of the ground is sampled as in `benchmarks.coverage`; the pictures in which spots and things are looked for
are rendered for the true poses and go through the whole of `onboard.spots` and `onboard.tracks`, their reports over the
wire, spots through `ground.spots`. Some cars go evenly; how much others speed up, brake and turn is sampled as the
trackers take it of things of which no more is known (24.19). What is found is told by its pixel, never by its place.
Printed: the share of true errors inside the 90 % ellipse (of tracks' speeds and courses inside 1.645 sigmas) with one
sigma of it from the dispersion between flights (goal 85 to 96 %), and the mean squared error over the claimed
covariance, 1 if honest.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial

from benchmarks.machine import describe, load, table, verdict

# isort: split
import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.autopilots import STARTS, ReplayedFlight, ReplayedTracker, Scene
from benchmarks.sampled_flight import SampledFlight, SampledSpec, SampledTracker
from benchmarks.scatter import mean_and_sigma
from benchmarks.short_flight import with_first_sets
from benchmarks.tracks import turned_deg
from contract.answer import CHI2_2, Place
from contract.camera import Camera
from contract.feature_set import FeatureSet
from contract.geodesy import LocalFrame
from contract.track import Course, TrackState
from contract.track_age import ACCELERATION_M_S2, TURN_RAD_S
from contract.wire.spot_code import decode_spots, encode_spots
from contract.wire.track_code import decode_track, encode_track
from ground.spots.merging import SpotMerger
from onboard.config.schema import parse_config
from onboard.events.types import Frame
from onboard.pipeline.pipeline import Pipeline
from onboard.spots.due_pictures import DuePictures
from onboard.spots.spot_book import SpotBook
from onboard.tracks.track_book import TrackBook
from simulation.movers import Manoeuvre, MoverSpec
from simulation.paths import PathSpec

Array = NDArray[np.float64]
Flight = SampledFlight | ReplayedFlight

GOAL = 0.85, 0.96
CHI2_1 = 1.6449**2  # quantile of chi-square with one degree of freedom at 90 %
SAME_PX = 4.0  # of a spot or a track from where the thing truly is
WARM_S = 6.0  # until the window is filled

GROUND_K, NOISE_K, CLUTTER = 290.0, 0.05, ((1.5, 0.3), (12.0, 0.8))  # clutter: px, K
PERSON_M, PERSON_K, LENS_PX = 0.5, 8.0, 0.6
PEOPLE, APART_M = 8, 8.0

RECORDED = "copter_survey", "plane_clean", "plane_breeze", "plane_log"
RECORDED_FROM_S, RECORDED_S, RECORDED_FOV_DEG = 60.0, 24.0, 30.0  # a person is a pixel and a half from 250 m

TEXEL_M, FIELD_M = 0.25, 640.0
CAR_SHADE, CAR_M = 235, (4.0, 1.8)
EACH_S = 0.5  # a track's place is asked for
MANNER_S = 5.0  # in the mean, in which a car that does not go evenly brakes and turns as it does


@dataclass
class Found:
    """The squared errors of one flight over their covariances: of every spot, of every thing, of tracks: of places, and
    of the speed and the course of what is under way.
    """

    spots: list[float] = field(default_factory=list)
    things: list[float] = field(default_factory=list)
    tracks: list[float] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    courses: list[float] = field(default_factory=list)
    people: int = 0
    parts: int = 0  # things that people have become: more than people where one fell apart


def rows() -> dict[str, SampledSpec]:
    """Flights of spots by name."""
    config = parse_config("[thermal]\nenabled = true\nscale = 0.01\n")
    camera = Camera.from_field_of_view(320, 256, 50.0)
    path = PathSpec(height_m=100.0, speed_m_s=12.0)
    nadir = SampledSpec(config, path=path, seconds=14.0, rate_hz=2.0, relief_sigma_m=2.0, camera=camera)
    tilted = config.model_copy(update={"mount": config.mount.model_copy(update={"pitch_deg": -60.0})})
    alone = config.model_copy(update={"solve": config.solve.model_copy(update={"attitude": "none"})})
    turns = replace(path, kind="turns", leg_m=60.0)
    return {
        "straight down": nadir,
        "30 degrees ahead": replace(nadir, config=tilted),
        "turns, twice over the same": replace(nadir, path=turns, seconds=30.0),
        "without attitude": replace(nadir, config=alone),
    }


def track_spec() -> SampledSpec:
    """A flight above traffic, over ground that is a plane."""
    camera = Camera.from_field_of_view(320, 240, 40.0)
    path = PathSpec(height_m=120.0, speed_m_s=12.0)
    return SampledSpec(parse_config(""), path=path, seconds=16.0, rate_hz=10.0, relief_sigma_m=0.0, camera=camera)


def recorded_flight(seed: int) -> ReplayedFlight:
    """A stretch of a recorded autopilot's flight, with what its simulator lacks sampled as it is declared.

    A receiver's correlated error is added (`benchmarks.autopilots`); the camera sits and stamps as the configuration's
    sigmas allow: a camera mounted and timed without any error shows nothing of how wide an ellipse must be.
    """
    rng = np.random.default_rng([seed, 950])
    config = parse_config("[thermal]\nenabled = true\nscale = 0.01\n")
    name = RECORDED[seed % len(RECORDED)]
    scene = Scene(
        name, config, STARTS[name] + float(rng.uniform(0.0, RECORDED_FROM_S)), RECORDED_S,
        mount_error_deg=tuple(config.mount.sigma_deg * rng.standard_normal(3)),
        stamps_late_s=float(config.camera.sigma_latency_s * rng.standard_normal()),
        camera=Camera.from_field_of_view(320, 256, RECORDED_FOV_DEG),
    )  # fmt: skip
    return ReplayedFlight(scene, seed)


def sets_in_flight(flight: Flight) -> Iterator[tuple[Frame, FeatureSet]]:
    """Each picture with its first set, as it is sent in flight."""
    pipeline = Pipeline(flight.spec.config, flight.spec.camera)
    pipeline.tracker = ReplayedTracker(flight) if isinstance(flight, ReplayedFlight) else SampledTracker(flight)
    return with_first_sets(flight.events(), pipeline)


def find_spots(flight: Flight, seed: int) -> Found:
    """One flight over people."""
    config, found = flight.spec.config, Found()
    people = people_below(flight, seed)
    book, merger = SpotBook("uav", config.spots, config.thermal), SpotMerger()
    due = DuePictures(config.spots.rate_hz, 256)
    whose: dict[int, int] = {}
    for frame, its_set in sets_in_flight(flight):
        if flight.times_s[frame.index] < WARM_S:
            continue
        due.event(replace(frame, counts=heat_picture(flight, seed, frame.index, people)))
        picture = due.take(its_set)
        said = None if picture is None else book.picture(picture, its_set)
        if said is None:
            continue
        report = decode_spots(encode_spots(said), "uav")
        uv, seen = flight.pixels(frame.index, people)
        for spot in report.spots:
            k = nearest(uv, seen, spot.u_px, spot.v_px)
            if k is not None and spot.place is not None and not spot.is_cut:
                found.spots.append(chi2_of(flight.place, spot.place, people[k, :2]))
        for thing in merger.add(report):
            k = nearest(uv, seen, thing.newest.u_px, thing.newest.v_px)
            if k is not None:
                whose[thing.number] = k
    things = [thing for thing in merger.things() if thing.number in whose and thing.is_sure]
    found.things = [chi2_of(flight.place, thing.place, people[whose[thing.number], :2]) for thing in things]
    found.people, found.parts = len({whose[thing.number] for thing in things}), len(things)
    return found


def people_below(flight: Flight, seed: int) -> Array:
    """Places (N, 3) on the ground that the pictures show, somewhat apart from each other."""
    rng = np.random.default_rng([seed, 920])
    size = np.array(flight.spec.camera.size_px)
    pictures = np.flatnonzero(flight.times_s > WARM_S)
    kept: list[Array] = []
    for _ in range(20 * PEOPLE):
        uv = rng.uniform(0.1, 0.9, (1, 2)) * size
        point = flight.ground_points(int(rng.choice(pictures)), uv)[0]
        if np.isfinite(point).all() and all(np.hypot(*(point - other)[:2]) > APART_M for other in kept):
            kept.append(point)
        if len(kept) == PEOPLE:
            break
    return np.array(kept)


def heat_picture(flight: Flight, seed: int, frame: int, people: Array) -> NDArray[np.uint16]:
    """Counts (H, W) of a picture: varied ground, noise, and people where they truly are, through the lens."""
    rng = np.random.default_rng([seed, 921, frame])
    width, height = flight.spec.camera.size_px
    kelvin = GROUND_K + NOISE_K * rng.standard_normal((height, width))
    for blur_px, sigma_k in CLUTTER:
        waves = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), blur_px)
        kelvin += sigma_k * waves / waves.std()
    v, u = np.mgrid[:height, :width].astype(float)
    uv, seen = flight.pixels(frame, people)
    for (u0, v0), point in zip(uv[seen], people[seen], strict=True):
        metres = np.linalg.norm(point - flight.centres_enu_m[frame]) / flight.spec.camera.fx_px
        side_px = PERSON_M / metres
        blur2 = LENS_PX**2 + side_px**2 / 16.0  # of a disc: a sixteenth of its diameter squared
        heat_k = PERSON_K * side_px**2 / (8.0 * blur2)
        kelvin += heat_k * np.exp(-((u - u0) ** 2 + (v - v0) ** 2) / (2.0 * blur2))
    scale = flight.spec.config.thermal.calibration
    assert scale is not None
    return scale.counts(kelvin)


def find_tracks(spec: SampledSpec, seed: int, *, is_even: bool = True) -> Found:
    """One flight above traffic, which goes evenly or does not: every car clicked once, a pixel next to its middle."""
    flight, found = SampledFlight(spec, seed), Found()
    cars = traffic(flight, is_even=is_even)
    scene, rng = Plane(flight, cars), np.random.default_rng([seed, 930])
    book, begun = TrackBook("uav"), dict[int, MoverSpec]()
    clicked = round(WARM_S * spec.rate_hz)
    for frame, its_set in sets_in_flight(flight):
        book.picture(replace(frame, image=scene.picture(frame.index)), its_set)
        t = float(flight.times_s[frame.index])
        if frame.index >= clicked and not begun:
            uv, seen = flight.pixels(clicked, np.array([scene.point(car, flight.times_s[clicked]) for car in cars]))
            at = uv + rng.normal(0.0, 1.0, uv.shape)
            number = 0
            for car, (u, v), is_seen in zip(cars, at, seen, strict=True):
                if is_seen and book.start(number + 1, (float(u), float(v)), clicked):
                    number += 1
                    begun[number] = car
        if frame.index % round(EACH_S * spec.rate_hz):
            continue
        for report in (decode_track(encode_track(one), "uav") for one in book.reports()):
            car = begun[report.number]
            where = scene.point(car, t)
            uv, seen = flight.pixels(frame.index, where[None])
            is_it = nearest(uv, seen, report.u_px, report.v_px) is not None
            if report.frame == frame.index and report.state is TrackState.FOLLOWED and report.place and is_it:
                found.tracks.append(chi2_of(flight.place, report.place, where[:2]))
                take_motion(report.course, car.velocity_m_s(t), found)
    return found


def take_motion(course: Course | None, true_m_s: Array, found: Found) -> None:
    """Add the errors of speed and course of a thing whose velocity (2,) is known to `found`, unless it is at rest."""
    speed_m_s = float(np.hypot(*true_m_s))
    if course is None or course.course_deg is None or course.sigma_course_deg is None or speed_m_s == 0.0:
        return
    off_deg = turned_deg(course.course_deg, float(np.degrees(np.arctan2(*true_m_s))))
    found.speeds.append(((course.speed_m_s - speed_m_s) / course.sigma_speed_m_s) ** 2)
    found.courses.append((off_deg / course.sigma_course_deg) ** 2)


def traffic(flight: SampledFlight, *, is_even: bool = True) -> list[MoverSpec]:
    """Six cars on their ways below the aircraft when they are clicked, one of them parked."""
    rng = np.random.default_rng([flight.seed, 931])
    size = np.array(flight.spec.camera.size_px)
    k = round(WARM_S * flight.spec.rate_hz)
    t, heading = float(flight.times_s[k]), flight.spec.path.heading_deg
    out: list[MoverSpec] = []
    lanes = np.linspace(0.15, 0.85, 6) + rng.uniform(-0.02, 0.02, 6)
    for lane, speed in zip(rng.permutation(lanes), (12.0, 12.5, 11.0, 9.0, 3.0, 0.0), strict=True):
        place = flight.ground_points(k, (np.array([lane, rng.uniform(0.3, 0.7)]) * size)[None])[0, :2]
        manners = () if is_even or speed == 0.0 else manners_of(np.random.default_rng([flight.seed, 934, len(out)]), t)
        car = MoverSpec((0.0, 0.0), speed, heading, *CAR_M, manoeuvres=manners)
        east, north = place - car.place_m(t)
        out.append(replace(car, start_m=(float(east), float(north))))
    return out


def manners_of(rng: np.random.Generator, from_s: float) -> tuple[Manoeuvre, ...]:
    """Return a car's speeding up, braking and turning from a time on, one manner after another, for a minute."""
    ends = from_s + np.concatenate([[0.0], np.cumsum(rng.exponential(MANNER_S, 12))])
    gained, turned = rng.normal(0.0, [[ACCELERATION_M_S2], [np.degrees(TURN_RAD_S)]], (2, 12))
    return tuple(map(Manoeuvre, *(values.tolist() for values in (ends[:-1], ends[1:], gained, turned))))


class Plane:
    """Ground that is a plane with a pattern on it, and cars: a picture of it is one homography."""

    def __init__(self, flight: SampledFlight, cars: list[MoverSpec]) -> None:
        self._flight, self._cars = flight, cars
        rng = np.random.default_rng([flight.seed, 932])
        texels = round(FIELD_M / TEXEL_M)
        pattern = np.zeros((texels, texels), np.float32)
        for blur in (1.0, 3.0, 10.0):
            waves = cv2.GaussianBlur(rng.standard_normal((texels, texels)).astype(np.float32), (0, 0), blur)
            pattern += 18.0 * waves / waves.std()
        self._ground = np.clip(pattern + 110.0, 0, 255).astype(np.uint8)
        middle = flight.centres_enu_m[len(flight.times_s) // 2, :2]
        self._west, self._south = middle - 0.5 * FIELD_M

    def point(self, car: MoverSpec, time_s: float) -> Array:
        """The place of a car (3,)."""
        place = car.place_m(time_s)
        return np.array([*place, float(self._flight.ground.height_m(place))])

    def picture(self, frame: int) -> NDArray[np.uint8]:
        """(H, W), with noise."""
        flight, t = self._flight, float(self._flight.times_s[frame])
        to_picture = self._texel_to_pixel(frame)
        size = flight.spec.camera.size_px
        out = cv2.warpPerspective(self._ground, to_picture, size, flags=cv2.INTER_AREA)
        for car in self._cars:
            a = float(car.course_rad(t))
            ways = np.array([[np.sin(a), np.cos(a)], [np.cos(a), -np.sin(a)]]) * (0.5 * np.array(CAR_M))[:, None]
            corners = car.place_m(t) + np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) @ ways
            points = np.column_stack([corners, flight.ground.height_m(corners)])
            uv, seen = flight.pixels(frame, points)
            if seen.any():
                fine = np.round(uv * 16.0).astype(np.int32)
                cv2.fillConvexPoly(out, fine, CAR_SHADE, cv2.LINE_AA, 4)
        noise = np.random.default_rng([flight.seed, 933, frame]).normal(0.0, 1.5, out.shape)
        noisy = cv2.GaussianBlur(out, (0, 0), LENS_PX) + noise
        return np.asarray(np.clip(noisy, 0, 255), np.uint8)

    def _texel_to_pixel(self, frame: int) -> Array:
        """(3, 3)."""
        slope, camera = self._flight.ground.slope, self._flight.spec.camera
        # Texel (i, j) -> east, north, up, 1.
        on_plane = np.array([[TEXEL_M, 0.0, self._west], [0.0, TEXEL_M, self._south], [0.0, 0.0, 1.0]])
        lifted = np.vstack([on_plane[:2], slope @ on_plane[:2]])
        lifted[:, 2] -= self._flight.centres_enu_m[frame]
        K = np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])
        return np.asarray(K @ self._flight.R_enu_cam[frame].T @ lifted, float)


def nearest(uv: Array, seen: NDArray[np.bool_], u_px: float, v_px: float) -> int | None:
    """The index of the point, of those at pixels (N, 2), that is at a pixel; None if none is."""
    off = np.where(seen, np.hypot(*(uv - (u_px, v_px)).T), np.inf)
    k = int(np.argmin(off))
    return k if off[k] < SAME_PX else None


def chi2_of(frame: LocalFrame, place: Place, true_m: Array) -> float:
    """The squared error of a place, east and north, over its covariance; where it truly is (2,)."""
    assert place.height_amsl_m is not None
    away = frame.to_enu(place.lat_deg, place.lon_deg, place.height_amsl_m)[:2] - true_m
    return float(away @ np.linalg.solve(place.ellipse.covariance_en_m2, away))


def share_inside(per_flight: list[list[float]], size: int = 2) -> tuple[float, float, float]:
    """Pool flights' squared errors of `size` components: the share inside, one sigma of it by the flights' dispersion,
    mean over the size.
    """
    simulated = [np.array(each) for each in per_flight if each]
    share, sigma = mean_and_sigma([float(np.mean(each < (CHI2_1, CHI2_2)[size - 1])) for each in simulated])
    return share, sigma, float(np.mean([np.mean(each) for each in simulated])) / size


def row(name: str, what: str, per_flight: list[list[float]], size: int = 2) -> tuple[str, ...]:
    """One line of the table."""
    share, sigma, mean = share_inside(per_flight, size)
    count = sum(map(len, per_flight))
    is_right = GOAL[0] <= share <= GOAL[1]
    return name, what, f"{count}", f"{share:.1%} +- {sigma:.1%}", f"{mean:.2f}", verdict(is_right)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=40, help="of each row")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rows", default="", help="only those whose names hold this; `tracks` is one")
    args = parser.parse_args()
    print(f"{describe()}; {load()}; {args.flights} flights a row, seed {args.seed}\n")
    cv2.setNumThreads(1)
    seeds, out = range(args.seed, args.seed + args.flights), []
    flights: dict[str, Callable[[int], Flight]] = {n: partial(SampledFlight, spec) for n, spec in rows().items()}
    for name, flight_of in {**flights, "recorded autopilots": recorded_flight}.items():
        if args.rows in name:
            began_s = time.monotonic()
            simulated = [find_spots(flight_of(seed), seed) for seed in seeds]
            out.append(row(name, "spots", [f.spots for f in simulated]))
            out.append(row(name, "merged", [f.things for f in simulated]))
            people, parts = sum(f.people for f in simulated), sum(f.parts for f in simulated)
            print(f"{name}: {people} people as {parts} things, {time.monotonic() - began_s:.0f} s", flush=True)
    if args.rows in "tracks":
        began_s = time.monotonic()
        for name, is_even in (("cars that go evenly", True), ("cars that brake and turn", False)):
            tracked = [find_tracks(track_spec(), seed, is_even=is_even) for seed in seeds]
            out.append(row(name, "tracks", [f.tracks for f in tracked]))
            out.append(row(name, "speeds", [f.speeds for f in tracked], 1))
            out.append(row(name, "courses", [f.courses for f in tracked], 1))
        print(f"tracks: {time.monotonic() - began_s:.0f} s", flush=True)
    print("\n" + table(("flights", "of", "reports", "inside 90 %", "squared over claimed", ""), out))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
