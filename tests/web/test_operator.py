"""What an operator sees and does beyond a first click: ages, the place under the cursor, stray clicks, phones."""

import itertools
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ground.pins.model import PinClick
from tests.rest_long import rest_long
from tests.waiting import eventually
from tests.web.browsing import Operator
from tests.web.conftest import page_is_built
from tests.web.flying import Flight
from tests.web.measured import opened, share_of
from tests.web.rendered import rendered_set
from tests.web.served import ROOT, Simulated

pytestmark = pytest.mark.xdist_group("web")

Operators = Callable[..., Operator]
PHONE = {"width": 390, "height": 844}
# A finger that stays aims; a swipe of this test's does not stay, however long the machine takes from touch to touch.
HOLD_MS = int(re.findall(r"HOLD_MS = (\d+);", (ROOT / "frontend" / "src" / "picture.ts").read_text("utf-8"))[0])
NEVER_HELD = """hold => {
  const later = window.setTimeout;
  window.setTimeout = (work, after, ...more) => after === hold ? 0 : later(work, after, ...more);
}"""
TWELVE = 12
# Of each control that is seen: the contrast of its border with what lies around it, as WCAG 2.2 (1.4.11) counts it.
BORDERS = """() => {
  const channel = c => { c /= 255; return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4; };
  const light = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
  const numbers = text => (text.match(/[\\d.]+/g) || []).map(Number);
  const ground = e => {
    for (let at = e.parentElement; at; at = at.parentElement) {
      const c = numbers(getComputedStyle(at).backgroundColor);
      if (c.length === 3 || c[3] > 0.99) return c;
    }
    return [255, 255, 255];
  };
  const out = [];
  const within = document.querySelector('dialog[open]') ?? document;
  for (const e of within.querySelectorAll('button, select, textarea, input:not([type=range]):not([type=file])')) {
    if (e.offsetParent === null || e.closest('.maplibregl-map') || e.getBoundingClientRect().height === 0) continue;
    const [a, b] = [light(numbers(getComputedStyle(e).borderTopColor)), light(ground(e))];
    const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (contrast < 3) out.push(`${e.id || e.textContent || e.className}: ${contrast.toFixed(2)}`);
  }
  return out;
}"""


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Flight]:
    """Twelve aircraft on a link, of which forty pictures each have come."""
    page_is_built()
    with Flight(tmp_path_factory.mktemp("fleet") / "pins.sqlite", aircraft=TWELVE) as flight:
        flight.source.fly_to(40)
        yield flight


@pytest.fixture(scope="module")
def screen(fleet: Flight, chromium: Any) -> Iterator[Any]:
    page = opened(chromium, fleet.url)
    yield page
    page.context.close()


def wait_for_age(page: Any, pattern: str) -> None:
    page.wait_for_function("p => new RegExp(p).test(document.querySelector('#age').textContent)", arg=pattern)


def test_the_age_of_what_is_seen_is_on_the_picture_and_counts(fleet: Flight, screen: Any) -> None:
    badge = screen.get_by_test_id("age")
    wait_for_age(screen, r"^LIVE \d\.\d s$")
    assert badge.get_attribute("data-kind") == "live"
    fleet.source.silent_s = 8.0
    wait_for_age(screen, r"^\d+(\.\d)? s OLD$")
    assert badge.get_attribute("data-kind") == "old"
    fleet.source.silent_s = 45.0  # it looks as it did, and is no longer what is there
    wait_for_age(screen, r"^LOST · 4\d s OLD$")
    assert badge.get_attribute("data-kind") == "lost"
    fleet.source.silent_s = 0.1
    wait_for_age(screen, r"^LIVE")
    screen.keyboard.press("Space")
    wait_for_age(screen, r"^FROZEN · \d")
    screen.keyboard.press("Space")
    wait_for_age(screen, r"^LIVE")


def test_points_and_paths_are_off_and_come_for_some_seconds(screen: Any) -> None:
    button = screen.locator("#show-features")
    assert button.get_attribute("aria-pressed") == "false"
    screen.get_by_test_id("layers").click()
    button.click()
    assert button.is_hidden()  # the menu would lie over what is asked for
    screen.keyboard.press("f")
    screen.wait_for_selector("#show-features[aria-pressed=false]", state="attached")
    before = screen.locator("#canvas").screenshot()

    def are_shown() -> bool:
        """Looked at while they are: once more where a busy machine drew them later than that."""
        if button.get_attribute("aria-pressed") == "false":
            screen.keyboard.press("f")
        return bool(screen.locator("#canvas").screenshot() != before)

    assert eventually(are_shown)
    screen.wait_for_selector("#show-features[aria-pressed=false]", state="attached")


def test_all_aircraft_are_in_the_strip_and_on_the_map_and_the_chosen_one_is_strong(fleet: Flight, screen: Any) -> None:
    tiles = screen.locator("#status-strip .craft")
    assert tiles.count() == TWELVE
    strip = screen.locator("#status-strip").bounding_box()
    for k in range(TWELVE):
        box = tiles.nth(k).bounding_box()
        assert box["y"] + box["height"] <= strip["y"] + strip["height"] + 1.0  # none is cut off
        assert box["x"] + box["width"] <= strip["x"] + strip["width"] + 1.0
    assert strip["height"] < 120.0
    screen.locator("#status-strip .craft[data-vehicle=uav-7]").click()
    screen.wait_for_selector("[data-vehicle=uav-7][aria-pressed=true]")
    screen.locator("#status-strip .craft[data-vehicle=uav-1]").click()


def test_an_aircraft_is_a_coloured_pill_and_its_words_come_when_it_is_pressed(fleet: Flight, screen: Any) -> None:
    screen.wait_for_selector("[data-vehicle=uav-1][aria-pressed=true]")
    pill, card = screen.locator("[data-vehicle=uav-1]"), screen.get_by_test_id("craft-card")
    assert re.match(r"●\s*uav-1\s*\d\.\d s$", pill.inner_text()) and card.is_hidden()
    pill.click()
    card.wait_for()
    words = card.inner_text()
    for wanted in (r"90 % within \d", r"Height\s+\d+\.\d m above the ground in view, \d+ m above sea", r"Link\s+\d",
                   r"GPS\s+RTK fixed, 17 satellites", r"Battery\s+64 %, 22\.1 V", r"Mode\s+AUTO"):  # fmt: skip
        assert re.search(wanted, words), words
    colours = []
    for silent_s in (0.1, 8.0, 45.0):
        fleet.source.silent_s = silent_s
        state = {0.1: "well", 8.0: "warning", 45.0: "lost"}[silent_s]
        screen.wait_for_selector(f"[data-vehicle=uav-1][data-state={state}]")
        colours.append(pill.evaluate("e => getComputedStyle(e).backgroundColor"))
        assert ("Battery" in card.inner_text()) == (silent_s < 10.0)  # it is stated as of now
    assert len(set(colours)) == 3
    fleet.source.silent_s, fleet.source.status_age_s = 0.1, 20.0
    screen.wait_for_selector("[data-vehicle=uav-1][data-state=well]")
    assert not re.search("GPS|Battery|Mode", card.inner_text())
    fleet.source.status_age_s = 0.1
    screen.keyboard.press("Escape")
    card.wait_for(state="hidden")


def test_picture_and_map_are_swapped_and_shown_side_by_side(screen: Any) -> None:
    def widths() -> tuple[float, float]:
        return tuple(screen.locator(pane).bounding_box()["width"] for pane in (".stage", ".map-box"))  # type: ignore[return-value]

    picture, small = widths()
    assert picture > 1.9 * small
    screen.locator("#views [data-view=map]").click()
    swapped, large = widths()
    assert large > 1.9 * swapped
    screen.locator("#views [data-view=both]").click()
    left, right = widths()
    assert 0.7 * left < right < 1.4 * left
    screen.reload()
    screen.wait_for_selector("body[data-view=both]")  # it is remembered
    screen.wait_for_selector("body[data-ready]")
    screen.keyboard.press("m")
    screen.keyboard.press("m")
    screen.wait_for_selector("body[data-view=picture]")


def test_what_was_clicked_is_marked_on_the_time_bar(anna: Operator, simulated: Simulated) -> None:
    marks = anna.by("time-mark")
    anna.show(simulated.newest - 2, simulated)
    anna.click(300.0, 200.0)
    marks.first.wait_for(state="attached")
    assert marks.count() == 1 and marks.first.get_attribute("data-frame") == str(simulated.newest - 2)
    bar, mark = anna.page.locator("#time-bar").bounding_box(), marks.first.bounding_box()
    share = simulated.frames.index(simulated.newest - 2) / (len(simulated.frames) - 1)
    middle = mark["x"] + mark["width"] / 2 - bar["x"]
    assert middle == pytest.approx(8.0 + share * (bar["width"] - 16.0), abs=1.5)  # where the thumb would be
    anna.clear()
    marks.first.wait_for(state="detached")


def test_what_would_make_a_radius_smaller_is_in_the_strip_and_at_an_answer(fleet: Flight, screen: Any) -> None:
    reported = "Mostly the camera's mount (60 %): fly one circle"
    chosen = screen.locator("#status-strip .craft[aria-pressed=true]")
    assert reported in chosen.get_attribute("title")
    chosen.click()
    assert reported in screen.get_by_test_id("craft-card").inner_text()
    chosen.click()
    box = screen.get_by_test_id("picture").bounding_box()
    screen.mouse.click(box["x"] + 0.4 * box["width"], box["y"] + 0.6 * box["height"])
    screen.get_by_test_id("pin").first.click()
    card = screen.get_by_test_id("smaller")
    card.wait_for()
    assert card.inner_text() == reported
    screen.get_by_role("button", name="Delete").click()
    screen.wait_for_selector("[data-testid=smaller]", state="detached")


def test_the_place_under_the_cursor_is_reported_and_the_crosshair_makes_a_pin(anna: Operator) -> None:
    readout = anna.by("readout")
    anna.page.mouse.move(*anna.at(300.0, 200.0))
    anna.page.wait_for_selector("#readout:not([hidden])")
    reported = str(readout.inner_text())
    assert re.match(r"-?\d+\.\d+, -?\d+\.\d+  90 % within \d", reported)
    anna.click(300.0, 200.0)
    assert reported.split("  ", maxsplit=1)[0] in str(anna.by("answer").inner_text())
    # By keyboard alone: a crosshair in the middle, moved by the arrows.
    page = anna.page
    page.locator("#picture").focus()
    page.keyboard.press("c")
    page.wait_for_selector("#crosshair", state="visible")
    for key in ("ArrowRight", "ArrowRight", "ArrowDown", "Shift+ArrowLeft"):
        page.keyboard.press(key)
    page.keyboard.press("Enter")
    anna.wait_for_pins(2)
    click, box = anna.newest_pin()["clicks"][0], anna.by("picture").bounding_box()
    assert click["u_px"] == pytest.approx(319.5 + 19.0 * 640.0 / box["width"], abs=0.6)
    assert click["v_px"] == pytest.approx(239.5 + 10.0 * 480.0 / box["height"], abs=0.6)
    page.keyboard.press("Escape")
    page.wait_for_selector("#crosshair", state="hidden")


def test_a_click_on_a_pin_chooses_it_and_makes_none_on_top(anna: Operator) -> None:
    anna.click(300.0, 200.0)
    anna.wait_for_pins(1)
    anna.page.wait_for_selector("[data-testid=picture-pin]")
    anna.page.mouse.click(*anna.at(301.0, 201.0))
    anna.page.wait_for_selector("#pin-card", state="visible")
    x, y = anna.at(300.0, 200.0)
    anna.page.locator("#pin-card button[title='close this card']").click()
    anna.page.mouse.click(x, y - 17.0)  # its shape
    anna.page.wait_for_selector("#pin-card", state="visible")
    assert anna.by("pin").count() == 1
    anna.page.keyboard.down("Shift")
    anna.page.mouse.click(x, y)  # another thing at the same place
    anna.page.keyboard.up("Shift")
    anna.wait_for_pins(2)


def test_a_stray_second_click_leaves_the_pin_where_it_was(anna: Operator) -> None:
    anna.click(300.0, 200.0)
    before = anna.newest_pin()
    anna.by("pin").first.click()
    anna.page.get_by_role("button", name="Click again").click()
    anna.page.mouse.click(*anna.at(60.0, 60.0))
    anna.page.wait_for_selector("#answer button")
    assert re.match(r"Not added: \d+ m from pin \d+\.", str(anna.by("answer").inner_text()))
    assert anna.newest_pin()["place"] == before["place"]
    anna.page.get_by_role("button", name="Add it anyway").click()
    anna.page.get_by_test_id("remove-last").click()
    anna.page.wait_for_function("() => document.querySelector('[data-testid=pin] .sure').textContent.endsWith(' m')")
    assert anna.newest_pin()["place"] == before["place"]
    # And as what it was: another thing.
    anna.page.get_by_role("button", name="Click again").click()
    anna.page.mouse.click(*anna.at(60.0, 60.0))
    anna.page.get_by_role("button", name="Make it a new pin").click()
    anna.wait_for_pins(2)


def test_three_pins_stay_next_to_the_card_and_all_its_buttons_are_in_view(anna: Operator) -> None:
    for u in (200.0, 300.0, 400.0, 500.0):
        anna.click(u, 200.0)
    anna.by("pin").first.click()
    anna.page.wait_for_selector("#pin-card", state="visible")
    inside = anna.page.locator("#pin-list").bounding_box()
    rows = [row.bounding_box() for row in anna.by("pin").all()]
    whole = [
        r for r in rows if r["y"] >= inside["y"] - 1 and r["y"] + r["height"] <= inside["y"] + inside["height"] + 1
    ]
    assert len(whole) >= 3
    card = anna.page.locator("#pin-card").bounding_box()
    for name in ("Copy", "Share", "From me", "Hand off", "Click again", "Seen in", "Measure", "Delete"):
        box = anna.page.locator("#pin-card").get_by_role("button", name=name).bounding_box()
        assert box["y"] + box["height"] <= card["y"] + card["height"] + 1.0
    for name, shown in (("Seen in", "#pin-card .seen .frame"), ("Measure", "#pin-card .seen select")):
        anna.page.get_by_role("button", name=name).click()
        anna.page.wait_for_selector(shown)
        anna.page.wait_for_function(
            "s => { const r = document.querySelector(s).getBoundingClientRect();"
            " const c = document.querySelector('#pin-card').getBoundingClientRect();"
            " return r.top >= c.top - 1 && r.bottom <= c.bottom + 1; }",
            arg=shown,
        )


@pytest.mark.parametrize("theme", rest_long(["day", "night"]))
def test_borders_of_controls_are_seen(anna: Operator, theme: str) -> None:
    anna.page.locator("#theme").select_option(theme)
    anna.click(300.0, 200.0)
    anna.by("pin").first.click()
    anna.page.locator("#kinds-shown").click()
    anna.page.locator(".chip").first.click()  # one that is off
    anna.page.mouse.move(5, 5)
    assert anna.page.evaluate(BORDERS) == []
    anna.page.locator(".chip").first.click()
    anna.page.keyboard.press("Escape")
    anna.by("handoff").click()
    anna.page.wait_for_selector(".format")
    assert anna.page.evaluate(BORDERS) == []


def test_a_swipe_moves_a_zoomed_picture_and_makes_no_pin(operators: Operators) -> None:
    anna = operators(has_map=False, viewport=PHONE, has_touch=True, device_scale_factor=2)
    page = anna.page
    touch = anna.context.new_cdp_session(page)
    page.evaluate(NEVER_HELD, HOLD_MS)

    def swipe(x: float, y: float, dx: float, dy: float) -> None:
        for kind, points in (
            ("touchStart", [(x, y)]), ("touchMove", [(x + dx / 2, y + dy / 2)]), ("touchMove", [(x + dx, y + dy)]),
            ("touchEnd", []),
        ):  # fmt: skip
            shown = [{"x": px, "y": py, "id": 0} for px, py in points]
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": shown})

    for _ in range(3):
        page.locator("#zoom-in").tap()
    anna.wait_for_zoom(3.0)
    x, y = anna.at(320.0, 240.0)
    before = page.locator("#canvas").screenshot()
    swipe(x, y, -80.0, -50.0)
    assert eventually(lambda: page.locator("#canvas").screenshot() != before)  # it moved
    assert anna.by("pin").count() == 0
    page.touchscreen.tap(x - 80.0, y - 50.0)
    page.wait_for_selector("[data-testid=pin]", state="attached")
    click = anna.newest_pin()["clicks"][0]
    assert (click["u_px"], click["v_px"]) == (pytest.approx(320.0, abs=2.0), pytest.approx(240.0, abs=2.0))
    page.keyboard.press("0")
    swipe(*anna.at(100.0, 100.0), 60.0, 10.0)  # nor does one over a whole picture
    page.wait_for_timeout(150)
    assert len(anna.ask("api/pins")["pins"]) == 1


def test_a_phone_has_picture_map_pins_card_hand_off_and_export(operators: Operators) -> None:
    anna = operators(viewport=PHONE, has_touch=True, device_scale_factor=2)
    page = anna.page

    def is_within(selector: str) -> bool:
        box = page.locator(selector).first.bounding_box()
        return box is not None and box["x"] >= -1 and box["x"] + box["width"] <= 391 and box["y"] + box["height"] <= 845

    assert page.evaluate("() => document.documentElement.scrollWidth") <= 390
    assert anna.by("picture").bounding_box()["width"] > 350
    for selector in ("#status-strip", "#freeze", "#answer", "#tab-map", "#pin-list"):
        assert is_within(selector), selector
    page.touchscreen.tap(*anna.at(220.0, 260.0))
    page.wait_for_selector("[data-testid=pin]")
    page.locator("#tab-map").tap()
    assert is_within("#map") and anna.small() == []
    assert not page.locator("#export").is_visible()
    page.locator("#tab-pins").tap()
    anna.by("pin").first.tap()
    page.wait_for_selector("#pin-card", state="visible")
    for name in ("Hand off", "Seen in", "Measure", "Delete"):
        assert page.get_by_role("button", name=name).bounding_box()["height"] >= 40
        box = page.get_by_role("button", name=name).bounding_box()
        assert box["y"] + box["height"] <= 845
    anna.by("handoff").tap()
    page.wait_for_selector(".format")
    assert page.locator("#handoff-dialog").bounding_box()["width"] <= 390
    assert page.evaluate("() => document.querySelector('#handoff-dialog').scrollWidth") <= 390
    page.locator("#handoff-dialog [data-close]").tap()
    page.locator("#pin-card button[title='close this card']").tap()
    anna.by("export").tap()
    assert is_within("#export-dialog")
    page.locator("#export-dialog [data-close]").tap()
    page.locator("#more").tap()
    page.locator("#who").fill("anna")
    page.keyboard.press("Tab")
    assert is_within("#who")


def test_what_is_printed_has_the_map_the_author_and_the_moment_of_the_sighting(
    anna: Operator, simulated: Simulated
) -> None:
    anna.page.locator("#who").fill("anna b")
    anna.page.keyboard.press("Tab")
    anna.click(300.0, 200.0)
    anna.by("pin").first.click()
    seen = anna.newest_pin()["seen_utc"]
    assert f"seen {seen[:19].replace('T', ' ')} UTC, marked by anna b" in anna.page.locator("#pin-card").inner_text()
    anna.by("handoff").click()
    anna.page.wait_for_selector("#print:enabled")
    anna.page.emulate_media(media="print")
    try:
        width = anna.page.evaluate("() => document.querySelector('.handoff-map img').naturalWidth")
        assert width > 100
        text = anna.page.locator("#handoff-dialog").inner_text()
        assert re.search(r"Marked by\s+anna b, \d{4}-", text)
        assert "by anna b; pointclick" in text
        assert re.search(r"\d\d[A-Z] [A-Z]{2} \d{5} \d{5}", text)
        assert "M G R S" in text
        assert not anna.page.locator("#print").is_visible()
    finally:
        anna.page.emulate_media(media="screen")


def test_a_late_answer_never_reaches_another_card_and_half_a_card_is_not_printed(anna: Operator) -> None:
    for u in (200.0, 400.0):
        anna.click(u, 200.0)
    anna.wait_for_pins(2)
    held: list[Any] = []

    def hold(route: Any) -> None:
        held.append(route)

    anna.page.route("**/handoff?*", hold)
    for order in (0, 1):
        anna.by("pin").nth(order).click()
        with anna.page.expect_request("**/handoff?*"):
            anna.by("handoff").click()
        anna.page.wait_for_selector("#print:disabled")
        if order == 0:
            anna.page.keyboard.press("Escape")
    late, wanted = held
    wanted.continue_()
    anna.page.wait_for_selector("#print:enabled")
    shown = anna.page.locator("#readback").inner_text()
    with anna.page.expect_response("**/handoff?*") as answered:
        late.continue_()
    assert answered.value.json()["readback"] != shown
    anna.page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert anna.page.locator("#readback").inner_text() == shown
    anna.page.unroute("**/handoff?*", hold)


def test_a_typed_coordinate_and_a_file_become_pins(anna: Operator, tmp_path: Path) -> None:
    anna.by("add").click()
    place = anna.page.locator("#add-form [name=place]")
    place.fill("-43,38 172,40 5")
    anna.page.locator("#add-form button[type=submit]").click()
    anna.page.wait_for_function("() => document.querySelector('#add-echo').textContent.length > 10")
    assert len(anna.ask("api/pins")["pins"]) == 0
    place.fill("43°22'48.5\"S 172°24'04.4\"E")
    anna.page.locator("#add-form [name=within]").fill("20")
    anna.page.locator("#add-form button[type=submit]").click()
    anna.wait_for_pins(1)
    pin = anna.newest_pin()
    assert (pin["place"]["lat_deg"], pin["place"]["lon_deg"]) == (
        pytest.approx(-43.380139, abs=1e-6), pytest.approx(172.401222, abs=1e-6)
    )  # fmt: skip
    assert pin["place"]["ce90_m"] == pytest.approx(20.0, abs=0.1)
    anna.page.locator("#pin-card", has_text="time of sighting unknown").wait_for()
    file = tmp_path / "wegpunkte.csv"
    file.write_bytes("name;lat;lon\nZelt am Bäch;-43,3805;172,4020\n".encode("latin-1"))
    anna.by("add").click()
    anna.by("import-file").set_input_files(file)
    anna.wait_for_pins(2)
    assert anna.newest_pin()["name"] == "Zelt am Bäch"
    assert "1 pins from wegpunkte.csv" in str(anna.by("answer").inner_text())


@pytest.mark.long
def test_very_many_pins_are_shown_after_all_of_them_are_fitted(chromium: Any, tmp_path: Path) -> None:
    """Though the pointer moves over them, which marks one after the other."""
    page_is_built()
    with Flight(tmp_path / "pins.sqlite") as flight:
        at = rendered_set(0)
        one = flight.store.add([PinClick.entered(at.camera_lat_deg, at.camera_lon_deg, sigma_m=3.0)])
        many = []
        for k in range(3000):
            place = at.camera_lat_deg + 1e-3 * (k % 60), at.camera_lon_deg + 1e-3 * (k // 60)
            click = PinClick.entered(*place, sigma_m=3.0)
            # An id of nothing but digits, as one of some ten thousand begins, took its whole tile off the map.
            more = {"id": f"{10**30 + k}", "number": k + 2, "clicks": [click.to_dict()]}
            many.append(type(one).from_dict({**one.to_dict(), **more}))
        flight.store.bring_in(many)
        page = opened(chromium, flight.url)
        try:
            page.wait_for_function("() => document.querySelector('#map').dataset.pins === '3001'")
            page.locator("#fit").click()
            page.wait_for_function("() => document.querySelector('#grid-step').textContent.includes('km')")
            assert re.fullmatch(r"grid [125] km", page.locator("#grid-step").inner_text())
            box = page.get_by_test_id("map").bounding_box()
            steps = itertools.cycle(range(100))

            def are_drawn() -> bool:
                page.mouse.move(box["x"] + box["width"] * (0.3 + 0.004 * next(steps)), box["y"] + box["height"] * 0.5)
                return share_of(page.get_by_test_id("map"), (0, 115, 90)) > 0.02

            assert eventually(are_drawn)
        finally:
            page.context.close()


@pytest.mark.long
def test_axe_finds_nothing_on_a_phone_and_in_the_new_dialog(operators: Operators) -> None:
    axe = ROOT / "frontend" / "node_modules" / "axe-core" / "axe.min.js"
    anna = operators(has_map=False, viewport=PHONE, has_touch=True)
    anna.page.evaluate(axe.read_text(encoding="utf-8") + "; undefined")
    run = (
        "axe.run(document, {runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa']}).then("
        "f => f.violations.flatMap(v => v.nodes.map(n => `${v.id}: ${n.html.slice(0, 120)}: ${n.failureSummary}`)))"
    )
    assert anna.page.evaluate(run) == []
    anna.by("add").click()
    assert anna.page.evaluate(run) == []
    anna.page.locator("#add-dialog [data-close]").click()
    anna.page.keyboard.press("c")
    anna.page.wait_for_selector("#readout:not([hidden])")
    assert anna.page.evaluate(run) == []


@pytest.mark.long
def test_of_dozens_of_aircraft_one_is_found_by_what_is_typed_and_they_stand_in_groups(
    tmp_path: Path, chromium: Any
) -> None:
    page_is_built()
    with Flight(tmp_path / "pins.sqlite", aircraft=24) as flight:
        flight.source.fly_to(2)
        page = opened(chromium, flight.url)
        shown = page.locator("#status-strip .craft:visible")
        page.wait_for_function("() => document.querySelectorAll('#status-strip .craft').length === 24")
        groups = page.locator("#status-strip .group:visible")
        assert shown.count() == 24 and sum(int(text.split()[0]) for text in groups.all_inner_texts()) == 24
        page.get_by_label("find aircraft").fill("uav-17")
        page.wait_for_function("() => [...document.querySelectorAll('.craft')].filter(t => !t.hidden).length === 2")
        assert "uav-17" in shown.all_inner_texts()[1] and shown.nth(0).get_attribute("aria-pressed") == "true"
        shown.nth(1).click()
        page.wait_for_function("() => document.querySelector('[data-vehicle=uav-17]').ariaPressed === 'true'")
        page.context.close()
