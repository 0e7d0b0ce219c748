"""A machine's finds on the page: listed, alarmed, confirmed to pins, dismissed; and behind it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from contract.answer import Ellipse, Fix, Place
from contract.feature_set import Status
from contract.locate import Locator
from contract.spot import Spot, SpotReport, ThingKind
from tests.waiting import eventually
from tests.web.flying import Flying, requests_to
from tests.web.rendered import VEHICLE, rendered_set

pytestmark = pytest.mark.xdist_group("web: a flight in motion")

PLACES = ((400.0, 300.0, 36.5), (200.0, 200.0, 52.0), (300.0, 120.0, 20.0))  # pixel of picture 0, temperature


def report(frame: int, count: int = 2, vehicle: str = VEHICLE) -> SpotReport:
    """The first of PLACES as a picture shows them: where they are on the ground does not change.

    The third is hardly warmer than its ground, but a net takes it for a person.
    """
    s = rendered_set(frame)
    spots = []
    for u, v, temperature_c in PLACES[:count]:
        found = Locator(rendered_set(0)).locate((u, v))
        assert isinstance(found, Fix)
        place = Place(
            found.lat_deg, found.lon_deg, found.height_amsl_m, found.height_ellipsoid_m, Ellipse(3.0, 2.0, 30.0), 2.0
        )
        named = (ThingKind.PERSON, 2.2) if temperature_c == 20.0 else (None, 0.0)
        spots.append(Spot(u, v + 17.0 * frame, 9.0, temperature_c, 15.0, Status.OK, place, 0.5, 0.1, (), False, *named))
    return SpotReport(s.session, frame, s.capture_unix_ns, True, tuple(spots), 0, 0.8, 0.6, vehicle, 0.962)


def states(client: TestClient) -> dict[int, str]:
    return {spot["spot"]: spot["state"] for spot in client.get("/api/spots").json()["spots"]}


def test_a_find_becomes_a_pin_with_its_source_or_is_dismissed_and_both_are_undone(tmp_path: Path) -> None:
    with requests_to(tmp_path) as (client, source):
        source.fly_to(9)
        source.views.spots.add([report(0), report(1)])
        assert states(client) == {1: "open", 2: "open"}
        assert client.get("/api/status").json()["vehicles"][0]["person_found"] == 0.962
        made = client.post("/api/spots/1/confirm", json={"category": "person", "who": "anna"})
        assert made.status_code == 201
        pin = made.json()
        assert pin["category"] == "person" and "hot spot 1, confirmed by anna: 36.5 degC" in pin["note"]
        assert pin["clicks"][0]["method"] == "hot spot" and 2.0 < pin["place"]["ce90_m"] < 3.5
        assert client.get(f"/api/pins/{pin['id']}/crop").status_code == 200
        dismissed = client.post("/api/spots/2/dismiss", json={"who": "ben"})
        assert dismissed.status_code == 200
        assert states(client) == {1: "confirmed", 2: "dismissed"}
        assert [p["id"] for p in client.get("/api/pins").json()["pins"]] == [pin["id"]]
        for number in (1, 2):
            for what in ("confirm", "dismiss"):
                assert client.post(f"/api/spots/{number}/{what}", json={}).status_code == 409
        source.views.spots.add([report(2), report(3)])  # seen again: it stays what was decided
        assert states(client) == {1: "confirmed", 2: "dismissed"}
        assert client.post("/api/undo", json={"who": "ben"}).json()["undone"] is not None
        assert states(client)[2] == "confirmed"  # the dismissal is taken back: it is a pin
        assert client.post("/api/spots/9/confirm", json={}).status_code == 404
        assert client.post("/api/spots/1/confirm", json={"kind": 1}).status_code == 422
        assert client.get("/api/spots/1/crop").headers["content-type"] == "image/jpeg"


def test_a_picture_states_where_in_it_each_find_is(tmp_path: Path) -> None:
    """A walker's ring was where he had come to by the end, in all pictures of his way."""
    with requests_to(tmp_path) as (client, source):
        source.fly_to(9)
        source.views.spots.add([report(k) for k in range(3)])
        for frame in range(3):
            view = client.get(f"/api/vehicles/{VEHICLE}/frames/{frame}/features").json()
            assert view["spots"] == {"1": [400.0, 300.0 + 17.0 * frame], "2": [200.0, 200.0 + 17.0 * frame]}
        assert client.get(f"/api/vehicles/{VEHICLE}/frames/5/features").json()["spots"] == {}


def test_a_second_camera_that_is_lost_is_named_and_nothing_is_claimed_of_its_search(tmp_path: Path) -> None:
    """Before, the share of the last picture that it had searched stayed there."""
    with requests_to(tmp_path) as (client, source):
        source.views.spots.add([report(0), report(1)])
        source.heat = "lost: no picture for 3.0 s"
        state = client.get("/api/status").json()["vehicles"][0]
    assert "no hot spots: thermal camera lost: no picture for 3.0 s" in state["words"]
    assert state["person_found"] is None


def test_what_one_server_dismissed_another_that_has_its_pins_does_not_show(tmp_path: Path) -> None:
    """Pins are shared with their tombstones; the other server numbers its finds in its own way."""
    with requests_to(tmp_path) as (client, source):
        source.views.spots.add([report(0), report(1), report(2)])
        client.post("/api/spots/2/dismiss", json={"who": "ben"})
    with requests_to(tmp_path) as (client, source):
        source.views.spots.add([replace(r, spots=r.spots[::-1]) for r in (report(1), report(2), report(3))])
        found = client.get("/api/spots").json()["spots"]
        assert {round(spot["temperature_c"]): spot["state"] for spot in found} == {52: "dismissed", 36: "open"}


def test_finds_come_as_events(tmp_path: Path) -> None:
    headers = {"host": "127.0.0.1:8080"}
    with requests_to(tmp_path) as (client, source), client.websocket_connect("/api/events", headers=headers) as socket:
        source.views.spots.add([report(0), report(1)])
        received: list[dict[str, Any]] = []
        while not received:
            event = socket.receive_json()
            received = event["spots"] if event["type"] == "spots" else []
    assert received[-1]["heat"].startswith("52.0 degC, +15.0 K") and received[-1]["pictures"] <= 2


# Counts the tones that the page plays.
_LISTEN = """() => { window.tones = 0; const start = OscillatorNode.prototype.start;
  OscillatorNode.prototype.start = function (...a) { window.tones += 1; return start.apply(this, a); }; }"""


def test_a_find_alarms_is_confirmed_or_dismissed_and_the_sound_can_be_muted(flying: Flying) -> None:
    flight, anna = flying()
    page = anna.page
    page.evaluate(_LISTEN)
    assert anna.by("found-list").is_hidden()
    flight.source.views.spots.add([report(0, 1)])
    flight.source.fly_to(2)
    anna.wait_for_frame(1)
    assert anna.by("found").count() == 0  # one picture alone may be noise
    flight.source.views.spots.add([report(1, 1)])
    page.wait_for_selector("[data-testid=found][data-news=yes]")
    assert page.evaluate("window.tones") == 3 and anna.by("found-list").get_attribute("data-alarm") == "yes"
    flight.source.views.spots.add([report(2), report(3)])
    page.wait_for_function("() => document.querySelectorAll('[data-testid=found]').length === 2")
    assert anna.by("found-count").inner_text() == "Hot spots 2, the hottest 52.0 °C"
    rows = {row.get_attribute("data-spot"): row.bounding_box()["y"] for row in anna.by("found").all()}
    assert rows["2"] < rows["1"]  # the hottest first
    assert eventually(lambda: anna.by("spot-mark").count() == 2)
    assert sorted(anna.by("spot-mark").all_inner_texts()) == ["1 36.5 °C", "2 52.0 °C"]
    page.wait_for_function("() => (document.querySelector('#map').dataset.tracks ?? '').includes('52.0 °C')")
    assert page.evaluate("window.tones") == 6  # each once: the first was seen again
    for button in ("confirm", "dismiss"):
        assert anna.by(button).first.bounding_box()["height"] >= 40.0
    anna.by("mute").click()
    assert anna.by("mute").inner_text() == "Sound off"
    tones = page.evaluate("window.tones")
    flight.source.views.spots.add([report(4, 3), report(5, 3)])
    page.wait_for_selector("[data-testid=found][data-spot='3'][data-news=yes]")
    assert page.evaluate("window.tones") == tones
    assert anna.by("found-count").inner_text() == "Hot spots 3, the likeliest person 90 %"
    assert eventually(lambda: "a person would be found on 96 %" in page.locator(".craft").get_attribute("title"))
    rows = {row.get_attribute("data-spot"): row.bounding_box()["y"] for row in anna.by("found").all()}
    assert rows["3"] < rows["2"] < rows["1"]
    assert "a person, 90 % likely, 20.0 degC" in page.locator("[data-spot='3'] .track-words").inner_text()
    assert "seen in 2 pictures" in page.locator("[data-spot='3'] .track-words").inner_text()
    crop = page.locator("[data-spot='3'] img.crop")
    assert crop.get_attribute("src").startswith("/api/spots/3/crop")
    page.keyboard.press("1")
    page.locator("[data-spot='2'] [data-testid=confirm]").click()
    anna.wait_for_pins(1)
    assert anna.newest_pin()["category"] == "person" and "52.0 degC" in anna.newest_pin()["note"]
    page.locator("[data-spot='3'] [data-testid=dismiss]").click()
    page.wait_for_function("() => document.querySelectorAll('[data-testid=found]').length === 1")
    flight.source.views.spots.add([report(6, 3), report(7, 3)])
    anna.wait_for_pins(1)
    assert [row.get_attribute("data-spot") for row in anna.by("found").all()] == ["1"]
    # What is there when a page is opened is no news: it is listed, and does not sound.
    page.reload()
    page.wait_for_selector("[data-testid=found]")
    assert anna.by("found").first.get_attribute("data-news") is None and anna.by("mute").inner_text() == "Sound off"
    flight.source.fly_to(9)  # the picture that shows it best has come
    page.wait_for_selector("[data-testid=time-mark][data-kind=find]", state="attached")


@pytest.mark.long
def test_a_fire_is_an_area_on_the_map_with_its_words(flying: Flying) -> None:
    flight, anna = flying()
    page = anna.page
    page.wait_for_function("() => document.querySelector('#grid-step').textContent.startsWith('grid ')")
    page.get_by_test_id("layers").click()
    page.get_by_test_id("show-fire").click()
    page.keyboard.press("Escape")
    page.wait_for_function(
        "() => document.querySelector('[data-testid=fire-words]').textContent.includes('No picture')"
    )
    ring = ((-15.0, -10.0), (15.0, -10.0), (15.0, 10.0), (-15.0, 10.0))
    for frame in range(3):
        made = report(frame, 1)
        spot = replace(made.spots[0], temperature_c=400.0, area_m2=600.0, outline_en_m=ring)
        flight.source.views.spots.add([replace(made, spots=(spot,))])
    page.get_by_test_id("fire-minutes").select_option("15")
    page.wait_for_function("() => document.querySelector('[data-testid=fire-words]').textContent.includes('fire of')")
    assert "surely" in anna.by("fire-words").inner_text() and "perimeter" in anna.by("fire-words").inner_text()
    reported = anna.ask("api/fire?minutes=15")
    assert [f["properties"]["kind"] for f in reported["features"]] == ["perhaps", "burned", "surely"]
    assert reported["features"][1]["properties"]["area_m2"] == pytest.approx(600.0, rel=0.1)
    assert page.request.get(f"{flight.local}api/fire?minutes=-1").status == 422
    page.get_by_test_id("layers").click()
    page.get_by_test_id("show-fire").click()
    page.keyboard.press("Escape")
    assert anna.by("fire-panel").is_hidden()
