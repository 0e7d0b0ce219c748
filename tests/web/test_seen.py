"""What has been seen, on the page and behind it: the layer, its tiles, and the pictures that show a place."""

import dataclasses
import io
import time
from typing import Any

import numpy as np
import pytest
from PIL import Image

from contract.feature_set import FeatureSet, Status
from ground.seen.tally import SeenGround
from ground.web.seen_map import LISTED, SeenMap
from ground.web.seen_tile import ALPHA, COLOURS, SIDE, seen_tile
from ground.web.source import FrameRow, Picture, VehicleReport
from tests.ground.seen.levels import HOUR_PICTURES, PLACE, an_hour_over_a_place, level_set
from tests.web.browsing import Operator
from tests.web.rendered import FlyingSource
from tests.web.served import Server, Simulated
from tests.web.unfollowed import Unfollowed

pytestmark = pytest.mark.xdist_group("web")

MIDDLE = PLACE.lat_deg, PLACE.lon_deg
ZOOM = 18


def tile_at(lat: float, lon: float) -> tuple[int, int, int, int]:
    """x and y of the tile with a place, and the place's pixel in it."""
    x = (lon + 180.0) / 360.0 * 2**ZOOM
    y = (1.0 - np.arcsinh(np.tan(np.radians(lat))) / np.pi) / 2.0 * 2**ZOOM
    return int(x), int(y), int((x % 1.0) * SIDE), int((y % 1.0) * SIDE)


def pixel(seen: SeenGround, east_m: float, north_m: float, by: str, now_s: float) -> tuple[int, ...]:
    lat, lon, _ = (float(c) for c in PLACE.to_geodetic((east_m, north_m, 0.0)))
    x, y, u, v = tile_at(lat, lon)
    image = Image.open(io.BytesIO(seen_tile(seen, ZOOM, x, y, by, now_s))).convert("RGBA")
    found = image.getpixel((u, v))
    assert image.size == (SIDE, SIDE) and isinstance(found, tuple)
    return found


def test_a_tile_is_coloured_where_the_ground_was_seen_by_age_and_by_count() -> None:
    seen = SeenGround(2.0)
    for frame in range(6):
        seen.add(level_set(frame, at_s=0.2 * frame))
    seen.add(level_set(9, east_m=60.0, at_s=2.0))
    now_s = seen.cell(*MIDDLE)["last_s"]  # type: ignore[index]
    assert pixel(seen, 0.0, 0.0, "count", now_s) == (*COLOURS[1], ALPHA)
    assert pixel(seen, 60.0, 10.0, "count", now_s) == (*COLOURS[3], ALPHA)
    assert pixel(seen, 0.0, 0.0, "age", now_s) == (*COLOURS[0], ALPHA)
    assert pixel(seen, 0.0, 0.0, "age", now_s + 120.0) == (*COLOURS[1], ALPHA)
    assert pixel(seen, 0.0, 0.0, "age", now_s + 90_000.0) == (*COLOURS[4], ALPHA)
    assert pixel(seen, 0.0, 70.0, "age", now_s)[3] == 0
    # Its borders are where the cells' are, to a pixel.
    inside = [pixel(seen, -60.0 + east, 0.0, "count", now_s)[3] > 0 for east in range(0, 40)]
    assert inside == sorted(inside)
    assert 40 - sum(inside) == pytest.approx(60.0 - 43.0, abs=2.5)


class ManySets(Unfollowed):
    """A source of sets that a test hands out, as of a link. Serves `Source`."""

    is_live = True
    name = "many sets"

    def __init__(self) -> None:
        self.sets: dict[tuple[int, int], FeatureSet] = {}
        self.changes = 0

    def put(self, *sets: FeatureSet) -> None:
        for s in sets:
            self.sets[s.session, s.frame] = s
            self.changes += 1

    def vehicles(self) -> list[str]:
        return ["uav"] if self.sets else []

    def version(self, vehicle: str) -> int:
        return self.changes

    def frames(self, vehicle: str, newest: int | None = None) -> list[FrameRow]:
        ordered = sorted(self.sets.values(), key=lambda s: s.capture_unix_ns)
        return [
            FrameRow(s.session, s.frame, s.revision, s.capture_unix_ns, s.status, False)
            for s in (ordered if newest is None else ordered[-newest:])
        ]

    def feature_set(self, vehicle: str, session: int | None, frame: int) -> FeatureSet | None:
        return self.sets.get((session or 1, frame))

    def picture(self, vehicle: str, session: int | None, frame: int) -> Picture | None:
        return None

    def age_s(self, feature_set: FeatureSet) -> float | None:
        return None

    def report(self, vehicle: str) -> VehicleReport:
        return VehicleReport(vehicle, 1, None, None, None, None, None, None)

    def no_pictures(self) -> str:
        return ""

    def damage(self) -> list[str]:
        return []

    def close(self) -> None:
        """Nothing is held."""


def test_pictures_are_counted_as_they_come_and_revised_as_they_are_revised() -> None:
    source = ManySets()
    seen = SeenMap(source)
    assert (seen.state()["pictures"], seen.state()["ahead"]) == (0, None)
    source.put(*(level_set(k, east_m=4.0 * k, sigma_m=3.0) for k in range(10)))
    seen.count(60.0)
    first = seen.state()
    assert (first["pictures"], first["ahead"], seen.at(*MIDDLE)["count"]) == (10, 0, 10)
    source.put(level_set(10, east_m=40.0), level_set(9, east_m=36.0, sigma_m=0.5, revision=1))
    seen.count(60.0)
    assert (seen.state()["pictures"], seen.at(*MIDDLE)["count"]) == (11, 11)
    assert seen.state()["area_m2"] > first["area_m2"]  # type: ignore[operator]
    source.put(dataclasses.replace(level_set(9), status=Status.POOR_FIT, revision=2))
    seen.count(60.0)
    assert seen.at(*MIDDLE)["count"] == 10
    reported: list[dict[str, Any]] = seen.at(*MIDDLE)["pictures"]  # type: ignore[assignment]
    assert [row["frame"] for row in reported] == [0, 1, 2, 3, 4, 5, 6, 7, 8, 10]


def test_of_very_many_pictures_some_are_named_and_all_are_counted() -> None:
    source = ManySets()
    seen = SeenMap(source)
    source.put(*(level_set(k, at_s=0.2 * k) for k in range(200)))
    seen.count(60.0)
    reported = seen.at(*MIDDLE)
    rows: list[dict[str, Any]] = reported["pictures"]  # type: ignore[assignment]
    assert (reported["count"], len(rows), rows[0]["frame"], rows[-1]["frame"]) == (200, LISTED, 0, 199)
    assert len({row["frame"] for row in rows}) == LISTED


def test_the_counting_begins_with_the_first_question_and_ends_with_the_server() -> None:
    source = FlyingSource()
    source.fly_to(3)
    seen = SeenMap(source)
    assert seen._thread is None
    seen.begin()
    until_s = time.monotonic() + 60.0
    while seen.state()["pictures"] != 3:
        assert time.monotonic() < until_s and not seen.trouble
        time.sleep(0.02)
    seen.close()
    source.fly_to(5)
    time.sleep(0.2)
    assert seen.state()["pictures"] == 3


@pytest.mark.long
@pytest.mark.wall_clock
def test_the_pictures_of_a_place_are_found_within_50_ms_after_an_hour() -> None:
    seen = SeenMap(ManySets())
    seen._seen = an_hour_over_a_place()
    took_ms = []
    for k in range(9):
        lat, lon, _ = (float(c) for c in PLACE.to_geodetic((0.5 * k, 1.0, 0.0)))
        began_s = time.perf_counter()
        reported = seen.at(lat, lon)
        took_ms.append(1000.0 * (time.perf_counter() - began_s))
        rows: list[dict[str, Any]] = reported["pictures"]  # type: ignore[assignment]
        assert len(rows) == LISTED and rows[-1]["frame"] > 0.99 * HOUR_PICTURES
    assert sorted(took_ms)[4] < 3.0 * 50.0


def test_a_place_on_the_map_leads_to_the_pictures_that_show_it(anna: Operator, simulated: Simulated) -> None:
    page = anna.page
    assert page.locator("#seen-panel").is_hidden()
    page.get_by_test_id("layers").click()
    page.get_by_test_id("show-seen").click()
    page.keyboard.press("Escape")
    page.wait_for_function("() => document.querySelector('[data-testid=seen-sum]').dataset.ahead === '0'")
    assert "ha in" in anna.by("seen-sum").inner_text() and "pictures" in anna.by("seen-sum").inner_text()
    legend = page.locator(".seen-legend").inner_text()
    assert "under 1" in legend and "not seen for certain" in legend
    assert "before the recording's end" in anna.by("seen-panel").inner_text()
    # The map has gone to the flight's ground.
    page.wait_for_function("() => document.querySelector('#grid-step').textContent.startsWith('grid ')")
    box = anna.by("map").bounding_box()
    page.mouse.click(box["x"] + 0.56 * box["width"], box["y"] + 0.52 * box["height"])
    page.wait_for_selector("[data-testid=seen-picture]")
    buttons = anna.by("seen-picture")
    assert anna.by("seen-found").inner_text().startswith("Seen ")
    first = buttons.first.inner_text()
    assert int(first) in simulated.frames
    buttons.first.click()
    anna.wait_for_frame(int(first))
    page.wait_for_selector("[data-testid=looked-for]")
    # The ring is where that place is in the picture: a click there answers with the place.
    ring = page.locator(".looked i").bounding_box()
    page.mouse.click(ring["x"] + ring["width"] / 2, ring["y"] + ring["height"] / 2)
    anna.wait_for_pins(1)
    place = anna.newest_pin()["place"]
    found = anna.ask(f"api/seen/at?lat={place['lat_deg']}&lon={place['lon_deg']}")
    assert int(first) in [row["frame"] for row in found["pictures"]]
    reported = anna.ask(
        f"api/vehicles/{simulated.vehicle}/frames/{first}/pixel?lat={place['lat_deg']}&lon={place['lon_deg']}"
    )
    click = anna.newest_pin()["clicks"][0]
    # The click was measured; where nothing but a place is given, the height is that of the ground between features.
    assert reported["u_px"] == pytest.approx(click["u_px"], abs=2.0)
    assert reported["v_px"] == pytest.approx(click["v_px"], abs=2.0)
    page.get_by_test_id("seen-by").select_option("count")
    assert "20 or more" in page.locator(".seen-legend").inner_text()
    page.get_by_test_id("layers").click()
    page.get_by_test_id("show-seen").click()
    page.keyboard.press("Escape")
    assert page.locator("#seen-panel").is_hidden()


def test_the_api_refuses_what_is_no_place(station: Server, anna: Operator) -> None:
    for path, status in (
        ("seen/at?lat=91&lon=0", 422), ("seen/at?lat=nan&lon=0", 422), ("seen/tiles/3/1/1?by=colour", 422),
        ("seen/tiles/99/0/0", 422), ("vehicles/none/frames/1/pixel?lat=0&lon=0", 404),
    ):  # fmt: skip
        assert anna.page.request.get(f"{station.local}api/{path}").status == status, path
    empty = anna.page.request.get(f"{station.local}api/seen/tiles/3/1/1")
    assert empty.status == 200 and Image.open(io.BytesIO(empty.body())).convert("RGBA").getextrema()[3] == (0, 0)
    assert anna.ask("api/seen/at?lat=12&lon=34")["count"] == 0
