"""What a chosen pin offers: its coordinate in the chosen system, copied, shared, and how far it is from here."""

import math
import re
import socket
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any

import pytest

from contract.geodesy import LocalFrame
from ground.formats.rounded import rounded_text
from tests.waiting import PATIENCE_S
from tests.web.browsing import Operator
from tests.web.served import Server

pytestmark = pytest.mark.xdist_group("web")

Operators = Callable[..., Operator]
# A phone with a clipboard and a sheet of its own, whose calls are kept; and one without a sheet.
SHEET = """() => { window.kept = [];
  navigator.clipboard.writeText = async text => { window.kept.push(text); };
  navigator.share = async what => { window.kept.push(what.text); }; }"""


def chosen(anna: Operator) -> dict[str, Any]:
    """A pin of hers, whose card is open and whose measurement is over."""
    anna.click(300.0, 200.0)
    pin = anna.newest_pin()
    anna.by("pin").first.click()
    anna.page.wait_for_selector("#pin-card [data-testid=coordinate]")
    return pin


def test_the_chosen_system_is_large_at_the_answer_and_the_card_and_is_remembered(anna: Operator) -> None:
    place = chosen(anna)["place"]
    where = place["lat_deg"], place["lon_deg"], place["ce90_m"]
    both, shown = anna.by("coordinate"), "document.querySelectorAll('[data-testid=coordinate]')"
    assert both.count() == 2
    for form in ("mgrs", "utm", "seconds", "degrees", "mgrs"):
        anna.page.locator("#pin-card [data-testid=form]").select_option(form)
        wanted = rounded_text(form, *where).replace(" ", ", " if form == "degrees" else " ")
        anna.page.wait_for_function(f"t => [...{shown}].every(e => e.textContent === t)", arg=wanted)
    assert re.fullmatch(r"\d\d[A-Z] [A-Z]{2} \d{4,5} \d{4,5}", wanted)
    size = "e => parseFloat(getComputedStyle(e).fontSize)"
    for k in (0, 1):
        assert both.nth(k).evaluate(size) > 1.2 * anna.by("how").evaluate(size)
    anna.open()
    anna.by("pin").first.click()
    anna.page.wait_for_function(
        "t => document.querySelector('#pin-card [data-testid=coordinate]').textContent === t", arg=wanted
    )
    anna.page.locator("#pin-card [data-testid=form]").select_option("degrees")


def test_a_pin_is_copied_and_shared_as_it_is_written(anna: Operator) -> None:
    pin = chosen(anna)
    written = anna.page.locator("#pin-card [data-testid=coordinate]").inner_text()
    geo = anna.ask(f"api/pins/{pin['id']}/handoff")["geo"]
    # Without a sheet of the system's: what a phone's camera or a map program takes.
    assert anna.page.evaluate("() => navigator.share === undefined")
    anna.by("share").click()
    assert anna.by("geo").get_attribute("href") == geo
    anna.page.wait_for_function("() => document.querySelector('#pin-card .qr').naturalWidth > 50")
    anna.page.evaluate(SHEET)
    anna.by("copy").click()
    anna.page.wait_for_function("() => document.querySelector('[data-testid=copy]').textContent === 'Copied'")
    anna.by("share").click()
    anna.page.wait_for_function("() => window.kept.length === 2")
    copied, shared = anna.page.evaluate("() => window.kept")
    assert copied == written
    assert written in shared and geo in shared and "90 % within" in shared
    anna.page.evaluate("() => { delete navigator.share; delete navigator.clipboard.writeText; }")


def test_from_here_a_pin_has_a_distance_and_a_bearing_true_and_magnetic(operators: Operators) -> None:
    anna = operators(has_map=False, permissions=["geolocation"])
    place = chosen(anna)["place"]
    frame = LocalFrame(place["lat_deg"], place["lon_deg"], 0.0)
    lat, lon, _ = frame.to_geodetic([-300.0, -400.0, 0.0])  # 500 m from it, which lies to the north-east
    anna.context.set_geolocation({"latitude": float(lat), "longitude": float(lon), "accuracy": 12.0})
    anna.by("from-me-button").click()
    line = anna.by("from-me")
    anna.page.wait_for_function("() => document.querySelector('[data-testid=from-me]').textContent.includes('true')")
    found = re.fullmatch(
        r"From me: (\d+) m, (\d{3})° true, (\d{3})° magnetic; this device's position within 12.0 m \(95 %\)",
        line.inner_text(),
    )
    assert found is not None, line.inner_text()
    metres, true_deg, magnetic_deg = map(int, found.groups())
    assert metres == pytest.approx(500, abs=1) and true_deg == round(math.degrees(math.atan2(300, 400)))
    # A compass points some 24 degrees east of north in Canterbury (World Magnetic Model 2025: 23.8 in 2026).
    assert (true_deg - magnetic_deg) % 360 == pytest.approx(24, abs=1)
    # Whoever walks sees it change; a second press ends it.
    lat, lon, _ = frame.to_geodetic([0.0, -100.0, 0.0])
    anna.context.set_geolocation({"latitude": float(lat), "longitude": float(lon), "accuracy": 12.0})
    near = "() => document.querySelector('[data-testid=from-me]').textContent.includes(' 100 m, 000°')"
    anna.page.wait_for_function(near)
    anna.by("from-me-button").click()
    assert line.count() == 0


def test_without_a_position_it_is_stated_why(operators: Operators) -> None:
    anna = operators(has_map=False)
    chosen(anna)
    anna.by("from-me-button").click()
    anna.page.wait_for_function(
        "() => document.querySelector('[data-testid=from-me]').textContent.includes('may not use its position')"
    )


def test_one_pin_is_sent_to_the_tak_server_and_one_that_is_gone_is_reported(
    serve: Callable[..., Server], operators: Operators
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as tak:
        tak.settimeout(PATIENCE_S)
        to = f"tcp://127.0.0.1:{tak.getsockname()[1]}"
        anna = operators(serve("--tak", to), has_map=False)
        pin = chosen(anna)
        anna.by("handoff").click()
        anna.by("tak-send").click()
        stream, _ = tak.accept()
        with stream:
            stream.settimeout(PATIENCE_S)
            received = b"".join(iter(lambda: stream.recv(65536), b""))
    result = "text => document.querySelector('[data-testid=tak-result]').textContent.startsWith(text)"
    anna.page.wait_for_function(result, arg=f"sent to {to}, 20")
    event = ET.fromstring(received)
    point, place = event.find("point"), pin["place"]
    assert event.get("uid") == f"pointclick.{pin['id']}" and point is not None
    assert float(point.get("lat", "")) == pytest.approx(place["lat_deg"], abs=1e-6)
    assert float(point.get("ce", "")) == pytest.approx(place["ce90_m"], rel=0.1)
    anna.by("tak-send").click()
    anna.page.wait_for_function(result, arg=f"not sent: cannot open {to}")


def test_without_a_tak_server_there_is_no_button(anna: Operator) -> None:
    pin = chosen(anna)
    anna.by("handoff").click()
    anna.page.wait_for_selector("[data-testid=package]")
    assert anna.by("tak-send").count() == 0
    refused = anna.page.request.post(f"{anna.server.local}api/pins/{pin['id']}/tak")
    assert refused.status == 409 and "--tak" in refused.json()["detail"]
