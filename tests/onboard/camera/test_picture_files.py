"""Pictures and videos: capture times from every source, sizes, and bad input in one line."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ExifTags, Image

from contract.camera import Camera
from contract.errors import InputError
from onboard.camera.file_stamps import stamp_from_name
from onboard.camera.picture_files import open_frames
from onboard.camera.pixel_formats import reduce_16_bit

CAMERA = Camera.from_field_of_view(64, 48, 40.0)
UNIX_S = 1533430852


def picture(path: Path, grey: int = 100, size: tuple[int, int] = (64, 48), exif: dict[int, str] | None = None) -> None:
    image = Image.new("L", size, grey)
    tags = Image.Exif()
    tags.get_ifd(ExifTags.IFD.Exif).update(exif or {})
    image.save(path, exif=tags)


def exif(second: int, fraction: str | None = "52", offset: str | None = None) -> dict[int, str]:
    tags = {int(ExifTags.Base.DateTimeOriginal): f"2018:08:05 01:00:{second:02d}"}
    if fraction is not None:
        tags[int(ExifTags.Base.SubsecTimeOriginal)] = fraction
    if offset is not None:
        tags[int(ExifTags.Base.OffsetTimeOriginal)] = offset
    return tags


@pytest.mark.parametrize(
    ("name", "fraction_ns"),
    [
        ("2018080501005238Z.jpg", 380_000_000),
        ("20180805010052.jpg", 0),
        ("20180805T010052.380Z.png", 380_000_000),
        ("20180805_010052.jpg", 0),
        ("IMG_20180805_010052_2.jpg", 0),
        ("IMG_20180805_010052_380.jpg", 380_000_000),
        ("2018-08-05_01-00-52-380.jpg", 380_000_000),
        ("2018-08-05T01:00:52.123456789Z.tif", 123_456_789),
        ("cam0_2018-08-05_01-00-52.jpg", 0),
        ("1533430852.jpg", 0),
        ("1533430852.380000.jpg", 380_000_000),
        ("frame_1533430852.38.png", 380_000_000),
    ],
)
def test_a_utc_time_is_found_in_a_file_s_name(name: str, fraction_ns: int) -> None:
    assert stamp_from_name(name) == UNIX_S * 10**9 + fraction_ns


@pytest.mark.parametrize(
    "name",
    ["img0001.jpg", "frame_0000000123.png", "20181305010052.jpg", "20180805256199.jpg", "2018-08-05.jpg", "x.jpg"],
)
def test_a_counter_or_an_impossible_date_is_no_time(name: str) -> None:
    assert stamp_from_name(name) is None


@given(st.datetimes(datetime(2001, 1, 1), datetime(2099, 1, 1)))
def test_any_moment_survives_being_a_name(moment: datetime) -> None:
    moment = moment.replace(tzinfo=UTC)
    expected = (moment - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
    assert stamp_from_name(moment.strftime("%Y%m%d%H%M%S%fZ.jpg")) == expected
    assert stamp_from_name(moment.strftime("%Y%m%dT%H%M%S.%fZ.jpg")) == expected
    assert stamp_from_name(moment.strftime("a_%Y-%m-%d_%H-%M-%S-%f.png")) == expected
    assert stamp_from_name(f"{expected // 10**9}.{expected % 10**9:09d}.png") == expected


def test_pictures_come_in_capture_order_counted_from_zero(tmp_path: Path) -> None:
    for second, name in ((53, "b"), (52, "c"), (51, "a")):
        picture(tmp_path / f"{name}_20180805T0100{second}.5Z.png", grey=second)
    source = open_frames(tmp_path, CAMERA)
    frames = list(source.frames())
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert [int(frame.image[0, 0]) for frame in frames if frame.image is not None] == [51, 52, 53]
    assert [frame.stamp_ns for frame in frames] == source.stamps_ns == sorted(source.stamps_ns)
    assert [frame.name for frame in frames] == source.names
    assert source.names[0] == "a_20180805T010051.5Z.png"
    assert frames[0].image.dtype == np.uint8
    assert frames[0].image.shape == (48, 64)


def test_the_latency_is_taken_off(tmp_path: Path) -> None:
    picture(tmp_path / "1533430852.5.png")
    assert open_frames(tmp_path, CAMERA, latency_s=0.1).stamps_ns == [UNIX_S * 10**9 + 400_000_000]


@pytest.mark.parametrize(("offset", "hours"), [(None, 0), ("+00:00", 0), ("+12:00", -12), ("-03:30", 3.5)])
def test_exif_comes_before_the_name_and_knows_its_offset(tmp_path: Path, offset: str | None, hours: float) -> None:
    picture(tmp_path / "20200101000000Z.jpg", exif=exif(52, "38", offset))
    assert open_frames(tmp_path, CAMERA).stamps_ns == [round((UNIX_S + hours * 3600) * 10**9) + 380_000_000]


def test_exif_in_whole_seconds_gives_way_to_the_name(tmp_path: Path) -> None:
    picture(tmp_path / "2018080501005238Z.jpg", exif=exif(50, fraction=None))
    assert open_frames(tmp_path, CAMERA).stamps_ns == [UNIX_S * 10**9 + 380_000_000]


def test_stamps_from_a_csv_come_first(tmp_path: Path) -> None:
    for name in ("x.jpg", "y.jpg"):
        picture(tmp_path / name, exif=exif(52))
    csv = tmp_path / "stamps.csv"
    csv.write_text("file,unix_time_s\r\ny.jpg,1533430852.123456789\r\nx.jpg,1533430853.5\r\n")
    source = open_frames(tmp_path, CAMERA, csv)
    assert source.names == ["y.jpg", "x.jpg"]
    assert source.stamps_ns == [1533430852_123456789, 1533430853_500000000]


def test_a_picture_of_another_size_is_named_with_both_sizes(tmp_path: Path) -> None:
    """What else is refused of pictures and their stamps: tests/transcripts/pc-onboard-replay.txt."""
    picture(tmp_path / "1533430852.png")
    picture(tmp_path / "1533430853.png", size=(60, 48))
    with pytest.raises(InputError, match=r"1533430853\.png is 60 x 48, the camera file states 64 x 48"):
        open_frames(tmp_path, CAMERA)


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def empty(path: Path) -> None:
    path.write_bytes(b"")


def scribble(path: Path) -> None:
    path.write_bytes(b"not a picture at all, but long enough to look at")


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "bmp"])
@pytest.mark.parametrize("damage", [cut, empty, scribble])
def test_a_picture_that_cannot_be_decoded_is_named(tmp_path: Path, suffix: str, damage: Callable[[Path], None]) -> None:
    rng = np.random.default_rng(0)
    path = tmp_path / f"1533430852.{suffix}"
    Image.fromarray(rng.integers(0, 255, (48, 64), np.uint8)).save(path)
    damage(path)
    with pytest.raises(InputError, match=r"1533430852\.\w+ cannot be decoded") as caught:
        list(open_frames(tmp_path, CAMERA).frames())
    assert "\n" not in str(caught.value)


def test_colour_and_sixteen_bit_pictures_become_grey(tmp_path: Path) -> None:
    Image.new("RGB", (64, 48), (255, 0, 0)).save(tmp_path / "1533430852.png")
    thermal = np.add.outer(np.arange(48), np.arange(64)).astype(np.uint16) * 3 + 8000
    Image.fromarray(thermal).save(tmp_path / "1533430853.png")
    red, deep = (frame.image for frame in open_frames(tmp_path, CAMERA).frames())
    assert deep is not None
    assert 74 <= red[0, 0] <= 78
    np.testing.assert_array_equal(deep, reduce_16_bit(thermal))  # as the live camera does
    assert np.ptp(deep.astype(int)) > 250


def video(path: Path, frames: int = 5) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (64, 48))
    assert writer.isOpened()
    for index in range(frames):
        writer.write(np.full((48, 64, 3), 40 * index, np.uint8))
    writer.release()
    return path


def test_a_video_takes_its_stamps_by_index(tmp_path: Path) -> None:
    clip, csv = video(tmp_path / "clip.avi"), tmp_path / "stamps.csv"
    csv.write_text("index,unix_time_s\n" + "".join(f"{i},{UNIX_S + i}.25\n" for i in range(5)))
    frames = list(open_frames(clip, CAMERA, csv).frames())
    assert [frame.stamp_ns for frame in frames] == [(UNIX_S + i) * 10**9 + 250_000_000 for i in range(5)]
    assert [frame.name for frame in frames] == [f"clip.avi#{i}" for i in range(5)]
    for index, frame in enumerate(frames):
        assert abs(int(frame.image[20, 20]) - 40 * index) <= 4


def test_a_video_s_name_gives_its_start(tmp_path: Path) -> None:
    source = open_frames(video(tmp_path / "20180805T010052.5Z.avi"), CAMERA)
    assert source.stamps_ns == [UNIX_S * 10**9 + 500_000_000 + i * 100_000_000 for i in range(5)]


def test_a_video_of_another_size_or_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="64 x 48, the camera file states 32 x 24"):
        open_frames(video(tmp_path / "clip.avi"), Camera.from_field_of_view(32, 24, 40.0))
    (tmp_path / "no.mp4").write_bytes(b"nothing")
    with pytest.raises(InputError, match="not a video"):
        open_frames(tmp_path / "no.mp4", CAMERA)


def test_the_real_flight_s_names_are_its_times(shared_data: Path) -> None:
    camera = Camera.from_json(shared_data / "cmac_2018" / "camera.json")
    source = open_frames(shared_data / "cmac_2018" / "frames", camera)
    assert len(source.names) == 18
    assert source.stamps_ns[0] == 1533430844_800000000
    gaps = np.diff(source.stamps_ns) / 1e9
    assert 0.6 < gaps.min() < gaps.max() < 1.2
