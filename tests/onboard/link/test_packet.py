"""One set, one packet."""

import socket

import numpy as np
import pytest

from contract.wire.codec import decode, encode
from onboard.link.packet import MAX_PAYLOAD, one_packet
from onboard.link.socket_backlog import Backlog
from tests.contract.sets import plain_set


def test_a_set_that_fits_is_sent_as_it_is() -> None:
    small = plain_set(100)
    assert one_packet(small) == encode(small)
    assert one_packet(small, b"encoded already") == b"encoded already"


@pytest.mark.parametrize("features", [200, 255])
def test_a_set_that_does_not_fit_loses_its_most_crowded_features(features: int) -> None:
    large = plain_set(features)
    assert MAX_PAYLOAD > len(encode(large)) > 800
    packet = one_packet(large, max_bytes=800)
    assert 800 - 60 < len(packet) <= 800
    kept, all_of_it = decode(packet), decode(encode(large))
    assert {tuple(uv) for uv in kept.uv_px.tolist()} < {tuple(uv) for uv in all_of_it.uv_px.tolist()}

    def spacing(uv_px: np.ndarray) -> float:
        apart = np.linalg.norm(uv_px[:, None] - uv_px[None], axis=2)
        np.fill_diagonal(apart, np.inf)
        return float(apart.min())

    assert spacing(kept.uv_px) > spacing(all_of_it.uv_px)
    assert (kept.frame, kept.capture_unix_ns) == (large.frame, large.capture_unix_ns)


def test_however_little_room_there_is_a_set_without_features_goes_through() -> None:
    bare = decode(one_packet(plain_set(30), max_bytes=10))
    assert len(bare) == 0 and bare.is_ok


def test_what_a_stream_holds_for_a_ground_that_does_not_read_is_known() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        ours = socket.create_connection(server.getsockname())
        theirs, _ = server.accept()
        with ours, theirs:
            host, port = ours.getpeername()
            backlog, peer = Backlog(), f"tcp/{host}:{port}"
            assert backlog.unacknowledged([peer]) == 0
            ours.setblocking(False)
            with pytest.raises(BlockingIOError):
                while True:
                    ours.send(bytes(65536))
            held = backlog.unacknowledged([peer])
            assert held > 10_000
            # One ground that reads, or a link that holds nothing, and sending goes on.
            assert backlog.unacknowledged([peer, "udp/127.0.0.1:9"]) == 0
    assert backlog.unacknowledged([peer]) == 0 and backlog.unacknowledged([]) == 0
