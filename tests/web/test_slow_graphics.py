"""Where drawing the map takes long, the map rests: what is clicked is the picture."""

from pathlib import Path
from typing import Any

import pytest

from tests.web.conftest import page_is_built
from tests.web.flying import Flight
from tests.web.measured import SMALL
from tests.web.served import PATIENCE_S

pytestmark = pytest.mark.xdist_group("web: a flight in motion")

PICTURES, EVERY_MS, DRAWING_MS = 60, 200, 700
LONGEST_REST_S = 4.0

# Graphics that take so long for what they are given; and the moments at which something was rendered, in `shownAt`.
_SLOW = """tookMs => {
  const kind = WebGL2RenderingContext.prototype, given = new WeakMap();
  const { fenceSync, getSyncParameter, drawElements } = kind;
  window.shownAt = [];
  kind.fenceSync = function (...a) {
    const made = fenceSync.apply(this, a);
    given.set(made, performance.now());
    return made;
  };
  kind.getSyncParameter = function (sync, what) {
    return performance.now() - given.get(sync) < tookMs ? this.UNSIGNALED : getSyncParameter.call(this, sync, what);
  };
  kind.drawElements = function (...a) { window.shownAt.push(performance.now()); return drawElements.apply(this, a); };
}"""


@pytest.mark.long
def test_a_map_that_renders_slowly_is_rendered_seldom_and_shows_the_last_picture_at_last(
    tmp_path: Path, chromium: Any
) -> None:
    page_is_built()
    context = chromium.new_context(viewport={"width": SMALL[0], "height": SMALL[1]})
    with Flight(tmp_path / "pins.sqlite") as flight:
        page = context.new_page()
        page.set_default_timeout(PATIENCE_S * 1000.0)
        page.add_init_script(f"({_SLOW})({DRAWING_MS})")
        flight.source.fly_to(1)
        page.goto(flight.url)
        page.wait_for_function("() => window.shownAt.length > 0")
        page.wait_for_timeout(5000)  # what the start draws
        began_ms = page.evaluate("performance.now()")
        for count in range(2, PICTURES):
            flight.source.fly_to(count)
            page.wait_for_timeout(EVERY_MS)
        simulated_ms = page.evaluate("performance.now()")
        page.wait_for_function("t => window.shownAt.at(-1) > t", arg=simulated_ms)
        drawn_ms = page.evaluate("window.shownAt")
        context.close()
    times = [t for t in drawn_ms if began_ms < t < simulated_ms]
    drawings = sum(b - a > 1000.0 for a, b in zip([0.0, *times], times, strict=False))
    assert 1 <= drawings <= (simulated_ms - began_ms) / 1000.0 / LONGEST_REST_S + 2.0
    assert len({round(t / 100.0) for t in times}) <= 8 * drawings  # of each a few frames
