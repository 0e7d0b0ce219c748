"""Who would have been found, on the page: the numbers that `pc-ground seen --pod` has, cells in colours, sectors."""

import io
import json
import re
import time
import zipfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from contract.errors import InputError
from contract.geodesy import LocalFrame
from ground.__main__ import main
from ground.seen import missions
from ground.seen.area import outlined_sector, read_sectors, sectors_of, woods_of
from ground.seen.export import gaps_kml
from ground.seen.outline import ring_area
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


def test_a_outlined_sector_is_one_more_and_those_of_the_page_are_kept_as_a_file(
    maps: tuple[SeenMap, FoundMap], tmp_path: Path
) -> None:
    _, found = maps
    assert found.add(outlined_sector("4", ring(*AREAS["4"])[:-1])) == 1
    assert found.add(outlined_sector("", ring(*AREAS["A & B"])[:-1])) == 2
    with pytest.raises(InputError, match="a sector 4 already"):
        found.add(outlined_sector(" 4 ", ring(0.0, 0.0)))
    state = computed(found)
    assert [one["name"] for one in state["sectors"]] == ["4", "1"]
    kept = tmp_path / "kept.geojson"
    kept.write_text(json.dumps(found.sectors()))
    found.choose(read_sectors(kept))
    assert computed(found)["lines"] == state["lines"]
    assert found.remove("4") == 1
    assert len(computed(found)["lines"]["machine"]) == 1
    with pytest.raises(InputError, match="no sector 4"):
        found.remove("4")


def test_a_kmz_s_sectors_are_those_of_the_kml_in_it(tmp_path: Path) -> None:
    corners = " ".join(f"{lon},{lat},0" for lon, lat in ring(0.0, 0.0))
    polygon = (
        f"<Polygon><outerBoundaryIs><LinearRing><coordinates>{corners}</coordinates></LinearRing></outerBoundaryIs>"
    )
    kml = f"<kml><Placemark><name>north</name>{polygon}</Polygon></Placemark></kml>"
    path = tmp_path / "sectors.kmz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("doc.kml", kml)
    for found in (read_sectors(path), sectors_of("from Google Earth.KMZ", path.read_bytes())):
        assert [sector.name for sector in found] == ["north"]
        np.testing.assert_allclose(found[0].rings[0], ring(0.0, 0.0)[:-1])
    with pytest.raises(InputError, match="unpack it"):
        woods_of("woods.geojson", path.read_bytes())
    with pytest.raises(InputError, match="not KMZ"):
        sectors_of("half.kmz", path.read_bytes()[:40])


@pytest.mark.parametrize(
    ("corners", "why"),
    [
        ([(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)], "sides cross"),
        ([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (1.0, 0.0), (0.0, 2.0)], "sides cross"),
        ([(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (0.0, 0.0)], "three corners"),
        ([(0.0, 0.0), (1.0, 0.0)], "three corners"),
        ([(0.0, 0.0), (1.0, 0.0), (1.0, 91.0)], "longitude and latitude"),
    ],
)
def test_a_outlined_sector_of_which_it_is_not_known_what_was_meant_is_refused(
    corners: list[tuple[float, float]], why: str
) -> None:
    with pytest.raises(InputError, match=why):
        outlined_sector("north", [list(corner) for corner in corners])


def test_corners_in_order_are_a_sector_whatever_its_form() -> None:
    bay = [(0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (2.0, 3.0), (2.0, 1.0), (1.0, 1.0), (1.0, 3.0), (0.0, 3.0), (0.0, 3.0)]
    (rings,) = outlined_sector("bay", [list(corner) for corner in bay]).polygons
    assert len(rings[0]) == 8
    turned = [bay[(k + 3) % 8] for k in range(8)][::-1]
    assert len(outlined_sector("bay", [list(corner) for corner in turned]).rings[0]) == 8


def test_the_page_s_rows_and_gaps_are_those_of_the_command_in_woods_too(
    session: Path, maps: tuple[SeenMap, FoundMap], tmp_path: Path
) -> None:
    _, found = maps
    with pytest.raises(InputError, match="not computed yet"):
        found.rows(None, 0.8)
    whole = computed(found)["lines"]["machine"]
    woods = tmp_path / "woods.geojson"
    wood = {"type": "Polygon", "coordinates": [ring(20.0, 16.0)]}
    woods.write_text(json.dumps({"type": "Feature", "properties": {"canopy": 0.7}, "geometry": wood}))
    found.choose_woods(woods_of(woods.name, woods.read_bytes()))
    state = computed(found)
    assert state["woods"] == 1 and state["lines"]["machine"] != whole
    plan, gaps = tmp_path / "gaps.plan", tmp_path / "gaps.kml"
    command = ["seen", "--from", str(session), "--pod", "--by", "operator", "--below", "0.9", "--woods", str(woods)]
    assert main([*command, "--fly", str(plan), "--height", "60", "--overlap", "0.5", "--out", str(gaps)]) == 0
    assert missions.plan(found.rows("operator", 0.9, 60.0, 0.5)) == plan.read_text()
    assert gaps_kml(*found.gaps("operator", 0.9)) == gaps.read_text()
    found.choose_woods([])
    assert computed(found)["lines"]["machine"] == whole


def wait_for_numbers(anna: Operator, text: str) -> None:
    numbers = "document.querySelector('[data-testid=seen-numbers]').textContent"
    anna.page.wait_for_function(f"text => {numbers}.includes(text)", arg=text)


def test_the_layer_states_whom_it_is_about_and_how_likely_in_each_sector(anna: Operator, tmp_path: Path) -> None:
    page = anna.page
    page.get_by_test_id("layers").click()
    page.get_by_test_id("show-seen").click()
    page.keyboard.press("Escape")
    page.wait_for_function("() => document.querySelector('[data-testid=seen-sum]').dataset.ahead === '0'")
    assert anna.by("sectors").is_hidden() and anna.by("draw").is_hidden() and anna.by("flights").is_hidden()
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


def fly_what_is_left(anna: Operator) -> None:
    """Rows over the gaps of the page's sector, and files of them and of the gaps."""
    page = anna.page
    page.locator("[data-testid=flights] summary").click()
    page.get_by_test_id("fly-below").select_option("0.9")
    page.get_by_test_id("fly-height").fill("40")
    page.get_by_test_id("fly").click()
    with page.expect_download() as plan:
        page.get_by_test_id("fly-plan").click()
    items = json.loads(Path(plan.value.path()).read_text())["mission"]["items"]
    assert plan.value.suggested_filename == "gaps.plan"
    assert len(items) >= 2 and {item["Altitude"] for item in items} == {40.0}
    assert "look at it before you fly it" in anna.by("fly-words").inner_text()
    with page.expect_download() as gaps:
        page.get_by_test_id("gaps-kml").click()
    assert "below 0.9 by operator" in Path(gaps.value.path()).read_text()
    assert anna.small() == []
    page.get_by_test_id("fly-overlap").select_option("0.5")
    assert anna.by("fly-files").inner_text() == ""  # of another choice


def test_a_sector_is_outlined_and_what_is_left_of_it_is_something_to_fly(anna: Operator) -> None:
    page = anna.page
    page.get_by_test_id("layers").click()
    page.get_by_test_id("show-seen").click()
    page.keyboard.press("Escape")
    page.get_by_test_id("seen-by").select_option("operator")
    wait_for_numbers(anna, "in the searched area")
    lat, lon = (anna.ask("api/seen/detection")["detection"]["gaps"][0][key] for key in ("lat_deg", "lon_deg"))

    page.locator("#fit").click()
    page.wait_for_function("() => / \\d+ m$/.test(document.querySelector('#grid-step').textContent)")

    def click_corners(*shares: tuple[float, float]) -> None:
        box = anna.by("map").bounding_box()
        for across, down in shares:
            page.mouse.click(box["x"] + across * box["width"], box["y"] + down * box["height"])

    page.locator("#follow").click()
    page.get_by_test_id("draw").click()
    assert page.locator("#follow").get_attribute("aria-pressed") == "false"  # it would move below the finger
    assert anna.by("draw-done").is_disabled()
    click_corners((0.3, 0.4), (0.7, 0.8), (0.7, 0.4), (0.3, 0.8))
    page.get_by_test_id("draw-name").fill("north <b>")
    page.keyboard.press("Enter")
    words = "document.querySelector('[data-testid=draw-words]').textContent"
    page.wait_for_function(f"() => {words}.includes('sides cross')")
    for _ in range(3):
        page.get_by_test_id("draw-back").click()
    click_corners((0.7, 0.4), (0.7, 0.8), (0.3, 0.8))
    stated = re.search(r"4 corners, ([\d.e+-]+) ha", anna.by("draw-words").inner_text())
    with page.expect_response(lambda response: response.url.endswith("/outline")) as outlined:
        page.get_by_test_id("draw-done").click()
    assert outlined.value.status == 201 and outlined.value.request.post_data_json["name"] == "north <b>"
    wait_for_numbers(anna, "in sector north <b>,")
    corners = LocalFrame(lat, lon, 0.0).to_enu(
        *np.array(outlined.value.request.post_data_json["corners"])[:, ::-1].T, np.zeros(4)
    )
    assert stated is not None and float(stated[1]) == pytest.approx(abs(ring_area(corners[:, :2])) / 1e4, rel=0.02)
    assert not anna.ask("api/pins")["pins"]
    fly_what_is_left(anna)
    page.get_by_test_id("no-sector").click()
    wait_for_numbers(anna, "in the searched area")
    page.get_by_test_id("draw").click()
    click_corners((0.3, 0.4))
    page.keyboard.press("Escape")
    assert anna.by("draw").is_visible() and anna.by("draw-done").is_hidden()
    page.get_by_test_id("seen-by").select_option("age")
    page.get_by_test_id("layers").click()
    page.get_by_test_id("show-seen").click()
    page.keyboard.press("Escape")
