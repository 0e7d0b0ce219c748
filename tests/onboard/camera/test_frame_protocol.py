"""Frames in a pipe: what was written is read, and what is none never becomes a picture."""

import math
import struct
import zlib
from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.camera.frame_protocol import (
    HEADER_BYTES,
    TRAILER_BYTES,
    Clock,
    FrameReader,
    GimbalFrame,
    Header,
    Moment,
    NoFrameError,
    Origin,
    decode_header,
    encode,
    middle_ns,
)

MAYBE = st.one_of(st.just(math.nan), st.floats(width=32, allow_nan=False))
HEADERS = st.builds(
    Header,
    width_px=st.integers(1, 40),
    height_px=st.integers(1, 20),
    stamp_ns=st.integers(-(2**63), 2**63 - 1),
    sequence=st.integers(0, 2**64 - 1),
    stride_bytes=st.sampled_from([0, 80, 96]),
    fourcc=st.sampled_from(["GREY", "Y10", "Y12", "Y16"]),
    arrival_ns=st.integers(-(2**63), 2**63 - 1),
    clock=st.sampled_from(Clock),
    moment=st.sampled_from(Moment),
    origin=st.sampled_from(Origin),
    is_damaged=st.booleans(),
    exposure_s=MAYBE,
    sigma_s=MAYBE,
    zoom=MAYBE,
    focal_px=MAYBE,
    gimbal=st.tuples(MAYBE, MAYBE, MAYBE, MAYBE),
    gimbal_frame=st.sampled_from(GimbalFrame),
)


@st.composite
def frames(draw: st.DrawFn) -> tuple[Header, bytes]:
    header = draw(HEADERS)
    seed = draw(st.integers(0, 255))
    return header, bytes((seed + 7 * k) % 256 for k in range(header.payload_bytes))


def same(one: Header, other: Header) -> bool:
    """Equal, NaN to NaN; a stride of 0 is that of rows without padding."""
    one, other = (replace(h, stride_bytes=h.line_bytes) for h in (one, other))
    return all(repr(getattr(one, f.name)) == repr(getattr(other, f.name)) for f in fields(Header))


def read(data: bytes, piece: int = 1 << 20) -> tuple[list[tuple[Header, bytes]], FrameReader]:
    reader = FrameReader()
    out = []
    for at in range(0, len(data), piece):
        out += [(header, bytes(luma)) for header, luma in reader.feed(data[at : at + piece])]
    return out, reader


@given(st.lists(frames(), max_size=4), st.integers(1, 5000))
def test_what_is_written_is_read_in_whatever_pieces_it_comes(sent: list[tuple[Header, bytes]], piece: int) -> None:
    got, reader = read(b"".join(encode(h, luma) for h, luma in sent), piece)
    assert len(got) == len(sent) and reader.skipped_bytes == 0
    for (one, luma), (other, read_luma) in zip(sent, got, strict=True):
        assert same(one, other) and luma == read_luma


@given(st.lists(st.tuples(st.binary(max_size=300), frames()), min_size=1, max_size=3))
def test_frames_are_found_again_after_garbage(parts: list[tuple[bytes, tuple[Header, bytes]]]) -> None:
    got, reader = read(b"".join(rubbish + encode(*frame) for rubbish, frame in parts), 777)
    assert [luma for _, luma in got] == [luma for _, (_, luma) in parts]
    assert reader.skipped_bytes == sum(len(rubbish) for rubbish, _ in parts)


@given(frames(), frames(), frames(), st.data())
def test_a_frame_that_was_broken_off_is_no_picture_and_costs_no_more_than_the_next(
    broken: tuple[Header, bytes], one: tuple[Header, bytes], other: tuple[Header, bytes], data: st.DataObject
) -> None:
    whole = encode(*broken)
    cut = data.draw(st.integers(0, len(whole) - 1))
    # Enough frames follow that the broken one's length is filled: what lies within it is looked through again.
    follow = [one, *[other] * (2 + len(whole) // (HEADER_BYTES + TRAILER_BYTES))]
    got, _ = read(whole[:cut] + b"".join(encode(*frame) for frame in follow))
    assert [luma for _, luma in got] == [luma for _, luma in follow]


@given(frames(), st.integers(0, HEADER_BYTES - 1), st.integers(1, 255))
def test_a_header_with_any_byte_changed_is_refused(frame: tuple[Header, bytes], at: int, by: int) -> None:
    data = bytearray(encode(*frame))
    data[at] ^= by
    got, reader = read(bytes(data))
    assert got == [] and reader.skipped_bytes > 0


@given(st.binary(max_size=3000), st.integers(1, 700))
def test_garbage_alone_is_nothing_and_is_not_kept(data: bytes, piece: int) -> None:
    got, reader = read(data.replace(b"PCFR", b"----"), piece)
    assert got == []
    assert reader.skipped_bytes >= len(data) - 3


def changed(offset: int, fmt: str, value: object) -> bytes:
    data = bytearray(encode(Header(8, 4, 1, 1), bytes(32))[:124])
    struct.pack_into(fmt, data, offset, value)
    return bytes(data) + struct.pack("<I", zlib.crc32(data))


@pytest.mark.parametrize(
    ("header", "why"),
    [
        (changed(4, "<H", 2), "version 2"),
        (changed(6, "<H", 64), "version 1"),
        (changed(8, "<I", 0), "size 0x4"),
        (changed(12, "<I", 1 << 20), "size 8x1048576"),
        (changed(16, "<I", 4), "4 bytes a row"),
        (changed(20, "4s", b"RGB3"), "format 'RGB3'"),
        (changed(24, "<I", 1 << 31), "2147483648 bytes of luma"),
        (changed(56, "<B", 9), "9 is not a valid Clock"),
    ],
    ids=lambda value: value.replace(" ", "_") if isinstance(value, str) else "",
)
def test_a_header_of_nonsense_is_refused_with_its_reason(header: bytes, why: str) -> None:
    with pytest.raises(NoFrameError, match=why):
        decode_header(header)
    _, reader = read(header)
    assert why in reader.complaint


def test_fields_of_a_later_version_behind_ours_are_passed_over() -> None:
    frame = encode(Header(8, 4, 1, 7), bytes(range(32)))
    longer = changed(6, "<H", 160)
    more = b"later version's fields, 32 bytes"
    data = longer + more + frame[128:160] + struct.pack("<4sI", b"PCFE", 1)
    got, reader = read(data + frame)
    assert [h.sequence for h, _ in got] == [1, 7] and reader.skipped_bytes == 0


def test_luma_that_does_not_fit_its_header_is_not_written() -> None:
    with pytest.raises(ValueError, match="31 bytes of luma; 32 by the header"):
        encode(Header(8, 4, 1, 1), bytes(31))


@pytest.mark.parametrize(
    ("moment", "ms"),
    [
        (Moment.UNKNOWN, 0.0),
        (Moment.FIRST_ROW_START, 10.0 + 2.0),
        (Moment.FIRST_ROW_END, 10.0 - 2.0),
        (Moment.MIDDLE, 0.0),
        (Moment.LAST_ROW_END, -10.0 - 2.0),
    ],
)
def test_any_moment_of_an_exposure_is_moved_to_its_middle(moment: Moment, ms: float) -> None:
    header = Header(8, 4, 0, 0, moment=moment, exposure_s=0.004)
    assert middle_ns(header, 0.02) == pytest.approx(ms * 1e6)
    unknown = middle_ns(replace(header, exposure_s=math.nan), 0.02)
    assert abs(unknown - middle_ns(header, 0.02)) <= 2e6
