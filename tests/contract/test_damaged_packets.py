"""Every kind of packet whose reader has no checksum to lean on, damaged: it is read, or refused by a WireError.

Sets and pieces of pictures carry a checksum: test_codec.py and test_picture_code.py.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.answer import Fix
from contract.errors import CorruptPayload, NewerPayload, TruncatedPayload, WireError
from contract.vehicle_status import VehicleStatus, decode_status, encode_status
from contract.wire.click_code import ClickAnswer, decode, encode_answer
from contract.wire.set_pieces import PIECE_HEAD, SetAssembly, read_piece, read_report
from contract.wire.spot_code import decode_spots, encode_spots
from contract.wire.track_code import decode_track, decode_tracks, encode_track
from tests.contract import test_spot_code, test_track_code
from tests.contract.test_click_code import FIX, MEASURED
from tests.contract.test_set_pieces import packets
from tests.contract.test_vehicle_status import FLYING


@dataclass(frozen=True)
class Packet:
    """True packets, their reader, whether what it read can be, and payloads that are wrong by their errors."""

    true: list[bytes]
    read: Callable[[bytes], Any]
    can_be: Callable[[Any], bool]
    wrong: dict[type[WireError], list[bytes]] = field(default_factory=dict)


def is_on_earth(place: Any) -> bool:
    return place is None or abs(place.lat_deg) <= 90.0


def is_sane_answer(found: Any) -> bool:
    answer = found.answer if isinstance(found, ClickAnswer) else None
    return not isinstance(answer, Fix) or bool(is_on_earth(answer) and np.all(np.isfinite(answer.covariance_enu_m2)))


def can_be_assembled(piece: Any) -> bool:
    if piece is not None:
        SetAssembly().take(piece, 0.0)  # raises nothing
    return True


TRACK, SPOTS = encode_track(test_track_code.REPORT), encode_spots(test_spot_code.REPORT)
NAMED = encode_spots(replace(test_spot_code.REPORT, person_found=0.2, person_named=(None, 0.5) * 10))
CLICKS = [encode_answer(ClickAnswer(7, replace(fix, vehicle="12345678"))) for fix in (FIX, MEASURED)]
PIECE = packets(bytes(500), None, 101)[0]
PACKETS = {
    "track": Packet([TRACK], decode_track, lambda track: is_on_earth(track.place), {
        TruncatedPayload: [TRACK[:-1], b""], CorruptPayload: [TRACK + b"\0", b"\x01" + TRACK[1:]],
        NewerPayload: [b"\x21" + TRACK[1:], TRACK[:4] + b"\xff" + TRACK[5:]],
    }),
    "tracks": Packet([TRACK + TRACK], decode_tracks, lambda tracks: all(is_on_earth(t.place) for t in tracks)),
    "spots": Packet([SPOTS, NAMED], decode_spots, lambda found: all(is_on_earth(spot.place) for spot in found.spots), {
        TruncatedPayload: [b"", SPOTS[:10]], CorruptPayload: [SPOTS[:-1], SPOTS + b"\0", b"\x01" + SPOTS[1:]],
        NewerPayload: [b"\x31" + SPOTS[1:], SPOTS[:38] + b"\x3f" + SPOTS[39:]],
    }),
    "click": Packet(CLICKS, decode, is_sane_answer, {
        TruncatedPayload: [CLICKS[0][:30], b""], CorruptPayload: [b"\x1f" + CLICKS[0][1:]],
        NewerPayload: [b"\x22" + CLICKS[0][1:]],
    }),
    "piece": Packet([PIECE], read_piece, can_be_assembled, {
        TruncatedPayload: [PIECE[: PIECE_HEAD - 1]],
        CorruptPayload: [PIECE[:-1], PIECE[:4] + b"\xff" + PIECE[5:]],
    }),
    "report of pieces": Packet([PIECE], read_report, lambda _: True),
    "status": Packet([encode_status(FLYING)], decode_status, lambda status: isinstance(status, VehicleStatus)),
}  # fmt: skip
EACH = pytest.mark.parametrize("packet", PACKETS.values(), ids=PACKETS)


def check(packet: Packet, payload: bytes) -> None:
    try:
        found = packet.read(payload)
    except WireError as error:
        assert str(error)
    else:
        assert packet.can_be(found)


@EACH
@given(payload=st.binary(max_size=400))
def test_any_bytes_are_read_or_a_wire_error(packet: Packet, payload: bytes) -> None:
    check(packet, payload)


@EACH
@given(data=st.data())
def test_a_changed_byte_is_read_or_a_wire_error(packet: Packet, data: st.DataObject) -> None:
    payload = bytearray(data.draw(st.sampled_from(packet.true)))
    payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    check(packet, bytes(payload))


@EACH
def test_what_is_cut_newer_or_never_was_is_distinguished(packet: Packet) -> None:
    for error, payloads in packet.wrong.items():
        for payload in payloads:
            with pytest.raises(error):
                packet.read(payload)
