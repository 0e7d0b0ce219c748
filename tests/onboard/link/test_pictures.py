"""Keyframes as pictures over the link: the daemon's sink, real zenoh sessions on loopback, the ground's cache."""

import dataclasses
import threading
import time

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from contract.feature_set import FeatureSet, Status
from contract.picture import ImageFormat, LinkPicture
from contract.topics import ANY_VEHICLE, PICTURE
from ground.client import SetCache
from ground.link_pictures import PictureCache
from onboard.config.schema import PictureConfig
from onboard.events.types import Frame
from onboard.link.picture_sender import HELD_FRAMES, PictureSender, small_image
from onboard.link.publisher import Publisher, Rate
from tests.contract.sets import plain_set
from tests.onboard.link.ports import free_endpoint
from tests.onboard.link.thin import ThinLink
from tests.waiting import eventually

BASE = plain_set(60)
START_NS = 1_700_000_000_000_000_000
SECTION = PictureConfig(enabled=True, rate_hz=5.0, max_px=240)


def an_image(number: int, width: int = 320, height: int = 240) -> NDArray[np.uint8]:
    """Another for each number, smooth enough that a compressed one can be distinguished from its neighbours'."""
    rows, columns = np.mgrid[:height, :width] / width
    wave = np.sin((9.0 + number) * columns + number) + np.cos((7.0 + 0.5 * number) * rows)
    return (127.5 + 60.0 * wave).astype(np.uint8)


def a_frame(number: int) -> Frame:
    return Frame(START_NS + number * 10**8, number, an_image(number))


def a_set(number: int, is_keyframe: bool = True, revision: int = 0) -> FeatureSet:
    return dataclasses.replace(
        BASE, frame=number, capture_unix_ns=START_NS + number * 10**8, is_keyframe=is_keyframe, revision=revision
    )


class Taken:
    """A link that takes pictures, one at a time when it is said to."""

    def __init__(self, room: int = 1250) -> None:
        self.room, self.pictures, self.threads = room, list[LinkPicture](), set[str]()

    def picture_room(self) -> int:
        return self.room

    def send_picture(self, picture: LinkPicture, piece_bytes: int) -> None:
        assert piece_bytes == self.room
        self.threads.add(threading.current_thread().name)
        self.pictures.append(picture)


def fly(sender: PictureSender, numbers: range, keyframe_every: int = 5, delay: int = 2) -> None:
    for number in numbers:
        sender.event(0, a_frame(number))
        if number >= delay:
            sender.feature_set(a_set(number - delay, is_keyframe=(number - delay) % keyframe_every == 0))


def test_only_keyframes_go_each_once_with_their_own_image_made_in_another_thread() -> None:
    link = Taken()
    with PictureSender(SECTION, link) as sender:
        for keyframe in range(0, 20, 5):
            fly(sender, range(keyframe, keyframe + 5), delay=0)
            sender.feature_set(a_set(keyframe, revision=1))
            assert eventually(lambda: len(link.pictures) == keyframe // 5 + 1)  # noqa: B023
    assert [p.frame for p in link.pictures] == [0, 5, 10, 15] and link.threads == {"pictures"}
    for p in link.pictures:
        assert (p.vehicle, p.session) == (BASE.vehicle, BASE.session)
        assert p.capture_unix_ns == START_NS + p.frame * 10**8
        assert (p.width_px, p.height_px, p.format) == (240, 180, ImageFormat.WEBP)
        got = cv2.imdecode(np.frombuffer(p.content, np.uint8), cv2.IMREAD_GRAYSCALE).astype(float)
        errors = {
            n: np.mean((got - cv2.resize(an_image(n), (240, 180), interpolation=cv2.INTER_AREA)) ** 2) ** 0.5
            for n in range(20)
        }
        assert min(errors, key=errors.__getitem__) == p.frame and errors[p.frame] < 4.0


def test_without_room_nothing_is_made_and_then_the_newest_keyframe_goes() -> None:
    link = Taken(room=0)
    with PictureSender(SECTION, link) as sender:
        fly(sender, range(52))
        assert sender.made == 0 and not link.pictures
        link.room = 1250
        assert eventually(lambda: bool(link.pictures))
    assert [p.frame for p in link.pictures] == [45]


def test_what_waits_for_its_set_is_bounded_and_a_picture_whose_set_comes_too_late_does_not_go() -> None:
    sender = PictureSender(SECTION, Taken())
    image = an_image(0, 640, 480)
    for number in range(200):
        sender.event(0, Frame(START_NS, number, image))
    assert sender._held_bytes == sum(f.image.nbytes for f in sender._held if f.image is not None) <= 32_000_000
    sender.feature_set(a_set(3))
    assert sender._next is None
    sender.feature_set(a_set(199))
    assert sender._next is not None and len(sender._held) == 1
    large = np.zeros((5000, 8000), np.uint8)
    for number in range(300, 310):
        sender.event(0, Frame(START_NS, number, large))
    assert len(sender._held) == HELD_FRAMES


def test_refusals_repeats_and_pictures_without_image_are_no_reason_to_send() -> None:
    sender = PictureSender(SECTION, Taken())
    sender.event(0, Frame(START_NS, 0, None))
    sender.event(0, a_frame(1))
    sender.feature_set(a_set(0))
    sender.feature_set(FeatureSet(BASE.vehicle, BASE.session, 1, START_NS, Status.TURNING, BASE.camera))
    assert sender._next is None


@pytest.mark.parametrize("kind", ["webp", "jpeg"])
@pytest.mark.parametrize(("size", "max_px", "expected"), [((640, 480), 320, (320, 240)), ((64, 48), 320, (64, 48))])
def test_images_are_made_smaller_never_larger(
    kind: str, size: tuple[int, int], max_px: int, expected: tuple[int, int]
) -> None:
    content, width, height = small_image(an_image(1, *size), PictureConfig(format=kind, max_px=max_px))
    assert (width, height) == expected
    assert cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE).shape == expected[::-1]


@pytest.mark.wall_clock(waits=True)
def test_the_pipelines_thread_pays_next_to_nothing() -> None:
    sender = PictureSender(SECTION, Taken())
    frames, sets = [a_frame(n) for n in range(20)], [a_set(n) for n in range(20)]
    began_s = time.thread_time()
    for again in range(50):
        for frame, its_set in zip(frames, sets, strict=True):
            sender.event(0, dataclasses.replace(frame, index=20 * again + frame.index))
            sender.feature_set(dataclasses.replace(its_set, frame=20 * again + frame.index))
    assert (time.thread_time() - began_s) / 1000 < 0.0005  # measured: 0.01 ms; making one takes 10 ms


def test_a_ground_that_asks_gets_the_right_picture_for_the_frame_and_one_that_does_not_costs_nothing() -> None:
    endpoint = free_endpoint()
    pictures = PictureCache()
    with Publisher("uav-1", [endpoint], rate=Rate(1e6, max_rate_hz=30.0)) as flying:
        with SetCache(endpoint) as without:
            assert eventually(lambda: _reported(flying, without, 1))
            assert flying.picture_room() == 0
        subscriptions = {PICTURE.key(ANY_VEHICLE): pictures.take}
        with PictureSender(SECTION, flying) as sender, SetCache(endpoint, subscriptions=subscriptions) as cache:
            assert eventually(lambda: flying.picture_room() > 0)

            def arrived(number: int) -> bool:
                flying.publish(
                    a_set(number)
                )  # again: only the newest goes, and it may have gone before it was asked for
                return number in pictures.frames("uav-1", BASE.session) and cache.by_frame("uav-1", number) is not None

            for number in (10, 20, 30):
                sender.event(0, a_frame(number))
                sender.feature_set(a_set(number))
                assert eventually(lambda: arrived(number))  # noqa: B023
        assert sorted(pictures.frames("uav-1", BASE.session)) == [10, 20, 30]
        for frame in (10, 20, 30):
            picture = pictures.picture("uav-1", BASE.session, frame)
            assert picture.capture_unix_ns == START_NS + frame * 10**8
            assert picture.content == small_image(an_image(frame), SECTION)[0]
        assert pictures.dropped.unreadable == 0


def _reported(flying: Publisher, cache: SetCache, number: int) -> bool:
    flying.publish(a_set(number))
    return cache.newest("uav-1") is not None


def test_the_cap_is_held_with_pictures_on_and_they_do_come() -> None:
    """Bytes counted on their way, headers too; 96 kbit/s, sets at 10 Hz offered, a picture of 20 kB always waiting."""
    target = free_endpoint()
    bit_rate, seconds = 96_000.0, 5.0
    pictures = PictureCache()
    with (
        Publisher("uav-1", [target], rate=Rate(bit_rate)) as flying,
        ThinLink(target, bit_rate=1e9) as link,
        SetCache(link.endpoint, subscriptions={PICTURE.key(ANY_VEHICLE): pictures.take}) as cache,
    ):
        assert eventually(lambda: flying.picture_room() > 0)
        assert eventually(lambda: _reported(flying, cache, 1))
        began_s, number = time.monotonic(), 2
        noise = np.random.default_rng(1).integers(0, 255, (160, 220), np.uint8)
        content, width, height = small_image(noise, PictureConfig(quality=80))

        def offered() -> None:
            nonlocal number
            number += 1
            flying.publish(a_set(number))
            if room := flying.picture_room():
                flying.send_picture(
                    LinkPicture("uav-1", BASE.session, number, START_NS, width, height, ImageFormat.WEBP, content), room
                )
            time.sleep(0.1)

        while time.monotonic() < began_s + seconds:
            offered()
        took_s = time.monotonic() - began_s
        sent = sum(size for at_s, size in link.down if began_s <= at_s <= began_s + took_s)
        # And one burst that was saved up, and the packet more that pictures may save up.
        assert sent <= took_s * bit_rate / 8.0 + 6000 + 1500
        assert eventually(lambda: offered() is None and pictures.received >= 1)
        assert eventually(lambda: offered() is None and len(cache.entries("uav-1")) >= 10)
