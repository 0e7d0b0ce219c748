"""Having a camera look at what was clicked, on the page and behind it: a role of its own, confirmed, ended, refused."""

import argparse
import dataclasses
import json
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from contract.answer import Fix
from contract.errors import LinkError
from contract.link_config import Rights, Tls
from contract.locate import Locator
from contract.look import AskCircle, AskLook, ConfirmLook, EndLook, Offer
from contract.topics import STATUS
from contract.vehicle_status import VehicleStatus, encode_status
from ground.__main__ import main
from ground.web.guard import Rules
from ground.web.live import LiveSource
from ground.web.startup import WebError, tokens_of
from onboard.link.certificates import make_credentials
from onboard.link.publisher import Publisher, Rate
from tests.onboard.link.asking import answered
from tests.onboard.link.ports import free_endpoint
from tests.waiting import eventually
from tests.web.browsing import Operator
from tests.web.flying import Flying, requests_to
from tests.web.rendered import VEHICLE, rendered_set

pytestmark = pytest.mark.xdist_group("web: a flight in motion")

TOKENS = {"operator": "operators-token-1234", "viewer": "viewers-token-1234", "pointer": "pointers-token-1234"}
RULES = Rules(TOKENS["operator"], viewer_token=TOKENS["viewer"], pointer_token=TOKENS["pointer"])


def seat(role: str) -> dict[str, Any]:
    return {"rules": RULES, "token": TOKENS[role], "has_map": False}


def headers(role: str) -> dict[str, str]:
    return {"authorization": f"Bearer {TOKENS[role]}"}


def body(**more: Any) -> dict[str, Any]:
    return {"vehicle": VEHICLE, "frame": 0, "session": rendered_set(0).session, "u": 320.0, "v": 200.0, **more}


# Behind the page.


def test_a_click_is_offered_confirmed_and_ended_by_requests(tmp_path: Path) -> None:
    fix = Locator(rendered_set(0)).locate((320.0, 200.0))
    assert isinstance(fix, Fix)
    with requests_to(tmp_path, RULES) as (client, source):
        offered = client.post("/api/look", json=body(), headers=headers("pointer"))
        assert offered.status_code == 200
        content = offered.json()
        assert (content["vehicle"], content["height_amsl_m"]) == (VEHICLE, 400.0)
        assert abs(content["lat_deg"] - fix.lat_deg) < 1e-7 and abs(content["lon_deg"] - fix.lon_deg) < 1e-7
        (asked,) = source.looked
        assert isinstance(asked, AskLook)
        assert (asked.session, asked.frame, asked.u_px, asked.v_px) == (rendered_set(0).session, 0, 320.0, 200.0)
        assert (asked.lat_deg, asked.lon_deg) == (fix.lat_deg, fix.lon_deg)
        confirmation = {"vehicle": VEHICLE, "ticket": content["ticket"], "waited_s": 3.5}
        done = client.post("/api/look/confirm", json=confirmation, headers=headers("pointer"))
        assert done.json() == {"result": "accepted"} and source.looked[1] == ConfirmLook(content["ticket"], 3.5)
        assert client.get("/api/vehicles", headers=headers("viewer")).json()[0]["look"].startswith("anna: at 47")
        source.look_refusal = "denied: the autopilot refuses: denied"
        refused = client.post("/api/look/ahead", json={"vehicle": VEHICLE}, headers=headers("pointer"))
        assert (refused.status_code, refused.json()["detail"]) == (422, source.look_refusal)
        assert source.looked[2] == EndLook()


def test_a_click_without_an_answer_does_not_get_to_the_aircraft(tmp_path: Path) -> None:
    with requests_to(tmp_path, RULES) as (client, source):
        refused = client.post("/api/look", json=body(v=9000.0), headers=headers("pointer"))
        assert refused.status_code == 422 and "outside" in refused.json()["detail"] and source.looked == []


@pytest.mark.parametrize(
    "path", ["/api/look", "/api/look/circle", "/api/look/confirm", "/api/look/ahead", "/api/look/", "/api//look"]
)
@pytest.mark.parametrize("role", ["operator", "viewer"])
def test_no_other_role_has_a_camera_turned(tmp_path: Path, role: str, path: str) -> None:
    with requests_to(tmp_path, RULES) as (client, source):
        for content in (body(), {"vehicle": VEHICLE}, {"vehicle": VEHICLE, "ticket": "ab", "waited_s": 0.0}):
            refused = client.post(path, json=content, headers=headers(role))
            assert refused.status_code in (403, 404, 405) and source.looked == []


def test_a_pointer_may_what_an_operator_may_and_where_no_token_is_asked_for_no_one_points(tmp_path: Path) -> None:
    with requests_to(tmp_path, RULES) as (client, source):
        assert client.get("/api/status", headers=headers("pointer")).json()["role"] == "pointer"
        assert client.post("/api/tracks", json=body(), headers=headers("pointer")).status_code == 201
    (tmp_path / "open").mkdir()
    with requests_to(tmp_path / "open") as (client, source):
        assert client.post("/api/tracks", json=body()).status_code == 201
        refused = client.post("/api/look", json=body())
        assert refused.status_code == 403 and "no camera is sent anywhere" in refused.text and source.looked == []


@pytest.mark.parametrize(
    "wrong",
    [
        {"ticket": "../x"}, {"ticket": ""}, {"ticket": "a" * 33}, {"waited_s": -1.0},
        {"waited_s": "nan"}, {"waited_s": "inf"}, {"more": 1}, {"vehicle": "x" * 201},
    ],
)  # fmt: skip
def test_a_confirmation_that_is_none_does_not_get_to_the_aircraft(tmp_path: Path, wrong: dict[str, Any]) -> None:
    content = {"vehicle": VEHICLE, "ticket": "ab", "waited_s": 1.0} | wrong
    with requests_to(tmp_path, RULES) as (client, source):
        assert client.post("/api/look/confirm", json=content, headers=headers("pointer")).status_code == 422
        assert source.looked == []


def test_tokens_of_roles_differ_and_a_pointers_makes_the_page_ask(tmp_path: Path) -> None:
    given = {"host": "127.0.0.1", "token": None, "viewer_token": None, "pointer_token": None}
    assert tokens_of(argparse.Namespace(**given)).operator == ""
    made = tokens_of(argparse.Namespace(**given | {"pointer_token": ""}))
    assert len(made.operator) >= 16 and len(made.pointer) >= 16 and made.operator != made.pointer and not made.viewer
    for same in ({"token": "x" * 16}, {"viewer_token": "x" * 16}):
        with pytest.raises(WebError, match="must differ"):
            tokens_of(argparse.Namespace(**given | {"pointer_token": "x" * 16} | same))


def test_a_pointers_link_without_certificates_is_refused_at_the_start(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["web", "--pointer-token"]) == 2
    assert "--pointer-token is for a live link with --credentials" in capsys.readouterr().err


def test_a_live_aircraft_is_asked_in_the_name_of_the_servers_certificate(tmp_path: Path) -> None:
    make_credentials(tmp_path, [VEHICLE], ["base", "ben"], [], 30.0)
    endpoint = free_endpoint().replace("tcp/", "tls/")
    asked: list[tuple[str, str]] = []

    def look(who: str, parameters: str, done: Callable[[bytes, bool], object]) -> None:
        asked.append((who, parameters))
        done(Offer("ab", 47.0, 8.0, 400.0, 3.0, 1.0).to_json(), False)

    tls = {name: Tls.in_folder(tmp_path / name) for name in (VEHICLE, "base", "ben")}
    with Publisher(VEHICLE, [endpoint], rate=Rate(1e6), tls=tls[VEHICLE], rights=Rights(pointers=["base"])) as flying:
        flying.have_look = look
        status = VehicleStatus(time.time(), rendered_set(0).session, "ok")

        def is_received(source: LiveSource, looks: bool) -> bool:
            flying.publish(dataclasses.replace(rendered_set(0), capture_unix_ns=time.time_ns()))
            flying.report(STATUS, encode_status(dataclasses.replace(status, looks=looks)))
            report = source.report(VEHICLE)
            is_known = report.status is not None and report.status.looks == looks
            return is_known and bool(source.frames(VEHICLE))

        with closing(LiveSource([endpoint], tls["base"])) as source:
            assert "is known here" in source.unlooked("uav-9")
            assert eventually(lambda: is_received(source, False))
            assert "its link.pointers is empty" in source.unlooked(VEHICLE)
            with pytest.raises(LinkError, match="pointers is empty"):
                source.look(VEHICLE, EndLook())
            assert eventually(lambda: is_received(source, True))
            assert source.unlooked(VEHICLE) == ""
            content = answered(lambda: source.look(VEHICLE, EndLook()))
            assert content["ticket"] == "ab" and {who for who, _ in asked} == {"base"}
        with closing(LiveSource([endpoint], tls["ben"])) as source:
            assert eventually(lambda: is_received(source, True))
            with pytest.raises(LinkError, match=r"does not answer 'ben'"):
                source.look(VEHICLE, EndLook())
        assert {who for who, _ in asked} == {"base"}


# On the page.


def states(operator: Operator, words: str) -> None:
    operator.page.wait_for_function(
        "words => document.querySelector('[data-testid=answer]').textContent.includes(words)", arg=words
    )


def test_the_place_is_confirmed_before_the_camera_turns_and_everybody_sees_it(flying: Flying) -> None:
    flight, anna = flying(**seat("pointer"))
    page, source = anna.page, flight.source
    assert "90 % within" in anna.click(400.0, 300.0)
    anna.by("look-there").click()
    page.wait_for_selector("#look-dialog[open]")
    asked = source.looked[0]
    assert isinstance(asked, AskLook) and len(source.looked) == 1
    shown = [float(part) for part in anna.by("look-place").inner_text().split(", ")]
    assert shown == pytest.approx([asked.lat_deg, asked.lon_deg], abs=2e-5)
    assert anna.by("look-height").inner_text().startswith("400 m above sea level, 90 % within")
    assert page.locator("#look-title").inner_text() == "Have the camera of uav-1 look there?"
    # The button that does nothing has the focus: Enter by habit turns no camera.
    page.keyboard.press("Enter")
    states(anna, "Not confirmed: nothing was sent.")
    assert len(source.looked) == 1
    anna.by("look-there").click()  # it is still offered
    page.wait_for_selector("#look-dialog[open]")
    anna.by("look-go").click()
    states(anna, "Accepted by the autopilot: the camera of uav-1 looks at")
    confirmed = source.looked[-1]
    assert isinstance(confirmed, ConfirmLook) and 0.0 <= confirmed.waited_s < 30.0
    page.locator(".craft").click()
    page.wait_for_function("() => document.querySelector('#craft-card').textContent.includes('anna: at 47.00000')")
    assert json.loads(page.request.get(f"{flight.local}api/status").text())["role"] == "pointer"
    anna.by("look-ahead").click()
    states(anna, "the camera of uav-1 looks ahead again")
    assert source.looked[-1] == EndLook()
    anna.by("look-ahead").wait_for(state="detached")  # nothing is left to be ended


def test_the_aircraft_circles_only_once_place_height_and_radius_are_confirmed_as_well(flying: Flying) -> None:
    flight, anna = flying(**seat("pointer"))
    page, source = anna.page, flight.source
    source.may_circle = True
    anna.click(400.0, 300.0)
    assert anna.by("circle-there").count() == 0
    anna.by("look-there").click()
    page.wait_for_selector("#look-dialog[open]")
    anna.by("look-go").click()
    anna.by("circle-there").click()  # as soon as the autopilot has accepted the look
    page.wait_for_selector("#look-dialog[open]")
    assert source.looked[-1] == AskCircle("0123456789abcdef") and len(source.looked) == 3
    assert page.locator("#look-title").inner_text() == "Have uav-1 circle there?"
    words = "at 520 m above sea level, 120 m above the place; radius 120 m"
    assert anna.by("look-height").inner_text() == words and anna.by("look-go").inner_text() == "Fly the circle"
    page.keyboard.press("Enter")
    states(anna, "Not confirmed: no circle was sent; the camera of uav-1 still looks there.")
    assert len(source.looked) == 3
    anna.by("look-there").click()
    page.wait_for_selector("#look-dialog[open]")
    assert anna.by("look-go").inner_text() == "Turn the camera"
    anna.by("look-go").click()
    anna.by("circle-there").click()
    page.wait_for_selector("#look-dialog[open]")
    anna.by("look-go").click()
    states(anna, "Accepted by the autopilot: uav-1 circles about 47.0")
    assert isinstance(source.looked[-1], ConfirmLook) and anna.by("circle-there").count() == 0


def test_a_refusal_is_stated_with_its_reason(flying: Flying) -> None:
    flight, anna = flying(**seat("pointer"))
    flight.source.look_refusal = "late: offer and confirmation were 9 s on their way: click again"
    anna.click(400.0, 300.0)
    anna.by("look-there").click()
    anna.page.wait_for_selector("#look-dialog[open]")
    anna.by("look-go").click()
    states(anna, "Not done: late: offer and confirmation were 9 s on their way")
    assert anna.by("answer").get_attribute("data-kind") == "refused"


@pytest.mark.parametrize(("role", "why"), [("operator", ""), ("viewer", ""), ("pointer", "its link.pointers is empty")])
def test_who_may_not_has_no_button(flying: Flying, role: str, why: str) -> None:
    flight, anna = flying(**seat(role))
    flight.source.why_unlooked = why
    flight.source.look_words = "ben: at 47.00000 8.00000, 400 m: accepted"
    anna.open()
    assert "90 % within" in anna.click(400.0, 300.0)
    assert anna.by("look-there").count() == 0
    anna.page.locator(".craft").click()
    anna.page.wait_for_function("() => document.querySelector('#craft-card').textContent.includes('ben: at 47.00000')")
    assert anna.by("look-ahead").count() == 0 and flight.source.looked == []
