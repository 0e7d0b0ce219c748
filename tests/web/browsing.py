"""Somebody at a browser, who waits for what is to come and never for a while."""

import re
from typing import Any

from ground.pins.machine import FOUND
from tests.waiting import PATIENCE_S, eventually
from tests.web.served import Server, Simulated

LAPTOP = {"width": 1280, "height": 800}
# A browser without WebGL, as on a machine whose graphics driver is barred. Half of what a page costs here is its map.
_NO_WEBGL = """const made = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return kind.startsWith('webgl') ? null : made.call(this, kind, ...more);
};"""
# What is too small for a finger in a glove, of all that is pressed and seen.
_SMALL = """() => [...document.querySelectorAll('button, input, select, textarea, summary, a')]
  .filter(e => e.offsetParent !== null && !e.closest('.maplibregl-ctrl-attrib'))
  .map(e => [e, e.getBoundingClientRect()]).filter(([e, b]) => b.height > 0 && (b.width < 43.9 || b.height < 43.9))
  .map(([e, b]) => `${e.id || e.textContent || e.className}: ${b.width.toFixed(1)} x ${b.height.toFixed(1)}`)"""


class Operator:
    """A browser of one's own, with the page."""

    def __init__(self, browser: Any, server: Server, *, has_map: bool = True, **context: Any) -> None:
        self.context = browser.new_context(**{"viewport": LAPTOP, **context})
        if not has_map:
            self.context.add_init_script(_NO_WEBGL)
        self.context.set_default_timeout(PATIENCE_S * 1000.0)
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
        self.page.wait_for_selector("body[data-ready]")
        self.page.wait_for_selector("#no-picture", state="hidden")

    def _console(self, message: Any) -> None:
        # A refusal is an answer; Chromium calls it an error all the same, and so it does a crop that is not there.
        if message.type == "error" and not re.search(r"status of (404|409|422)", message.text):
            self.wrong.append(message.text)

    def _request(self, request: Any) -> None:
        if not request.url.startswith((self.server.url.split("?")[0], self.server.local, "data:", "blob:")):
            self.elsewhere.append(request.url)

    def by(self, name: str) -> Any:
        return self.page.get_by_test_id(name)

    def at(self, u: float, v: float) -> tuple[float, float]:
        """Where on the page a pixel is, of a whole picture of 640 x 480."""
        box = self.by("picture").bounding_box()
        return box["x"] + (u + 0.5) * box["width"] / 640.0, box["y"] + (v + 0.5) * box["height"] / 480.0

    def click(self, u: float, v: float) -> str:
        self.page.mouse.click(*self.at(u, v))
        self.page.wait_for_function("() => document.querySelector('[data-testid=answer]').dataset.kind !== 'note'")
        return str(self.by("answer").inner_text())

    def wait_for_pins(self, count: int) -> None:
        self.page.wait_for_function("n => document.querySelectorAll('[data-testid=pin]').length === n", arg=count)

    def wait_for_frame(self, frame: int) -> None:
        self.page.wait_for_function(
            "n => document.querySelector('#frame-label').textContent.startsWith(`picture ${n} `)", arg=frame
        )

    def wait_for_zoom(self, least: float) -> None:
        """Until the picture is drawn so much larger than whole."""
        self.page.wait_for_function(
            "z => Number(document.querySelector('[data-testid=picture]').dataset.zoom) >= z", arg=least
        )

    def ask(self, path: str) -> Any:
        return self.page.request.get(self.server.local + path).json()

    def newest_pin(self) -> dict[str, Any]:
        """Return it as the server has it, once its last click is measured, or is not for a reason."""
        is_measured = self.ask("api/status")["measures"]

        def newest() -> dict[str, Any]:
            pin: dict[str, Any] = max(self.ask("api/pins")["pins"], key=lambda pin: pin["number"])
            return pin

        def is_settled() -> bool:
            click = newest()["clicks"][-1]
            return click["u_px"] is None or click["method"] in ("measured", FOUND) or bool(click["unmeasured"])

        assert not is_measured or eventually(is_settled)
        return newest()

    def frame(self) -> int:
        found = re.search(r"picture (\d+)", self.page.locator("#frame-label").inner_text())
        assert found is not None
        return int(found[1])

    def show(self, frame: int, simulated: Simulated) -> None:
        self.page.locator("#time-bar").fill(str(simulated.frames.index(frame)))
        self.wait_for_frame(frame)

    def small(self) -> list[str]:
        """Which controls that are seen are smaller than 44 pixels."""
        found: list[str] = self.page.evaluate(_SMALL)
        return found

    def tidy(self) -> None:
        """As the page was at first, for whoever comes next."""
        if not self.page.locator("#offline").is_hidden():
            self.page.wait_for_selector("#offline", state="hidden")
        self.page.evaluate("() => document.querySelectorAll('dialog[open]').forEach(dialog => dialog.close())")
        self.page.set_viewport_size(LAPTOP)
        self.page.locator("#theme").select_option("auto")
        if self.page.locator("#follow").get_attribute("aria-pressed") == "false":
            self.page.locator("#follow").click()
        self.page.locator("#stage").focus()
        for key in ("Escape", "0", "5"):
            self.page.keyboard.press(key)
        self.clear()
        self.wait_for_pins(0)

    def clear(self) -> None:
        reported = self.ask("api/pins")
        for kind in ("pins", "ties"):
            for held in reported[kind]:
                self.page.request.delete(f"{self.server.local}api/{kind}/{held['id']}")

    def check(self) -> None:
        """Nothing went wrong, and nothing came from elsewhere."""
        wrong, elsewhere = self.wrong[:], self.elsewhere[:]
        self.wrong.clear()
        self.elsewhere.clear()
        assert wrong == []
        assert elsewhere == []

    def forgive_a_lost_server(self) -> None:
        """A server that is gone is what the test was about."""
        self.wrong = [line for line in self.wrong if "ERR_" not in line and "WebSocket" not in line]
