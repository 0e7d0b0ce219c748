"""The pictures of the page in docs: `python -m tests.web.screenshots` flies, marks four things, and takes them."""

from __future__ import annotations

import io
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

from tests.web.browsing import Operator
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


def save(png: bytes, name: str) -> None:
    """As JPEG."""
    Image.open(io.BytesIO(png)).convert("RGB").save(IMAGES / name, quality=QUALITY)
    print(IMAGES / name)


if __name__ == "__main__":
    sys.exit(main())
