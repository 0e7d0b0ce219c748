"""The HTTP API: the same answers as the command line, pins on disk, ties, and what is refused."""

import asyncio
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from ground.formats.rounded import decimals
from ground.pins.store import PinStore
from ground.web.app import create_app
from ground.web.context import ServerContext
from ground.web.guard import Rules
from ground.web.recorded import RecordedSource
from ground.web.tiles import Tiles
from tests.ground.formats.packages import Package
from tests.web.served import ROOT, Simulated

pytestmark = pytest.mark.xdist_group("web: served alone")


class Api:
    def __init__(
        self, simulated: Simulated, pins: Path, rules: Rules | None = None, tiles: Tiles | None = None
    ) -> None:
        self.simulated = simulated
        self.source = RecordedSource(simulated.path)
        self.store = PinStore(pins)
        self.context = ServerContext(self.source, self.store, pins.parent, tiles)
        self.client = TestClient(create_app(self.context, rules or Rules()), base_url="http://127.0.0.1:8080")

    def click(self, u: float, v: float, frame: int | None = None) -> dict[str, Any]:
        return {
            "vehicle": self.simulated.vehicle, "frame": self.simulated.newest if frame is None else frame,
            "u": u, "v": v,
        }  # fmt: skip

    def pin(self, u: float, v: float, frame: int | None = None, **more: Any) -> dict[str, Any]:
        made = self.client.post("/api/pins", json={"click": self.click(u, v, frame), **more})
        assert made.status_code == 201, made.text
        pin: dict[str, Any] = made.json()["pin"]
        return pin


@pytest.fixture
def api(simulated: Simulated, tmp_path: Path) -> Iterator[Api]:
    made = Api(simulated, tmp_path / "pins.sqlite")
    with made.client:
        yield made
    made.store.close()


def test_a_click_is_answered_as_on_the_command_line(api: Api, simulated: Simulated) -> None:
    for u, v, frame in (
        (320.0, 240.0, simulated.newest),
        (100.25, 400.5, simulated.newest - 5),
        (5.0, 5.0, simulated.refused),
    ):
        printed = api.client.post("/api/click", json=api.click(u, v, frame))
        command = [sys.executable, "-m", "ground", "click", str(u), str(v), "--frame", str(frame)]
        done = subprocess.run(
            [*command, "--from", simulated.path, "--format", "json", "--interpolated"],
            capture_output=True, text=True, check=False, cwd=ROOT, timeout=60,
        )  # fmt: skip
        assert printed.status_code == 200
        assert printed.text == done.stdout.strip()
    assert json.loads(printed.text)["status"] == "turning"


def test_a_click_on_a_picture_that_is_not_there_says_so(api: Api) -> None:
    printed = api.client.post("/api/click", json=api.click(320, 240, 100_000)).json()
    assert printed["status"] == "unknown_frame"
    assert "no set of this picture" in printed["reason"]
    other = {**api.click(320, 240), "session": 1}
    assert "restarted" in api.client.post("/api/click", json=other).json()["reason"]
    other = {**api.click(320, 240), "vehicle": "<b>"}
    assert api.client.post("/api/click", json=other).json()["status"] == "unknown_frame"


@pytest.mark.parametrize("body", [{}, {"vehicle": "uav"}, {"vehicle": "uav", "frame": -1, "u": 1, "v": 1}, [], 7])
def test_a_body_that_is_none_is_refused(api: Api, body: Any) -> None:
    assert api.client.post("/api/click", json=body).status_code == 422


@pytest.mark.parametrize(
    "body",
    [
        b'{"lat_deg": NaN, "lon_deg": 1}', b'{"lat_deg": 1e999, "lon_deg": 1}', b'{"lat_deg": 1, "lon_deg": -Infinity}',
        b'{"lat_deg": 1, "lon_deg": 1, "name": "\\ud800"}', b'{"lat_deg": 1, "lon_deg": 1, "who": "\\udfff"}',
        b'{"lat_deg": 1, "lon_deg": 1, "\\ud800": 1}', b'{"lat_deg": 1, "lon_deg": 1, "sigma_m": NaN}', b"{",
    ],
)  # fmt: skip
def test_what_is_no_number_or_no_text_is_refused_in_a_line(api: Api, body: bytes) -> None:
    printed = api.client.post("/api/pins", content=body, headers={"content-type": "application/json"})
    assert printed.status_code == 422
    detail = printed.json()["detail"]
    assert isinstance(detail, str)
    assert 5 < len(detail) < 200
    assert "\n" not in detail
    assert api.client.get("/api/pins").json()["pins"] == []


def test_a_typed_pin_was_seen_when_somebody_says_so_and_not_when_it_was_typed(api: Api) -> None:
    typed = {"lat_deg": -43.38, "lon_deg": 172.4, "sigma_m": 5.0}
    pin = api.client.post("/api/pins", json=typed).json()["pin"]
    assert pin["seen_utc"] is None
    printed = api.client.get(f"/api/pins/{pin['id']}/handoff").json()
    assert {row["name"]: row["text"] for row in printed["texts"]}["time"] == "not known"
    assert "Time of sighting unknown" in printed["readback"]
    assert ",," in api.client.get("/api/export/csv").text.splitlines()[1]
    known = api.client.post("/api/pins", json={**typed, "seen_utc": "2026-05-01T21:03:00Z"}).json()["pin"]
    assert known["seen_utc"] == "2026-05-01T21:03:00.000000Z"
    printed = api.client.get(f"/api/pins/{known['id']}/handoff").json()
    assert "Seen at 21 03 U T C" in printed["readback"]


def test_a_pin_and_all_pins_go_out_as_data_packages_with_their_pictures(api: Api) -> None:
    pins = [api.pin(300.5, 200.25, name="tent"), api.pin(200.0, 180.0)]
    one = Package(api.client.get(f"/api/pins/{pins[0]['id']}/package.zip").content)
    both = Package(api.client.get("/api/export/tak").content)
    assert [len(package.events) for package in (one, both)] == [1, 2]
    (event,) = one.events.values()
    assert event.find("detail/contact").get("callsign") == "1 tent"
    assert float(event.find("point").get("lat")) == pytest.approx(pins[0]["place"]["lat_deg"], abs=1e-8)
    assert all(len(both.pictures[uid]) == 1 for uid in both.events)
    api.client.delete(f"/api/pins/{pins[0]['id']}")
    assert api.client.get(f"/api/pins/{pins[0]['id']}/package.zip").status_code == 404


def test_the_place_under_the_cursor_is_that_of_the_pin_a_click_would_make(api: Api, simulated: Simulated) -> None:
    printed = api.client.post("/api/place", json=api.click(300.5, 200.25)).json()
    place = api.pin(300.5, 200.25)["place"]
    assert {name: printed[name] for name in place} == place
    assert printed["method"] == "interpolated"
    refused = api.client.post("/api/place", json=api.click(320, 240, simulated.refused)).json()
    assert (refused["status"], bool(refused["advice"])) == ("turning", True)
    assert len(api.client.get("/api/pins").json()["pins"]) == 1


def test_what_would_make_a_radius_smaller_is_in_a_recordings_state(api: Api, simulated: Simulated) -> None:
    """The recording's last status has it, by the replay that made it."""
    (vehicle,) = api.client.get("/api/vehicles").json()
    assert re.fullmatch(r"(mostly|mainly) [^()]+ \(\d+ %\): .{8,}", vehicle["radius"]), vehicle["radius"]


def test_pictures_and_their_features_are_served(api: Api, simulated: Simulated) -> None:
    (vehicle,) = api.client.get("/api/vehicles").json()
    assert vehicle["id"] == simulated.vehicle
    rows = api.client.get(f"/api/vehicles/{simulated.vehicle}/frames").json()
    assert [row["frame"] for row in rows] == [*simulated.frames]
    assert [row["has_picture"] for row in rows] == [frame != simulated.refused for frame in simulated.frames]
    frame = f"/api/vehicles/{simulated.vehicle}/frames/{simulated.newest}"
    picture = api.client.get(f"{frame}/picture")
    assert picture.headers["content-type"] == "image/jpeg"
    assert picture.content.startswith(b"\xff\xd8\xff")
    found = simulated.recording.by_frame(simulated.vehicle, simulated.newest)
    assert found is not None
    view = api.client.get(f"{frame}/features").json()
    assert len(view["features"]["uv"]) == len(found)
    tracked = sum(bool(path) for path in view["features"]["paths"])
    assert 0.5 * len(found) < tracked <= len(found)
    assert all(view["mesh"]["lonlat"])
    refused = api.client.get(f"/api/vehicles/{simulated.vehicle}/frames/{simulated.refused}/features").json()
    assert (refused["status"], refused["camera"]) == ("turning", None)
    assert refused["advice"]
    assert api.client.get(f"/api/vehicles/{simulated.vehicle}/frames/{simulated.refused}/picture").status_code == 404
    assert api.client.get("/api/vehicles/nobody/frames").status_code == 404


def test_a_feature_is_seen_where_its_ground_place_was(api: Api, simulated: Simulated) -> None:
    """A path's earlier pixel is the same place: what was clicked there then lies where it lies now."""
    frame = simulated.newest
    view = api.client.get(f"/api/vehicles/{simulated.vehicle}/frames/{frame}/features").json()
    checked = 0
    for (u, v), path in zip(view["features"]["uv"], view["features"]["paths"], strict=True):
        if len(path) < 4 or not (100 < u < 540 and 100 < v < 380):
            continue
        now = api.client.post("/api/click", json=api.click(u, v, frame)).json()
        then = api.client.post("/api/click", json=api.click(*path[0], frame - 1)).json()
        if now["status"] == then["status"] == "ok":
            assert now["lat_deg"] == pytest.approx(then["lat_deg"], abs=3e-5)
            assert now["lon_deg"] == pytest.approx(then["lon_deg"], abs=4e-5)
            checked += 1
    assert checked >= 5


def test_a_pin_is_on_disk_with_its_crop_before_it_is_answered(api: Api, tmp_path: Path) -> None:
    pin = api.pin(300.5, 200.25, name="tent", category="person", who="anna")
    with PinStore(tmp_path / "pins.sqlite") as other:
        (kept,) = other.pins()
        assert (kept.id, kept.name, kept.who, kept.category.value) == (pin["id"], "tent", "anna", "person")
        crop = other.crop(kept.clicks[0].id)
    assert crop is not None
    assert crop[8:12] == b"WEBP"
    assert api.client.get(f"/api/pins/{pin['id']}/crop").content == crop
    assert pin["place"]["status"] == "ok"
    assert 0.1 < pin["place"]["ce90_m"] < 50.0


def test_a_refused_click_makes_no_pin_and_says_what_would_help(api: Api, simulated: Simulated) -> None:
    printed = api.client.post("/api/pins", json={"click": api.click(320, 240, simulated.refused)})
    assert printed.status_code == 422
    answer = printed.json()["answer"]
    assert (printed.json()["pin"], answer["status"]) == (None, "turning")
    assert "before or after the turn" in answer["advice"]
    assert api.client.get("/api/pins").json()["pins"] == []


def test_pins_are_edited_deleted_and_brought_back(api: Api) -> None:
    pin = api.pin(320, 240, who="anna")
    url = f"/api/pins/{pin['id']}"
    edited = api.client.patch(url, json={"name": "car", "note": "red", "category": "vehicle", "who": "anna"}).json()
    assert (edited["name"], edited["note"], edited["category"]) == ("car", "red", "vehicle")
    assert api.client.delete(url, params={"who": "anna"}).status_code == 200
    assert api.client.get(url).status_code == 404
    assert api.client.post("/api/undo", json={"who": "anna"}).json()["undone"]
    assert api.client.get(url).json()["name"] == "car"
    assert api.client.post("/api/undo", json={"who": "nobody"}).json()["undone"] is None
    assert api.client.delete("/api/pins/none").status_code == 404


def test_pins_are_filtered(api: Api) -> None:
    api.pin(300, 200, name="Tent by the creek", category="person", who="anna")
    api.pin(340, 250, name="car", category="vehicle", who="bo")

    def found(**filters: str) -> list[str]:
        return [pin["name"] for pin in api.client.get("/api/pins", params=filters).json()["pins"]]

    assert found(text="CREEK") == ["Tent by the creek"]
    assert found(category="vehicle") == ["car"]
    assert found(who="anna") == ["Tent by the creek"]
    assert len(found()) == 2


@pytest.mark.parametrize("datum", [None, "height_amsl_m"])
def test_a_last_known_position_without_a_height_was_seen_by_the_pictures_that_show_its_ground(
    api: Api, simulated: Simulated, datum: str | None
) -> None:
    clicked = api.pin(320, 240, simulated.newest - 4)

    def seen(pin: dict[str, Any]) -> dict[int, tuple[float, float]]:
        rows = api.client.get(f"/api/pins/{pin['id']}/seen").json()
        return {row["frame"]: (row["u_px"], row["v_px"]) for row in rows}

    heights = {} if datum is None else {datum: clicked["place"][datum]}
    typed = {"lat_deg": clicked["place"]["lat_deg"], "lon_deg": clicked["place"]["lon_deg"], **heights}
    found = seen(api.client.post("/api/pins", json=typed).json()["pin"])
    assert len(found) >= 8 and found.keys() == seen(clicked).keys()
    assert found[simulated.newest - 4] == pytest.approx((320.0, 240.0), abs=2.0)


def test_a_pin_clicked_again_is_surer_and_one_clicked_elsewhere_contradicts_itself(
    api: Api, simulated: Simulated
) -> None:
    pin = api.pin(320, 240, simulated.newest - 4)
    place = pin["place"]
    seen = {row["frame"]: row for row in api.client.get(f"/api/pins/{pin['id']}/seen").json()}
    assert seen[simulated.newest - 4]["u_px"] == pytest.approx(320.0, abs=0.05)
    assert simulated.newest in seen
    row = seen[simulated.newest]
    body = {**api.click(row["u_px"], row["v_px"], simulated.newest), "who": "anna"}
    again = api.client.post(f"/api/pins/{pin['id']}/clicks", json=body).json()["pin"]
    assert again["place"]["clicks"] == 2
    assert again["place"]["ce90_m"] < place["ce90_m"]
    assert again["place"]["lat_deg"] == pytest.approx(place["lat_deg"], abs=2e-5)
    elsewhere = {**api.click(60, 60, simulated.newest)}
    refused = api.client.post(f"/api/pins/{pin['id']}/clicks", json=elsewhere)
    assert refused.status_code == 409
    assert 10.0 < refused.json()["apart_m"] < 200.0
    assert f"m from pin {pin['number']}" in refused.json()["reason"]
    kept = api.client.get(f"/api/pins/{pin['id']}").json()
    assert (kept["place"], len(kept["clicks"])) == (again["place"], 2)
    wrong = api.client.post(f"/api/pins/{pin['id']}/clicks", json={**elsewhere, "anyway": True}).json()["pin"]
    assert wrong["place"]["status"] == "contradiction"
    assert "chi" not in wrong["place"]["reason"]
    assert len(wrong["place"]["answers"]) == 3
    url = f"/api/pins/{pin['id']}/clicks/{wrong['clicks'][-1]['id']}"
    assert api.client.delete(url).json()["place"]["status"] == "ok"


def test_distance_between_two_pins_is_surer_than_either(api: Api) -> None:
    one, two = api.pin(300, 200), api.pin(360, 240)
    printed = api.client.get("/api/measure", params={"from": one["id"], "to": two["id"]}).json()
    assert printed["status"] == "ok"
    assert 5.0 < printed["distance_m"] < 60.0
    assert printed["sigma_distance_m"] < 0.5 * one["place"]["ce90_m"]


def test_a_tie_moves_all_pins_of_its_flight_and_is_taken_back(api: Api, simulated: Simulated) -> None:
    pins = [api.pin(200, 150), api.pin(420, 330, simulated.newest - 8)]
    printed = api.client.post("/api/click", json=api.click(320, 240)).json()
    north_deg = 3.0 / 111_320.0
    tie = {
        "click": api.click(320, 240), "lat_deg": printed["lat_deg"] + north_deg, "lon_deg": printed["lon_deg"],
        "sigma_m": 0.3, "name": "bridge",
    }  # fmt: skip
    made = api.client.post("/api/ties", json=tie)
    assert made.status_code == 201, made.text
    moved = {pin["id"]: pin["place"] for pin in api.client.get("/api/pins").json()["pins"]}
    for pin in pins:
        place = moved[pin["id"]]
        assert place["tied"] == 1
        assert 0.5 * north_deg < place["lat_deg"] - pin["place"]["lat_deg"] < 1.5 * north_deg
        assert place["ce90_m"] < pin["place"]["ce90_m"]
    far = {**tie, "lat_deg": printed["lat_deg"] + 400.0 / 111_320.0, "name": "elsewhere"}
    refused = api.client.post("/api/ties", json=far)
    assert refused.status_code == 409
    assert 300 < refused.json()["misses_m"] < 500
    assert "would still be accepted" in refused.json()["reason"]
    assert api.client.delete(f"/api/ties/{made.json()['tie']['id']}").status_code == 200
    back = {pin["id"]: pin["place"] for pin in api.client.get("/api/pins").json()["pins"]}
    for pin in pins:
        assert back[pin["id"]]["lat_deg"] == pytest.approx(pin["place"]["lat_deg"], abs=1e-9)


def test_a_pin_is_handed_off_in_every_format(api: Api) -> None:
    pin, other = api.pin(320, 240, name="<script>alert(1)</script>"), api.pin(360, 300)
    url = f"/api/pins/{pin['id']}/handoff"
    printed = api.client.get(url, params={"from": other["id"], "crs": "EPSG:2193"}).json()
    texts = {row["name"]: row["text"] for row in printed["texts"]}
    lat, lon = pin["place"]["lat_deg"], pin["place"]["lon_deg"]
    assert 0.5 < pin["place"]["ce90_m"] < 10.0
    places = decimals("degrees", pin["place"]["ce90_m"])
    assert texts["degrees"] == f"{lat:.{places}f} {lon:.{places}f}"
    assert texts["geo"].startswith(f"geo:{lat:.7f},{lon:.7f},")
    assert re.fullmatch(r"\d\d[A-Z] [A-Z]{2} \d{5} \d{5}", texts["mgrs"])
    assert "M G R S: " in printed["readback"]
    assert texts["author"].startswith("no name given, ")
    assert texts["time"] == pin["seen_utc"][:19].replace("T", " ") + " UTC"
    assert "deg true" in texts["bearing"]
    assert "N" in texts["crs"]
    assert "Read back" in printed["readback"]
    code = api.client.get(f"/api/pins/{pin['id']}/qr.svg")
    assert code.headers["content-type"] == "image/svg+xml"
    assert code.content.startswith(b"<?xml") or code.content.startswith(b"<svg")


def test_browsers_hear_of_each_others_pins(api: Api) -> None:
    host = {"host": "127.0.0.1:8080"}
    with (
        api.client.websocket_connect("/api/events", headers=host) as one,
        api.client.websocket_connect("/api/events", headers=host) as two,
    ):
        pin = api.pin(320, 240)
        for socket in (one, two):
            event = next(e for e in iter(socket.receive_json, None) if e["type"] == "pin")
            assert event["pin"]["id"] == pin["id"]
        api.client.delete(f"/api/pins/{pin['id']}")
        event = next(e for e in iter(two.receive_json, None) if e["type"] == "pin_deleted")
        assert event["id"] == pin["id"]


def test_a_browser_that_does_not_read_is_asked_to_begin_again(api: Api) -> None:
    async def flood() -> list[str]:
        queue = api.context.hub.join()
        assert queue is not None
        for k in range(1000):
            api.context.hub.send({"type": "pins", "k": k})
        held = [json.loads(queue.get_nowait())["type"] for _ in range(queue.qsize())]
        api.context.hub.leave(queue)
        return held

    with ThreadPoolExecutor(1) as thread:  # a browser that is open has a loop of its own in this one
        held = thread.submit(asyncio.run, flood()).result()
    assert len(held) <= 200
    assert held[0] == "resync"


def test_the_api_documents_itself_without_another_origin(api: Api) -> None:
    paths = api.client.get("/api/openapi.json").json()["paths"]
    assert {"/api/vehicles", "/api/click", "/api/pins", "/api/ties", "/api/status"} <= set(paths)
    page = api.client.get("/api").text
    assert "/api/click" in page
    assert "http://" not in page
    assert "https://" not in page
