"""The status topic over real zenoh sessions on the loopback interface."""

from __future__ import annotations

import json
import time

import zenoh

from contract.link_config import link_config
from contract.topics import STATUS
from contract.vehicle_status import VehicleStatus, decode_status, encode_status
from onboard.link.publisher import Publisher
from tests.onboard.link.ports import free_endpoint

NOW = VehicleStatus(1_700_000_000.5, 7, "ok")


def zenoh_client(endpoint: str) -> zenoh.Session:
    return zenoh.open(zenoh.Config.from_json5(link_config("client", connect=[endpoint])))


def query(session: zenoh.Session, selector: str) -> list[bytes]:
    replies = session.get(selector, timeout=2.0)
    return [(reply.ok or reply.err).payload.to_bytes() for reply in replies]  # type: ignore[union-attr]


def test_a_status_is_heard_and_can_be_asked_for() -> None:
    endpoint = free_endpoint()
    heard: list[bytes] = []
    with Publisher("kiwi", (endpoint,)) as publisher, zenoh_client(endpoint) as ground:
        ground.declare_subscriber(STATUS.key("kiwi"), lambda sample: heard.append(sample.payload.to_bytes()))
        (refused,) = query(ground, STATUS.key("kiwi"))
        assert json.loads(refused) == {"status": "starting", "vehicle": "kiwi"}
        deadline = time.monotonic() + 5.0
        while not heard and time.monotonic() < deadline:
            publisher.publish_status(encode_status(NOW), b'{"more": 1}')
            time.sleep(0.05)
        assert decode_status(heard[0]) == NOW
        assert decode_status(query(ground, STATUS.key("kiwi"))[0]) == NOW
        assert query(ground, STATUS.key("kiwi") + "?detail=1") == [b'{"more": 1}']
