"""A click on the page that the aircraft measures: answered at once, replaced in place, or kept with the reason."""

import json
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from contract.errors import LinkError
from contract.feature_set import ClickedPixel, FeatureSet, Measured
from contract.geodesy import LocalFrame
from contract.locate import pixels_of
from ground.pins.store import PinStore
from ground.unmeasured import NO_ANSWER, TOO_MANY, in_words
from ground.web.app import create_app
from ground.web.clicks import MOST_MEASURED
from ground.web.context import ServerContext
from ground.web.guard import Rules
from ground.web.live import LiveSource
from onboard.config.schema import parse_config
from onboard.events.types import Frame
from onboard.link.publisher import Publisher, Rate
from onboard.service.measure_thread import MeasureThread
from tests.onboard.link.ports import free_endpoint
from tests.onboard.measured.step_world import CLICKED, EPOCH_NS, World
from tests.waiting import PATIENCE_S, eventually
from tests.web.conftest import page_is_built
from tests.web.flying import Flight
from tests.web.measured import opened
from tests.web.rendered import VEHICLE, not_measured, rendered_set

pytestmark = pytest.mark.xdist_group("web: a flight in motion")

ROOF = 1.03  # its inverse depth over the ground's: seven metres of 250
SPOT = (320.0, 200.0)


def with_pixel(s: FeatureSet, uv: tuple[float, float], measured: Measured) -> FeatureSet:
    if measured is not Measured.MEASURED:
        return replace(s, clicked=ClickedPixel(*uv, measured))
    x, y, _ = s.camera.unproject(np.array(uv))[0]
    w = float(s.plane_per_m @ [1.0, x, y]) * ROOF
    return replace(s, clicked=ClickedPixel(*uv, measured, w, 1e-3 * w))


class Aircraft:
    """Measures once it may, every pixel as the same word."""

    def __init__(self, measured: Measured = Measured.MEASURED) -> None:
        self.may_answer = threading.Event()
        self.measured = measured

    def __call__(self, s: FeatureSet, uv: tuple[float, float]) -> FeatureSet:
        if not self.may_answer.wait(PATIENCE_S):
            raise LinkError(NO_ANSWER)
        return with_pixel(s, uv, self.measured)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flight]:
    page_is_built()
    with Flight(tmp_path_factory.mktemp("measured") / "pins.sqlite") as flight:
        flight.source.fly_to(8)
        yield flight


@pytest.fixture
def flight(server: Flight) -> Iterator[Flight]:
    yield server
    server.source.measure = not_measured
    server.store.clear()


def asked(flight: Flight, path: str, body: dict[str, Any] | None = None) -> Any:
    request = urllib.request.Request(
        flight.url + path, None if body is None else json.dumps(body).encode(), {"content-type": "application/json"}
    )
    try:
        with urllib.request.urlopen(request, timeout=PATIENCE_S) as reply:
            return json.load(reply)
    except urllib.error.HTTPError as error:
        return json.load(error)


def spot(frame: int = 4, uv: tuple[float, float] = SPOT, **more: Any) -> dict[str, Any]:
    return {"vehicle": VEHICLE, "frame": frame, "u": uv[0], "v": uv[1], **more}


def only_pin(flight: Flight) -> dict[str, Any]:
    (pin,) = asked(flight, "api/pins")["pins"]
    return dict(pin)


def test_a_pin_is_there_at_once_and_becomes_the_measured_one_in_place(flight: Flight) -> None:
    aircraft = flight.source.measure = Aircraft()
    first = asked(flight, "api/pins", {"click": spot()})["pin"]
    assert first["clicks"][0]["method"] == "interpolated" and first["clicks"][0]["above_ground_m"] is None
    other = asked(flight, "api/pins", {"click": spot(uv=(400.0, 300.0))})["pin"]  # one under way holds up no other
    asked(flight, "api/undo", {"who": ""})
    aircraft.may_answer.set()
    assert eventually(lambda: only_pin(flight)["clicks"][0]["method"] == "measured")
    pin = only_pin(flight)
    assert (pin["id"], pin["number"], pin["clicks"][0]["id"]) == (
        first["id"],
        first["number"],
        first["clicks"][0]["id"],
    )
    (click,) = pin["clicks"]
    rise_m = pin["place"]["height_amsl_m"] - first["place"]["height_amsl_m"]
    assert 4.0 < rise_m < 16.0 and click["above_ground_m"] == pytest.approx(rise_m, abs=3.0)
    assert 0.1 < click["sigma_above_ground_m"] < 10.0
    # What is undone and made again is the measured pin; also the one that was undone while it was measured.
    assert asked(flight, "api/redo", {"who": ""})["redone"] == f"pin {other['number']} added"
    assert [p["clicks"][0]["method"] for p in asked(flight, "api/pins")["pins"]] == ["measured", "measured"]
    for _ in range(2):
        asked(flight, "api/undo", {"who": ""})
    assert asked(flight, "api/pins")["pins"] == []
    asked(flight, "api/redo", {"who": ""})
    assert only_pin(flight)["clicks"][0]["method"] == "measured"


def test_what_cannot_be_measured_keeps_its_first_answer_with_the_reason(flight: Flight) -> None:
    def silent(s: FeatureSet, uv: tuple[float, float]) -> FeatureSet:
        raise LinkError(NO_ANSWER)

    edge = Aircraft(Measured.EDGE)
    edge.may_answer.set()
    for measure, reason in ((edge, in_words("edge")), (silent, NO_ANSWER)):
        flight.source.measure = measure
        first = asked(flight, "api/pins", {"click": spot()})["pin"]
        assert eventually(lambda reason=reason: only_pin(flight)["clicks"][0]["unmeasured"] == reason)
        assert only_pin(flight)["place"] == first["place"]
        placed = asked(flight, "api/place", spot(measured=True))
        clicked = asked(flight, "api/click", spot(measured=True))
        assert in_words(clicked["unmeasured"]) == reason and "unmeasured" not in asked(flight, "api/click", spot())
        assert placed["unmeasured"] == reason and placed["lat_deg"] == first["place"]["lat_deg"]
        flight.store.clear()


def test_many_clicks_at_once_are_all_answered_and_those_beyond_the_bound_not_measured(flight: Flight) -> None:
    aircraft = flight.source.measure = Aircraft()
    with ThreadPoolExecutor(5) as people:
        began_s = time.monotonic()
        made = list(people.map(lambda k: asked(flight, "api/pins", {"click": spot(uv=(200.0 + k, 200.0))}), range(20)))
        assert all(reply["pin"] is not None for reply in made) and time.monotonic() - began_s < PATIENCE_S / 2

    def states() -> list[str]:
        clicks = [pin["clicks"][0] for pin in asked(flight, "api/pins")["pins"]]
        return [click["unmeasured"] or click["method"] for click in clicks]

    assert eventually(lambda: states().count(TOO_MANY) == 20 - MOST_MEASURED)
    aircraft.may_answer.set()
    assert eventually(lambda: states().count("measured") == MOST_MEASURED)


def test_a_roof_clicked_again_is_not_refused_for_the_ground_that_lies_around_it(flight: Flight) -> None:
    """Interpolated, two clicks on a high roof contradict each other; measured they agree."""
    one, two = rendered_set(0), rendered_set(7)
    x, y, _ = one.camera.unproject(np.array(SPOT))[0]
    w = float(one.plane_per_m @ [1.0, x, y]) * 1.4  # 70 m high: the ground behind it is another in each picture
    frame = [LocalFrame(s.camera_lat_deg, s.camera_lon_deg, s.camera_height_m) for s in (one, two)]
    at = two.R_enu_cam.T @ frame[1].to_enu(*frame[0].to_geodetic(one.R_enu_cam @ np.array([x, y, 1.0]) / w))
    (uv,), _ = pixels_of(two, (two.R_enu_cam @ at)[None])
    again = {**spot(7, (float(uv[0]), float(uv[1]))), "who": ""}

    def measure(s: FeatureSet, uv: tuple[float, float]) -> FeatureSet:
        return replace(s, clicked=ClickedPixel(*uv, Measured.MEASURED, w if s.frame == 0 else 1.0 / at[2], 1e-3 * w))

    flight.source.measure = measure
    pin = asked(flight, "api/pins", {"click": spot(0)})["pin"]
    assert eventually(lambda: only_pin(flight)["clicks"][0]["method"] == "measured")
    flight.source.measure = not_measured
    assert asked(flight, f"api/pins/{pin['id']}/clicks", again)["apart_m"] > 1.0
    flight.source.measure = measure
    reply = asked(flight, f"api/pins/{pin['id']}/clicks", again)
    assert reply["pin"] is not None, reply.get("reason")
    assert reply["pin"]["place"]["status"] == "ok" and reply["pin"]["clicks"][1]["method"] == "measured"


def test_over_the_link_the_aircraft_measures_the_roof_that_is_clicked(tmp_path: Path) -> None:
    at, world, pixel = free_endpoint(), World(roof_m=8.0, seed=12), (200.0, 85.0)
    with (
        Publisher("uav-1", [at], rate=Rate(1e8, 0.2, 30.0)) as link,
        MeasureThread(parse_config('[vehicle]\nid = "uav-1"\n')) as thread,
    ):
        link.measure = thread.measure
        source = LiveSource([at])
        try:
            for number in range(9):
                thread.event(0, Frame(EPOCH_NS + number * 10**9, number, world.image(number)))
                thread.feature_set(world.its_set(number))

            def has_come() -> bool:
                link.publish(world.its_set(CLICKED))
                return source.feature_set("uav-1", None, CLICKED) is not None

            assert eventually(has_come)
            store = PinStore(tmp_path / "pins.sqlite")
            app = create_app(ServerContext(source, store, tmp_path), Rules())
            with store, TestClient(app, base_url="http://127.0.0.1:8080") as client:
                body = {"click": {**spot(CLICKED, pixel), "vehicle": "uav-1"}}
                assert client.post("/api/pins", json=body).status_code == 201
                assert eventually(lambda: store.pins()[0].clicks[0].method == "measured")
        finally:
            source.close()


def test_on_the_page_the_answer_and_the_card_change_in_place_and_state_the_reason_when_asked(
    flight: Flight, chromium: Any
) -> None:
    aircraft = flight.source.measure = Aircraft()
    page = opened(chromium, flight.url)
    try:
        picture, answer, card = (page.locator(f"#{name}") for name in ("stage", "answer", "pin-card"))

        def press(u_share: float, v_share: float) -> None:
            box = picture.bounding_box()
            page.mouse.click(box["x"] + u_share * box["width"], box["y"] + v_share * box["height"])

        def wait_for(selector: str, words: str) -> None:
            page.wait_for_function(
                "([s, w]) => document.querySelector(s)?.textContent.includes(w) ?? false", arg=[selector, words]
            )

        press(0.5, 0.4)
        wait_for("#answer", "between measured points, being measured")
        page.get_by_test_id("pin").first.click()
        wait_for("#pin-card .how summary", "between measured points")
        page.evaluate("() => { for (const s of ['.crop', 'input', 'textarea']) "
                      "document.querySelector('#pin-card ' + s).dataset.first = 'yes'; }")  # fmt: skip
        before = card.bounding_box(), answer.bounding_box()
        aircraft.may_answer.set()
        wait_for("#answer", "measured, ")
        wait_for("#pin-card .how summary", " m above the ground")
        wait_for("#answer", " m above the ground")
        assert (card.bounding_box(), answer.bounding_box()) == before
        assert page.locator("#pin-card [data-first=yes]").count() == 3  # nothing but the words is new
        assert page.get_by_test_id("pin").count() == 1 and page.locator(".follow-it").count() == 1

        flight.source.measure = repeated = Aircraft(Measured.REPEATED)
        repeated.may_answer.set()
        press(0.3, 0.6)
        page.wait_for_function("() => document.querySelectorAll('[data-testid=pin]').length === 2")
        page.locator("[data-testid=pin]:not(.selected)").click()
        reason = page.locator("#pin-card .how")
        page.wait_for_function(
            "w => document.querySelector('#answer').title.includes(w)", arg=in_words(Measured.REPEATED.value)
        )
        reason.locator("summary").click()
        assert in_words("repeated texture") in reason.inner_text()
        assert "being measured" not in answer.inner_text()
    finally:
        page.context.close()
