"""Pictures in pieces: every bit comes back, one lost piece of each group too, and nothing is accepted unchecked."""

import contextlib
import dataclasses
import itertools
import json
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.errors import CorruptPayload, NewerPayload, TruncatedPayload, WireError
from contract.picture import MAX_BYTES, ImageFormat, LinkPicture, image_size
from contract.wire.parity import groups_of
from contract.wire.picture_code import cut, join, read_piece
from tests.contract.pictures import START_NS, pictures, small_picture, webp_of

GOLDEN = json.loads((Path(__file__).parent / "golden" / "picture.json").read_text())


def put_together(payloads: list[bytes]) -> LinkPicture | None:
    pieces = [read_piece(payload) for payload in payloads]
    assert len({piece.whole for piece in pieces}) == 1
    return join(pieces[0].whole, {piece.number: piece.content for piece in pieces})


def with_checksum(body: bytes) -> bytes:
    return body + struct.pack("<I", zlib.crc32(body))


@given(pictures(), st.booleans(), st.integers(200, 1250), st.randoms())
def test_any_picture_comes_back_from_its_pieces_in_any_order(
    picture: LinkPicture, with_parity: bool, max_bytes: int, order: object
) -> None:
    try:
        pieces = cut(picture, with_parity=with_parity, max_bytes=max_bytes)
    except ValueError as error:
        assert "does not go into" in str(error) and len(picture.content) > 100 * (max_bytes - 90)
        return
    assert all(len(piece) <= max_bytes for piece in pieces)
    order.shuffle(pieces)
    assert put_together(pieces) == picture


@given(pictures(), st.integers(300, 1250), st.data())
def test_one_lost_piece_of_each_group_comes_back_and_two_do_not(
    picture: LinkPicture, max_bytes: int, data: st.DataObject
) -> None:
    pieces = cut(picture, with_parity=True, max_bytes=max_bytes)
    needed = len(cut(picture, with_parity=False, max_bytes=max_bytes))
    groups = groups_of(needed)
    assert len(pieces) == needed + groups and groups == (0 if needed == 1 else -(-needed // 6))
    members = [[*range(g, needed, groups), needed + g] for g in range(groups)]
    lost = {data.draw(st.sampled_from(group)) for group in members}
    assert not groups or put_together([p for i, p in enumerate(pieces) if i not in lost]) == picture
    for group in members[:1]:
        for two in itertools.islice(itertools.combinations(group, 2), 4):
            left = [p for i, p in enumerate(pieces) if i not in two]
            assert put_together(left) is None


def test_the_golden_pieces_are_what_they_were_and_mean_what_they_meant() -> None:
    """docs/wire-format.md, section 11, with nothing else in hand."""
    pieces = [bytes.fromhex(piece) for piece in GOLDEN["pieces"]]
    want = GOLDEN["picture"]
    content = bytes.fromhex(want.pop("content"))
    picture = LinkPicture(**{**want, "format": ImageFormat(want["format"])}, content=content)
    assert put_together(pieces) == picture == put_together(pieces[1:])  # the first is lost, its parity is there
    assert cut(picture, with_parity=True, max_bytes=150) == pieces
    first = pieces[0]
    assert first[:2] == b"PP" and first[2] == 0x10 and first[3] == 2  # WebP
    length, session, frame, capture, width, height, size, checksum = struct.unpack_from("<HIIQHHII", first, 4)
    assert (length, session, frame, capture) == (len(first), 3_000_000_001, 77, START_NS)
    assert (width, height, size, checksum) == (48, 36, len(content), zlib.crc32(content))
    assert (first[34], first[35], first[36]) == (0, len(pieces) - 1, 5) and first[37:42] == b"uav-1"
    share = -(-size // first[35])
    assert first[42:-4] == content[:share]
    assert first[-4:] == struct.pack("<I", zlib.crc32(first[:-4]))
    bodies = np.array([np.frombuffer(piece[42:-4].ljust(share, b"\0"), np.uint8) for piece in pieces])
    assert pieces[-1][34] == len(pieces) - 1 and not np.bitwise_xor.reduce(bodies).any()
    assert cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE).shape == (36, 48)


@pytest.mark.parametrize("suffix", [".webp", ".jpg"])
def test_the_size_of_an_image_is_what_its_decoder_finds(suffix: str) -> None:
    rng = np.random.default_rng(1)
    for width, height in ((1, 1), (7, 300), (480, 360)):
        for channels in ((), (3,)):
            image = rng.integers(0, 255, (height, width, *channels), np.uint8)
            for quality in (1, 30, 95):
                flag = cv2.IMWRITE_WEBP_QUALITY if suffix == ".webp" else cv2.IMWRITE_JPEG_QUALITY
                content = cv2.imencode(suffix, image, [flag, quality])[1].tobytes()
                kind = ImageFormat.WEBP if suffix == ".webp" else ImageFormat.JPEG
                assert image_size(content) == (kind, width, height)


@given(st.binary(max_size=200))
def test_whatever_bytes_come_only_a_wire_error_is_raised(junk: bytes) -> None:
    for payload in (junk, b"PP\x10\x02" + junk, with_checksum(b"PP\x10\x01" + junk)):
        with pytest.raises(WireError):
            read_piece(payload)
    with contextlib.suppress(CorruptPayload):
        assert image_size(b"\xff\xd8\xff" + junk[:20])[0] is ImageFormat.JPEG


@given(st.integers(0, 36), st.binary(min_size=1, max_size=9))
def test_a_head_that_lies_is_refused_or_harmless_though_its_checksum_is_right(at: int, junk: bytes) -> None:
    payload = cut(small_picture(size=3000), with_parity=True)[0]
    lying = bytearray(payload[:-4])
    lying[at : at + len(junk)] = junk[: len(lying) - at]
    try:
        piece = read_piece(with_checksum(bytes(lying)))
    except WireError:
        return
    assert piece.whole.bytes <= MAX_BYTES and len(piece.content) < 1250
    assert piece.whole.pieces <= 255 and len(piece.whole.vehicle.encode()) <= 32


@given(st.data())
def test_every_truncation_and_every_flipped_bit_is_noticed(data: st.DataObject) -> None:
    payload = cut(small_picture(size=800), with_parity=False)[0]
    cut_at = data.draw(st.integers(0, len(payload) - 1))
    with pytest.raises((TruncatedPayload, CorruptPayload)):
        read_piece(payload[:cut_at])
    bit = data.draw(st.integers(0, 8 * len(payload) - 1))
    spoilt = bytearray(payload)
    spoilt[bit // 8] ^= 1 << bit % 8
    with pytest.raises(WireError):
        read_piece(bytes(spoilt))
    with pytest.raises(CorruptPayload):
        read_piece(payload + b"\0")


def test_a_later_version_and_an_unknown_format_say_so() -> None:
    payload = cut(small_picture(), with_parity=False)[0]
    for at, value in ((2, 0x20), (3, 9)):
        changed = bytearray(payload[:-4])
        changed[at] = value
        with pytest.raises(NewerPayload):
            read_piece(with_checksum(bytes(changed)))


def test_what_is_no_picture_is_neither_sent_nor_put_together() -> None:
    good = small_picture(size=3000)
    for wrong in (
        dataclasses.replace(good, content=b"<html>" + bytes(100)),
        dataclasses.replace(good, width_px=481),
        dataclasses.replace(good, format=ImageFormat.JPEG),
        dataclasses.replace(good, content=b""),
        dataclasses.replace(good, content=webp_of(480, 360, bytes(MAX_BYTES))),
        dataclasses.replace(good, width_px=5000, content=webp_of(5000, 360, b"")),
        dataclasses.replace(good, content=good.content + b"more than its head says"),
        dataclasses.replace(good, vehicle="x" * 33),
        dataclasses.replace(good, frame=-1),
    ):
        with pytest.raises(ValueError):
            cut(wrong, with_parity=True)
    pieces = [read_piece(payload) for payload in cut(good, with_parity=False)]
    other = [read_piece(payload) for payload in cut(small_picture(78, 3000), with_parity=False)]
    with pytest.raises(CorruptPayload, match="belong together"):
        join(pieces[0].whole, {0: pieces[0].content, 1: other[1].content, 2: pieces[2].content})
