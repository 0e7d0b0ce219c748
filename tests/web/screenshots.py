"""The pictures of the page in docs: `python -m tests.web.screenshots` flies, does what they show, and takes them.

    python -m tests.web.screenshots [pins] [look] [follow] [heat]

Of all, or of those that are named.
"""

import argparse
import io
import shutil
import sys
from collections.abc import Callable
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
from tests.web.pictured_flights import Followed, heat, traffic
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
CLICKED = 20, 343.0, 262.0  # a picture of `traffic`, and where its car is
PHONE = {"viewport": {"width": 390, "height": 844}, "device_scale_factor": 4 / 3, "has_touch": True, "is_mobile": True}


def main() -> int:
    """0 once the pictures are written."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", choices=list(TAKEN), default=list(TAKEN))
    arguments = parser.parse_args()
    if CHROMIUM is None:
        print("no chromium; sudo apt-get install chromium", file=sys.stderr)
        return 2
    with TemporaryDirectory() as name, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        try:
            for what in arguments.what:
                folder = Path(name) / what
                folder.mkdir()
                TAKEN[what](browser, folder)
        finally:
            browser.close()
    return 0


def alone(folder: Path) -> tuple[Path, Simulated]:
    """A copy of the recording that the tests share, without the picture that refuses."""
    simulated = recorded()
    return Path(shutil.copy(simulated.path, folder / "flight.mcap")), simulated


def with_pins(browser: Any, folder: Path) -> None:
    path, simulated = alone(folder)
    with closing(Server("--from", path, "--pins", folder / "pins.sqlite")) as server:
        on_a_laptop(browser, server, simulated)
        on_a_phone(browser, server, simulated)


def on_a_laptop(browser: Any, server: Server, simulated: Simulated) -> None:
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


def before_the_camera_turns(browser: Any, folder: Path) -> None:
    """The question whether a camera is to look at a van."""
    path, simulated = alone(folder)
    rules = Rules("operators-token-1234", pointer_token="pointers-token-1234")
    source = Turning(path)
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


def a_car_is_followed(browser: Any, folder: Path) -> None:
    """A car that was clicked and followed by hand, some seconds later."""
    path = traffic(folder)
    with closing(Followed(path)) as source, Flight(folder / "pins.sqlite", source=source) as flight:
        anna, simulated = Operator(browser, flight), Simulated(path)
        anna.show(CLICKED[0], simulated)
        anna.click(*CLICKED[1:])
        anna.by("follow-it").click()
        anna.by("track-words").wait_for()
        anna.show(simulated.newest - 8, simulated)
        anna.page.locator("[data-testid=track-box][data-phase=followed]").wait_for()
        save_page(anna, "follow.jpg")


def finds_and_a_fire(browser: Any, folder: Path) -> None:
    """What a machine found in heat, to be confirmed by a person; and where it burns, on the map."""
    path = heat(folder)
    with closing(Server("--from", path, "--pins", folder / "pins.sqlite")) as server:
        anna, simulated = Operator(browser, server), Simulated(path)
        anna.show(simulated.frames[len(simulated.frames) // 2], simulated)
        anna.by("found").first.wait_for()
        anna.page.get_by_role("button", name="Both", exact=True).click()
        save_page(anna, "finds.jpg", is_last=False)
        anna.page.get_by_role("button", name="Map", exact=True).click()
        anna.by("layers").click()
        anna.by("show-fire").click()
        anna.page.keyboard.press("Escape")
        anna.page.wait_for_function(
            "() => document.querySelector('[data-testid=fire-words]').textContent.includes('perimeter')"
        )
        save_page(anna, "fire.jpg")


def save_page(operator: Operator, name: str, *, is_last: bool = True) -> None:
    """Once the map shows it all, which may rest for four seconds before."""
    operator.page.wait_for_timeout(6000.0)
    save(operator.page.screenshot(), name)
    if is_last:
        operator.context.close()


TAKEN: dict[str, Callable[[Any, Path], None]] = {
    "pins": with_pins, "look": before_the_camera_turns, "follow": a_car_is_followed, "heat": finds_and_a_fire,
}  # fmt: skip


def save(png: bytes, name: str) -> None:
    Image.open(io.BytesIO(png)).convert("RGB").save(IMAGES / name, quality=QUALITY)
    print(IMAGES / name)


if __name__ == "__main__":
    sys.exit(main())
