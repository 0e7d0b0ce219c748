"""A message is accepted by its key: content that names another vehicle is refused, whatever the topic."""

import pytest

from contract.errors import ForeignMessage, WireError
from contract.topics import FEATURES, PICTURE, SPOTS, STATUS, TRACKS
from contract.vehicle_status import VehicleStatus, encode_status
from contract.wire.codec import encode
from contract.wire.message import SPOT_REPORTS, TRACK_REPORTS, peek_set, read_picture_piece, read_set, read_status
from contract.wire.picture_code import cut
from tests.contract.pictures import small_picture
from tests.contract.sets import plain_set

SET = encode(plain_set(20))
PIECE = cut(small_picture(), with_parity=False)[0]


@pytest.mark.parametrize(
    ("read", "topic", "payload"),
    [(read_set, FEATURES, SET), (peek_set, FEATURES, SET), (read_picture_piece, PICTURE, PIECE)],
)
def test_a_set_or_a_picture_on_another_vehicle_s_key_is_refused_by_name(read, topic, payload) -> None:
    read(topic.key("uav-1"), payload)
    with pytest.raises(ForeignMessage, match="'uav-2' sends what names 'uav-1'"):
        read(topic.key("uav-2"), payload)
    with pytest.raises(ValueError, match="is not a key of"):
        read("pc/uav-1/other", payload)
    with pytest.raises(WireError):
        read(topic.key("uav-1"), payload[:20])


def test_what_names_no_vehicle_is_its_key_s() -> None:
    status = encode_status(VehicleStatus(1.0, 7, "ok"))
    assert read_status(STATUS.key("uav-2"), status)[0] == "uav-2"
    for read, topic in ((read_status, STATUS), (TRACK_REPORTS.read, TRACKS), (SPOT_REPORTS.read, SPOTS)):
        with pytest.raises(ValueError, match="is not a key of"):
            read(FEATURES.key("uav-2"), status)
        with pytest.raises(WireError):
            read(topic.key("uav-2"), b"\xff")
