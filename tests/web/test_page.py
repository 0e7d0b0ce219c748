"""The page in a real Chromium, on a replayed flight, as an operator uses it."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from ground.recording import Recording
from tests.web.conftest import ROOT, Flown, Server

pytestmark = pytest.mark.xdist_group("web")

Serve = Callable[..., Server]
LAPTOP = {"width": 1280, "height": 800}
AXE = ROOT / "frontend" / "node_modules" / "axe-core" / "axe.min.js"


class Operator:
    """Somebody at a browser of their own."""

    def __init__(self, browser: Any, server: Server, **context: Any) -> None:
        self.context = browser.new_context(**{"viewport": LAPTOP, **context})
        self.page = self.context.new_page()
        self.wrong: list[str] = []
        self.elsewhere: list[str] = []
        self.page.on("pageerror", lambda error: self.wrong.append(str(error)))
        self.page.on("console", self._console)
        self.page.on("request", self._request)
        self.server = server
        self.open()

    def open(self) -> None:
        """The page, until it shows a picture."""
        self.page.goto(self.server.url)
        self.page.wait_for_selector("body[data-ready]", timeout=20_000)
        self.page.wait_for_selector("#no-picture", state="hidden", timeout=10_000)

    def _console(self, message: Any) -> None:
        # A refusal is an answer; Chromium calls it an error all the same, and so it does a crop that is not there.
        if message.type == "error" and not re.search(r"status of (404|409|422)", message.text):
            self.wrong.append(message.text)

    def _request(self, request: Any) -> None:
        if not request.url.startswith((self.server.url.split("?")[0], "data:", "blob:")):
            self.elsewhere.append(request.url)

    def by(self, name: str) -> Any:
        """By its data-testid."""
        return self.page.get_by_test_id(name)

    def at(self, u: float, v: float) -> tuple[float, float]:
        """Where on the page a pixel is, of a whole picture of 640 x 480."""
        box = self.by("picture").bounding_box()
        return box["x"] + (u + 0.5) * box["width"] / 640.0, box["y"] + (v + 0.5) * box["height"] / 480.0

    def click(self, u: float, v: float) -> str:
        """Click a pixel; what the page then says."""
        self.page.mouse.click(*self.at(u, v))
        self.page.wait_for_function("() => document.querySelector('[data-testid=answer]').dataset.kind !== 'note'")
        return str(self.by("answer").inner_text())

    def newest_pin(self) -> dict[str, Any]:
        """As the server has it."""
        pins = self.page.request.get(f"http://127.0.0.1:{self.server.port}/api/pins").json()["pins"]
        pin: dict[str, Any] = max(pins, key=lambda pin: pin["number"])
        return pin

    def frame(self) -> int:
        """The number of the picture that is shown."""
        found = re.search(r"picture (\d+)", self.page.locator("#frame-label").inner_text())
        assert found is not None
        return int(found[1])

    def show(self, frame: int, flown: Flown) -> None:
        """Go to a picture by the time bar."""
        self.page.locator("#time-bar").fill(str(flown.frames.index(frame)))
        self.page.wait_for_function(
            "n => document.querySelector('#frame-label').textContent.startsWith(`picture ${n} `)", arg=frame
        )

    def close(self) -> None:
        """Nothing went wrong, and nothing came from elsewhere."""
        self.context.close()
        assert self.wrong == []
        assert self.elsewhere == []


@pytest.fixture
def operators(chromium: Any) -> Iterator[Callable[..., Operator]]:
    """As many browsers as a test wants."""
    made: list[Operator] = []

    def another(server: Server, **context: Any) -> Operator:
        made.append(Operator(chromium, server, **context))
        return made[-1]

    yield another
    for operator in made:
        operator.close()


def test_a_click_becomes_a_pin_that_is_there_after_a_reload(serve: Serve, operators: Any, flown: Flown) -> None:
    server = serve()
    anna = operators(server)
    anna.show(flown.newest, flown)
    said = anna.click(200.0, 150.0)
    pin = anna.newest_pin()
    click = pin["clicks"][0]
    assert (click["frame"], click["session"]) == (flown.newest, anna.newest_pin()["clicks"][0]["session"])
    assert click["u_px"] == pytest.approx(200.0, abs=0.6)
    assert click["v_px"] == pytest.approx(150.0, abs=0.6)
    place = pin["place"]
    assert f"{place['lat_deg']:.6f}, {place['lon_deg']:.6f}" in said
    assert "CE90" in said
    assert "AMSL" in said
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
    anna.show(flown.newest - 3, flown)
    anna.page.wait_for_selector("[data-testid=picture-pin]")
    seen = anna.page.request.get(f"{server.url}api/pins/{pin['id']}/seen").json()
    row = next(r for r in seen if r["frame"] == flown.newest - 3)
    marker = anna.by("picture-pin").first.locator(".spot").bounding_box()
    x, y = anna.at(row["u_px"], row["v_px"])
    assert abs(marker["x"] + marker["width"] / 2 - x) < 1.0
    assert abs(marker["y"] + marker["height"] / 2 - y) < 1.0


def test_a_frozen_and_a_stepped_picture_is_clicked_as_itself(serve: Serve, operators: Any, flown: Flown) -> None:
    anna = operators(serve())
    anna.show(flown.newest, flown)
    anna.by("freeze").click() if anna.by("freeze").get_attribute("aria-pressed") == "false" else None
    assert anna.by("freeze").get_attribute("aria-pressed") == "true"
    for expected in (flown.newest - 1, flown.newest - 2):
        anna.by("step-back").click()
        anna.page.wait_for_function(
            "n => document.querySelector('#frame-label').textContent.startsWith(`picture ${n} `)", arg=expected
        )
    anna.click(330.0, 220.0)
    pin = anna.newest_pin()
    assert pin["clicks"][0]["frame"] == flown.newest - 2
    recording = Recording(flown.path)
    age_s = recording.age_s(recording.by_frame(flown.vehicle, flown.newest - 2) or pytest.fail("no set"))
    assert f"{age_s:.1f} s old" in anna.by("answer").inner_text()
    anna.page.keyboard.press("ArrowRight")
    anna.page.wait_for_function(
        "n => document.querySelector('#frame-label').textContent.startsWith(`picture ${n} `)", arg=flown.newest - 1
    )


def test_a_refused_click_says_why_and_what_helps_at_the_spot(serve: Serve, operators: Any, flown: Flown) -> None:
    anna = operators(serve())
    anna.show(flown.refused, flown)
    assert "cannot be clicked" in anna.page.locator("#banner").inner_text()
    said = anna.click(400.0, 100.0)
    assert said.startswith("Refused: the aircraft was turning too fast")
    assert "What helps" in said
    bubble = anna.page.locator(".bubble").bounding_box()
    x, y = anna.at(400.0, 100.0)
    assert bubble["x"] - 5 <= x <= bubble["x"] + bubble["width"] + 20
    assert 0 < bubble["y"] - y < 40
    assert anna.by("pin").count() == 0
    # Without a picture, the features of the one before still make one to click.
    anna.show(flown.newest, flown)
    anna.page.wait_for_selector(".bubble", state="hidden", timeout=3000)


def test_what_was_pressed_is_clicked_whatever_happens_before_the_release(
    serve: Serve, operators: Any, flown: Flown
) -> None:
    """Resized, zoomed, and another picture shown between press and release; at twice the pixels of the screen."""
    anna = operators(serve(), device_scale_factor=2)
    anna.show(flown.newest, flown)
    page = anna.page
    page.mouse.move(*anna.at(250.0, 180.0))
    page.mouse.down()
    page.set_viewport_size({"width": 1000, "height": 700})
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("+")
    page.wait_for_timeout(300)
    assert anna.frame() == flown.newest
    page.mouse.up()
    page.wait_for_selector("[data-testid=pin]")
    click = anna.newest_pin()["clicks"][0]
    assert click["frame"] == flown.newest
    assert (click["u_px"], click["v_px"]) == (pytest.approx(250.0, abs=0.6), pytest.approx(180.0, abs=0.6))
    # Zoomed in by the wheel about a pixel, that pixel stays where it is; what is clicked beside it is what is seen.
    page.keyboard.press("0")
    anna.show(flown.newest, flown)
    x, y = anna.at(400.0, 300.0)
    page.mouse.move(x, y)
    page.mouse.wheel(0, -600)
    page.wait_for_timeout(200)
    page.mouse.click(x, y)
    page.wait_for_function("() => document.querySelectorAll('[data-testid=pin]').length === 2")
    click = anna.newest_pin()["clicks"][0]
    assert (click["u_px"], click["v_px"]) == (pytest.approx(400.0, abs=0.6), pytest.approx(300.0, abs=0.6))
    # A drag moves the zoomed picture and clicks nothing.
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 60, y - 40, steps=4)
    page.mouse.up()
    page.mouse.click(x - 60, y - 40)
    page.wait_for_function("() => document.querySelectorAll('[data-testid=pin]').length === 3")
    click = anna.newest_pin()["clicks"][0]
    assert (click["u_px"], click["v_px"]) == (pytest.approx(400.0, abs=0.6), pytest.approx(300.0, abs=0.6))


def test_two_operators_share_pins_and_a_name_is_only_text(serve: Serve, operators: Any, flown: Flown) -> None:
    server = serve()
    anna, bo = operators(server), operators(server)
    for operator in (anna, bo):
        operator.show(flown.newest, flown)
    anna.click(300.0, 200.0)
    bo.page.wait_for_selector("[data-testid=pin]", timeout=3000)
    anna.by("pin").first.click()
    name = "<img src=x onerror=alert(1)> =1+1"
    anna.page.get_by_label("name", exact=True).fill(name)
    anna.page.keyboard.press("Tab")
    bo.page.wait_for_function("t => document.querySelector('[data-testid=pin]').innerText.includes(t)", arg=name)
    assert bo.page.locator("[data-testid=pin] img").count() == 0
    bo.by("pin").first.hover()
    bo.page.wait_for_selector(".marker.marked", state="attached", timeout=2000)
    anna.page.get_by_role("button", name="Delete").click()
    bo.page.wait_for_function("() => document.querySelectorAll('[data-testid=pin]').length === 0")
    anna.page.locator("#undo").click()
    bo.page.wait_for_selector("[data-testid=pin]")


def test_a_tie_moves_every_pin_of_the_aircraft(serve: Serve, operators: Any, flown: Flown) -> None:
    anna = operators(serve())
    anna.show(flown.newest, flown)
    anna.click(200.0, 150.0)
    anna.click(450.0, 330.0)
    before = [row.inner_text() for row in anna.by("pin").all()]
    where = anna.page.request.post(
        f"{anna.server.url}api/click", data={"vehicle": flown.vehicle, "frame": flown.newest, "u": 320, "v": 240}
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
    anna.page.wait_for_function("() => document.querySelector('#tie-result').textContent.includes('still be believed')")
    anna.page.locator("#tie-dialog [data-close]").click()


def test_a_tablet_is_used_by_touch(serve: Serve, operators: Any, flown: Flown) -> None:
    anna = operators(serve(), viewport={"width": 800, "height": 1280}, has_touch=True, device_scale_factor=2)
    anna.show(flown.newest, flown)
    page = anna.page
    page.touchscreen.tap(*anna.at(220.0, 260.0))
    page.wait_for_selector("[data-testid=pin]")
    click = anna.newest_pin()["clicks"][0]
    assert (click["u_px"], click["v_px"]) == (pytest.approx(220.0, abs=1.0), pytest.approx(260.0, abs=1.0))
    small = page.evaluate(
        "() => [...document.querySelectorAll('button, input, select')]"
        ".filter(e => e.offsetParent !== null && e.closest('.maplibregl-ctrl') === null)"
        ".filter(e => e.getBoundingClientRect().height < 40).map(e => e.id || e.textContent)"
    )
    assert small in ([], ["time-bar"])
    touch = anna.context.new_cdp_session(page)

    def fingers(kind: str, *points: tuple[float, float]) -> None:
        touch.send(
            "Input.dispatchTouchEvent",
            {"type": kind, "touchPoints": [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)]},
        )

    # A held finger gets a loupe, aims while it slides, and clicks where it is lifted.
    fingers("touchStart", anna.at(100.0, 300.0))
    page.wait_for_selector("#loupe", state="visible", timeout=2000)
    fingers("touchMove", anna.at(150.0, 330.0))
    fingers("touchMove", anna.at(180.0, 340.0))
    fingers("touchEnd")
    page.wait_for_function("() => document.querySelectorAll('[data-testid=pin]').length === 2")
    click = anna.newest_pin()["clicks"][0]
    assert (click["u_px"], click["v_px"]) == (pytest.approx(180.0, abs=1.0), pytest.approx(340.0, abs=1.0))
    assert not page.locator("#loupe").is_visible()
    # Two fingers zoom and click nothing.
    x, y = anna.at(320.0, 240.0)
    fingers("touchStart", (x - 40, y), (x + 40, y))
    for k in range(1, 6):
        fingers("touchMove", (x - 40 - 16 * k, y), (x + 40 + 16 * k, y))
    fingers("touchEnd")
    page.wait_for_timeout(200)
    page.touchscreen.tap(x, y)
    page.wait_for_function("() => document.querySelectorAll('[data-testid=pin]').length === 3")
    click = anna.newest_pin()["clicks"][0]
    assert (click["u_px"], click["v_px"]) == (pytest.approx(320.0, abs=2.0), pytest.approx(240.0, abs=2.0))
    page.touchscreen.tap(x + 60, y)
    page.wait_for_function("() => document.querySelectorAll('[data-testid=pin]').length === 4")
    moved_px = anna.newest_pin()["clicks"][0]["u_px"] - click["u_px"]
    assert moved_px == pytest.approx(60.0 * 640.0 / anna.by("picture").bounding_box()["width"] / 3.0, rel=0.1)


def test_a_server_that_is_killed_and_started_again_has_lost_nothing(serve: Serve, operators: Any, flown: Flown) -> None:
    server = serve()
    anna = operators(server)
    anna.show(flown.newest, flown)
    anna.click(300.0, 200.0)
    anna.click(340.0, 260.0)
    rows = [row.inner_text() for row in anna.by("pin").all()]
    server.kill()
    anna.page.wait_for_selector("#offline", state="visible", timeout=5000)
    said = anna.click(100.0, 100.0)
    assert said.startswith("Not kept")
    serve(port=server.port)
    anna.page.wait_for_selector("#offline", state="hidden", timeout=10_000)
    assert [row.inner_text() for row in anna.by("pin").all()] == rows
    anna.click(400.0, 300.0)
    assert anna.by("pin").count() == 3
    anna.wrong = [line for line in anna.wrong if "ERR_CONNECTION" not in line and "WebSocket" not in line]


def test_other_machines_need_the_token(serve: Serve, chromium: Any) -> None:
    server = serve("--host", "0.0.0.0")
    assert "NO TLS" in server.said or "▄" in server.said
    link = server.url
    assert "?token=" in link
    base = f"http://127.0.0.1:{server.port}/"
    context = chromium.new_context()
    try:
        page = context.new_page()
        refused = page.goto(base)
        assert refused is not None
        assert refused.status == 401
        page.goto(f"{base}?token={link.split('token=')[1]}")
        page.wait_for_selector("body[data-ready]", timeout=20_000)
        assert page.url == base
        assert page.request.get(f"{base}api/pins").status == 200
    finally:
        context.close()
    context = chromium.new_context()
    try:
        assert context.request.get(f"{base}api/pins").status == 401
        assert context.request.get(f"{base}?token=wrong").status == 401
    finally:
        context.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_contrast_and_names_are_accessible(serve: Serve, operators: Any, flown: Flown, scheme: str) -> None:
    if not AXE.is_file():
        pytest.fail(f"{AXE} is not there: make web")
    anna = operators(serve(), color_scheme=scheme, bypass_csp=True)
    anna.show(flown.newest, flown)
    anna.click(300.0, 200.0)
    anna.by("pin").first.click()
    anna.page.add_script_tag(path=str(AXE))

    def violations() -> list[str]:
        found = anna.page.evaluate(
            "axe.run(document, {runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa']})"
        )
        return [f"{v['id']}: {n['html'][:120]}: {n['failureSummary']}" for v in found["violations"] for n in v["nodes"]]

    assert violations() == []
    anna.by("handoff").click()
    anna.page.wait_for_selector(".format")
    assert violations() == []
    anna.page.keyboard.press("Escape")
    anna.show(flown.refused, flown)
    anna.click(200.0, 200.0)
    assert violations() == []


def test_the_first_page_is_small_and_its_own(serve: Serve, operators: Any) -> None:
    anna = operators(serve())
    sizes = anna.page.evaluate(
        "performance.getEntriesByType('resource').concat(performance.getEntriesByType('navigation'))"
        ".map(e => [e.name, e.transferSize])"
    )
    assert len(sizes) > 5
    assert sum(size for _, size in sizes) < 3_000_000
    assert all(name.startswith(anna.server.url) for name, _ in sizes)


def test_sigint_ends_the_server_at_once(serve: Serve, operators: Any) -> None:
    server = serve()
    anna = operators(server)
    began_s = time.monotonic()
    server.process.send_signal(signal.SIGINT)
    server.process.wait(8)
    assert time.monotonic() - began_s < 6.0
    anna.page.close()
    anna.wrong = [line for line in anna.wrong if "ERR_CONNECTION" not in line and "WebSocket" not in line]
