"""A click without --frame or --time means the newest picture: live, the aircraft's clock years off the ground's.

The pictures' ages come from the arrivals of events, so that a set 25 s old needs no 25 s of waiting.
"""

import dataclasses
import json
import re
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
from tests.onboard.link.asking import answered
from tests.onboard.link.ports import free_endpoint
from tests.waiting import eventually

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
        """Asked again where the link was too slow to answer at all."""
        printed: list[tuple[int, str]] = []

        def is_answered() -> bool:
            code = main(["click", "320", "240", "--connect", endpoint, "--format", "json", *options])
            printed.append((code, capsys.readouterr().out))
            return code != 2

        assert eventually(is_answered)
        return printed[-1][0], json.loads(printed[-1][1])

    return run


class Since:
    """Time that goes by in a test: so much older may a picture be."""

    def __init__(self) -> None:
        self._began_s = time.monotonic()

    def holds(self, age_s: float | None, at_first_s: float) -> bool:
        """Whether an age is what it was at first and at most what has gone by since, and half a second."""
        return age_s is not None and at_first_s <= age_s <= at_first_s + time.monotonic() - self._began_s + 0.5


def reported_age_s(pattern: str, text: str) -> float:
    found = re.search(pattern, text)
    assert found is not None, text
    return float(found[1])


def fly(aircraft: Aircraft, cause: Status | None) -> None:
    """Ten pictures that answer, the last of them LOST_S ago, and refusals since, or nothing."""
    for frame in range(10):
        aircraft.picture(frame, LOST_S + 0.2 * (9 - frame))
    if cause is not None:
        for frame in range(10, 20):
            aircraft.picture(frame, LOST_S * (19 - frame) / 10.0 + 0.1, cause)


def test_a_fresh_picture_is_answered_with_its_age(aircraft: Aircraft, click: Click) -> None:
    frame, answer = 1, {}

    def is_fresh() -> bool:
        """With new pictures, where a busy machine let the last ones grow old."""
        nonlocal frame, answer
        frame += 2
        aircraft.picture(frame, 0.4)
        aircraft.picture(frame + 1, 0.2, Status.TURNING)
        code, answer = click()
        return code == 0

    assert eventually(is_fresh), answer
    assert answer["status"] == "ok" and answer["frame"] == frame
    assert 0.4 <= answer["age_s"] <= 3.0


LOST = [
    (Status.NO_GPS, "no gps", "the position is not accepted", "frame 19, ", "no_gps: there was no usable GPS"),
    (Status.UNSYNCHRONISED, "telemetry lost", "nothing for 25 s", "frame 19, ", "unsynchronised: picture and"),
    (None, "camera lost", "no such device", "camera lost", "no such device"),
    (None, "", "", "no newer picture came", ""),
]


@pytest.mark.parametrize(("cause", "state", "reason", "first", "second"), LOST)
def test_with_gps_telemetry_or_camera_gone_the_old_picture_is_refused_with_the_reason(
    aircraft: Aircraft, click: Click, endpoint: str, capsys: pytest.CaptureFixture[str], cause: Status | None,
    state: str, reason: str, first: str, second: str,
) -> None:  # fmt: skip
    since = Since()
    fly(aircraft, cause)
    if state:
        aircraft.says(state, reason)
    code, answer = click()
    assert code == 3 and answer["status"] == "stale" and answer["frame"] == 9
    assert since.holds(answer["age_s"], LOST_S)
    assert first in answer["reason"] and second in answer["reason"] and reason in answer["reason"]
    if cause is not None:
        assert since.holds(reported_age_s(r"frame 19, (\d+\.\d) s old", answer["reason"]), 0.1)
    printed: list[str] = []

    def is_refused() -> bool:
        code = main(["click", "320", "240", "--connect", endpoint])
        out, err = capsys.readouterr()
        assert out == ""
        printed.append(err)
        return code == 3

    assert eventually(is_refused)
    age_s = reported_age_s(r"^stale: the newest picture that can be clicked is (\d+\.\d) s old", printed[-1])
    assert since.holds(age_s, LOST_S) and printed[-1].count("\n") == 1
    # Who wants that very picture still gets it, with its age.
    for options in (["--max-age", "300"], ["--max-age", "inf"], ["--frame", "9"]):
        code, answer = click(*options)
        assert code == 0 and answer["status"] == "ok" and answer["frame"] == 9
        assert since.holds(answer["age_s"], LOST_S)


def test_the_limit_holds_on_both_sides_and_time_goes_on_without_events(aircraft: Aircraft, click: Click) -> None:
    began_s = time.monotonic()
    aircraft.picture(0, 10.0)
    assert click("--max-age", "10")[0] == 3
    code, answer = click("--max-age", "300")
    assert code == 0 and 10.0 <= answer["age_s"] <= 10.0 + time.monotonic() - began_s + 0.5
    time.sleep(0.3)  # all threads stand still on board
    assert click("--max-age", "300")[1]["age_s"] >= answer["age_s"] + 0.3


def test_a_refused_picture_that_is_old_is_stale_too(aircraft: Aircraft, click: Click) -> None:
    aircraft.picture(0, LOST_S, Status.LOW_PARALLAX)
    aircraft.says("camera lost", "no such device")
    code, answer = click()
    assert code == 3 and answer["status"] == "stale"
    assert "low_parallax" in answer["reason"] and "camera lost: no such device" in answer["reason"]
    frame = 0

    def is_fresh() -> bool:
        nonlocal frame, code, answer
        frame += 1
        aircraft.picture(frame, 0.1, Status.LOW_PARALLAX)
        code, answer = click()
        return answer["status"] != "stale"

    assert eventually(is_fresh)
    assert code == 3 and answer["status"] == "low_parallax" and answer["frame"] == frame and answer["age_s"] <= 3.0


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
    since = Since()
    aircraft.picture(0, 1.0)
    reply = answered(lambda: inquire(endpoint))["uav-1"]
    assert since.holds(reply.age_s, 1.0)


def test_a_listener_that_comes_later_knows_how_old_the_repeated_picture_is(aircraft: Aircraft, endpoint: str) -> None:
    """With nothing newer the newest set is sent again: to have received it just now does not make it young."""
    since = Since()
    fly(aircraft, None)
    with SetCache(endpoint) as cache:
        # The last of the ten: older ones that the link had not carried yet may come before it.
        assert eventually(lambda: (newest := cache.newest("uav-1")) is not None and newest.frame == 9)
        # Until it has answered what its clock shows, its pictures may be as old as the clocks differ.
        assert eventually(lambda: cache.doubt("uav-1").startswith("the aircraft's clock is 9 years behind"))
        asking = Since()
        reply, age_s = cache.reply("uav-1"), cache.age_s("uav-1")
        assert reply.age_s is not None
        assert since.holds(age_s, LOST_S) and asking.holds(age_s, reply.age_s)
        refused = reply.fresh(3.0)
        assert not isinstance(refused, FeatureSet) and refused.status is Status.STALE
        # A refusal that comes now is young; the picture that can be clicked is not.
        refusing = Since()

        def is_refused() -> bool:
            aircraft.picture(19, 0.1, Status.NO_GPS)
            found = cache.reply("uav-1")
            return found is not None and found.later is not None

        assert eventually(is_refused)
        assert refusing.holds(cache.age_s("uav-1"), 0.0)
        reply = cache.reply("uav-1")
        refused = reply.fresh(3.0)
        assert reply.age_s >= LOST_S
        assert not isinstance(refused, FeatureSet) and "no_gps" in refused.reason
