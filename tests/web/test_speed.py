"""How long an operator waits. Bounds are some times the goals: `python -m benchmarks.web` measures those."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.web.conftest import page_is_built
from tests.web.measured import first_page_s, opened, press_to_answer_ms, ten_thousand_pins
from tests.web.rendered import record_rendered
from tests.web.served import Server

pytestmark = [pytest.mark.wall_clock, pytest.mark.xdist_group("web")]
TRIES = 3  # at most: the machine may have other work in one of them


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    page_is_built()
    folder = tmp_path_factory.mktemp("speed")
    record_rendered(folder / "drawn.mcap")
    ten_thousand_pins(folder / "pins.sqlite")
    running = Server("--from", folder / "drawn.mcap", "--pins", folder / "pins.sqlite")
    yield running
    running.close()


@pytest.fixture
def bare_server(tmp_path: Path) -> Iterator[Server]:
    record_rendered(tmp_path / "drawn.mcap")
    running = Server("--from", tmp_path / "drawn.mcap", "--pins", tmp_path / "pins.sqlite")
    yield running
    running.close()


def test_the_first_page_comes_soon_and_an_answer_at_once(bare_server: Server, chromium: Any) -> None:
    for _ in range(TRIES):
        took_s, transferred, page = first_page_s(chromium, bare_server)
        times = press_to_answer_ms(page, 40)
        nodes = page.evaluate("() => document.querySelectorAll('*').length")
        page.context.close()
        if took_s < 4.0 and times[20] < 200.0 and times[38] < 1000.0:
            break
    print(f"\nfirst page {took_s:.2f} s, {transferred} bytes")
    print(f"press to answer: median {times[20]:.1f} ms, 95 % {times[38]:.1f} ms")
    assert took_s < 4.0  # goal: 1
    assert transferred < 3_000_000
    assert times[20] < 200.0  # goal: 95 % under 50
    assert times[38] < 1000.0
    assert nodes < 3000


@pytest.mark.long
def test_ten_thousand_pins_leave_a_click_quick(server: Server, chromium: Any) -> None:
    page = opened(chromium, server.url)
    page.wait_for_function("() => document.querySelector('#pin-count').textContent === '10000'")
    for seed in range(TRIES):
        times = press_to_answer_ms(page, 20, seed)
        if times[10] < 250.0 and times[19] < 1500.0:
            break
    rows = page.evaluate("() => document.querySelectorAll('[data-testid=pin]').length")
    page.context.close()
    print(f"\nwith 10,000 pins: median {times[10]:.1f} ms, 95 % {times[19]:.1f} ms")
    assert times[10] < 250.0  # goal: under 100
    assert times[19] < 1500.0
    assert 3 < rows < 60  # those in sight
