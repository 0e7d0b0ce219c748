"""Of a thermal camera's R-JPEG the counts are the picture, whatever palette shows it; damaged ones are refused."""

import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ExifTags, Image

from contract.camera import Camera
from contract.errors import InputError
from onboard.camera.photo_metadata import read_photo
from onboard.camera.picture_files import open_frames, read_colour, read_grey
from onboard.camera.radiometric_jpeg import DJI, FLIR, Counts, counts_of, radiometric
from tests.onboard.photographs import XMP
from tests.onboard.radiometric_pictures import (
    Segment,
    dji_segments,
    flir_segments,
    shown,
    with_segments,
    write_radiometric,
)

WIDTH, HEIGHT = 240, 192
FORMS = ("png, bytes swapped", "png", "plain", "plain, least byte first")


def ground(number: int = 0) -> Counts:
    rows, columns = np.indices((HEIGHT, WIDTH))
    rng = np.random.default_rng(number)
    warm = 300.0 * np.sin((columns + 5 * number) / 17.0) * np.cos(rows / 11.0) + 8.0 * rng.standard_normal(rows.shape)
    return np.rint(15700.0 + warm).astype(np.uint16)


def read(path: Path) -> tuple[tuple[str, tuple[int, int]] | None, Counts | None]:
    with Image.open(path) as image:
        return radiometric(image), counts_of(image)


def check(path: Path, counts: Counts, kind: str) -> None:
    stated, found = read(path)
    assert stated == (kind, (WIDTH, HEIGHT)) and found is not None
    np.testing.assert_array_equal(found, counts)


@pytest.mark.parametrize("enlarged", [1, 2])
def test_dji_s_counts_come_out_as_they_are(tmp_path: Path, enlarged: int) -> None:
    counts, path = ground(), tmp_path / "DJI_0001_T.JPG"
    write_radiometric(path, counts, dji_segments(counts), "DJI", enlarged)
    check(path, counts, DJI)
    photo = read_photo(path)
    assert photo.counts == DJI and photo.size_px == (WIDTH, HEIGHT)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("order", "<>")
def test_flir_s_counts_come_out_whatever_their_form_and_byte_order(tmp_path: Path, form: str, order: str) -> None:
    counts, path = ground(), tmp_path / "FLIR0001.jpg"
    write_radiometric(path, counts, flir_segments(counts, form, order), "FLIR Systems AB", 2)
    check(path, counts, FLIR)


def test_other_pictures_have_none(tmp_path: Path) -> None:
    counts, path = ground(), tmp_path / "a.jpg"
    write_radiometric(path, counts, dji_segments(counts), "Canon")  # another maker's APP3 is something else
    assert read(path) == (None, None)
    write_radiometric(path, counts, [], "DJI")
    assert read(path) == (None, None) and read_photo(path).counts == ""


def test_a_picture_that_was_turned_is_refused_for_its_counts_were_not(tmp_path: Path) -> None:
    """In rows of the wrong width they were clicked 24 m off, by ellipses of 7 m."""
    counts, path, jpeg = ground(), tmp_path / "DJI_0001_T.JPG", io.BytesIO()
    exif = Image.Exif()
    exif[ExifTags.Base.Make] = "DJI"
    picture = Image.fromarray(shown(counts)).transpose(Image.Transpose.ROTATE_90)
    picture.save(jpeg, "JPEG", exif=exif)
    path.write_bytes(with_segments(jpeg.getvalue(), dji_segments(counts)))
    with pytest.raises(InputError, match=f"counts are {WIDTH} x {HEIGHT}: the picture was turned"):
        read_photo(path)


def test_a_lens_in_pixels_is_of_the_picture_for_people_where_nothing_else_is_stated(tmp_path: Path) -> None:
    counts, path = ground(), tmp_path / "DJI_0001_T.JPG"
    write_radiometric(path, counts, dji_segments(counts), "DJI", 2)
    with Image.open(path) as image:
        words = XMP.format(attributes=f'drone-dji:CalibratedFocalLength="{2 * WIDTH}"').encode()
        exif, jpeg = image.getexif(), io.BytesIO()
        image.convert("RGB").save(jpeg, "JPEG", exif=exif, xmp=words)
    path.write_bytes(with_segments(jpeg.getvalue(), dji_segments(counts)))
    focal = read_photo(path).focal
    assert focal is not None and focal.fx_px == pytest.approx(WIDTH)


def without(segments: list[Segment], number: int) -> list[Segment]:
    return segments[:number] + segments[number + 1 :]


@pytest.mark.parametrize(
    ("segments", "words"),
    [
        (without(dji_segments(ground()), 1), "are no picture of 240 x 192"),
        (without(flir_segments(ground(), "plain"), 1), "1 of 2 parts of its thermal counts"),
        ([(1, b"FLIR\0\1\0\0no FFF file, but long enough for its head")], "of an unknown form"),
        ([(1, flir_segments(ground()[:8, :8])[0][1][:80])], "cut off"),
    ],
)
def test_an_r_jpeg_without_all_of_its_counts_is_refused_and_its_palette_never_taken(
    tmp_path: Path, segments: list[Segment], words: str
) -> None:
    path = tmp_path / "DJI_0001_T.JPG"
    write_radiometric(path, ground(), segments, "DJI")
    for read_picture in (read_photo, read_grey):
        with pytest.raises((InputError, ValueError), match=words):
            read_picture(path)


@given(st.integers(0, 400), st.integers(0, 255), st.integers(0, 400))
def test_a_damaged_record_is_read_or_refused(at: int, value: int, length: int) -> None:
    (number, data), *_ = flir_segments(ground()[:10, :12])
    damaged = bytearray(data[: max(len(data) - length, 0)])
    if at < len(damaged):
        damaged[at] = value
    image = Image.new("L", (12, 10))
    image.applist = [(f"APP{number}", bytes(damaged))]  # type: ignore[attr-defined]
    try:
        stated, found = radiometric(image), counts_of(image)
    except (ValueError, OSError, SyntaxError):
        return
    assert (stated is None) == (found is None)
    assert stated is None or found is None or stated[1] == found.shape[::-1]


def test_a_folder_of_them_gives_counts_and_warm_is_bright(tmp_path: Path) -> None:
    wanted = [ground(number) for number in range(3)]
    for number, counts in enumerate(wanted):
        path = tmp_path / f"2026-11-30T10-00-0{number}.000Z.jpg"
        write_radiometric(path, counts, flir_segments(counts) if number else dji_segments(counts), "DJI", 2)
    camera = Camera.from_field_of_view(WIDTH, HEIGHT, 57.0)
    for is_thermal in (True, False):
        frames = list(open_frames(tmp_path, camera, in_colour=True, is_thermal=is_thermal).frames())
        for frame, counts in zip(frames, wanted, strict=True):
            assert frame.image is not None and frame.colour is None
            assert np.corrcoef(frame.image.ravel(), counts.ravel().astype(float))[0, 1] > 0.9
            assert (frame.counts is not None) == is_thermal
            assert frame.counts is None or np.array_equal(frame.counts, counts)


def test_a_thermal_camera_s_picture_in_a_palette_is_refused_by_name(tmp_path: Path) -> None:
    """Its brightness does not rise with heat; a few coloured marks in a grey one are none."""
    camera = Camera.from_field_of_view(WIDTH, HEIGHT, 57.0)
    path = tmp_path / "2026-11-30T10-00-00.000Z.jpg"
    write_radiometric(path, ground(), [], "FLIR")
    with pytest.raises(InputError, match="colour palette"):
        list(open_frames(tmp_path, camera, is_thermal=True).frames())
    assert len(list(open_frames(tmp_path, camera).frames())) == 1
    grey = np.repeat(((ground() - 15300) // 4).astype(np.uint8)[:, :, None], 3, axis=2)
    grey[90:94, 100:130] = (255, 0, 0)
    Image.fromarray(grey).save(path)
    (frame,) = open_frames(tmp_path, camera, is_thermal=True).frames()
    assert frame.counts is not None and read_colour(path) is not None
