"""What an operator waits for, measured in the browser: by tests with bounds, by `benchmarks.web` for figures."""

import io
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ground.pins.model import PinClick
from ground.pins.store import PinStore
from tests.waiting import PATIENCE_S
from tests.web.rendered import rendered_set
from tests.web.served import Server

# Presses as the browser delivers them; the clock stops when the frame with the answer is done.
_PRESSES = """async ([count, seed]) => {
  const pane = document.querySelector('[data-testid=picture]'), answer = document.querySelector('[data-testid=answer]');
  const times = [];
  let state = seed;
  const random = () => (state = (state * 1103515245 + 12345) % 2147483648) / 2147483648;
  for (let k = 0; k < count; k++) {
    const box = pane.getBoundingClientRect();
    const at = {clientX: box.left + box.width * (0.1 + 0.8 * random()),
                clientY: box.top + box.height * (0.1 + 0.8 * random()),
      pointerId: 1, pointerType: 'mouse', button: 0, bubbles: true, cancelable: true,
      shiftKey: true};  // on a pin too it is a new one
    const began = performance.now();
    pane.dispatchEvent(new PointerEvent('pointerdown', at));
    pane.dispatchEvent(new PointerEvent('pointerup', at));
    if (answer.dataset.kind !== 'note') throw new Error('the press did nothing');
    await new Promise(done => {
      new MutationObserver((_, watch) => {
        if (answer.dataset.kind === 'note') return;
        watch.disconnect();
        requestAnimationFrame(() => setTimeout(done, 0));
      }).observe(answer, {attributes: true});
    });
    times.push(performance.now() - began);
    await new Promise(done => setTimeout(done, 5));
  }
  return times.sort((a, b) => a - b);
}"""


LAPTOP = (1280, 800)
SMALL = (800, 520)  # of half the pixels: drawing them is most of what a page costs here


def opened(chromium: Any, url: str, size_px: tuple[int, int] = LAPTOP, *, has_picture: bool = True) -> Any:
    """A page that shows a picture, if there is one."""
    page = chromium.new_context(viewport={"width": size_px[0], "height": size_px[1]}).new_page()
    page.set_default_timeout(PATIENCE_S * 1000.0)
    page.goto(url)
    page.wait_for_selector("body[data-ready]")
    if has_picture:
        page.wait_for_selector("#no-picture", state="hidden")
    return page


def press_to_answer_ms(page: Any, count: int, seed: int = 7) -> list[float]:
    """From press to answer on the screen, sorted, after some that warm up."""
    page.evaluate(_PRESSES, [5, 1])
    times: list[float] = page.evaluate(_PRESSES, [count, seed])
    return times


def first_page_s(chromium: Any, server: Server) -> tuple[float, int, Any]:
    """From the address to the first picture in a cold browser, the bytes that were transferred, and the page."""
    context = chromium.new_context(viewport={"width": 1280, "height": 800})
    page = context.new_page()
    began_s = time.monotonic()
    page.goto(server.url)
    page.wait_for_selector("#no-picture", state="hidden", timeout=PATIENCE_S * 1000.0)
    took_s = time.monotonic() - began_s
    page.wait_for_selector("body[data-ready]")
    transferred: int = page.evaluate(
        "performance.getEntriesByType('resource').concat(performance.getEntriesByType('navigation'))"
        ".reduce((sum, e) => sum + e.transferSize, 0)"
    )
    return took_s, transferred, page


def ten_thousand_pins(path: Path, step_deg: float = 1e-6) -> None:
    """Entered ones, a hundred by a hundred, about the simulated flight's first picture."""
    found = rendered_set(0)
    with PinStore(path) as store:
        one = store.add([PinClick.entered(found.camera_lat_deg, found.camera_lon_deg, sigma_m=3.0)])
        many = []
        for k in range(9_999):
            place = found.camera_lat_deg + step_deg * (k % 100), found.camera_lon_deg + step_deg * (k // 100)
            click = PinClick.entered(*place, sigma_m=3.0)
            many.append(
                type(one).from_dict({**one.to_dict(), "id": click.id, "number": k + 2, "clicks": [click.to_dict()]})
            )
        assert store.bring_in(many) == 9_999


def share_of(element: Any, colour: tuple[int, int, int]) -> float:
    """Of an element's pixels, those of a colour, or nearly so."""
    pixels = np.asarray(Image.open(io.BytesIO(element.screenshot())).convert("RGB"), float)
    return float(np.mean(np.max(np.abs(pixels - colour), axis=2) < 12.0))


def grown(page: Any) -> tuple[float, int]:
    """The page's heap in MB and its DOM nodes, after everything that can be let go of is."""
    devtools = page.context.new_cdp_session(page)
    devtools.send("Performance.enable")
    for _ in range(2):
        devtools.send("HeapProfiler.collectGarbage")
    reported = {row["name"]: row["value"] for row in devtools.send("Performance.getMetrics")["metrics"]}
    devtools.detach()
    return reported["JSHeapUsedSize"] / 1e6, int(reported["Nodes"])
