"""The page in a real Chromium, on a replayed flight, as an operator uses it."""

import signal
from collections.abc import Callable
from typing import Any

import pytest

from ground.formats.rounded import decimals
from ground.recording import Recording
from tests.rest_long import rest_long
from tests.waiting import PATIENCE_S
from tests.web.browsing import Operator
from tests.web.served import ROOT, Server, Simulated

pytestmark = pytest.mark.xdist_group("web")

Serve = Callable[..., Server]
Operators = Callable[..., Operator]
AXE = ROOT / "frontend" / "node_modules" / "axe-core" / "axe.min.js"


def test_a_click_becomes_a_pin_that_is_there_after_a_reload(anna: Operator, simulated: Simulated) -> None:
    reported = anna.click(200.0, 150.0)
    pin = anna.newest_pin()
    click = pin["clicks"][0]
    assert (click["frame"], click["session"]) == (simulated.newest, anna.newest_pin()["clicks"][0]["session"])
    assert click["u_px"] == pytest.approx(200.0, abs=0.6)
    assert click["v_px"] == pytest.approx(150.0, abs=0.6)
    place = pin["place"]
    digits = decimals("degrees", place["ce90_m"])
    assert f"{place['lat_deg']:.{digits}f}, {place['lon_deg']:.{digits}f}" in reported
    assert "90 % within" in reported
    assert "above sea level" in reported
    marker = anna.by("picture-pin").first.locator(".spot").bounding_box()
    x, y = anna.at(200.0, 150.0)
    assert abs(marker["x"] + marker["width"] / 2 - x) < 1.0
    assert abs(marker["y"] + marker["height"] / 2 - y) < 1.0
    row = anna.by("pin").first.inner_text()
    anna.open()
    anna.page.wait_for_selector("[data-testid=pin]")
    assert anna.by("pin").count() == 1
    assert anna.by("pin").first.inner_text() == row
    # The same place is marked in another picture, where it is seen from there.
    anna.show(simulated.newest - 3, simulated)
    anna.page.wait_for_selector("[data-testid=picture-pin]")
    seen = anna.ask(f"api/pins/{pin['id']}/seen")
    row = next(r for r in seen if r["frame"] == simulated.newest - 3)
    marker = anna.by("picture-pin").first.locator(".spot").bounding_box()
    x, y = anna.at(row["u_px"], row["v_px"])
    assert abs(marker["x"] + marker["width"] / 2 - x) < 1.0
    assert abs(marker["y"] + marker["height"] / 2 - y) < 1.0


def test_a_frozen_and_a_stepped_picture_is_clicked_as_itself(anna: Operator, simulated: Simulated) -> None:
    if anna.by("freeze").get_attribute("aria-pressed") == "false":
        anna.by("freeze").click()
    assert anna.by("freeze").get_attribute("aria-pressed") == "true"
    for expected in (simulated.newest - 1, simulated.newest - 2):
        anna.by("step-back").click()
        anna.wait_for_frame(expected)
    anna.click(330.0, 220.0)
    pin = anna.newest_pin()
    assert pin["clicks"][0]["frame"] == simulated.newest - 2
    recording = Recording(simulated.path)
    age_s = recording.age_s(recording.by_frame(simulated.vehicle, simulated.newest - 2) or pytest.fail("no set"))
    assert f"{age_s:.1f} s old" in anna.by("answer").inner_text()
    anna.page.keyboard.press("ArrowRight")
    anna.wait_for_frame(simulated.newest - 1)


def test_a_refused_click_says_why_and_what_helps_at_the_spot(anna: Operator, simulated: Simulated) -> None:
    anna.show(simulated.refused, simulated)
    assert "cannot be clicked" in anna.page.locator("#banner").inner_text()
    reported = anna.click(400.0, 100.0)
    assert reported.startswith("Refused: the aircraft was turning too fast")
    assert "What helps" in reported
    bubble = anna.page.locator(".bubble").bounding_box()
    x, y = anna.at(400.0, 100.0)
    assert bubble["x"] - 5 <= x <= bubble["x"] + bubble["width"] + 20
    assert 0 < bubble["y"] - y < 40
    assert anna.by("pin").count() == 0
    # Without a picture, the features of the one before still make one to click.
    anna.show(simulated.newest, simulated)
    anna.page.wait_for_selector(".bubble", state="hidden")


def test_what_was_pressed_is_clicked_whatever_happens_before_the_release(
    operators: Operators, simulated: Simulated
) -> None:
    """Resized, zoomed, and another picture shown between press and release; at twice the pixels of the screen."""
    anna = operators(device_scale_factor=2, has_map=False)
    page = anna.page
    page.mouse.move(*anna.at(250.0, 180.0))
    page.mouse.down()
    width = anna.by("picture").bounding_box()["width"]
    page.set_viewport_size({"width": 1000, "height": 700})
    with page.expect_response(lambda reported: f"/frames/{simulated.newest - 1}/features" in reported.url):
        page.keyboard.press("ArrowLeft")
    page.keyboard.press("+")
    anna.wait_for_zoom(1.4)
    assert anna.by("picture").bounding_box()["width"] < width
    assert anna.frame() == simulated.newest
    page.mouse.up()
    page.wait_for_selector("[data-testid=pin]")
    click = anna.newest_pin()["clicks"][0]
    assert click["frame"] == simulated.newest
    assert (click["u_px"], click["v_px"]) == (pytest.approx(250.0, abs=0.6), pytest.approx(180.0, abs=0.6))
    # Zoomed in by the wheel about a pixel, that pixel stays where it is; what is clicked next to it is what is seen.
    page.keyboard.press("0")
    anna.show(simulated.newest, simulated)
    x, y = anna.at(400.0, 300.0)
    page.mouse.move(x, y)
    page.mouse.wheel(0, -600)
    anna.wait_for_zoom(1.3)
    page.mouse.click(x, y)
    anna.wait_for_pins(2)
    click = anna.newest_pin()["clicks"][0]
    assert (click["u_px"], click["v_px"]) == (pytest.approx(400.0, abs=0.6), pytest.approx(300.0, abs=0.6))
    # A drag moves the zoomed picture and clicks nothing.
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 60, y - 40, steps=4)
    page.mouse.up()
    page.keyboard.down("Shift")  # there is a pin, which a click alone would choose
    page.mouse.click(x - 60, y - 40)
    page.keyboard.up("Shift")
    anna.wait_for_pins(3)
    click = anna.newest_pin()["clicks"][0]
    assert (click["u_px"], click["v_px"]) == (pytest.approx(400.0, abs=0.6), pytest.approx(300.0, abs=0.6))


def test_two_operators_share_pins_and_a_name_is_only_text(anna: Operator, operators: Operators) -> None:
    bo = operators(has_map=False)
    assert bo.page.locator("#no-map").is_visible()
    assert not anna.page.locator("#no-map").is_visible()
    anna.click(300.0, 200.0)
    bo.page.wait_for_selector("[data-testid=pin]")
    anna.by("pin").first.click()
    name = "<img src=x onerror=alert(1)> =1+1"
    anna.page.get_by_label("name", exact=True).fill(name)
    anna.page.keyboard.press("Tab")
    bo.page.wait_for_function("t => document.querySelector('[data-testid=pin]').innerText.includes(t)", arg=name)
    assert bo.page.locator("[data-testid=pin] img").count() == 0
    bo.by("pin").first.hover()
    bo.page.wait_for_selector(".marker.marked", state="attached")
    anna.page.get_by_role("button", name="Delete").click()
    bo.wait_for_pins(0)
    anna.page.locator("#undo").click()
    bo.page.wait_for_selector("[data-testid=pin]")


def test_a_tie_moves_every_pin_of_the_aircraft(anna: Operator, simulated: Simulated) -> None:
    anna.click(200.0, 150.0)
    anna.click(450.0, 330.0)
    before = [row.inner_text() for row in anna.by("pin").all()]
    where = anna.page.request.post(
        f"{anna.server.local}api/click",
        data={"vehicle": simulated.vehicle, "frame": simulated.newest, "u": 320, "v": 240},
    ).json()
    anna.by("tie").click()
    anna.page.mouse.click(*anna.at(320.0, 240.0))
    anna.page.locator("#tie-form [name=place]").fill(f"{where['lat_deg'] + 3e-5:.7f}, {where['lon_deg']:.7f}")
    anna.page.locator("#tie-form [name=sigma]").fill("0.3")
    anna.page.locator("#tie-form button[type=submit]").click()
    anna.page.wait_for_function(
        "t => [...document.querySelectorAll('[data-testid=pin]')].every((row, k) => row.innerText !== t[k])", arg=before
    )
    anna.by("tie").click()
    anna.page.mouse.click(*anna.at(320.0, 240.0))
    anna.page.locator("#tie-form [name=place]").fill(f"{where['lat_deg'] + 5e-3:.7f}, {where['lon_deg']:.7f}")
    anna.page.locator("#tie-form button[type=submit]").click()
    anna.page.wait_for_function("() => document.querySelector('#tie-result').textContent.includes('still be accepted')")
    anna.page.locator("#tie-dialog [data-close]").click()


@pytest.mark.parametrize(("width", "height"), rest_long([(390, 844), (1280, 800), (1024, 768)]))
def test_no_button_is_cut_off(operators: Operators, width: int, height: int) -> None:
    """On a laptop, a tablet held across and a phone; nor on a chosen pin's card, with what its radius is from."""
    anna = operators(has_map=False, viewport={"width": width, "height": height}, has_touch=width < 1280)
    cut = (
        "() => [...document.querySelectorAll('.toolbar button, .pin-card .buttons button')]"
        ".filter(e => e.offsetParent !== null).filter(e => { const b = e.getBoundingClientRect(),"
        " p = e.closest('.pin-card, section').getBoundingClientRect();"
        " return b.right > p.right || b.bottom > p.bottom + 0.5; }).map(e => e.id || e.textContent)"
    )
    assert anna.page.evaluate(cut) == []
    anna.click(320.0, 240.0)
    anna.page.get_by_test_id("pin").first.evaluate("e => e.click()")
    anna.page.wait_for_selector("[data-testid=smaller]")
    assert anna.page.evaluate(cut) == []
    assert anna.small() == []
    anna.by("layers").click()
    assert anna.small() == []
    if width > 600:  # a phone has one view after the other
        for view in ("both", "map"):
            anna.page.locator(f"#views [data-view={view}]").click()
            assert anna.page.evaluate(cut) == [] and anna.small() == []


def test_a_tablet_is_used_by_touch(operators: Operators) -> None:
    anna = operators(has_map=False, viewport={"width": 800, "height": 1280}, has_touch=True, device_scale_factor=2)
    page = anna.page
    page.touchscreen.tap(*anna.at(220.0, 260.0))
    page.wait_for_selector("[data-testid=pin]")
    click = anna.newest_pin()["clicks"][0]
    assert (click["u_px"], click["v_px"]) == (pytest.approx(220.0, abs=1.0), pytest.approx(260.0, abs=1.0))
    assert anna.small() == []
    touch = anna.context.new_cdp_session(page)

    def fingers(kind: str, *points: tuple[float, float]) -> None:
        touch.send(
            "Input.dispatchTouchEvent",
            {"type": kind, "touchPoints": [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)]},
        )

    # A held finger gets a loupe, aims while it slides, and clicks where it is lifted.
    fingers("touchStart", anna.at(100.0, 300.0))
    page.wait_for_selector("#loupe", state="visible")
    fingers("touchMove", anna.at(150.0, 330.0))
    fingers("touchMove", anna.at(180.0, 340.0))
    fingers("touchEnd")
    anna.wait_for_pins(2)
    click = anna.newest_pin()["clicks"][0]
    assert (click["u_px"], click["v_px"]) == (pytest.approx(180.0, abs=1.0), pytest.approx(340.0, abs=1.0))
    assert not page.locator("#loupe").is_visible()
    # Two fingers zoom and click nothing.
    x, y = anna.at(320.0, 240.0)
    fingers("touchStart", (x - 40, y), (x + 40, y))
    for k in range(1, 6):
        fingers("touchMove", (x - 40 - 16 * k, y), (x + 40 + 16 * k, y))
    fingers("touchEnd")
    anna.wait_for_zoom(2.5)
    page.touchscreen.tap(x, y)
    anna.wait_for_pins(3)
    click = anna.newest_pin()["clicks"][0]
    assert (click["u_px"], click["v_px"]) == (pytest.approx(320.0, abs=2.0), pytest.approx(240.0, abs=2.0))
    page.touchscreen.tap(x + 60, y)
    anna.wait_for_pins(4)
    moved_px = anna.newest_pin()["clicks"][0]["u_px"] - click["u_px"]
    assert moved_px == pytest.approx(60.0 * 640.0 / anna.by("picture").bounding_box()["width"] / 3.0, rel=0.1)


def test_a_server_that_is_killed_and_started_again_has_lost_nothing(anna: Operator) -> None:
    anna.click(300.0, 200.0)
    anna.click(340.0, 260.0)
    anna.wait_for_pins(2)
    rows = [row.inner_text() for row in anna.by("pin").all()]
    anna.server.kill()
    anna.page.wait_for_selector("#offline", state="visible")
    reported = anna.click(100.0, 100.0)
    assert reported.startswith("Not kept")
    anna.server.start(anna.server.port)
    anna.page.wait_for_selector("#offline", state="hidden")
    assert [row.inner_text() for row in anna.by("pin").all()] == rows
    anna.click(400.0, 300.0)
    anna.wait_for_pins(3)
    anna.forgive_a_lost_server()


def test_other_machines_need_the_token_and_the_first_page_is_small_and_its_own(serve: Serve, chromium: Any) -> None:
    server = serve("--host", "0.0.0.0")
    assert "NO TLS" in server.printed
    assert "▄" in server.printed  # the QR code
    link, base = server.url, server.local
    assert "?token=" in link
    context = chromium.new_context()
    try:
        page = context.new_page()
        refused = page.goto(base)
        assert refused is not None
        assert refused.status == 401
        assert context.request.get(f"{base}api/pins").status == 401
        assert context.request.get(f"{base}?token=wrong").status == 401
        page.goto(f"{base}?token={link.split('token=')[1]}")
        page.wait_for_selector("body[data-ready]", timeout=PATIENCE_S * 1000.0)
        assert page.url == base
        assert page.request.get(f"{base}api/pins").status == 200
        # A cold browser: this is all that a first visit transfers.
        sizes = page.evaluate(
            "performance.getEntriesByType('resource').concat(performance.getEntriesByType('navigation'))"
            ".map(e => [e.name, e.transferSize])"
        )
        assert len(sizes) > 5
        assert 300_000 < sum(size for _, size in sizes) < 3_000_000
        assert all(name.startswith(base) for name, _ in sizes)
    finally:
        context.close()


def test_contrast_and_names_are_accessible(anna: Operator, simulated: Simulated) -> None:
    """By day and by night: the page with a chosen pin, the hand-off card, and a refusal."""
    if not AXE.is_file():
        pytest.fail(f"{AXE} is not there: make web")
    anna.click(300.0, 200.0)
    anna.by("pin").first.click()
    anna.page.evaluate(AXE.read_text(encoding="utf-8") + "; undefined")

    def violations() -> list[str]:
        found = anna.page.evaluate(
            "axe.run(document, {runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa'],"
            " resultTypes: ['violations']})"
        )
        return [f"{v['id']}: {n['html'][:120]}: {n['failureSummary']}" for v in found["violations"] for n in v["nodes"]]

    def as_by(theme: str) -> None:
        anna.page.evaluate(
            "theme => { const e = document.querySelector('#theme'); e.value = theme;"
            " e.dispatchEvent(new Event('change')); }",
            theme,
        )

    places = "axe.run(document, {runOnly: {type: 'rule', values: ['landmark-unique', 'page-has-heading-one']}})"
    assert anna.page.evaluate(f"{places}.then(f => f.violations.map(v => v.id))") == []
    for theme in ("day", "night"):
        as_by(theme)
        assert violations() == []
    anna.page.locator(".craft").click()
    anna.by("layers").click()
    assert violations() == []  # by night
    anna.page.keyboard.press("Escape")
    anna.by("handoff").click()
    anna.page.wait_for_selector(".format")
    assert violations() == []  # by night
    anna.page.keyboard.press("Escape")
    anna.show(simulated.refused, simulated)
    anna.click(200.0, 200.0)
    as_by("day")
    assert violations() == []


def test_sigint_ends_the_server_at_once(anna: Operator) -> None:
    """Though a browser is connected, and would be for hours."""
    anna.server.process.send_signal(signal.SIGINT)
    anna.server.process.wait(PATIENCE_S)
    anna.server.start(anna.server.port)
    anna.page.wait_for_selector("#offline", state="hidden")
    anna.forgive_a_lost_server()
