"""The pictures of the page in docs: `python -m tests.web.screenshots` flies, marks four things, and takes them."""

from __future__ import annotations

import io
import shutil
import sys
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

from contract.answer import Fix
from contract.locate import Locator
from contract.look import AskLook, LookRequest, Offer
from ground.web.guard import Rules
from ground.web.recorded import RecordedSource
from tests.web.browsing import Operator
from tests.web.flying import Flight
from tests.web.served import ARGUMENTS, CHROMIUM, ROOT, Server, Simulated, recorded

IMAGES = ROOT / "docs" / "images"
QUALITY = 82
# What is marked: pixel of the newest picture, kind by its key, name.
THINGS = (
    (212.0, 144.0, "1", "red jacket"),
    (330.0, 201.0, "2", "white van"),
    (498.0, 314.0, "4", "power line"),
    (120.0, 326.0, "5", "gate"),
)
PHONE = {"viewport": {"width": 390, "height": 844}, "device_scale_factor": 4 / 3, "has_touch": True, "is_mobile": True}


def main() -> int:
    """0 once both pictures are written."""
    if CHROMIUM is None:
        print("no chromium; sudo apt-get install chromium", file=sys.stderr)
        return 2
    with TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        simulated = recorded()
        alone = shutil.copy(simulated.path, folder / "flight.mcap")  # without the picture that refuses
        server = Server("--from", alone, "--pins", folder / "pins.sqlite")
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        try:
            on_a_laptop(browser, server, simulated)
            on_a_phone(browser, server, simulated)
            before_the_camera_turns(browser, simulated, folder)
        finally:
            browser.close()
            server.close()
    return 0


def on_a_laptop(browser: Any, server: Server, simulated: Simulated) -> None:
    """Four pins, the first one chosen, and the place under the cursor."""
    anna = Operator(browser, server)
    anna.show(simulated.newest, simulated)
    anna.page.locator("#who").fill("anna")
    for count, (u, v, key, title) in enumerate(THINGS, start=1):
        anna.page.keyboard.press("Escape")
        anna.page.locator("#picture").focus()
        anna.page.keyboard.press(key)
        anna.click(u, v)
        anna.wait_for_pins(count)
        anna.page.request.patch(f"{server.local}api/pins/{anna.newest_pin()['id']}", data={"name": title})
    anna.by("pin").filter(has_text="red jacket").click()
    anna.page.mouse.move(*anna.at(400.0, 250.0))
    anna.page.wait_for_timeout(2000.0)  # the map draws
    save(anna.page.screenshot(), "web.jpg")
    anna.context.close()


def on_a_phone(browser: Any, server: Server, simulated: Simulated) -> None:
    """The same pin's card."""
    ben = Operator(browser, server, **PHONE)
    ben.show(simulated.newest, simulated)
    ben.by("pin").filter(has_text="red jacket").click()
    ben.page.wait_for_timeout(2000.0)
    save(ben.page.screenshot(), "web_phone.jpg")
    ben.context.close()


class Turning(RecordedSource):
    """A recorded flight that answers as if its camera could be turned."""

    def unlooked(self, vehicle: str) -> str:
        return ""

    def look(self, vehicle: str, request: LookRequest) -> dict[str, Any]:
        assert isinstance(request, AskLook)
        found = self.feature_set(vehicle, request.session, request.frame)
        assert found is not None
        fix = Locator(found).locate((request.u_px, request.v_px))
        assert isinstance(fix, Fix) and fix.height_amsl_m is not None
        return vars(Offer("ab", fix.lat_deg, fix.lon_deg, fix.height_amsl_m, request.radius_m, 0.4))


def before_the_camera_turns(browser: Any, simulated: Simulated, folder: Path) -> None:
    """The question whether a camera is to look at a van."""
    rules = Rules("operators-token-1234", pointer_token="pointers-token-1234")
    source = Turning(folder / "flight.mcap")
    with (
        closing(source),
        Flight(folder / "more.sqlite", rules=rules, token=rules.pointer_token, source=source) as flight,
    ):
        cleo = Operator(browser, flight)
        cleo.show(simulated.newest, simulated)
        cleo.click(*THINGS[1][:2])
        cleo.by("look-there").click()
        cleo.page.wait_for_selector("#look-dialog[open]")
        cleo.page.wait_for_timeout(2000.0)
        save(cleo.page.screenshot(), "look_there.jpg")
        cleo.context.close()


def save(png: bytes, name: str) -> None:
    """As JPEG."""
    Image.open(io.BytesIO(png)).convert("RGB").save(IMAGES / name, quality=QUALITY)
    print(IMAGES / name)


if __name__ == "__main__":
    sys.exit(main())
