"""Who asks to have the camera look at a place: what is offered, what is commanded, and everything that is refused."""

import dataclasses
import json
import math
import random
import threading
import time
from typing import Any

import numpy as np
import pytest

from contract.answer import Fix
from contract.feature_set import FeatureSet, HeightDatum, Status
from contract.locate import Locator
from contract.look import LATE_S, OFFER_S, AskCircle, AskLook, ConfirmLook, EndLook, LookRequest, Offer, parameters_of
from contract.mavlink_camera.status_texts import CHUNK_LENGTH, MAX_CHUNKS
from contract.vehicle_status import MAX_LOOK
from contract.wire.codec import decode, encode
from onboard.config.link import Look
from onboard.events.pointing import (
    ACCEPTED,
    NO_AUTOPILOT,
    NO_CIRCLE,
    NOT_ACKNOWLEDGED,
    ON_GROUND,
    CircleAbout,
    LookAhead,
    LookAt,
    Order,
)
from onboard.service.look_thread import BETWEEN_S, LookThread
from tests.contract.sets import plain_set

SET = decode(encode(dataclasses.replace(plain_set(200), frame=12)))
PIXEL = (320.0, 240.0)
FIX = Locator(SET).locate(PIXEL)
assert isinstance(FIX, Fix) and FIX.height_amsl_m is not None


class Autopilot:
    def __init__(self) -> None:
        self.orders: list[Order] = []
        self.words: list[str] = []
        self.height_m: float | None = 1000.0

    def command(self, order: Order) -> str:
        self.orders.append(order)
        return self.words.pop(0) if self.words else ACCEPTED

    def height_amsl_m(self) -> float | None:
        return self.height_m


class Aircraft:
    """A `LookThread` without its thread, on a clock of its own, over a picture of a given age."""

    def __init__(self, limits: Look | None = None, feature_set: FeatureSet = SET, age_s: float | None = 2.0) -> None:
        self.now_s = 100.0
        self.age_s = age_s
        self.autopilot = Autopilot()
        self.pilot: list[str] = []
        packet = encode(feature_set)
        self.thread = LookThread(
            limits or Look(max_radius_m=30.0),
            lambda frame: (packet, self.age_s) if frame == feature_set.frame else None,
            self.autopilot,
            lambda: self.now_s,
        )
        self.thread.notified.append(self.pilot.append)

    def ask(self, request: LookRequest | str, who: str = "anna") -> dict[str, Any]:
        answers: list[tuple[bytes, bool]] = []
        text = request if isinstance(request, str) else parameters_of(request)
        self.thread.ask(who, text, lambda payload, is_error: answers.append((payload, is_error)))
        self.thread.work()
        ((payload, is_error),) = answers
        content: dict[str, Any] = json.loads(payload)
        assert is_error == ("reason" in content)
        return content

    def confirm(self, offered: dict[str, Any], after_s: float = 5.0, who: str = "anna") -> dict[str, Any]:
        self.now_s += after_s
        return self.ask(ConfirmLook(offered["ticket"], after_s), who)


ASKED = AskLook(SET.session, SET.frame, *PIXEL, FIX.lat_deg, FIX.lon_deg, 5.0)


def test_a_confirmed_click_has_the_camera_look_at_the_aircrafts_own_answer_above_sea_level() -> None:
    aircraft = Aircraft()
    offered = aircraft.ask(ASKED)
    assert aircraft.autopilot.orders == []  # nothing before it is confirmed
    offer = Offer.of(offered)
    assert abs(offer.lat_deg - FIX.lat_deg) < 1e-6 and abs(offer.lon_deg - FIX.lon_deg) < 1e-6
    done = aircraft.confirm(offered)
    (order,) = aircraft.autopilot.orders
    assert isinstance(order, LookAt) and done["result"] == "accepted"
    assert (order.lat_deg, order.lon_deg) == (FIX.lat_deg, FIX.lon_deg)
    assert FIX.height_ellipsoid_m is not None and order.height_amsl_m == FIX.height_amsl_m
    assert order.height_amsl_m == pytest.approx(FIX.height_ellipsoid_m - SET.undulation_m, abs=0.01)
    where = f"at {FIX.lat_deg:.5f} {FIX.lon_deg:.5f}, {FIX.height_amsl_m:.0f} m"
    assert aircraft.thread.newest == f"anna: {where}: accepted"  # for everybody's eyes
    assert aircraft.pilot == [f"anna has the camera look {where}"]


CIRCLES = Look(max_radius_m=30.0, circle_radius_m=120.0, circle_clearance_m=60.0)


def looking(limits: Look = CIRCLES, height_m: float | None = 1000.0, age_s: float = 2.0) -> tuple[Aircraft, str]:
    aircraft = Aircraft(limits, age_s=age_s)
    aircraft.autopilot.height_m = height_m
    offered = aircraft.ask(ASKED)
    assert aircraft.confirm(offered)["may_circle"] == (limits.circle_radius_m is not None)
    aircraft.now_s += BETWEEN_S
    return aircraft, offered["ticket"]


def test_it_circles_about_what_the_camera_looks_at_only_once_place_and_height_are_confirmed_again() -> None:
    aircraft, ticket = looking()
    offered = aircraft.ask(AskCircle(ticket))
    assert len(aircraft.autopilot.orders) == 1  # the look alone
    circle, place = Offer.of(offered).circle, FIX.height_amsl_m
    assert circle is not None and place is not None and offered["ticket"] != ticket
    assert (circle.radius_m, circle.height_amsl_m) == (120.0, 1000.0)
    assert circle.above_place_m == pytest.approx(1000.0 - place, abs=0.06)
    done = aircraft.confirm(offered)
    order = aircraft.autopilot.orders[-1]
    assert order == CircleAbout(FIX.lat_deg, FIX.lon_deg, 1000.0, 120.0)
    assert (done["result"], done["radius_m"]) == ("accepted", 120.0) and "may_circle" not in done
    words = f"circling {FIX.lat_deg:.5f} {FIX.lon_deg:.5f} at 1000 m, radius 120 m"
    assert (
        aircraft.thread.newest == f"anna: {words}: accepted" and aircraft.pilot[-1] == f"anna has the aircraft {words}"
    )


def test_the_height_that_was_confirmed_is_sent_whatever_the_aircraft_has_done_since() -> None:
    aircraft, ticket = looking()
    offered = aircraft.ask(AskCircle(ticket))
    aircraft.autopilot.height_m = 500.0
    aircraft.confirm(offered)
    assert isinstance(order := aircraft.autopilot.orders[-1], CircleAbout) and order.height_amsl_m == 1000.0


SIGMA_M = math.sqrt(FIX.covariance_enu_m2[2, 2])
LEAST_M = FIX.height_amsl_m + 60.0 + 1.645 * SIGMA_M


@pytest.mark.parametrize(
    ("height_m", "word"), [(LEAST_M + 0.1, ""), (LEAST_M - 0.1, "too_low"), (None, "no_height"), (math.nan, "too_low")]
)
def test_a_circle_lower_than_the_clearance_above_what_the_place_may_be_is_refused(
    height_m: float | None, word: str
) -> None:
    aircraft, ticket = looking(height_m=height_m)
    assert aircraft.ask(AskCircle(ticket)).get("status", "") == word and len(aircraft.autopilot.orders) == 1


def test_no_circle_without_its_radius_a_look_before_or_for_another_and_none_of_old_pictures() -> None:
    aircraft, ticket = looking(Look(max_radius_m=30.0))
    assert aircraft.ask(AskCircle(ticket))["status"] == "not_allowed"
    aircraft, ticket = looking()
    for _ in range(20):  # asked again and again it is still known
        assert "ticket" in aircraft.ask(AskCircle(ticket))
    assert aircraft.ask(AskCircle(ticket), "ben")["status"] == "not_looking"
    assert aircraft.ask(AskCircle("0" * 16))["status"] == "not_looking"
    offered = aircraft.ask(ASKED)  # and not confirmed
    assert aircraft.ask(AskCircle(offered["ticket"]))["status"] == "not_looking"
    assert aircraft.ask(EndLook())["result"] == "accepted"
    assert aircraft.ask(AskCircle(ticket))["status"] == "not_looking"
    aircraft, ticket = looking(age_s=50.0)
    assert "ticket" in aircraft.ask(AskCircle(ticket))
    aircraft.now_s += 4.0
    assert aircraft.ask(AskCircle(ticket))["status"] == "stale"


@pytest.mark.parametrize("who", ["anna", "ben"])
@pytest.mark.parametrize("word", [ACCEPTED, NOT_ACKNOWLEDGED, "denied", NO_AUTOPILOT])
@pytest.mark.parametrize("is_end", [True, False])
def test_a_circle_that_was_offered_is_not_done_once_the_camera_may_look_elsewhere(
    who: str, word: str, is_end: bool
) -> None:
    aircraft, ticket = looking()
    offered, elsewhere = aircraft.ask(AskCircle(ticket)), aircraft.ask(ASKED, who)
    aircraft.autopilot.words = [word]
    aircraft.ask(EndLook() if is_end else ConfirmLook(elsewhere["ticket"], 0.0), who)
    aircraft.now_s += BETWEEN_S
    is_as_it_was = word == NO_AUTOPILOT  # then nothing was sent
    assert aircraft.confirm(offered).get("status", "") == ("" if is_as_it_was else "not_looking")
    assert isinstance(aircraft.autopilot.orders[-1], CircleAbout) == is_as_it_was
    assert ("ticket" in aircraft.ask(AskCircle(ticket))) == is_as_it_was


@pytest.mark.parametrize("word", [NOT_ACKNOWLEDGED, "temporarily_rejected", "command_unsupported_mav_frame", ACCEPTED])
@pytest.mark.parametrize("who", ["a", "n" * 32])
def test_however_long_the_names_what_came_of_it_is_whole(who: str, word: str) -> None:
    far = dataclasses.replace(SET, camera_lat_deg=-53.12345, camera_lon_deg=-153.12345)
    fix = Locator(far).locate(PIXEL)
    assert isinstance(fix, Fix)
    aircraft = Aircraft(Look(max_radius_m=30.0, circle_radius_m=1000.0), feature_set=far)
    aircraft.autopilot.height_m = 10_000.0
    look = aircraft.ask(dataclasses.replace(ASKED, lat_deg=fix.lat_deg, lon_deg=fix.lon_deg), who)
    aircraft.confirm(look, who=who)
    aircraft.now_s += BETWEEN_S
    aircraft.autopilot.words = [word]
    aircraft.confirm(aircraft.ask(AskCircle(look["ticket"]), who), who=who)
    shown, read = aircraft.thread.newest, f"pointclick: {aircraft.pilot[-1]}"
    assert shown.startswith(f"{who}: circling ") and shown.endswith(f": {word}") and 60 < len(shown) <= MAX_LOOK
    assert len(read) <= MAX_CHUNKS * CHUNK_LENGTH and read.startswith(f"pointclick: {who} has the aircraft ci")
    assert word == ACCEPTED or read.endswith(f": {word}")
    for text in (shown, read):  # a number is whole, or seen to be cut
        assert "at 10000 m, radius 1000 m" in text or "..." in text


def test_it_looks_ahead_again_when_that_is_asked_for() -> None:
    aircraft = Aircraft()
    assert aircraft.ask(EndLook()) == {"result": "accepted"}
    assert aircraft.autopilot.orders == [LookAhead()] and aircraft.thread.newest == "anna: ahead: accepted"


def test_asked_again_a_confirmation_has_the_same_answer_and_is_sent_once() -> None:
    aircraft = Aircraft()
    offered = aircraft.ask(ASKED)
    first = aircraft.confirm(offered)
    assert aircraft.confirm(offered, 0.1) == first and len(aircraft.autopilot.orders) == 1


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"session": SET.session - 1}, "unknown_frame"),
        ({"frame": 13}, "unknown_frame"),
        ({"u_px": 5000.0}, "outside"),
        ({"lat_deg": FIX.lat_deg + 0.001}, "contradiction"),
        ({"lon_deg": FIX.lon_deg + 0.001, "radius_m": 1e5}, "contradiction"),  # a stated radius counts to the limit
        ({"lon_deg": FIX.lon_deg - 180.0}, "contradiction"),
        ({"lat_deg": 0.0, "lon_deg": 0.0}, "contradiction"),
    ],
)
def test_a_click_that_does_not_hold_is_refused_and_nothing_is_sent(change: dict[str, float], word: str) -> None:
    aircraft = Aircraft()
    refused = aircraft.ask(dataclasses.replace(ASKED, **change))  # type: ignore[arg-type]
    assert refused["status"] == word and refused["reason"]
    assert aircraft.autopilot.orders == [] and aircraft.thread.newest == ""


def test_a_place_off_by_less_than_both_radii_is_no_contradiction() -> None:
    aircraft = Aircraft()
    offered = aircraft.ask(dataclasses.replace(ASKED, lat_deg=FIX.lat_deg + 4.0 / 111_000.0, radius_m=5.0))
    assert offered["lat_deg"] == pytest.approx(FIX.lat_deg, abs=1e-6)  # its own is offered, not what was asked for


@pytest.mark.parametrize(("age_s", "is_taken"), [(59.0, True), (61.0, False), (None, False), (float("nan"), False)])
def test_a_click_on_an_old_picture_or_one_of_unknown_age_is_refused(age_s: float | None, is_taken: bool) -> None:
    assert ("ticket" in Aircraft(age_s=age_s).ask(ASKED)) == is_taken
    assert is_taken or Aircraft(age_s=age_s).ask(ASKED)["status"] == "stale"


def test_a_place_that_is_not_known_well_enough_is_refused_with_its_radius() -> None:
    radius_m = Offer.of(Aircraft(Look(max_radius_m=1000.0)).ask(ASKED)).ce90_m
    assert "ticket" in Aircraft(Look(max_radius_m=radius_m + 0.2)).ask(ASKED)
    refused = Aircraft(Look(max_radius_m=radius_m - 0.2)).ask(ASKED)
    assert refused["status"] == "uncertain" and f"known to {radius_m:.0f} m" in refused["reason"]


def test_heights_above_the_ellipsoid_are_sent_as_heights_above_the_sea() -> None:
    above = dataclasses.replace(
        SET, height_datum=HeightDatum.ELLIPSOID, camera_height_m=SET.camera_height_m + SET.undulation_m
    )
    aircraft = Aircraft(feature_set=above)
    aircraft.confirm(aircraft.ask(ASKED))
    (order,) = aircraft.autopilot.orders
    assert isinstance(order, LookAt) and order.height_amsl_m == pytest.approx(FIX.height_amsl_m, abs=0.01)


def test_a_place_without_a_height_above_the_sea_is_refused() -> None:
    unknown = dataclasses.replace(SET, height_datum=HeightDatum.ELLIPSOID, undulation_m=math.nan)
    assert Aircraft(feature_set=unknown).ask(ASKED)["status"] == "no_height"


def test_a_picture_that_has_no_answer_is_refused_in_its_own_words() -> None:
    turning = FeatureSet(SET.vehicle, SET.session, SET.frame, SET.capture_unix_ns, Status.TURNING, SET.camera)
    refused = Aircraft(feature_set=turning).ask(ASKED)
    assert refused == {"status": "turning", "reason": "the aircraft was turning too fast"}


def test_what_was_long_on_its_way_is_refused_however_long_the_person_waited() -> None:
    aircraft = Aircraft()
    offered = aircraft.ask(ASKED)
    aircraft.now_s += 20.0
    assert aircraft.ask(ConfirmLook(offered["ticket"], 20.0 - LATE_S - 0.1))["status"] == "late"
    assert aircraft.ask(ConfirmLook(offered["ticket"], 20.0 - LATE_S + 0.1))["result"] == "accepted"
    offered = aircraft.ask(ASKED)
    assert aircraft.ask(ConfirmLook(offered["ticket"], OFFER_S + 0.1))["status"] == "late"  # a dialog left open
    aircraft.now_s += OFFER_S + 0.1
    assert aircraft.ask(ConfirmLook(offered["ticket"], OFFER_S))["status"] == "late"
    assert len(aircraft.autopilot.orders) == 1


def test_no_one_confirms_for_another_and_no_ticket_can_be_made_up() -> None:
    aircraft = Aircraft()
    offered = aircraft.ask(ASKED)
    assert aircraft.confirm(offered, who="ben")["status"] == "unknown_ticket"
    assert aircraft.ask(ConfirmLook("0" * 16, 0.0))["status"] == "unknown_ticket"
    assert aircraft.autopilot.orders == []


def test_the_camera_is_not_sent_to_and_fro() -> None:
    aircraft = Aircraft()
    one, other = aircraft.ask(ASKED), aircraft.ask(ASKED, "ben")
    assert aircraft.confirm(one, 1.0)["result"] == "accepted"
    assert aircraft.ask(ConfirmLook(other["ticket"], 0.9), "ben")["status"] == "busy"
    aircraft.now_s += BETWEEN_S - 0.1
    assert aircraft.ask(EndLook(), "ben")["status"] == "busy"
    aircraft.now_s += 0.2
    assert (
        aircraft.ask(ConfirmLook(other["ticket"], 3.0), "ben")["result"] == "accepted"
    )  # a busy one may be tried again
    assert len(aircraft.autopilot.orders) == 2


@pytest.mark.parametrize(
    ("word", "reason", "is_shown"),
    [
        ("denied", "the autopilot refuses: denied", True),
        ("temporarily_rejected", "refuses: temporarily rejected", True),
        (NOT_ACKNOWLEDGED, "has not acknowledged it: it may have been done or not", True),
        (NO_AUTOPILOT, "no autopilot is received: nothing was sent", False),
        (NO_CIRCLE, "does not report whether it is a VTOL: nothing was sent", True),
        (ON_GROUND, "is on the ground: nothing was sent", True),
    ],
)
def test_what_the_autopilot_makes_of_it_is_the_answer(word: str, reason: str, is_shown: bool) -> None:
    aircraft = Aircraft()
    aircraft.autopilot.words = [word]
    refused = aircraft.confirm(aircraft.ask(ASKED))
    assert refused["status"] == word and reason in refused["reason"]
    assert aircraft.thread.newest.endswith(f": {word}") == is_shown == bool(aircraft.pilot)


def test_what_is_sent_is_logged_with_who_where_and_what_came_of_it(caplog: pytest.LogCaptureFixture) -> None:
    aircraft = Aircraft()
    with caplog.at_level("INFO", "pointclick"):
        aircraft.confirm(aircraft.ask(ASKED))
    (line,) = caplog.messages
    assert line.startswith(f"look: anna has the camera look at {FIX.lat_deg:.5f} ") and line.endswith(": accepted")


def test_a_thousand_hostile_questions_a_second_neither_move_the_camera_nor_keep_others_out() -> None:
    rng = random.Random(5)
    aircraft = Aircraft()
    good = parameters_of(ASKED)
    answers: list[dict[str, Any]] = []

    def hostile() -> str:
        text = list(good)
        for _ in range(rng.randrange(1, 6)):
            text[rng.randrange(len(text))] = rng.choice("0123456789.=;nainfe-+ \0é")
        return rng.choice(["", "".join(text), "lat=nan", f"ticket={rng.randbytes(8).hex()};waited=0", good * 9])

    thread = LookThread(Look(max_radius_m=30.0), lambda _: (encode(SET), 2.0), aircraft.autopilot)
    with thread:
        for _ in range(1000):
            thread.ask("mallory", hostile(), lambda payload, _: answers.append(json.loads(payload)))
        done = threading.Event()
        offered: list[dict[str, Any]] = []

        def take(payload: bytes, _: bool) -> None:
            offered.append(json.loads(payload))
            done.set()

        while not (offered and "ticket" in offered[-1]):  # the queue is short: asked again, it is answered
            done.clear()
            thread.ask("anna", good, take)
            assert done.wait(60.0)
            time.sleep(0.01)
    assert len(answers) == 1000 and aircraft.autopilot.orders == []
    assert {answer.get("status", "offer") for answer in answers} <= {
        "busy", "bad_request", "unknown_ticket", "unknown_frame", "contradiction", "outside", "offer", "uncertain",
    }  # fmt: skip
    assert thread.thread.report().restarts == 0


@pytest.mark.parametrize("at", np.linspace(0.0, 479.0, 6).tolist())
def test_where_a_click_has_no_answer_there_is_no_offer(at: float) -> None:
    """Over the whole picture: an offer is made exactly where a click is answered within the limit."""
    aircraft = Aircraft()
    answer = Locator(SET).locate((100.0, at))
    where = (answer.lat_deg, answer.lon_deg) if isinstance(answer, Fix) else (0.0, 0.0)
    found = aircraft.ask(AskLook(SET.session, SET.frame, 100.0, at, *where, 5.0))
    assert ("ticket" in found) or found["status"] in (answer.status.value, "uncertain")
    assert "ticket" not in found or isinstance(answer, Fix)
