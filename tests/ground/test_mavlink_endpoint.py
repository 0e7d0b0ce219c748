"""`--connect mavlink:...`: what may be written, and which system numbers are refused."""

import math

import pytest

from contract.answer import Answer, Fix, Refusal
from contract.feature_set import Status
from ground.commands import sources
from ground.commands.sources import AskedClicker
from ground.link_options import UsageError
from ground.mavlink_endpoint import MavlinkEndpoint
from tests.contract.test_click_code import FIX


def test_the_usual_and_everything_reported() -> None:
    assert MavlinkEndpoint.parse("mavlink:udpin:0.0.0.0:14551") == MavlinkEndpoint("udpin", "0.0.0.0", 14551)
    assert MavlinkEndpoint.parse(
        "mavlink:serial:/dev/ttyUSB0:57600?system=200&component=26&vehicle=3&companion=192&ground_stations=250-255"
    ) == MavlinkEndpoint("serial", "/dev/ttyUSB0", 57600, 200, 26, 3, 192)


@pytest.mark.parametrize(
    ("options", "is_refused"),
    [
        ("system=255", True),
        ("system=254", False),
        ("system=250&ground_stations=250-255", True),
        ("system=249&ground_stations=250-255", False),
        ("ground_stations=240-250", True),  # ours without another word
        ("system=255&ground_stations=250", False),
    ],
)
def test_a_ground_station_s_number_is_refused_with_what_it_would_hide(options: str, is_refused: bool) -> None:
    text = f"mavlink:udpin:0.0.0.0:14551?{options}"
    if not is_refused:
        assert MavlinkEndpoint.parse(text).kind == "udpin"
        return
    with pytest.raises(UsageError, match="would not notice that its ground station is lost"):
        MavlinkEndpoint.parse(text)


class Link:
    def __init__(self, answer: Answer) -> None:
        self.answer = answer

    def ask(self, u_px: float, v_px: float, *, frame: int | None = None, capture_unix_ns: int | None = None) -> Answer:
        return self.answer


def clicked(answer: Answer, vehicle: str | None = None, max_age_s: float = 3.0) -> Answer:
    return AskedClicker(Link(answer), vehicle, max_age_s).click(1.0, 2.0)[0]


def test_an_answer_that_is_too_old_is_refused_as_over_the_link() -> None:
    young = clicked(FIX)
    assert 0.42 <= young.age_s < 1.0
    old = clicked(FIX, max_age_s=0.1)
    assert old.status is Status.STALE and "0.4 s old" in old.reason
    assert isinstance(clicked(FIX, max_age_s=math.inf), Fix)
    turning = clicked(Refusal(Status.TURNING, vehicle="uav-1"))
    assert turning.reason == "the aircraft was turning too fast"
    starting = clicked(Refusal(Status.STARTING, vehicle="uav-1", detail="no gps: no fix"))
    assert starting.status is Status.STARTING
    assert starting.reason == "the aircraft has no solved picture yet; the aircraft reports: no gps: no fix"


def test_a_thin_radios_own_delay_makes_no_picture_stale(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = iter((100.0, 105.6))
    monkeypatch.setattr(sources.time, "monotonic", lambda: next(now_s))
    found = clicked(FIX)
    assert found.age_s == pytest.approx(6.02)


def test_the_vehicle_that_answers_must_be_the_one_that_is_meant() -> None:
    assert clicked(FIX, "uav-1").vehicle == "uav-1"
    with pytest.raises(UsageError, match="no vehicle 'uav-2'"):
        clicked(FIX, "uav-2")
