"""Who would have been found, on the page: the numbers that `pc-ground seen --pod` has, cells in colours, sectors."""

import io
import json
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from ground.__main__ import main
from ground.seen.area import read_sectors
from ground.web.found_map import FoundMap
from ground.web.recorded import RecordedSource
from ground.web.seen_map import SeenMap
from ground.web.seen_tile import ALPHA, COLOURS
from tests.ground.seen.levels import PLACE, record_search
from tests.web.browsing import Operator
from tests.web.test_seen import ZOOM, tile_at

pytestmark = pytest.mark.xdist_group("web")

AREAS = {"4": (0.0, 0.0), "A & B": (20.0, 16.0)}


def ring(east_m: float, north_m: float) -> list[list[float]]:
    """Thirty metres to the side about a place of PLACE, longitude and latitude."""
    corners = [(-15.0, -15.0, 0.0), (15.0, -15.0, 0.0), (15.0, 15.0, 0.0), (-15.0, 15.0, 0.0), (-15.0, -15.0, 0.0)]
    out: list[list[float]] = PLACE.to_geodetic(np.add(corners, (east_m, north_m, 0.0)))[:, [1, 0]].tolist()
    return out


def sectors_file(path: Path, areas: dict[str, list[list[float]]]) -> Path:
    features = [
        {"type": "Feature", "properties": {"name": name}, "geometry": {"type": "Polygon", "coordinates": [at]}}
        for name, at in areas.items()
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five looks straight down; a person is found in their upper half, and in the lower one with 0.6."""
    return record_search(tmp_path_factory.mktemp("thermal") / "session.mcap", 5, (1.0,) * 10 + (0.6,) * 10)


@pytest.fixture
def maps(session: Path) -> Iterator[tuple[SeenMap, FoundMap]]:
    with closing(RecordedSource(session)) as source:
        seen = SeenMap(source)
        with closing(FoundMap(seen, source)) as found:
            seen.count(60.0)
            yield seen, found


def computed(found: FoundMap) -> dict[str, Any]:
    until_s = time.monotonic() + 60.0
    while not (state := found.state())["is_current"]:
        assert time.monotonic() < until_s and not state["trouble"]
        time.sleep(0.02)
    return state


def colour(found: FoundMap, who: str, east_m: float, north_m: float) -> tuple[int, ...]:
    lat, lon, _ = (float(c) for c in PLACE.to_geodetic((east_m, north_m, 0.0)))
    x, y, u, v = tile_at(lat, lon)
    image = Image.open(io.BytesIO(found.tile(ZOOM, x, y, who))).convert("RGBA")
    at = image.getpixel((u, v))
    assert isinstance(at, tuple)
    return at


def test_the_page_has_the_numbers_of_the_command(
    session: Path, maps: tuple[SeenMap, FoundMap], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, found = maps
    path = sectors_file(tmp_path / "sectors.geojson", {name: ring(*at) for name, at in AREAS.items()})
    found.choose(read_sectors(path))
    state = computed(found)
    assert main(["seen", "--from", str(session), "--polygon", str(path), "--pod", "--json"]) == 0
    by_command = json.loads(capsys.readouterr().out)["detection"]
    assert state["detection"] == by_command
    assert main(["seen", "--from", str(session), "--polygon", str(path), "--pod"]) == 0
    printed = capsys.readouterr().out.splitlines()
    for who in ("machine", "operator"):
        assert len(state["lines"][who]) == 2 and set(state["lines"][who]) <= set(printed)
    assert {one["name"] for one in state["sectors"]} == set(AREAS)
    pods = [one["machine"]["pod"] for one in by_command["sectors"]]
    assert pods == [pytest.approx(0.8, abs=0.04), pytest.approx(1.0, abs=0.04)]


def test_cells_are_coloured_by_the_probability_of_the_one_who_was_asked_for(maps: tuple[SeenMap, FoundMap]) -> None:
    _, found = maps
    assert colour(found, "machine", 0.0, 20.0)[3] == 0  # no one has asked: nothing is computed
    computed(found)
    assert colour(found, "machine", 0.0, 20.0) == (*COLOURS[0], ALPHA)
    assert colour(found, "machine", 0.0, -20.0) == (*COLOURS[2], ALPHA)
    assert colour(found, "operator", 0.0, 20.0) == colour(found, "operator", 0.0, -20.0)
    assert colour(found, "machine", 0.0, 70.0)[3] == 0


def test_another_choice_of_sectors_is_computed_and_a_sector_without_a_cell_is_refused(
    maps: tuple[SeenMap, FoundMap], tmp_path: Path
) -> None:
    _, found = maps
    (whole,) = computed(found)["lines"]["machine"]
    assert "in the searched area" in whole
    speck = [[lon, PLACE.lat_deg] for lon in (PLACE.lon_deg, PLACE.lon_deg + 1e-9, PLACE.lon_deg + 2e-9)]
    found.choose(read_sectors(sectors_file(tmp_path / "speck.geojson", {"speck": speck})))
    until_s = time.monotonic() + 60.0
    while "sector speck" not in str(found.state()["trouble"]):
        assert time.monotonic() < until_s
        time.sleep(0.02)
    found.choose([])
    until_s = time.monotonic() + 60.0
    while not (state := found.state())["is_current"]:
        assert time.monotonic() < until_s
        time.sleep(0.02)
    assert state["lines"]["machine"] == [whole]


def wait_for_numbers(anna: Operator, text: str) -> None:
    numbers = "document.querySelector('[data-testid=seen-numbers]').textContent"
    anna.page.wait_for_function(f"text => {numbers}.includes(text)", arg=text)


def test_the_layer_states_whom_it_is_about_and_how_likely_in_each_sector(anna: Operator, tmp_path: Path) -> None:
    page = anna.page
    page.get_by_test_id("layers").click()
    page.get_by_test_id("show-seen").click()
    page.keyboard.press("Escape")
    page.wait_for_function("() => document.querySelector('[data-testid=seen-sum]').dataset.ahead === '0'")
    assert anna.by("sectors").is_hidden()
    with page.expect_request(lambda request: "/api/seen/tiles/" in request.url and "by=operator" in request.url):
        page.get_by_test_id("seen-by").select_option("operator")
    current = "() => document.querySelector('[data-testid=seen-numbers]').dataset.current === 'true'"
    page.wait_for_function(current)
    legend, panel = page.locator(".seen-legend").inner_text(), anna.by("seen-panel").inner_text()
    assert "0.9 and more" in legend and "not seen for certain" in legend
    assert "declared, not measured" in panel and "by operator in the searched area" in panel
    view = anna.ask("api/seen/detection")
    lat, lon = view["detection"]["gaps"][0]["lat_deg"], view["detection"]["gaps"][0]["lon_deg"]
    around = [[lon - 1e-3, lat - 1e-3], [lon + 1e-3, lat - 1e-3], [lon + 1e-3, lat + 1e-3], [lon - 1e-3, lat - 1e-3]]
    path = sectors_file(tmp_path / "sectors.geojson", {"north <b>": around})
    page.set_input_files("[data-testid=sectors-file]", str(path))
    wait_for_numbers(anna, "in sector north <b>,")
    page.get_by_test_id("seen-by").select_option("machine")
    wait_for_numbers(anna, "no picture of a calibrated")
    assert "8 K warmer than the ground" in anna.by("seen-panel").inner_text()
    page.get_by_test_id("no-sectors").click()
    page.get_by_test_id("seen-by").select_option("operator")
    wait_for_numbers(anna, "in the searched area")
    bad = tmp_path / "places.kml"
    bad.write_text("<kml/>")
    page.set_input_files("[data-testid=sectors-file]", str(bad))
    wait_for_numbers(anna, "holds no Polygon")
    page.get_by_test_id("seen-by").select_option("age")
    assert anna.by("sectors").is_hidden() and "under 1" in page.locator(".seen-legend").inner_text()
    page.get_by_test_id("layers").click()
    page.get_by_test_id("show-seen").click()
    page.keyboard.press("Escape")
