"""Raw pictures become frames: times, gaps, repeats, damage."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.camera.picture_decoder import Pictures, RawPicture
from onboard.events.session_clock import SessionClock
from onboard.events.types import Frame
from tests.onboard.camera.fake_camera import SIZE_PX, picture

CLOCK = SessionClock(1_700_000_000_000_000_000)
MS = 1_000_000
START_NS = 10**12


def judge() -> Pictures:
    return Pictures(CLOCK, 0.0, SIZE_PX, 30.0)


def offer(
    pictures: Pictures, number: int, *, sequence: int | None = None, age_ns: int = MS,
    data: bytearray | None = None, size_px: tuple[int, int] = SIZE_PX, is_monotonic: bool = True,
    is_damaged: bool = False, has_waited: bool = False,
) -> Frame | None:  # fmt: skip
    now_ns = START_NS + number * 33 * MS
    raw = RawPicture(
        picture(number) if data is None else data, "GREY", size_px, 0, now_ns - age_ns,
        number if sequence is None else sequence, is_monotonic, is_damaged, has_waited,
    )  # fmt: skip
    return pictures.take(raw, now_ns)


@given(st.lists(st.integers(1, 5), min_size=1, max_size=30), st.integers(0, 2**32 - 1))
def test_every_gap_in_the_numbers_is_counted_also_where_they_wrap(steps: list[int], first: int) -> None:
    pictures, sequence = judge(), first
    offer(pictures, 0, sequence=sequence)
    for number, step in enumerate(steps, 1):
        sequence = (sequence + step) % 2**32
        offer(pictures, number, sequence=sequence)
    assert pictures.counts.lost == sum(steps) - len(steps)
    assert pictures.counts.pictures == len(steps) + 1


def test_numbers_that_begin_again_are_no_loss() -> None:
    pictures = judge()
    offer(pictures, 0, sequence=500)
    offer(pictures, 1, sequence=0)
    pictures.restart()
    offer(pictures, 2, sequence=77)
    assert pictures.counts.lost == 0


def test_a_driver_that_does_not_number_says_so() -> None:
    pictures = judge()
    for number in range(3):
        offer(pictures, number, sequence=0)
    assert pictures.complaints() == ["the driver does not number its pictures: lost ones cannot be counted"]


def test_stamps_of_the_monotonic_clock_are_taken_as_they_are() -> None:
    pictures = judge()
    frame = offer(pictures, 3, age_ns=7 * MS)
    assert frame.stamp_ns == CLOCK.from_monotonic_ns(START_NS + 3 * 33 * MS - 7 * MS)
    assert pictures.complaints() == []


def test_a_stale_picture_is_skipped() -> None:
    pictures = judge()
    assert offer(pictures, 0, age_ns=501 * MS) is None
    assert offer(pictures, 1, age_ns=499 * MS) is not None
    assert pictures.counts.skipped == 1


def test_stamps_in_the_future_are_reported() -> None:
    pictures = judge()
    assert offer(pictures, 0, age_ns=-33 * MS) is not None
    assert pictures.complaints() == ["stamps lie 33 ms in the future: calibrate camera.latency_s"]


def test_an_unknown_clock_is_accepted_only_where_it_agrees_with_ours() -> None:
    pictures = judge()
    agreeing = offer(pictures, 0, is_monotonic=False, age_ns=20 * MS)
    assert agreeing.stamp_ns == CLOCK.from_monotonic_ns(START_NS - 20 * MS)
    assert pictures.complaints() == []
    for age_ns in (-(10**18), 10**12):  # Unix time, another machine's uptime
        pictures = judge()
        frame = offer(pictures, 1, is_monotonic=False, age_ns=age_ns)
        assert frame.stamp_ns == CLOCK.from_monotonic_ns(START_NS + 33 * MS)
        assert "not of CLOCK_MONOTONIC" in pictures.complaints()[0]
        assert offer(pictures, 2, is_monotonic=False, age_ns=age_ns, has_waited=True) is None


def test_stamps_never_run_backwards() -> None:
    pictures = judge()
    frames = [offer(pictures, number, age_ns=age) for number, age in enumerate([MS, 40 * MS, MS, 34 * MS, MS])]
    stamps_ns = [frame.stamp_ns for frame in frames if frame is not None]
    assert stamps_ns == sorted(set(stamps_ns))
    assert pictures.counts.skipped == 2
    pictures.restart()
    assert offer(pictures, 0) is None


def test_a_repeat_to_the_last_bit_bears_no_image() -> None:
    pictures = judge()
    nearly = picture(0)
    nearly[-1] ^= 1
    images = [offer(pictures, n, data=data) for n, data in enumerate([picture(0), picture(0), nearly, nearly])]
    assert [frame is not None and frame.image is not None for frame in images] == [True, False, True, False]
    assert pictures.counts.repeated == 2


def test_a_blank_picture_is_reported_and_is_no_repeat() -> None:
    pictures = judge()
    black = bytearray(SIZE_PX[0] * SIZE_PX[1])
    frames = [offer(pictures, number, data=black) for number in range(3)]
    assert all(frame is not None and frame.image is not None for frame in frames)
    assert "single grey value" in pictures.complaints()[0]


def test_a_damaged_picture_bears_no_image_and_many_are_reported() -> None:
    pictures = judge()
    wide, high = SIZE_PX
    for number in range(4):  # the last is of as many bytes, but of another size than the camera file's
        frame = offer(pictures, number, is_damaged=number < 3, size_px=(wide, high) if number < 3 else (high, wide))
        assert frame.image is None
    assert pictures.complaints() == []
    short = offer(pictures, 4, data=picture(4)[:-1])
    assert short.image is None
    assert pictures.complaints() == ["the last 5 pictures are damaged"]
    assert pictures.counts.damaged == 5
    offer(pictures, 5)
    assert pictures.complaints() == []


def test_half_the_rate_is_reported() -> None:
    pictures = judge()
    for number in range(0, 120, 2):
        offer(pictures, number)
    assert pictures.rate_hz == pytest.approx(15.15, abs=0.01)
    assert pictures.complaints() == ["15.2 of 30 pictures a second: exposure too long, or bus too slow"]


def test_images_do_not_share_memory() -> None:
    pictures = judge()
    frames = [offer(pictures, number) for number in range(2)]
    first, second = (frame.image for frame in frames if frame is not None)
    assert first is not None and second is not None
    assert not np.shares_memory(first, second)


def test_of_a_compressed_stream_a_picture_that_hardly_changes_while_others_do_is_a_repeat() -> None:
    rng = np.random.default_rng(2)
    width, height = SIZE_PX
    ground = rng.integers(0, 255, (height, width + 400), np.uint8)
    pictures = Pictures(CLOCK, 0.0, SIZE_PX, 30.0, is_compressed=True)

    def shown(number: int, at: int) -> bool:
        noisy = ground[:, at : at + width].astype(int) + rng.integers(-2, 3, (height, width))
        frame = offer(pictures, number, data=bytearray(np.clip(noisy, 0, 255).astype(np.uint8).tobytes()))
        return frame is not None and frame.image is not None

    moving = [shown(k, 2 * k) for k in range(30)]
    assert all(moving)
    assert [shown(30 + k, 60 + 2 * (k // 3)) for k in range(60)] == [k % 3 == 0 for k in range(60)]  # ten of thirty
    # An aircraft that stops: nothing but noise changes, and after a second that is what is usual.
    assert sum(shown(100 + k, 100) for k in range(90)) > 50
