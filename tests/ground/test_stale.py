"""A click without --frame or --time means the newest picture: live, the aircraft's clock years off the ground's.

The pictures' ages come from the arrivals of events, so that a set 25 s old needs no 25 s of waiting.
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from contract.feature_set import FeatureSet, Status
from contract.link_config import link_config
from contract.vehicle_status import VehicleStatus, encode_status
from contract.wire.codec import encode
from ground.__main__ import main
from ground.client import SetCache, inquire
from onboard.events.types import GpsQuality
from onboard.link.publisher import Publisher, Rate
from tests.contract.sets import plain_set
from tests.onboard.link.ports import free_endpoint

BASE = plain_set(100)
NOW_NS = 1_500_000_000_000_000_000  # by the aircraft; the ground's clock says otherwise
LOST_S = 25.0
WIDE = Rate(max_bit_rate=1e8, max_rate_hz=30.0)
Click = Callable[..., tuple[int, dict[str, Any]]]


class Aircraft:
    """Publishes what a daemon would; `now_s` is the time of its session, which goes on by itself."""

    def __init__(self, publisher: Publisher) -> None:
        self.publisher = publisher
        self._began_s = time.monotonic()

    def now_ns(self) -> int:
        return NOW_NS + round((time.monotonic() - self._began_s) * 1e9)

    def tick(self) -> None:
        """Something arrives, if only a message of the receiver."""
        self.publisher.event(self.now_ns(), GpsQuality(self.now_ns(), 3, 12))

    def picture(self, frame: int, ago_s: float, status: Status = Status.OK) -> None:
        stamp_ns = self.now_ns() - round(ago_s * 1e9)
        if status is Status.OK:
            self.publisher.publish(dataclasses.replace(BASE, frame=frame, capture_unix_ns=stamp_ns))
        else:
            self.publisher.publish(FeatureSet("uav-1", BASE.session, frame, stamp_ns, status, BASE.camera))

    def says(self, state: str, reason: str = "") -> None:
        self.publisher.publish_status(encode_status(VehicleStatus(self.now_ns() / 1e9, 7, state, reason)), b"{}")


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def aircraft(endpoint: str) -> Iterator[Aircraft]:
    with Publisher("uav-1", [endpoint], rate=WIDE) as publisher:
        flying = Aircraft(publisher)
        flying.tick()
        yield flying


@pytest.fixture
def click(endpoint: str, capsys: pytest.CaptureFixture[str]) -> Click:
    def run(*options: str) -> tuple[int, dict[str, Any]]:
        code = main(["click", "320", "240", "--connect", endpoint, "--format", "json", *options])
        return code, json.loads(capsys.readouterr().out)

    return run


def fly(aircraft: Aircraft, cause: Status | None) -> None:
    """Ten pictures that answer, the last of them LOST_S ago, and refusals since, or nothing."""
    for frame in range(10):
        aircraft.picture(frame, LOST_S + 0.2 * (9 - frame))
    if cause is not None:
        for frame in range(10, 20):
            aircraft.picture(frame, LOST_S * (19 - frame) / 10.0 + 0.1, cause)


def test_a_fresh_picture_is_answered_with_its_age(aircraft: Aircraft, click: Click) -> None:
    aircraft.picture(3, 0.4)
    aircraft.picture(4, 0.2, Status.TURNING)
    code, answer = click()
    assert code == 0 and answer["status"] == "ok" and answer["frame"] == 3
    assert 0.4 <= answer["age_s"] < 3.0


LOST = [
    (Status.NO_GPS, "no gps", "the position is not accepted", "frame 19, 0.", "no_gps: there was no usable GPS"),
    (Status.UNSYNCHRONISED, "telemetry lost", "nothing for 25 s", "frame 19, 0.", "unsynchronised: picture and"),
    (None, "camera lost", "no such device", "camera lost", "no such device"),
    (None, "", "", "no newer picture came", ""),
]


@pytest.mark.parametrize(("cause", "state", "reason", "first", "second"), LOST)
def test_with_gps_telemetry_or_camera_gone_the_old_picture_is_refused_with_the_reason(
    aircraft: Aircraft, click: Click, endpoint: str, capsys: pytest.CaptureFixture[str], cause: Status | None,
    state: str, reason: str, first: str, second: str,
) -> None:  # fmt: skip
    fly(aircraft, cause)
    if state:
        aircraft.says(state, reason)
    code, answer = click()
    assert code == 3 and answer["status"] == "stale" and answer["frame"] == 9
    assert LOST_S <= answer["age_s"] < LOST_S + 3.0
    assert first in answer["reason"] and second in answer["reason"] and reason in answer["reason"]
    assert main(["click", "320", "240", "--connect", endpoint]) == 3
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("stale: the newest picture that can be clicked is 25.") and err.count("\n") == 1
    # Who wants that very picture still gets it, with its age.
    for options in (["--max-age", "60"], ["--max-age", "inf"], ["--frame", "9"]):
        code, answer = click(*options)
        assert code == 0 and answer["status"] == "ok" and answer["frame"] == 9
        assert LOST_S <= answer["age_s"] < LOST_S + 3.0


def test_the_limit_holds_on_both_sides_and_time_goes_on_without_events(aircraft: Aircraft, click: Click) -> None:
    aircraft.picture(0, 10.0)
    began_s = time.monotonic()
    assert click("--max-age", "10")[0] == 3
    code, answer = click("--max-age", "14")
    assert code == 0 and 10.0 <= answer["age_s"] <= 10.0 + time.monotonic() - began_s + 0.5
    time.sleep(0.3)  # all threads stand still on board
    assert click("--max-age", "14")[1]["age_s"] >= answer["age_s"] + 0.3


def test_a_refused_picture_that_is_old_is_stale_too(aircraft: Aircraft, click: Click) -> None:
    aircraft.picture(0, LOST_S, Status.LOW_PARALLAX)
    aircraft.says("camera lost", "no such device")
    code, answer = click()
    assert code == 3 and answer["status"] == "stale"
    assert "low_parallax" in answer["reason"] and "camera lost: no such device" in answer["reason"]
    aircraft.picture(1, 0.1, Status.LOW_PARALLAX)
    code, answer = click()
    assert code == 3 and answer["status"] == "low_parallax" and answer["age_s"] < 2.0


@pytest.mark.parametrize(
    ("state", "status"), [("camera lost", "camera_lost"), ("no gps", "starting"), ("", "starting")]
)
def test_before_the_first_set_the_aircraft_says_what_is_missing(
    aircraft: Aircraft, click: Click, state: str, status: str
) -> None:
    if state:
        aircraft.says(state, "for a reason")
    code, answer = click()
    assert code == 3 and answer["status"] == status and answer["age_s"] is None
    assert (f"the aircraft reports: {state}: for a reason" in answer["reason"]) == bool(state)


def test_an_aircraft_that_says_no_age_is_not_taken_for_fresh(endpoint: str, click: Click) -> None:
    """Of an older version, or of none of ours: sets without an attachment, or with a senseless one."""
    payload = encode(dataclasses.replace(BASE, capture_unix_ns=time.time_ns()))
    config = zenoh.Config.from_json5(link_config("peer", listen=[endpoint]))
    for about in (None, b"", b"[]", b'{"age_s": -1}', b'{"age_s": NaN, "newest": 7}', b'{"age_s": true}', b"\xff"):
        with zenoh.open(config) as session:
            key = "pc/uav-1/features"
            queryable = session.declare_queryable(key, lambda q, a=about: q.reply(key, payload, attachment=a))  # noqa: B023
            code, answer = click()
            assert code == 3 and answer["status"] == "stale" and answer["age_s"] is None, about
            assert "unknown age" in answer["reason"]
            code, answer = click("--max-age", "inf")
            assert code == 0 and answer["age_s"] is None
            queryable.undeclare()


def test_the_time_that_an_answer_takes_counts_as_age(aircraft: Aircraft, endpoint: str) -> None:
    aircraft.picture(0, 1.0)
    asked_s = time.monotonic()
    reply = inquire(endpoint)["uav-1"]
    assert reply.age_s is not None and 1.0 < reply.age_s <= 1.0 + time.monotonic() - asked_s + 0.1


def test_a_listener_that_comes_later_knows_how_old_the_repeated_picture_is(aircraft: Aircraft, endpoint: str) -> None:
    """With nothing newer the newest set is sent again: to have heard it just now does not make it young."""
    fly(aircraft, None)
    with SetCache(endpoint) as cache:
        deadline = time.monotonic() + 15.0
        while cache.newest("uav-1") is None and time.monotonic() < deadline:
            time.sleep(0.02)
        reply, age_s = cache.reply("uav-1"), cache.age_s("uav-1")
        assert reply is not None and age_s is not None
        assert LOST_S <= age_s < LOST_S + 20.0 and reply.age_s == pytest.approx(age_s, abs=0.5)
        refused = reply.fresh(3.0)
        assert not isinstance(refused, FeatureSet) and refused.status is Status.STALE
        # A refusal that comes now is young; the picture that can be clicked is not.
        while (reply.later is None) and time.monotonic() < deadline + 15.0:
            aircraft.picture(19, 0.1, Status.NO_GPS)
            time.sleep(0.05)
            reply = cache.reply("uav-1")
            assert reply is not None
        age_s = cache.age_s("uav-1")
        assert age_s is not None and age_s < 3.0
        refused = reply.fresh(3.0)
        assert reply.age_s is not None and reply.age_s >= LOST_S
        assert not isinstance(refused, FeatureSet) and "no_gps" in refused.reason
