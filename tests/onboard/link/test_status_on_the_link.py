"""The status topic over real zenoh sessions on the loopback interface."""

from __future__ import annotations

import json
import time
from dataclasses import replace

import zenoh

from contract.feature_set import Status
from contract.link_config import link_config
from contract.topics import FEATURES, STATUS
from contract.vehicle_status import VehicleStatus, decode_status, encode_status
from onboard.link.publisher import Publisher
from tests.contract.sets import plain_set
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


def test_the_newest_picture_is_refused_for_the_reason_that_holds() -> None:
    """A click without a frame means what the operator sees: with the camera lost no older picture stands for it."""
    endpoint, key = free_endpoint(), FEATURES.key("kiwi")
    older = replace(plain_set(12), vehicle="kiwi")
    with Publisher("kiwi", (endpoint,)) as publisher, zenoh_client(endpoint) as ground:
        assert json.loads(query(ground, key)[0]) == {"status": "starting", "vehicle": "kiwi"}
        publisher.explain(Status.NO_GPS, "no gps: no fix", False)
        assert json.loads(query(ground, key)[0]) == {"status": "no_gps", "vehicle": "kiwi", "reason": "no gps: no fix"}
        packet = publisher.publish(older)
        assert query(ground, key) == [packet]
        publisher.explain(Status.CAMERA_LOST, "camera lost: unplugged", True)
        lost = {"status": "camera_lost", "vehicle": "kiwi", "reason": "camera lost: unplugged"}
        assert json.loads(query(ground, key)[0]) == lost
        assert query(ground, f"{key}?frame={older.frame}") == [packet]
        assert query(ground, f"{key}?time={older.capture_unix_ns / 1e9}") == [packet]
        assert json.loads(query(ground, f"{key}?frame=99999")[0]) == {"status": "unknown_frame", "vehicle": "kiwi"}
        publisher.explain(Status.STARTING, "ok", False)
        assert query(ground, key) == [packet]
