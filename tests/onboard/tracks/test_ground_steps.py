"""The ground's own motion: found to a fraction of a pixel, kept within bounds, and never invented."""

import numpy as np
import pytest

from onboard.events.kept_pictures import KeptPictures
from onboard.geometry.plane_homography import move
from onboard.tracks.ground_steps import Pictures, Seen, step
from tests.onboard.tracks.flat_world import M_PX, Thing, World, at, stamp_ns

CORNERS = np.array([[20.0, 20.0], [300.0, 20.0], [300.0, 220.0], [20.0, 220.0]])


def seen(world: World, number: int, *, with_set: bool = True) -> Seen:
    return Seen(number, stamp_ns(number), world.image(number), world.its_set(number) if with_set else None)


@pytest.mark.parametrize("with_set", [False, True])
def test_the_step_between_two_pictures_is_the_grounds(with_set: bool) -> None:
    world = World((Thing(at(0.0, 0.0, (12.0, 0.0)), 8.0),), camera=at(0.0, 0.0, (9.0, -6.0)))
    found = step(seen(world, 0, with_set=with_set), seen(world, 1, with_set=with_set))
    assert found is not None
    moved = move(found, CORNERS) - CORNERS
    expected = np.array([-0.9, -0.6]) / M_PX
    assert np.abs(moved - expected).max() < 0.15 and np.abs(expected).min() > 2.0


def test_steps_add_up_between_any_two_pictures() -> None:
    world, pictures = World(camera=at(0.0, 0.0, (5.0, 3.0))), Pictures()
    for number in range(12):
        pictures.add(seen(world, number))
    pictures.join()
    kept = list(pictures)
    H = pictures.between(kept[2], kept[10])
    back = pictures.between(kept[10], kept[2])
    assert H is not None and back is not None
    assert np.abs(move(H, CORNERS) - CORNERS - np.array([-4.0, 2.4]) / M_PX).max() < 0.3
    assert np.abs(move(back, move(H, CORNERS)) - CORNERS).max() < 1e-6


def test_where_nothing_can_be_followed_the_poses_say_how_the_ground_moved() -> None:
    world = World(camera=at(0.0, 0.0, (10.0, 0.0)))
    one, two = seen(world, 0), seen(world, 1)
    two.image[:] = 128
    found = step(one, two)
    assert found is not None and np.abs(move(found, CORNERS) - CORNERS - [-1.0 / M_PX, 0.0]).max() < 0.1
    one.its_set = None
    assert step(one, two) is None


def test_a_missing_step_breaks_the_row_and_what_comes_after_it_is_whole_again() -> None:
    world, pictures = World(camera=at(0.0, 0.0, (5.0, 0.0))), Pictures()
    for number in range(6):
        picture = seen(world, number, with_set=False)
        if number == 3:
            picture.image[:] = 128
        pictures.add(picture)
    pictures.join()
    kept = list(pictures)
    assert pictures.between(kept[0], kept[2]) is None or pictures.between(kept[0], kept[5]) is None
    assert pictures.between(kept[2], kept[4]) is None
    assert pictures.between(kept[4], kept[5]) is not None


def test_pictures_are_kept_within_their_bytes_and_their_seconds() -> None:
    world = World()
    by_bytes, by_time = Pictures(KeptPictures(10 * 320 * 240)), Pictures(kept_ns=1_500_000_000)
    for number in range(40):
        for pictures in (by_bytes, by_time):
            pictures.add(seen(world, number))
    assert [picture.frame for picture in by_bytes] == list(range(30, 40))
    assert [picture.frame for picture in by_time] == list(range(24, 40))
    by_time.add(seen(world, 3))  # the camera began again
    assert [picture.frame for picture in by_time] == [3]
