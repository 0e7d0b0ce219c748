"""Pictures of which much is as bright or dark as a picture can be: what moves there unseen is not left standing."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from contract.track import TrackReport, TrackState
from onboard.tracks.backdrop import cut, difference
from onboard.tracks.ground_steps import Pictures, Seen
from tests.onboard.tracks.flat_world import PLACE, RATE_HZ, Thing, World, at
from tests.onboard.tracks.test_track_book import fly
from tests.rest_long import rest_long

GROUND, BRIGHTEST = 180, 255


def over_ellipse(thing: Thing, reports: dict[int, TrackReport]) -> float:
    """The largest error of a place over its ellipse."""
    ratios = [0.0]
    for n, report in reports.items():
        if report.place is not None:
            off = PLACE.to_enu(report.place.lat_deg, report.place.lon_deg, 100.0)[:2] - thing.place(n / RATE_HZ)
            ratios.append(float(np.hypot(*(off - [0.8, -0.5]))) / report.place.ellipse.semi_major_m)
    return max(ratios)


def crossing(speed: float, seed: int, size_m: float, grey: float) -> Thing:
    """A thing that is in the middle of the picture after 5 s."""
    course = np.random.default_rng([seed, 77]).uniform(0.0, 2.0 * math.pi)
    velocity = speed * math.sin(course), speed * math.cos(course)
    return Thing(at(-5.0 * velocity[0], -5.0 * velocity[1], velocity), size_m, grey)


@pytest.mark.parametrize(
    ("clipped", "speed", "seed", "grey"),
    rest_long([(0.6, 3.0, 1, 230.0), (-0.45, 3.0, 0, 30.0), (0.6, 1.4, 0, 150.0), (0.6, 1.4, 1, 230.0),
               (0.45, 1.4, 1, 150.0), (-0.45, 1.4, 1, 30.0)]),
)  # fmt: skip
def test_who_moves_over_clipped_ground_is_hidden_or_lost_and_never_left_standing(
    clipped: float, speed: float, seed: int, grey: float
) -> None:
    """As bright, or as dark, as half of the ground. Before (24.28) "at rest" for 5 s, up to 8 ellipses off."""
    walker = crossing(speed, seed, 0.9, grey)
    camera = at(0.0, 0.0, (0.4, 0.25)) if seed % 2 else at(0.0, 0.0)
    world = World((walker,), camera=camera, seed=seed, clipped=clipped)
    _, reported = fly(world, range(90), {1: walker}, clicked=30)
    assert over_ellipse(walker, reported[1]) < 1.5
    assert sum("at rest" in r.course_text for r in reported[1].values() if r.state is TrackState.FOLLOWED) <= 5


@pytest.mark.parametrize(("clipped", "grey"), rest_long([(0.45, 30.0), (-0.45, 230.0), (0.6, 30.0)]))
def test_what_differs_from_clipped_ground_is_followed_over_it(clipped: float, grey: float) -> None:
    walker = crossing(1.4, 0, 0.9, grey)
    _, reported = fly(World((walker,), clipped=clipped), range(70), {1: walker}, clicked=30)
    assert all(r.state is TrackState.FOLLOWED for r in reported[1].values())
    assert over_ellipse(walker, reported[1]) < 0.3


def test_a_parked_car_that_is_clipped_itself_stays_where_it_is() -> None:
    """On ground that is not: what is not known of it goes on no farther than the car."""
    car = Thing(at(1.0, 1.0), 4.0, 250.0)
    _, reported = fly(World((car,)), range(60), {1: car}, clicked=20)
    assert sum(r.state is TrackState.FOLLOWED for r in reported[1].values()) > 35
    assert "at rest" in reported[1][59].course_text


def pictures_of(*images: NDArray[np.float64]) -> tuple[Pictures, list[Seen]]:
    """A row of pictures 0.4 s apart over ground that does not move."""
    pictures = Pictures()
    seen = [Seen(k, round(0.4e9 * k), np.clip(image, 0, BRIGHTEST).astype(np.uint8)) for k, image in enumerate(images)]
    for one in seen:
        pictures.add(one)
        one.to_newest, one.is_joined = np.eye(3), True
    return pictures, seen


def test_a_clipped_pixel_shows_no_more_than_a_bound() -> None:
    """(24.28): both beyond it: nothing is known; one beyond it and the other not: they differ by that at least."""
    rng = np.random.default_rng(0)
    ground = GROUND + rng.normal(0.0, 10.0, (80, 80))
    ground[:, :40] = 300.0  # clipped
    now = ground.copy()
    now[20:30, 20:30] = 400.0  # as bright as can be, on clipped ground
    now[20:30, 50:60] = 400.0  # and on ground that is not
    now[50:60, 20:30] = GROUND  # something that is not, on clipped ground
    pictures, seen = pictures_of(*[ground + rng.normal(0.0, 1.0, ground.shape) for _ in range(5)], now)
    patch = cut(seen[-1], np.array([39.5, 39.5]), 36)
    changed = difference(pictures, seen[-1], patch, 5.0)
    rows, columns = np.mgrid[:73, :73] + patch.corner[::-1, None, None]
    is_dark = (rows >= 50) & (rows < 60) & (columns >= 20) & (columns < 30)
    is_bright = (rows >= 20) & (rows < 30) & (columns >= 50) & (columns < 60)
    assert changed.unknown[(columns < 39) & ~is_dark].all() and not changed.unknown[columns > 41].any()
    assert changed.surely[is_dark].min() == changed.surely[is_bright].min() == 1.0
    assert changed.surely[(columns < 30) & (rows < 40)].max() < 0.01
