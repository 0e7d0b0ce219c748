"""Sets in pieces: put together again from any of them that suffice, and never from what does not belong together."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.wire.parity import groups_of, joined, length_of, parities, pieces_of
from contract.wire.set_pieces import (
    MAX_BYTES,
    ReceiverReport,
    SetAssembly,
    SetPiece,
    cut_set,
    encode_piece,
    encode_report,
    read_piece,
    read_report,
)

SETS = st.binary(min_size=1, max_size=1250)
ROOMS = st.integers(30, 101)


def packets(payload: bytes, age_s: float | None, room: int, of: int = 3, first: int = 0) -> list[bytes]:
    cut = cut_set(payload, age_s, room)
    return [encode_piece(SetPiece((first + i) % 65536, of, *piece)) for i, piece in enumerate(cut)]


def taken(assembly: SetAssembly, packet: bytes, now_s: float = 0.0) -> tuple[bytes, float | None] | None:
    piece = read_piece(packet)
    assert piece is not None
    return assembly.take(piece, now_s)


@given(SETS, st.none() | st.floats(0.0, 600.0), ROOMS, st.randoms())
def test_a_set_is_whole_from_all_pieces_but_one_of_each_group_in_any_order(
    payload: bytes, age_s: float | None, room: int, chance: random.Random
) -> None:
    sent = packets(payload, age_s, room)
    assert all(len(packet) <= room for packet in sent)
    count = len(cut_set(payload, age_s, room)) - groups_of(cut_set(payload, age_s, room)[0][1])
    groups = groups_of(count)
    lost = {chance.randrange(group, count + groups, groups) for group in range(groups) if count > 1}
    lost = {number for number in lost if number < count or number - count in range(groups)}
    by_group: dict[int, int] = {}
    for number in lost:  # one of a group at most: a parity counts to the group it is of
        by_group[(number - count) if number >= count else number % groups] = number
    kept = [packet for number, packet in enumerate(sent) if number not in by_group.values()]
    chance.shuffle(kept)
    assembly = SetAssembly()
    found = [whole for packet in kept if (whole := taken(assembly, packet)) is not None]
    assert [whole[0] for whole in found] == [payload]
    assert (found[0][1] is None) == (age_s is None)
    if age_s is not None:
        assert found[0][1] == pytest.approx(age_s, abs=0.006)
    assert assembly.report(0.0).received == len(kept)


@given(SETS.filter(lambda payload: len(payload) > 200))
def test_two_lost_of_a_group_are_no_set_and_a_later_one_is_not_held_up(payload: bytes) -> None:
    assembly = SetAssembly()
    sent = packets(payload, None, 101)
    groups = groups_of(read_piece(sent[0]).pieces)
    assert all(taken(assembly, packet) is None for number, packet in enumerate(sent) if number not in (0, groups))
    later = [taken(assembly, packet) for packet in packets(b"later" + payload, 1.0, 101, of=4, first=100)]
    assert [found for found in later if found is not None] == [(b"later" + payload, 1.0)]


def test_a_set_that_comes_twice_counts_once_and_sets_that_stay_incomplete_are_given_up() -> None:
    assembly = SetAssembly()
    sent = packets(bytes(500), None, 101)
    found = [taken(assembly, packet) for packet in sent + sent]
    assert sum(whole is not None for whole in found) == 1
    for of in range(50):
        taken(assembly, packets(bytes(500), None, 101, of=100 + of)[0])
    assert len(assembly._partial) <= SetAssembly.MAX_PARTIAL


def test_a_report_states_the_highest_packet_also_past_65535_and_out_of_order() -> None:
    assembly = SetAssembly()
    assert assembly.report(0.0) == ReceiverReport(0, 0)
    for number in (65534, 1, 65535, 0):
        taken(assembly, encode_piece(SetPiece(number, number % 256, 0, 1, 5, b"12345")))
    report = assembly.report(0.0)
    assert (report.highest, report.received) == (1, 4)
    assert read_report(encode_report(report)) == report


def test_a_report_states_how_long_ago_each_of_the_latest_packets_came() -> None:
    assembly = SetAssembly()
    for number, at_s in enumerate((0.0, 1.0, 5.5, 6.0, 6.02, 6.5, 7.0, 7.0, 7.5, 8.0)):
        if number != 5:  # it was lost
            taken(assembly, encode_piece(SetPiece(number, number % 256, 0, 1, 5, b"12345")), at_s)
    packet = encode_report(assembly.report(8.1))
    read = read_report(packet)
    assert len(packet) == 13
    expected = {2: 2.6, 3: 2.1, 4: 2.08, 6: 1.1, 7: 1.1, 8: 0.6, 9: 0.1}  # of the last eight
    assert read.came_s == pytest.approx(expected, abs=0.011)
    later = read_report(encode_report(assembly.report(12.55)))
    assert sorted(later.came_s) == [8, 9]  # the others came more than 5 s ago
    assert read_report(packet[:5]) == ReceiverReport(9, 9)  # as grounds of before report


def test_pieces_that_cannot_be_are_not_cut_and_other_packets_are_none() -> None:
    good = packets(bytes(500), None, 101)[0]
    with pytest.raises(ValueError, match="a set of"):
        cut_set(bytes(MAX_BYTES), None, 101)
    assert read_piece(b"\x11" + good[1:]) is None and read_report(good) is None


@given(st.binary(min_size=1, max_size=3000), st.integers(1, 60))
def test_pieces_and_parities_have_the_lengths_that_are_reported(content: bytes, pieces: int) -> None:
    pieces = min(pieces, len(content))
    contents = pieces_of(content, pieces)
    contents += parities(contents)
    assert [len(c) for c in contents] == [length_of(len(content), pieces, i) for i in range(pieces + groups_of(pieces))]
    assert joined(len(content), pieces, dict(enumerate(contents))) == content
