"""Pixel formats -> grey."""

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from onboard.camera.pixel_formats import DECODERS, reduce_16_bit, to_grey

WIDTH, HEIGHT = SIZE_PX = (64, 48)
RNG = np.random.default_rng(1)
GREY = RNG.integers(0, 255, (HEIGHT, WIDTH), np.uint8)
SMOOTH = np.add.outer(np.arange(HEIGHT), np.arange(WIDTH)).astype(np.uint8)


def padded(lines: NDArray[np.uint8], stride: int) -> bytearray:
    full = RNG.integers(0, 255, (lines.shape[0], stride), np.uint8)
    full[:, : lines.shape[1]] = lines
    return bytearray(full.tobytes())


def packed(fourcc: str, padding: int = 0) -> tuple[bytearray, int]:
    """`GREY` in a format, and its bytes a line."""
    if fourcc == "GREY":
        return padded(GREY, WIDTH + padding), WIDTH + padding
    if fourcc == "YUYV":
        pairs = np.stack([GREY, RNG.integers(0, 255, GREY.shape, np.uint8)], axis=-1).reshape(HEIGHT, 2 * WIDTH)
        return padded(pairs, 2 * WIDTH + padding), 2 * WIDTH + padding
    if fourcc == "UYVY":
        pairs = np.stack([RNG.integers(0, 255, GREY.shape, np.uint8), GREY], axis=-1).reshape(HEIGHT, 2 * WIDTH)
        return padded(pairs, 2 * WIDTH + padding), 2 * WIDTH + padding
    if fourcc == "YU12":
        colours = RNG.integers(0, 255, (WIDTH + padding) // 2 * HEIGHT, np.uint8).tobytes()
        return padded(GREY, WIDTH + padding) + colours, WIDTH + padding
    assert fourcc == "NV12"
    colour = RNG.integers(0, 255, (HEIGHT // 2, WIDTH), np.uint8)
    return padded(np.concatenate([GREY, colour]), WIDTH + padding), WIDTH + padding


@pytest.mark.parametrize("padding", [0, 32])
@pytest.mark.parametrize("fourcc", ["GREY", "YUYV", "NV12", "UYVY", "YU12"])
def test_luma_is_read_exactly_whatever_the_stride(fourcc: str, padding: int) -> None:
    data, line_bytes = packed(fourcc, padding)
    grey = to_grey(fourcc, data, SIZE_PX, line_bytes)
    assert grey.flags["C_CONTIGUOUS"]
    np.testing.assert_array_equal(grey, GREY)
    if padding == 0:
        np.testing.assert_array_equal(to_grey(fourcc, data, SIZE_PX, 0), GREY)  # a driver that gives no stride


@pytest.mark.parametrize("fourcc", ["GREY", "YUYV", "NV12", "UYVY", "YU12"])
def test_a_short_buffer_is_no_picture(fourcc: str) -> None:
    data, line_bytes = packed(fourcc)
    assert to_grey(fourcc, data[:-2], SIZE_PX, line_bytes) is None
    assert to_grey(fourcc, bytearray(), SIZE_PX, line_bytes) is None


def jpeg(picture: NDArray[np.uint8] = SMOOTH, colour: bool = True) -> bytearray:
    out = io.BytesIO()
    image = Image.fromarray(picture)
    (image.convert("RGB") if colour else image).save(out, "JPEG", quality=95)
    return bytearray(out.getvalue())


def without_tables(data: bytearray) -> bytearray:
    """As most webcams send it: no Huffman tables (DHT), the standard's own being meant."""
    out, at = bytearray(data[:2]), 2
    while data[at + 1] != 0xDA:
        length = 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        if data[at + 1] != 0xC4:
            out += data[at : at + length]
        at += length
    return out + data[at:]


@pytest.mark.parametrize("colour", [True, False])
def test_motion_jpeg_with_and_without_tables(colour: bool) -> None:
    data = jpeg(colour=colour)
    stripped = without_tables(data)
    assert len(stripped) < len(data) - 20
    for frame in (data, stripped, data + bytes(100)):
        grey = to_grey("MJPG", frame, SIZE_PX, 0)
        assert np.abs(grey.astype(int) - SMOOTH).max() <= 4


def test_a_cut_off_or_foreign_jpeg_is_no_picture() -> None:
    data = jpeg()
    for length in (0, 2, 100, len(data) // 2, len(data) - 20):
        assert to_grey("MJPG", data[:length], SIZE_PX, 0) is None
    assert to_grey("MJPG", jpeg(SMOOTH[:40]), SIZE_PX, 0) is None


@given(st.sampled_from(sorted(DECODERS)), st.binary(max_size=400), st.integers(0, 500))
def test_garbage_never_crashes(fourcc: str, data: bytes, line_bytes: int) -> None:
    grey = to_grey(fourcc, bytearray(data), (16, 8), line_bytes)
    assert grey is None or (grey.shape == (8, 16) and grey.dtype == np.uint8)


@given(st.integers(2, 600), st.integers(0, 255))
def test_a_jpeg_with_a_wrong_byte_never_crashes(position: int, value: int) -> None:
    data = jpeg()
    data[position % len(data)] = value
    grey = to_grey("MJPG", data, SIZE_PX, 0)
    assert grey is None or grey.shape == (HEIGHT, WIDTH)


def test_thermal_contrast_survives_the_reduction() -> None:
    """A landscape of 400 counts at 8000 of a 14-bit camera; shifting right by eight would leave two grey values."""
    scene = (8000 + 400 * RNG.random((HEIGHT, WIDTH))).astype("<u2")
    grey = to_grey("Y16", bytearray(scene.tobytes()), SIZE_PX, 2 * WIDTH)
    assert grey is not None
    assert len(np.unique(grey)) > 200
    assert np.corrcoef(grey.ravel(), scene.ravel())[0, 1] > 0.999
    assert len(np.unique(scene >> 8)) <= 3


@given(st.integers(0, 65535 - 40), st.integers(1, 40))
def test_little_contrast_is_not_blown_up(level: int, span: int) -> None:
    scene = (level + RNG.integers(0, span + 1, (HEIGHT, WIDTH))).astype(np.uint16)
    grey = reduce_16_bit(scene).astype(int)
    assert grey.max() - grey.min() <= np.ptp(scene.astype(int)) + 1


def test_hot_spots_do_not_darken_the_rest() -> None:
    scene = np.full((HEIGHT, WIDTH), 7000, np.uint16) + RNG.integers(0, 300, (HEIGHT, WIDTH)).astype(np.uint16)
    scene[0, :4] = 16383
    assert reduce_16_bit(scene).std() > 50


@pytest.mark.parametrize("fourcc", ["GRBG", "GBRG", "RGGB", "BA81"])
@pytest.mark.parametrize("padding", [0, 32])
def test_of_raw_colours_green_is_taken_and_its_mean_where_there_is_none(fourcc: str, padding: int) -> None:
    rows = {"GRBG": ("GR", "BG"), "GBRG": ("GB", "RG"), "RGGB": ("RG", "GB"), "BA81": ("BG", "GR")}[fourcc]
    green = np.array([[rows[y % 2][x % 2] == "G" for x in range(WIDTH)] for y in range(HEIGHT)])
    scene = np.add.outer(2 * np.arange(HEIGHT), np.arange(WIDTH)).astype(np.uint8)  # linear: means are exact
    raw = np.where(green, scene, RNG.integers(0, 255, scene.shape, np.uint8)).astype(np.uint8)
    grey = to_grey(fourcc, padded(raw, WIDTH + padding), SIZE_PX, WIDTH + padding)
    np.testing.assert_array_equal(grey[green], scene[green])
    np.testing.assert_allclose(grey[1:-1, 1:-1].astype(int), scene[1:-1, 1:-1].astype(int), atol=1)
    assert to_grey(fourcc, padded(raw, WIDTH)[:-1], SIZE_PX, WIDTH) is None


@pytest.mark.parametrize(("fourcc", "bits"), [("Y10", 10), ("Y12", 12), ("Y16", 16)])
def test_of_deep_greys_the_pictures_own_range_is_shown(fourcc: str, bits: int) -> None:
    deep = (SMOOTH.astype(np.uint16) << (bits - 8)).astype("<u2")
    grey = to_grey(fourcc, bytearray(deep.tobytes()), SIZE_PX, 0)
    assert np.corrcoef(grey.ravel(), SMOOTH.ravel())[0, 1] > 0.999 and np.ptp(grey) > 250
