"""Pictures on the ground: put together, kept within bounds, recorded and read again; and whatever is sent instead."""

import dataclasses
import random
from pathlib import Path

from contract.topics import PICTURE
from contract.wire.codec import encode
from contract.wire.picture_code import cut
from ground.link_pictures import MAX_PARTIAL, MAX_VEHICLES, PictureCache
from ground.link_recorder import LinkRecorder
from ground.recorded_link_pictures import RecordedLinkPictures
from ground.recording import Recording
from tests.contract.pictures import small_picture
from tests.contract.sets import plain_set

KEY = PICTURE.key("uav-1")
SESSION = small_picture().session


def test_pictures_are_given_by_vehicle_session_and_frame_also_with_pieces_of_several_mixed() -> None:
    cache = PictureCache()
    pictures = [small_picture(frame, size) for frame, size in ((1, 900), (2, 5000), (3, 12_000))]
    pieces = [piece for picture in pictures for piece in cut(picture, with_parity=True)]
    random.Random(1).shuffle(pieces)
    completed = [found for piece in pieces if (found := cache.take(KEY, piece)) is not None]
    assert sorted(found.frame for found in completed) == [1, 2, 3] and {id(found) for found in completed} == {
        id(cache.picture("uav-1", SESSION, frame)) for frame in (1, 2, 3)
    }
    assert cache.frames("uav-1", SESSION) == {1, 2, 3} and cache.received == 3
    for picture in pictures:
        assert cache.picture("uav-1", SESSION, picture.frame) == picture
    assert cache.picture("uav-1", SESSION + 1, 1) is None and cache.picture("uav-2", SESSION, 1) is None
    assert cache.frames("uav-2", SESSION) == set()
    assert cache.dropped.unreadable == 0 and cache.incomplete == 0


def test_what_is_kept_is_bounded_in_pictures_and_bytes_and_the_newest_stay() -> None:
    few, small = PictureCache(max_pictures=5), PictureCache(max_bytes=20_000)
    for frame in range(40):
        for piece in cut(small_picture(frame, 3000), with_parity=False):
            few.take(KEY, piece)
            small.take(KEY, piece)
    assert few.frames("uav-1", SESSION) == set(range(35, 40))
    assert small.frames("uav-1", SESSION) == set(range(34, 40))


def test_pieces_that_never_become_pictures_are_given_up() -> None:
    """Of one vehicle, and of a peer that invents vehicles."""
    cache = PictureCache()
    for frame in range(300):
        cache.take(KEY, cut(small_picture(frame, 5000), with_parity=True)[0])
    for number in range(300):
        name = f"v{number}"
        cache.take(PICTURE.key(name), cut(small_picture(1, 5000, name), with_parity=True)[0])
    held = sum(len(partial) for partial in cache._assembly._partial.values())
    assert held <= MAX_VEHICLES * MAX_PARTIAL and cache.incomplete >= 600 - MAX_VEHICLES - MAX_PARTIAL
    good = small_picture(7)
    for piece in cut(good, with_parity=True):
        cache.take(KEY, piece)
    assert cache.picture("uav-1", SESSION, 7) == good


def test_whatever_else_comes_on_the_key_is_counted() -> None:
    cache = PictureCache()
    piece = cut(small_picture(), with_parity=False)[0]
    junk = [b"", b"PP", bytes(3000), piece[:-1], piece[:100] + b"?" + piece[101:], encode(plain_set(20))]
    for payload in junk:
        cache.take(KEY, payload)
    cache.take(PICTURE.key("uav-2"), piece)  # in another's name
    cache.take("pc/uav-1/features", piece)
    assert cache.dropped.unreadable == len(junk) + 1 and cache.received == 0 and cache.dropped.last_error is not None
    assert "dropped, 'uav-2' sends what names 'uav-1': 1 messages" in cache.dropped.lines()
    random.seed(2)
    for _ in range(500):
        spoilt = bytearray(piece)
        spoilt[random.randrange(len(spoilt))] ^= 1 + random.randrange(255)
        cache.take(KEY, bytes(spoilt))
    assert cache.dropped.unreadable == len(junk) + 501 and not cache.frames("uav-1", SESSION)


def test_recorded_pictures_are_given_again_with_a_piece_of_each_group_lost(tmp_path: Path) -> None:
    s = dataclasses.replace(plain_set(30), session=SESSION)
    pictures = [small_picture(frame, 9000) for frame in range(4)]
    with LinkRecorder(tmp_path) as recorder:
        for picture in pictures:
            recorder.take("pc/uav-1/features", encode(dataclasses.replace(s, frame=picture.frame)))
            for number, piece in enumerate(cut(picture, with_parity=True)):
                if number != picture.frame and not (picture.frame == 3 and number < 5):
                    recorder.take(KEY, piece)
        recorder.take(PICTURE.key("uav-2"), cut(pictures[0], with_parity=False)[0])  # in another's name
        recorder.take(KEY, b"PP nonsense")
        assert "1 messages were none of ours" in recorder.words
        assert "dropped, 'uav-2' sends what names 'uav-1': 1 messages" in recorder.words
    assert Recording(tmp_path).frames("uav-1") == [0, 1, 2, 3]  # and they are in the way of nothing
    recorded = RecordedLinkPictures(tmp_path)
    assert recorded.frames("uav-1", SESSION) == {0, 1, 2}
    assert [recorded.picture("uav-1", SESSION, k) for k in range(4)] == [*pictures[:3], None]
    assert recorded.picture("uav-1", SESSION + 1, 0) is None


def test_a_damaged_recording_gives_the_pictures_that_are_whole_and_no_others(tmp_path: Path) -> None:
    pictures = [small_picture(frame, 4000) for frame in range(20)]
    with LinkRecorder(tmp_path) as recorder:
        for picture in pictures:
            for piece in cut(picture, with_parity=True):
                recorder.take(KEY, piece)
    (path,) = tmp_path.iterdir()
    content = bytearray(path.read_bytes())
    rng = random.Random(3)
    for _ in range(40):
        content[rng.randrange(100, len(content))] = rng.randrange(256)
    path.write_bytes(content[: len(content) * 3 // 4])
    recorded = RecordedLinkPictures(path)
    found = [recorded.picture("uav-1", SESSION, picture.frame) for picture in pictures]
    assert all(got is None or got == picture for got, picture in zip(found, pictures, strict=True))
    assert 3 <= sum(got is not None for got in found) < 20
