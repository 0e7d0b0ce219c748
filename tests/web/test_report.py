"""The report of a search: one file that another machine shows without a network."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from contract.answer import Ellipse
from contract.geodesy import LocalFrame
from ground.formats.mark import Mark, up
from ground.formats.rounded import rounded_text
from ground.pins.model import PinClick
from ground.pins.store import PinStore
from ground.web.app import create_app
from ground.web.context import ServerContext
from ground.web.guard import Rules
from ground.web.report_map import report_map
from ground.web.seen_tile import empty_tile
from tests.web.browsing import Operator
from tests.web.rendered import FlyingSource
from tests.web.served import Simulated

pytestmark = pytest.mark.xdist_group("web")

SVG = "{http://www.w3.org/2000/svg}"


@pytest.mark.parametrize(("lat_deg", "lon_deg"), [(-43.38, 172.4), (68.0, -0.001), (-17.0, 179.999)])
def test_the_map_of_a_report_is_north_up_and_to_the_scale_of_its_bar(lat_deg: float, lon_deg: float) -> None:
    frame = LocalFrame(lat_deg, lon_deg, 0.0)
    marks = [Mark("0", "at the pole, where no such map is", "ok", number=4, lat_deg=90.0, lon_deg=lon_deg)]
    for number, (east_m, north_m) in enumerate([(0.0, 0.0), (300.0, 0.0), (0.0, 400.0)], start=1):
        lat, lon, _ = frame.to_geodetic([east_m, north_m, 0.0])
        ellipse = Ellipse(20.0, 5.0, 30.0 if number == 1 else 90.0)
        marks.append(
            Mark(str(number), "", "ok", number=number, lat_deg=float(lat), lon_deg=float(lon), ellipse=ellipse)
        )
    asked: list[tuple[int, int, int]] = []

    def tile(z: int, x: int, y: int) -> bytes:
        asked.append((z, x, y))
        return empty_tile()

    root = ET.fromstring(report_map(marks, [], tile))
    at = [(float(c.get("cx", "")), float(c.get("cy", ""))) for c in root.iter(f"{SVG}circle")]
    bar = next(e.get("d", "") for e in root.iter(f"{SVG}path"))
    left, right = map(float, re.findall(r"M(\S+) .* H(\S+) ", bar)[0])
    metres = float(next(e.text or "" for e in root.iter(f"{SVG}text") if "north" in (e.text or "")).split(" m")[0])
    px_per_m = (right - left) / metres
    assert at[1][0] - at[0][0] == pytest.approx(300.0 * px_per_m, rel=0.01) and at[1][1] == pytest.approx(
        at[0][1], abs=1
    )
    assert at[0][1] - at[2][1] == pytest.approx(400.0 * px_per_m, rel=0.01) and at[2][0] == pytest.approx(
        at[0][0], abs=1
    )
    first, second, _ = root.iter(f"{SVG}ellipse")
    assert float(first.get("rx", "")) == pytest.approx(20.0 * px_per_m, rel=0.02)
    # Turned clockwise from the east: an azimuth of 30 degrees is 60 less.
    assert first.get("transform", "").startswith("rotate(-60.0 ") and second.get("transform", "").startswith(
        "rotate(0.0 "
    )
    assert 1 <= len(asked) <= 36 and len(asked) == len(list(root.iter(f"{SVG}image")))
    assert all(0 <= column < 1 << z for z, column, _ in asked)
    assert any((text.text or "").startswith("1 beyond 85 degrees") for text in root.iter(f"{SVG}text"))
    assert report_map(marks[:1], [], tile) == ""


def test_a_report_has_every_place_of_a_pin_that_contradicts_itself_and_no_radius_below_the_known_one(
    tmp_path: Path,
) -> None:
    with PinStore(tmp_path / "pins.sqlite") as store:
        clicks = [PinClick.entered(-35.12, 149.16 + k * 1e-3, sigma_m=0.0101, sigma_height_m=1.0) for k in range(2)]
        store.add(clicks, name="two things")
        app = create_app(ServerContext(FlyingSource(), store, tmp_path), Rules())
        with TestClient(app, base_url="http://127.0.0.1:8080") as client:
            text = client.get("/api/report").text
    assert "contradict each other" in text and text.count("<circle") == 2 and text.count("<tr>") == 2
    for lon_deg in (149.16, 149.161):
        assert f"-35.1200000 {lon_deg:.7f}" in text
    assert text.count("+-0.1 m (CE90)") == 2 and "0.0 x" not in text  # of 0.0217 m


def test_a_report_has_map_pins_what_was_seen_who_and_when_in_one_file(
    anna: Operator, simulated: Simulated, chromium: Any, tmp_path: Path
) -> None:
    anna.page.locator("#who").fill("anna <b>")
    anna.page.keyboard.press("Tab")
    anna.click(300.0, 200.0)
    pin = anna.newest_pin()
    anna.page.request.patch(f"{anna.server.local}api/pins/{pin['id']}", data={"name": "<img src=x onerror=alert(1)>"})
    anna.by("export").click()
    with anna.page.expect_download() as downloading:
        anna.by("report").click()
    file = tmp_path / "report.html"
    downloading.value.save_as(file)
    assert re.fullmatch(r"search-\d{8}-\d{4}Z\.html", downloading.value.suggested_filename)
    content = file.read_text("utf-8")
    assert "http" not in content.replace("http://www.w3.org/2000/svg", "")  # all of it is here
    context = chromium.new_context(offline=True)
    try:
        page = context.new_page()
        alarms: list[str] = []
        page.on("dialog", lambda dialog: alarms.append(dialog.message))
        page.goto(file.as_uri())
        text = page.locator("body").inner_text()
        place = pin["place"]
        assert rounded_text("mgrs", place["lat_deg"], place["lon_deg"], place["ce90_m"]) in text
        assert f"+-{up(place['ce90_m']):.1f} m (CE90)" in text and "<img src=x onerror=alert(1)>" in text
        assert "by anna <b>, from" in text and "Marked by: anna <b>" in text
        assert re.search(r"\d+\.\d\d ha for certain, in \d+ pictures", text) and re.search(r"POD 0\.\d+", text)
        assert f"{simulated.vehicle}: {len(simulated.frames)} pictures, 20" in text
        page.wait_for_function("() => document.querySelector('td img').naturalWidth > 50")
        assert page.locator("svg image").count() >= 1 and page.locator("svg circle").count() == 1 and alarms == []
    finally:
        context.close()
